# SPDX-License-Identifier: Apache-2.0
"""Slurm of one node, from Debian's packages slurm-wlm and munge; it takes root.

`python -m tests.batch.slurm` as root, with apt-get, installs what is missing.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

PACKAGES = ("slurm-wlm", "munge")

_CONFIG = """
ClusterName=robir
SlurmctldHost={host}
SlurmUser=root
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CryptoType=crypto/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
ReturnToService=2
KillWait=30
GresTypes=gpu
NodeName={host} CPUs={cores} RealMemory={memory} Gres=gpu:1 State=UNKNOWN
PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP
PartitionName=graphics Nodes={host} MaxTime=INFINITE State=UP
"""

_GRES = "Name=gpu File=/dev/null\n"
"""A graphics card as far as Slurm looks at one."""


def missing() -> str:
    """Why there is no cluster here; empty if there can be one."""
    if os.geteuid() != 0:
        return "Slurm's daemons take root"
    lacking = [name for name in ("slurmctld", "slurmd", "munged") if not shutil.which(name)]
    if lacking:
        return f"{', '.join(lacking)} not installed (as root: apt-get install slurm-wlm munge)"
    return ""


@contextmanager
def cluster(folder: Path) -> Iterator[Callable[[Sequence[str]], None]]:
    """A cluster for the length of the block; yields a function that waits for jobs."""
    if why := missing():
        pytest.skip(f"SLURM NOT TESTED: {why}")
    for name in ("state", "spool"):
        (folder / name).mkdir(parents=True)
    cores, memory = os.cpu_count(), os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") >> 20
    config = folder / "slurm.conf"
    config.write_text(
        _CONFIG.format(
            host=socket.gethostname().partition(".")[0],
            ports=(_free_port(), _free_port()),
            folder=folder,
            cores=cores,
            memory=memory - 512,
        )
    )
    (folder / "gres.conf").write_text(_GRES)
    before = os.environ.get("SLURM_CONF")
    os.environ["SLURM_CONF"] = str(config)
    daemons: list[subprocess.Popen[bytes]] = []
    try:
        for command in _commands(folder):
            log = (folder / f"{Path(command[0]).name}.out").open("wb")
            daemons.append(subprocess.Popen(command, stdout=log, stderr=log))
            log.close()
            time.sleep(1.0)
        _until(lambda: "idle" in _said("sinfo", "-h", "-o", "%T"), 60, "the node is not idle")
        yield _wait
    finally:
        for daemon in reversed(daemons):
            daemon.terminate()
            daemon.wait(30)
        os.environ.pop("SLURM_CONF")
        if before is not None:
            os.environ["SLURM_CONF"] = before


def _commands(folder: Path) -> list[list[str]]:
    key = folder / "munge.key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o400)
    munged = ["munged", "--foreground", "--force", f"--key-file={key}"]
    munged += [f"--{name}-file={folder}/munge.{name}" for name in ("log", "pid", "seed")]
    munged += [f"--socket={folder}/munge.socket"]
    return [munged, ["slurmctld", "-D", "-i"], ["slurmd", "-D"]]


def _wait(jobs: Sequence[str]) -> None:
    _until(lambda: not _said("squeue", "-h", "-o", "%i").strip(), 600, f"{jobs} do not end")


def _until(condition: Callable[[], bool], seconds: float, complaint: str) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, complaint
        time.sleep(0.5)


def _said(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


if __name__ == "__main__":
    subprocess.run(["apt-get", "update", "-qq"], check=True)
    install = ["apt-get", "install", "-y", "-qq", "--no-install-recommends", *PACKAGES]
    sys.exit(subprocess.run(install, check=False).returncode)
