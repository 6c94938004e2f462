# SPDX-License-Identifier: Apache-2.0
"""A program that drags one file onto a window: `drag.py URI X Y` (the XDND protocol, version 5).

Runs with the python3 that has python-xlib. Ends with 1 if the window does not take the file.
"""

import sys
import time

from Xlib import X, display
from Xlib.protocol import event

VERSION = 5
PATIENCE = 90.0


class Drag:
    """The source's side of one drag."""

    def __init__(self, uri: str) -> None:
        self._uri = uri
        self._display = display.Display()
        self._root = self._display.screen().root
        self._source = self._root.create_window(0, 0, 1, 1, 0, X.CopyFromParent)
        self._type = self._atom("text/uri-list")

    def onto(self, x: int, y: int) -> bool:
        """Drag to a pixel of the screen and let go; whether the target took it."""
        target = self._target(x, y)
        if target is None:
            sys.stderr.write("no window there takes drops\n")
            return False
        self._source.set_selection_owner(self._atom("XdndSelection"), X.CurrentTime)
        self._send(target, "XdndEnter", [VERSION << 24, self._type, 0, 0])
        copy = self._atom("XdndActionCopy")
        for step in (-8, -4, 0):
            position = (x + step) << 16 | y
            self._send(target, "XdndPosition", [0, position, X.CurrentTime, copy])
            if not self._wait_for("XdndStatus"):
                return False
            time.sleep(0.1)
        self._send(target, "XdndDrop", [0, X.CurrentTime, 0, 0])
        return self._wait_for("XdndFinished")

    def _target(self, x: int, y: int) -> object:
        """The innermost window at a pixel that says it takes drops."""
        aware, window, found = self._atom("XdndAware"), self._root, None
        while True:
            child = window.translate_coords(self._root, x, y).child
            if not child:
                return found
            window = child
            if window.get_full_property(aware, X.AnyPropertyType) is not None:
                found = window

    def _wait_for(self, name: str) -> bool:
        wanted, end = self._atom(name), time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if not self._display.pending_events():
                time.sleep(0.02)
                continue
            happened = self._display.next_event()
            if happened.type == X.SelectionRequest:
                self._hand_over(happened)
            elif happened.type == X.ClientMessage and happened.client_type == wanted:
                return True
        sys.stderr.write(f"the window does not answer with {name}\n")
        return False

    def _hand_over(self, request: event.SelectionRequest) -> None:
        """Give the file's address to the target that asks for it."""
        given = request.target == self._type
        if given:
            text = (self._uri + "\r\n").encode()
            request.requestor.change_property(request.property, self._type, 8, text)
        answer = event.SelectionNotify(
            time=request.time,
            requestor=request.requestor,
            selection=request.selection,
            target=request.target,
            property=request.property if given else X.NONE,
        )
        request.requestor.send_event(answer)
        self._display.flush()

    def _send(self, target: object, name: str, numbers: list[int]) -> None:
        message = event.ClientMessage(
            window=target,
            client_type=self._atom(name),
            data=(32, [self._source.id, *numbers]),
        )
        target.send_event(message)
        self._display.flush()

    def _atom(self, name: str) -> int:
        return self._display.intern_atom(name)


if __name__ == "__main__":
    sys.exit(0 if Drag(sys.argv[1]).onto(int(sys.argv[2]), int(sys.argv[3])) else 1)
