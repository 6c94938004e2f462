# SPDX-License-Identifier: Apache-2.0
"""A real Chromium without a window, what it is served, and what its pages say."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = os.environ.get("ROBIR_CHROMIUM") or next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None,
    reason="NOT TRIED IN A BROWSER: no Chromium; install one or name it in ROBIR_CHROMIUM",
)

# nothing of its own over the network; WebGL by the processor
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
    *("--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--enable-logging=stderr"),
)
# what the report's viewer itself writes into the console; no fault
NOTICES = ("RGBELoader has been deprecated", "GPU stall", "rAF timed out in updateSource")

# a page says what it found by `say(found)`; until then its picture keeps the browser waiting
SAY = """<script>
const say = found => fetch("/said", {method: "POST", body: JSON.stringify(found)});
</script><img src="/wait" alt="" hidden>"""


@dataclass(frozen=True)
class Visit:
    """What came of one page."""

    said: Any  # by `say`; None if nothing was said
    faults: list[str]  # lines of the console
    asked: list[str]  # paths that were asked for and not served


def faults_of(address: str, profile: Path) -> list[str]:
    """Open an address; returns what its console complains of."""
    command = [str(CHROMIUM), *FLAGS, "--window-size=500,900", f"--user-data-dir={profile}"]
    done = subprocess.run(
        [*command, "--dump-dom", address], capture_output=True, text=True, timeout=600, check=True
    )
    lines = re.findall(r"CONSOLE.*", done.stderr)
    return [line for line in lines if not any(notice in line for notice in NOTICES)]


def visit(pages: Mapping[str, str], profile: Path) -> Visit:
    """Open the first of some pages, served by their paths, and wait for what it says."""
    server = _Server(pages)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        address = f"http://127.0.0.1:{server.server_port}{next(iter(pages))}"
        faults = faults_of(address, profile)
    finally:
        server.shutdown()
        server.server_close()
    return Visit(server.said, faults, server.asked)


class _Server(ThreadingHTTPServer):
    def __init__(self, pages: Mapping[str, str]) -> None:
        super().__init__(("127.0.0.1", 0), _Answer)
        self.pages, self.asked, self.said, self.done = pages, [], None, threading.Event()


class _Answer(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self):
        if self.path == "/wait":
            self.server.done.wait(90)
        elif self.path not in (*self.server.pages, "/favicon.ico"):
            self.server.asked.append(self.path)
        self._answer(self.server.pages.get(self.path, ""))

    def do_POST(self):
        self.server.said = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self._answer("")
        self.server.done.set()

    def _answer(self, text):
        content = text.encode()
        kind = "text/javascript" if self.path.endswith(".js") else "text/html"
        self.send_response(200)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *args):
        """Not into the tests' output."""
