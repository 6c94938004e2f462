# SPDX-License-Identifier: Apache-2.0
"""Work side by side: the items' order, the first fault, the cores there are, the same bits."""

from __future__ import annotations

import threading
import time

import pytest
from hostile.tiny_run import contents, words

from robir import cli, workers
from robir.jobs.paths import JobPaths
from robir.specimen import write_specimen
from robir.workers import available_cores, blocks, meanwhile, side_by_side, use_workers


@pytest.fixture(autouse=True)
def _as_many_as_before():
    yield
    use_workers(None)


def test_results_are_in_the_items_order_and_items_run_side_by_side() -> None:
    use_workers(3)
    together = threading.Barrier(3, timeout=120)

    def meet(item: int) -> tuple[int, int]:
        together.wait()  # breaks unless three are at work
        time.sleep(0.01 * (3 - item % 3))
        return item, len(side_by_side(str, range(2)))  # inside, one after the other

    assert side_by_side(meet, range(6)) == [(item, 2) for item in range(6)]


def test_the_first_fault_in_order_is_raised_and_what_waits_is_not_begun() -> None:
    use_workers(2)
    begun = []

    def fail(item: int) -> None:
        begun.append(item)
        time.sleep(0.05 if item == 0 else 0.01)
        raise ValueError(str(item))

    with pytest.raises(ValueError, match="0"):
        side_by_side(fail, range(100))
    assert len(begun) < 100


@pytest.mark.parametrize("count", [1, 2])
def test_what_is_done_meanwhile_gives_its_result(count) -> None:
    use_workers(count)
    with meanwhile(lambda: side_by_side(str, range(3))) as found:
        pass
    assert found() == ["0", "1", "2"]


def test_what_nobody_waits_for_ends_at_its_next_item() -> None:
    use_workers(2)
    done, is_begun = [], threading.Event()

    def slow(item: int) -> None:
        is_begun.set()
        time.sleep(0.02)
        done.append(item)

    with pytest.raises(KeyError), meanwhile(lambda: side_by_side(slow, range(1000))):
        is_begun.wait()
        raise KeyError
    assert len(done) < 1000


def test_blocks_cover_everything_whatever_the_number_of_threads() -> None:
    assert blocks(7, 3) == [slice(0, 3), slice(3, 6), slice(6, 7)]
    assert blocks(0, 3) == []


@pytest.mark.parametrize(
    ("told", "files", "expected"),
    [
        ("0::/a/b\n", {"a/cpu.max": "150000 100000", "a/b/cpu.max": "max 100000"}, [1.5]),
        ("0::/\n", {"cpu.max": "max 100000"}, []),
        ("4:cpu,cpuacct:/x\n3:memory:/x\n",
         {"cpu,cpuacct/x/cpu.cfs_quota_us": "400000", "cpu,cpuacct/x/cpu.cfs_period_us": "100000"},
         [4.0]),
        ("nonsense\n", {}, []),
    ],
)  # fmt: skip
def test_control_groups_limit_the_cores(tmp_path, told, files, expected) -> None:
    (tmp_path / "cgroup").write_text(told)
    for name, text in files.items():
        file = tmp_path / "fs" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    assert list(workers._quotas(tmp_path / "cgroup", tmp_path / "fs")) == expected


def test_who_starts_several_runs_shares_the_cores_out(monkeypatch) -> None:
    monkeypatch.delenv(workers.CORES, raising=False)
    every = available_cores()
    for told, cores in (("1", 1), ("many", every), (str(every + 7), every), ("0", 1)):
        monkeypatch.setenv(workers.CORES, told)
        assert available_cores() == cores


@pytest.mark.slow
def test_neither_threads_nor_a_lost_mark_change_a_bit_of_a_result(tmp_path) -> None:
    """Begun on five cores and gone on with on two; killed before a stage was marked as done."""
    capture = tmp_path / "capture"
    write_specimen(capture)
    found = []
    for first, then in ((5, 2), (1, 1)):
        out = tmp_path / str(first)
        command = [*words(capture, out, has_renders=False), "--threads"]
        if then != first:
            cli.main([*command, str(first), "--until", "transport"])
        cli.main([*command, str(then)])
        found.append(contents(out))
    JobPaths(out).manifest("export").unlink()
    cli.main([*command, "1"])
    assert contents(out) == found[1]
    for files in found:
        del files["run.json"]  # says how many threads there were
    assert found[0] == found[1]
    assert len(found[0]) > 40
