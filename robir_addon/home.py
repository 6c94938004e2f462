# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's own folder, which updates leave alone."""

from pathlib import Path

import bpy


def own_folder(*, create: bool) -> Path | None:
    """Where it is; None where RobIR runs from a checkout.

    Args:
        create: Whether it is made if it is missing.
    """
    try:
        return Path(bpy.utils.extension_path_user(__package__, create=create))
    except ValueError:
        return None
