# SPDX-License-Identifier: Apache-2.0
"""A layout that draws nothing, writes down what was asked of it, and refuses what does not exist.

What exists is asked from Blender: functions, their parameters and properties of `UILayout`,
operators, menus, panels, and the properties of whatever is to be shown. Runs inside Blender, where
nothing of the checkout can be imported; so this file's text is put in front of a test's script.
"""

import types

import bpy

_LAYOUT = bpy.types.UILayout.bl_rna
_FUNCTIONS = {function.identifier: function for function in _LAYOUT.functions}
_INNER = ("row", "column", "column_flow", "grid_flow", "box", "split", "menu_pie")


class Fault(Exception):
    """Something that a real layout would not draw, or would draw as an error."""


class Recorder:
    """Stands in for a `UILayout`.

    Attributes:
        calls: (function, arguments by name) in the order of drawing, shared with inner layouts.
        is_open: Whether sub-panels are drawn open.
        room: Width of a line, points.
        wide: Texts that are cut off, shared with inner layouts.
    """

    def __init__(self, outer=None, is_open=True, room=240.0):
        calls, wide = ([], []) if outer is None else (outer.calls, outer.wide)
        self.__dict__.update(calls=calls, wide=wide, is_open=is_open, room=room)

    def __setattr__(self, name, value):
        prop = _LAYOUT.properties.get(name)
        if prop is None:
            raise Fault(f"a layout has no property {name!r}")
        if prop.type == "ENUM" and value not in prop.enum_items:
            raise Fault(f"layout.{name} cannot be {value!r}")

    def __getattr__(self, name):
        if name not in _FUNCTIONS:
            raise Fault(f"a layout has no function {name!r}")
        return lambda *values, **named: self._call(_FUNCTIONS[name], values, named)

    def _call(self, function, values, named):
        parameters = [p for p in function.parameters if not p.is_output]
        if len(values) > len(parameters):
            raise Fault(f"{function.identifier}() got {len(values)} values")
        given = dict(zip((p.identifier for p in parameters), values, strict=False)) | named
        for unknown in given.keys() - {p.identifier for p in parameters}:
            raise Fault(f"{function.identifier}() has no parameter {unknown!r}")
        for parameter in parameters:
            _check_argument(function, parameter, given)
        self.calls.append((function.identifier, given))
        icon = 20.0 if given.get("icon", "NONE") != "NONE" else 0.0
        if function.identifier == "label" and text_width(given["text"]) + icon > self.room:
            self.wide.append(given["text"])
        check = globals().get(f"_check_{function.identifier}")
        answer = check(given) if check else None
        if function.identifier in _INNER:
            narrower = 14.0 if function.identifier == "box" else 0.0
            return Recorder(self, self.is_open, self.room - narrower)
        if function.identifier in ("panel", "panel_prop"):
            body = Recorder(self, self.is_open, self.room) if self.is_open else None
            return Recorder(self, self.is_open, self.room), body
        return answer

    def texts(self):
        """Everything that a user would read, buttons with their operators' names."""
        said = []
        for function, given in self.calls:
            text = given.get("text")
            if function == "operator" and text is None:
                text = _operator(given["operator"]).name
            said.append(text or "")
        return [text for text in said if text]

    def pictures(self):
        """How many large icons are drawn."""
        return sum(function == "template_icon" for function, _ in self.calls)

    def controls(self):
        """How many things can be pressed or set."""
        kinds = ("operator", "prop", "menu", "template_icon_view", "template_list")
        return sum(function in kinds for function, _ in self.calls)

    def operators(self):
        """Names of the operators that can be pressed, those in menus too."""
        names = []
        for _, given in self.calls:
            names += [given["operator"]] if "operator" in given else []
            if "menu" in given:
                menu = Drawn(getattr(bpy.types, given["menu"]), self.is_open)
                names += menu.draw_all(bpy.context).operators()
        return names


class OperatorButton:
    """What `layout.operator` returns: takes the operator's own properties."""

    def __init__(self, rna):
        self.__dict__["_rna"] = rna

    def __setattr__(self, name, value):
        if name not in self._rna.properties:
            raise Fault(f"operator {self._rna.identifier} has no property {name!r}")


def _check_argument(function, parameter, given):
    name = parameter.identifier
    if name not in given:
        if parameter.is_required:
            raise Fault(f"{function.identifier}() lacks {name!r}")
        return
    value = given[name]
    if parameter.type == "ENUM" and not parameter.is_enum_flag:
        if value not in parameter.enum_items:
            raise Fault(f"{function.identifier}(): no {name} is named {value!r}")
    elif parameter.type == "STRING" and not isinstance(value, str):
        raise Fault(f"{function.identifier}(): {name} is {value!r}, not text")


def _operator(identifier):
    family, _, name = identifier.partition(".")
    try:
        return getattr(getattr(bpy.ops, family), name).get_rna_type()
    except (AttributeError, KeyError):
        raise Fault(f"no operator is named {identifier!r}") from None


def _property(data, name):
    if not isinstance(data, bpy.types.bpy_struct):
        raise Fault(f"{data!r} has no properties to show")
    if name not in data.bl_rna.properties:
        raise Fault(f"{data.bl_rna.identifier} has no property {name!r}")


def _check_operator(given):
    return OperatorButton(_operator(given["operator"]))


def _check_operator_menu_enum(given):
    rna = _operator(given["operator"])
    found = rna.properties.get(given["property"])
    if found is None or found.type != "ENUM":
        raise Fault(f"operator {given['operator']} has no choice named {given['property']!r}")
    return OperatorButton(rna)


def _check_prop(given):
    _property(given["data"], given["property"])


def _check_menu(given):
    if not issubclass(getattr(bpy.types, given["menu"], object), bpy.types.Menu):
        raise Fault(f"no menu is named {given['menu']!r}")


def _check_popover(given):
    if not issubclass(getattr(bpy.types, given["panel"], object), bpy.types.Panel):
        raise Fault(f"no panel is named {given['panel']!r}")


def _check_icon(given):
    return 1


class Drawn:
    """A panel or menu as its own methods see it, with a recorder for a layout."""

    def __init__(self, cls, is_open=True):
        self._cls, self.layout = cls, Recorder(is_open=is_open)

    def __getattr__(self, name):
        found = getattr(self._cls, name)
        return types.MethodType(found, self) if isinstance(found, types.FunctionType) else found

    def draw_all(self, context):
        """Draw header and body; returns the recorder."""
        for part in ("draw_header", "draw_header_preset", "draw"):
            if hasattr(self._cls, part):
                getattr(self, part)(context)
        return self.layout


def text_width(text):
    """Width in points at Blender's own size of text."""
    import blf  # found once bpy was imported

    blf.size(0, bpy.context.preferences.ui_styles[0].widget.points)
    return blf.dimensions(0, text)[0]


def classes_of(module, base):
    """Registered classes of an extension that derive from a Blender type, by name."""
    found = (getattr(bpy.types, name) for name in dir(bpy.types))
    return {
        cls.__name__: cls
        for cls in found
        if isinstance(cls, type) and issubclass(cls, base) and cls.__module__.startswith(module)
    }
