# SPDX-License-Identifier: Apache-2.0
"""Files of a result folder: whole or not at all, and readable by others."""

from __future__ import annotations

import json
import os
import threading

import pytest

from robir.jobs.paths import JobPaths, read_json, replacing, write_json
from robir.jobs.status import StatusWriter, read_status


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "run.json"
    write_json(path, {"state": "done"})
    with pytest.raises(ZeroDivisionError), replacing(path) as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError
    assert read_json(path) == {"state": "done"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.json"]


def test_readers_never_see_half_a_file(tmp_path):
    path = tmp_path / "status.json"
    write_json(path, [0] * 2000)
    seen = []
    is_over = threading.Event()

    def read() -> None:
        while not is_over.is_set():
            seen.append(len(read_json(path)))

    reader = threading.Thread(target=read)
    reader.start()
    for number in range(50):
        write_json(path, [number] * 2000)
    is_over.set()
    reader.join()
    assert set(seen) == {2000}


def test_status_and_events_round_trip(tmp_path):
    paths = JobPaths(tmp_path)
    writer = StatusWriter(paths)
    writer.status("running", stage="geometry", fraction=0.5, message="fit", seconds_left=12.34)
    status = read_status(paths.status)
    assert (status.stage, status.fraction, status.seconds_left) == ("geometry", 0.5, 12.3)
    assert (status.pid, status.exit_code) == (os.getpid(), None)
    for index in range(3):
        writer.event("metric", "geometry", name="loss", value=index)
    events = [json.loads(line) for line in paths.events.read_text().splitlines()]
    assert [event["value"] for event in events] == [0, 1, 2]
    assert events[0].keys() == {"time", "kind", "stage", "name", "value"}
