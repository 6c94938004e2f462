# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine: the Python, apart from Blender's, that the reconstruction runs in.

Either RobIR makes and keeps one in a folder of its own, or the user names one that exists. Nothing
here imports Blender, and nothing ever installs into Blender's Python.
"""

from pathlib import Path

CAN_INSTALL = Path(__file__).with_name("install.py").is_file()  # else one that is there is used
