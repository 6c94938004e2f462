# SPDX-License-Identifier: Apache-2.0
"""A real Blender with the add-on installed, to be used as a person uses it: mouse, keys, eyes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from window.screen import HEIGHT, WIDTH, Screen

TAB = "RobIR"
STEP = 14  # pixels between two places where the sidebar is probed; its lowest rows are 18 high

# where across the sidebar it is probed: fields, names of fields, the small buttons of a row
COLUMNS = (0.55, 0.3, 0.93, 0.85, 0.77)

SCROLL = 40  # notches of the wheel that bring the sidebar from one end to the other

PATIENCE = 300.0  # seconds that Blender may take over what a processor draws

# what lies under the mouse: the Python of its operator, or the path of its property
PROBE = """
manager = bpy.context.window_manager
area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
region = next(r for r in area.regions if r.type == "UI")
manager.clipboard = ""
with bpy.context.temp_override(window=window, area=area, region=region):
    if bpy.ops.ui.copy_python_command_button.poll():
        bpy.ops.ui.copy_python_command_button()
    elif bpy.ops.ui.copy_data_path_button.poll():
        bpy.ops.ui.copy_data_path_button(full_path=True)
answer = manager.clipboard
"""

# what F3 does; a virtual keyboard has no such key
SEARCH = """
area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
region = next(r for r in area.regions if r.type == "WINDOW")
with bpy.context.temp_override(window=window, area=area, region=region):
    bpy.ops.wm.search_menu("INVOKE_DEFAULT")
