# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine: the Python, apart from Blender's, that the reconstruction runs in.

Either RobIR makes and keeps one in a folder of its own, or the user names one that exists. Nothing
here imports Blender, and nothing ever installs into Blender's Python.
"""

from pathlib import Path

from .errors import EngineError, Sentence
from .places import (
    CHOOSE_EXISTING,
    Facts,
    Place,
    base_python,
    bundled_wheel,
    clean_environment,
    constraints,
    inspect,
    interpreter,
    worker_command,
)
from .states import Status, read_record, status, wheel_version

CAN_INSTALL = Path(__file__).with_name("install.py").is_file()  # else one that is there is used

__all__ = [
    "CAN_INSTALL", "CHOOSE_EXISTING", "EngineError", "Facts", "Place", "Sentence", "Status",
    "base_python", "bundled_wheel", "clean_environment", "constraints", "inspect", "interpreter",
    "read_record", "status", "wheel_version", "worker_command",
]  # fmt: skip
