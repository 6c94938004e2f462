# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own Cube and Light, which stand in every new file where the object is to stand.

Whoever opens Blender and drops a capture has them in the scene: the cube hides the object, and the
light shines on it. As long as nobody has touched them they are hidden, not removed.
"""

import bpy

_ASIDE = "robir_aside"  # custom property of what was hidden here
_LIGHT_AT = (4.076, 1.005, 5.904)
_LIGHT_WATTS = 1000.0


def put_aside(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> list[str]:
    """Hide the untouched Cube and Light of Blender's startup file; their names."""
    names = []
    for obj in scene.objects:
        if obj.name not in view_layer.objects or not (_is_cube(obj) or _is_light(obj)):
            continue
        if obj.hide_render or obj.hide_get(view_layer=view_layer):
            continue
        obj.hide_set(True, view_layer=view_layer)
        obj.hide_render = True
        obj[_ASIDE] = True
        names.append(obj.name)
    return names


def bring_back(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> None:
    """Show again what `put_aside` has hidden."""
    for obj in scene.objects:
        if _ASIDE in obj:
            del obj[_ASIDE]
            obj.hide_render = False
            if obj.name in view_layer.objects:
                obj.hide_set(False, view_layer=view_layer)


def _is_cube(obj: bpy.types.Object) -> bool:
    if obj.type != "MESH" or obj.name != "Cube" or obj.modifiers or not _is_at(obj, (0, 0, 0)):
        return False
    vertices = obj.data.vertices
    return len(vertices) == 8 and all(abs(x) == 1.0 for v in vertices for x in v.co)


def _is_light(obj: bpy.types.Object) -> bool:
    if obj.type != "LIGHT" or obj.name != "Light" or not _is_at(obj, _LIGHT_AT):
        return False
    return obj.data.type == "POINT" and abs(obj.data.energy - _LIGHT_WATTS) < 1e-3


def _is_at(obj: bpy.types.Object, place: tuple[float, float, float]) -> bool:
    unscaled = all(abs(s - 1.0) < 1e-5 for s in obj.scale)
    return unscaled and all(abs(a - b) < 1e-3 for a, b in zip(obj.location, place, strict=True))