"""


@dataclass(frozen=True)
class Place:
    """A pixel of the screen, from the left and the top."""

    x: int
    y: int


class BlenderFault(Exception):
    """Code that ran inside Blender raised; the message is its traceback."""


class BlenderWindow:
    """One Blender process on one virtual screen.

    Args:
        screen: where it appears.
        home: folder that takes the place of the user's own; preferences live there.
        pictures: folder of the screenshots; what Blender prints goes into blender.log beside it.
    """

    # where controls were found in this or an earlier window: it is looked there first
    _found: ClassVar[dict[str, Place]] = {}

    def __init__(self, screen: Screen, home: Path, pictures: Path) -> None:
        self.screen = screen
        self.pictures = pictures
        self._home = home
        self._log = pictures.parent / "blender.log"
        self._control = home / "control"
        for folder in (self._control, pictures):
            folder.mkdir(parents=True, exist_ok=True)
        self._process: subprocess.Popen[bytes] | None = None
        self._taken = 0

    def start(self, blend: Path | None = None) -> None:
        """Open the window and wait until it answers."""
        for left_over in self._control.iterdir():
            left_over.unlink()
        command = ["blender", "--no-window-focus", "-p", "0", "0", str(WIDTH), str(HEIGHT)]
        command += [str(blend)] if blend else []
        command += ["--python", str(Path(__file__).with_name("control.py"))]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                command, env=self._environment(), stdout=log, stderr=log, start_new_session=True
            )
        self.run(
            "for area in window.screen.areas:\n"
            "    if area.type == 'VIEW_3D': area.spaces.active.show_region_ui = True",
            timeout=90,
        )
        time.sleep(1.0)
        self._show_tab()

    def choose_engine(self, python: Path = Path(sys.executable)) -> None:
        """Take a Python as the engine, here and in windows opened later."""
        self.run(
            "import bl_ext.user_default.robir as addon\n"
            "chosen = bpy.context.preferences.addons[addon.__name__].preferences\n"
            "chosen.engine = 'EXISTING'\n"
            f"chosen.python = {str(python)!r}\n"
            "bpy.ops.wm.save_userpref()"
        )

    @property
    def pid(self) -> int:
        """Blender's process."""
        assert self._process is not None
        return self._process.pid

    def run(self, code: str, timeout: float = 90.0) -> Any:
        """Run code inside Blender between two events; what it assigns to `answer` comes back."""
        request, answer = self._control / "request.py", self._control / "answer.json"
        answer.unlink(missing_ok=True)
        temporary = self._control / "request.part"
        temporary.write_text(code, encoding="utf-8")
        temporary.replace(request)
        end = time.monotonic() + timeout
        while not answer.exists():
            if self._process is not None and self._process.poll() is not None:
                raise BlenderFault(f"Blender ended with {self._process.returncode}: {self.log()}")
            if time.monotonic() > end:
                raise TimeoutError(f"Blender has not answered for {timeout:.0f} s")
            time.sleep(0.01)
        said = json.loads(answer.read_text(encoding="utf-8"))
        if "fault" in said:
            raise BlenderFault(said["fault"])
        return said["answer"]

    def get(self, expression: str) -> Any:
        """The value of a Python expression inside Blender."""
        return self.run(f"answer = {expression}")

    def wait_until(self, expression: str, timeout: float = 120.0) -> float:
        """Wait until an expression is true inside Blender; returns the seconds it took."""
        start = time.monotonic()
        while not self.get(f"bool({expression})"):
            if time.monotonic() - start > timeout:
                raise TimeoutError(f"after {timeout:.0f} s still not so: {expression}")
            # a long wait need not be told to the tenth of a second: every question costs Blender
            time.sleep(min(0.5, 0.05 + 0.02 * (time.monotonic() - start)))
        return time.monotonic() - start

    def settle(self) -> None:
        """Wait until Blender has drawn what it was told; shaders take a processor a minute."""
        for _ in range(2):
            time.sleep(3.0)
            self.run("answer = None", timeout=PATIENCE)

    def sidebar(self) -> tuple[int, int, int, int]:
        """Left, top, right and bottom of the sidebar on the screen, tabs left out."""
        x, y, width, height = self.run(
            "area = next(a for a in window.screen.areas if a.type == 'VIEW_3D')\n"
            "region = next(r for r in area.regions if r.type == 'UI')\n"
            "answer = [region.x, region.y, region.width, region.height]"
        )
        window_height = self.get("window.height")
        return x, window_height - y - height, x + width - 22, window_height - y

    def find(self, wanted: str, *, is_scrolled: bool = True) -> Place:
        """A pixel of a control in the sidebar, found by moving the mouse over it.

        Args:
            wanted: How its Python begins: `bpy.ops.robir.reconstruct` for a button, or the end of
                a property's path, `robir.texture`.
            is_scrolled: Whether the sidebar may be scrolled until it is seen.

        Returns:
            Where it lies.
        """
        left, top, right, bottom = self.sidebar()
        columns = [left + int(share * (right - left)) for share in COLUMNS]
        near = self._found.get(wanted, Place(columns[0], top))
        ys = sorted(range(top + STEP, bottom - 2, STEP), key=lambda y: abs(y - near.y))
        seen: set[str] = set()
        for notches in (0, -SCROLL, SCROLL // 2, SCROLL // 2) if is_scrolled else (0,):
            if notches:
                self.screen.scroll(left + 40, (top + bottom) // 2, notches=notches)
            for x in sorted(columns, key=lambda x: x != near.x):
                for y in ys:
                    name = self._under(Place(x, y))
                    if name.startswith(wanted) or name.endswith(wanted):
                        self._found[wanted] = Place(x, y)
                        return self._found[wanted]
                    seen.add(name)
        raise LookupError(f"no {wanted} in the sidebar, but {sorted(seen)}")

    def press(self, wanted: str) -> float:
        """Click a control of the sidebar; returns the time (`time.monotonic`) of the click."""
        place = self.find(wanted)
        self.screen.click(place.x, place.y)
        return time.monotonic()

    def press_in_menu(self, beside: str, letter: str) -> None:
        """Choose from the menu at the right end of a control's row, by its underlined letter."""
        left, _, right, _ = self.sidebar()
        self.screen.click(left + int(COLUMNS[2] * (right - left)), self.find(beside).y)
        time.sleep(0.8)
        self.screen.key(letter)

    def search(self, words: str) -> None:
        """Do what Blender's search finds first; a search belongs to the editor under the mouse."""
        place = self.view_centre()
        self.screen.move(place.x, place.y)
        time.sleep(0.4)
        self.run(SEARCH)
        time.sleep(2.5)  # letters that come before its field is open are lost
        self.screen.write(words)
        time.sleep(2.5)
        self.picture(f"searched_{words.replace(' ', '_')}")
        self.screen.key("Return")
        time.sleep(1.5)

    def _under(self, place: Place) -> str:
        self.screen.move(place.x, place.y)
        time.sleep(0.04)
        return self.run(PROBE)

    def view_centre(self) -> Place:
        """A pixel in the middle of the 3D viewport."""
        x, y, width, height = self.run(
            "area = next(a for a in window.screen.areas if a.type == 'VIEW_3D')\n"
            "region = next(r for r in area.regions if r.type == 'WINDOW')\n"
            "answer = [region.x, region.y, region.width, region.height]"
        )
        return Place(x + width // 3, self.get("window.height") - y - height // 2)

    def picture(self, name: str) -> Path:
        """Save a screenshot, numbered in the order of taking."""
        self._taken += 1
        time.sleep(0.4)
        return self.screen.save(self.pictures / f"{self._taken:02d}_{name}.png")

    def leave_other_windows(self) -> None:
        """Close all windows but the first, as there is no window manager with a button for it."""
        self.run(
            "for other in list(bpy.context.window_manager.windows)[1:]:\n"
            "    with bpy.context.temp_override(window=other):\n"
            "        bpy.ops.wm.window_close()"
        )

    def log(self) -> str:
        """The end of what Blender wrote to its console."""
        return self._log.read_text(encoding="utf-8", errors="replace")[-3000:]

    def kill(self) -> None:
        """kill -9: Blender alone, nothing it has started."""
        assert self._process is not None
        os.kill(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._process = None

    def quit(self) -> None:
        """Leave Blender in an orderly way."""
        if self._process is None:
            return
        self.run(
            "def leave():\n"
            "    bpy.ops.wm.quit_blender()\n"
            "bpy.app.timers.register(leave, first_interval=0.2)"
        )
        try:
            self._process.wait(90)
        finally:
            self._process.kill()
            self._process = None

    def _show_tab(self) -> None:
        """Bring the add-on's tab to the front, which Blender allows once the sidebar was drawn."""
        self.run(
            "area = next(a for a in window.screen.areas if a.type == 'VIEW_3D')\n"
            "region = next(r for r in area.regions if r.type == 'UI')\n"
            f"region.active_panel_category = {TAB!r}\n"
            "area.tag_redraw()"
        )
        time.sleep(0.5)

    def _environment(self) -> dict[str, str]:
        own = {
            "HOME": str(self._home),
            "ROBIR_WINDOW_CONTROL": str(self._control),
            "LANG": "C.UTF-8",
        }
        return {**self.screen.environment(), **own}
