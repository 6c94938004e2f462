# SPDX-License-Identifier: Apache-2.0
"""Blender that hangs at its end: a stranger's driver dead-locks its exit."""

from pathlib import Path

import pytest

from robir.errors import DeviceError
from robir.export import blender

FAKE = """
import json, os, sys, time
if sys.argv[1] == "told":
    print(json.dumps({"files": ["a.png"], "notes": []}), flush=True)
os.close(1)
time.sleep(60)
"""


def test_blender_that_hangs_at_its_end_is_ended(tmp_path, monkeypatch):
    """What it has reported is done all the same."""
    package = tmp_path / "robir_addon"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "headless.py").write_text(FAKE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(blender, "missing_blender", lambda: None)
    monkeypatch.setattr(blender, "_PATIENCE", 0.5)
    assert blender.run_headless(["told"], lambda f, m: None).files == (Path("a.png"),)
    with pytest.raises(DeviceError):
        blender.run_headless(["mute"], lambda f, m: None)
