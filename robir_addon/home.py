# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension is called here, where its code lies, and its own folder beside that."""

from pathlib import Path

import bpy

ADDON = __package__  # name under which Blender knows the extension
CODE = Path(__file__).parent


def own_folder(*, create: bool) -> Path | None:
    """Where what updates leave alone lies; None where RobIR runs from a checkout."""
    try:
        return Path(bpy.utils.extension_path_user(ADDON, create=create))
    except ValueError:
        return None
