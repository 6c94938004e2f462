# SPDX-License-Identifier: Apache-2.0
"""What test_german.py has done in a Blender that speaks German.

Runs inside Blender after the texts of recording.py, panel_session.py and texts_session.py, whose
names it uses.
"""

from importlib import import_module

import bpy
from panel_session import STATES, in_state, panels, refusals  # taken out before it runs
from recording import Drawn, text_width  # taken out before it runs
from texts_session import registered  # taken out before it runs

MODULE = "bl_ext.user_default.robir"
SAID = ("message", "error", "error_cure", "recognised", "engine_text")
ROOM = 240.0  # points of a line in a narrow sidebar, as in recording.py

WIDE = set()  # labels and buttons that would be cut off; sentences are broken into lines

TRANSLATED = ("label", "operator", "operator_menu_enum", "prop", "progress", "menu")


def main(archive, result):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True
    )
    speak("de_DE")
    # one line a sentence, however narrow a panel may be
    import_module(f"{MODULE}.paragraphs")._WIDTH_WITHOUT_REGION = 100000
    answer = {
        "seen": {name: seen_in(name, result) for name in STATES},
        "refusals": refusals(),
        "names": [(*known, look_up(known[1], known[0])) for known in registered(MODULE)],
        "reports": reports(),
    }
    answer["wide"] = sorted(WIDE)
    speak("en_US")
    answer["english"] = seen_in("lacking", result)
    return answer


def speak(language):
    view = bpy.context.preferences.view
    view.language = language
    view.use_translate_interface = view.use_translate_tooltips = True
    view.use_translate_reports = True


def look_up(text, context):
    return bpy.app.translations.pgettext(text, context)


def seen_in(state, result):
    """What a user reads in every panel that is there, but for what the session itself said."""
    in_state(state, result)
    manager = bpy.context.window_manager.robir
    own = {getattr(manager, name) for name in SAID}
    own |= {part for found in manager.findings for part in (found.text, found.cure)}
    texts = []
    for cls in panels().values():
        if hasattr(cls, "poll") and not cls.poll(bpy.context):
            continue
        texts.append(look_up(cls.bl_label, "*"))
        for function, given in Drawn(cls).draw_all(bpy.context).calls:
            if function in TRANSLATED:
                texts.append(shown(function, given))
                is_whole = function in ("label", "operator") and given.get("translate", True)
                if is_whole and text_width(texts[-1] or "") > ROOM:
                    WIDE.add(texts[-1])
    return [text for text in texts if text and text not in own]


def shown(function, given):
    """As Blender's own layout looks a text up."""
    text, is_ours = given.get("text"), given.get("translate", True)
    if function in ("operator", "operator_menu_enum"):
        family, _, name = given["operator"].partition(".")
        rna = getattr(getattr(bpy.ops, family), name).get_rna_type()
        return look_up(rna.name if text is None else text, rna.translation_context)
    if function == "prop" and text is None:
        prop = given["data"].bl_rna.properties[given["property"]]
        return look_up(prop.name, prop.translation_context)
    return look_up(text, "*") if text and is_ours else text


def reports():
    """What operators report when they refuse, as Blender hands it on, and as the panel says it."""
    in_state("nothing", "")
    words, said = import_module(f"{MODULE}.words"), {}
    for name, call in (
        ("choose_capture", lambda: bpy.ops.robir.choose_capture(directory="/nowhere")),
        ("import_result", lambda: bpy.ops.robir.import_result(directory="/nowhere")),
    ):
        try:
            call()
        except RuntimeError as fault:
            state = bpy.context.window_manager.robir
            said[name] = [str(fault).strip(), words.reported(fault), state.error, state.error_cure]
    return said
