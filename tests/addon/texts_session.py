# SPDX-License-Identifier: Apache-2.0
"""Names and descriptions that the registered add-on has told Blender, with Blender's contexts.

Runs inside Blender after the text of recording.py, whose names it uses.
"""

import sys

import bpy
from recording import classes_of  # taken out before it runs

MODULE = "bl_ext.user_default.robir"
ANY = "*"


def main(archive):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True
    )
    return sorted(registered(MODULE))


def registered(module):
    """(context, text, who) of everything with a name that a user can see."""
    for base in (bpy.types.Panel, bpy.types.Menu, bpy.types.FileHandler):
        for name, cls in classes_of(module, base).items():
            yield ANY, cls.bl_label, name
            yield ANY, getattr(cls, "bl_category", ""), name
    for name in dir(bpy.ops.robir):
        rna = getattr(bpy.ops.robir, name).get_rna_type()
        yield rna.translation_context, rna.name, name
        yield ANY, rna.description, name
        yield from properties(rna)
    preferences = sys.modules[f"{module}.preferences"].ROBIR_AP_preferences
    yield from properties(preferences.bl_rna)
    yield from properties(bpy.context.scene.robir.bl_rna)


def properties(rna):
    """Of the add-on's own properties that are shown, and of what they hold."""
    inherited = {prop.identifier for prop in rna.base.properties} if rna.base else set()
    for prop in rna.properties:
        if prop.is_hidden or prop.identifier in inherited:
            continue
        who = f"{rna.identifier}.{prop.identifier}"
        yield prop.translation_context, prop.name, who
        yield ANY, prop.description, who
        for item in getattr(prop, "enum_items", ()):
            yield prop.translation_context, item.name, f"{who} {item.identifier}"
            yield ANY, item.description, f"{who} {item.identifier}"
        held = getattr(prop, "fixed_type", None)
        if held is not None and held.identifier.startswith("ROBIR_"):
            yield from properties(held)
