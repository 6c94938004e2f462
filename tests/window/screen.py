# SPDX-License-Identifier: Apache-2.0
"""A virtual screen with a mouse, a keyboard and a camera."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

WIDTH, HEIGHT = 1440, 1000


class Screen:
    """An X server without hardware; mouse and keyboard events come from xdotool.

    Attributes:
        display: The server's name, :1 for example.
        clicks: How often something was clicked or dropped.
    """

    def __init__(self) -> None:
        self.clicks = 0
        command = ["Xvfb", "-displayfd", "1", "-screen", "0", f"{WIDTH}x{HEIGHT}x24"]
        self._server = subprocess.Popen(
            [*command, "-nolisten", "tcp"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        assert self._server.stdout is not None
        with self._server.stdout as answer:  # comes when the screen is ready
            self.display = f":{int(answer.readline())}"

    def move(self, x: int, y: int) -> None:
        """Put the mouse at a pixel, from the left and the top of the screen."""
        self._xdotool("mousemove", str(x), str(y))

    def click(self, x: int, y: int) -> None:
        """Move there, give Blender time to see what is under the mouse, and click."""
        self.move(x, y)
        time.sleep(0.4)
        self.clicks += 1
        self._xdotool("click", "1")

    def scroll(self, x: int, y: int, *, notches: int) -> None:
        """Turn the wheel at a pixel, downwards if positive."""
        self.move(x, y)
        wheel = "5" if notches > 0 else "4"
        self._xdotool("click", "--repeat", str(abs(notches)), "--delay", "60", wheel)
        time.sleep(0.5)

    def key(self, name: str) -> None:
        """Press and release one key, by its X name: Return, Escape, ctrl+z."""
        self._xdotool("key", name)

    def write(self, text: str) -> None:
        """Type letters one by one."""
        self._xdotool("type", "--delay", "60", text)

    def drop(self, path: Path, x: int, y: int) -> None:
        """Drag a file from another program and let go of it at a pixel."""
        self.clicks += 1
        source = Path(__file__).with_name("drag.py")
        self._run("/usr/bin/python3", str(source), path.as_uri(), str(x), str(y))

    def save(self, picture: Path) -> Path:
        """Write what the screen shows now as a PNG."""
        self._run("import", "-window", "root", "-strip", str(picture))
        return picture

    def close(self) -> None:
        """Switch it off, and everything on it."""
        self._server.terminate()
        self._server.wait()

    def _xdotool(self, *words: str) -> None:
        self._run("xdotool", *words)

    def _run(self, *words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            words, env=self.environment(), capture_output=True, text=True, check=False, timeout=60
        )
        if check and done.returncode != 0:
            raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")
        return done

    def environment(self) -> dict[str, str]:
        """The environment of a program that is to appear here."""
        return {**os.environ, "DISPLAY": self.display, "LIBGL_ALWAYS_SOFTWARE": "1"}
