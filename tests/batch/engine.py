# SPDX-License-Identifier: Apache-2.0
"""Stands for the engine where only its life matters: python engine.py TEMPLATE reconstruct ...

It copies a finished result into OUT, or does what the file `act` of the capture says. It knows the
files of a result folder but nothing of robir, so that it starts in a hundredth of a second.
"""

import fcntl
import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path

STAGES = ("capture", "geometry", "transport", "appearance", "export")


def status(out, state, message, code):
    known = {
        "state": state, "stage": "geometry", "fraction": 1.0 if state == "done" else 0.5,
        "message": message, "seconds_left": None, "exit_code": code, "pid": os.getpid(),
        "heartbeat": time.time(), "metrics": {},
    }  # fmt: skip
    half = out / ".status"
    half.write_text(json.dumps(known))
    half.replace(out / "status.json")


def note(out, word):
    """Write down a word and when; the number of lines there are."""
    with (out / "log.txt").open("a+") as log:
        log.write(f"{word} {time.time()}\n")
        log.seek(0)
        return len(log.readlines())


def ending(out, code, message):
    status(out, "failed", message, code)
    sys.exit(code)


def main():
    template, act = sys.argv[1], Path(sys.argv[3], "act").read_text()
    if act == "really":
        os.execv(sys.executable, [sys.executable, "-P", "-m", "robir", *sys.argv[2:]])
    out = Path(sys.argv[sys.argv.index("-o") + 1])
    lock = os.open(out / "lock", os.O_RDWR | os.O_CREAT, 0o644)
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    os.write(lock, f"{os.getpid()}\n".encode())
    starts = note(out, "start")
    status(out, "running", "at work", None)
    signal.signal(signal.SIGTERM, lambda *_: ending(out, 130, "stopped by SIGTERM"))
    kind, _, what = act.partition(" ")
    if kind == "wait":  # until somebody makes the file
        while not Path(what).exists():
            time.sleep(0.02)
    elif kind == "sleep":
        time.sleep(float(what))
    elif kind == "refuse":
        ending(out, 3, what)
    elif kind == "break":
        ending(out, 1, what)
    elif kind == "die" and starts == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if "--until" in sys.argv:
        until = sys.argv[sys.argv.index("--until") + 1]
        for stage in STAGES[: STAGES.index(until) + 1]:
            shutil.copytree(
                f"{template}/stages/{stage}", out / "stages" / stage, dirs_exist_ok=True
            )
        if until != STAGES[-1]:
            run = json.loads(Path(template, "run.json").read_text())
            (out / "run.json").write_text(json.dumps(run | {"state": "running"}))
            note(out, f"end of {until} on {sys.argv[sys.argv.index('--device') + 1]}")
            status(out, "cancelled", f"{until} is done", 0)
            return
    shutil.copytree(template, out, dirs_exist_ok=True)
    note(out, "end")
    status(out, "done", "finished", 0)


main()
