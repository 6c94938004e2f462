# SPDX-License-Identifier: Apache-2.0
"""Libraries of captures without photographs, for an engine that only copies a finished result."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from robir.batch.start import batch
from robir.cli import _parser
from robir.config import RunConfig
from robir.export.asset import REVISION, AssetFacts
from robir.jobs.paths import STAGES, JobPaths, write_json
from robir.pipeline.ledger import capture_fingerprint
from robir.settings import table_from_settings, toml_from_settings

ROOT = Path(__file__).parents[2]
ENGINE = Path(__file__).with_name("engine.py")


def variables() -> dict[str, str]:
    """Variables of a process that shall run this checkout."""
    return {**os.environ, "PYTHONPATH": f"{ROOT / 'core'}{os.pathsep}{ROOT}"}


def make_captures(folder: Path, acts: dict[str, str]) -> Path:
    """Captures in a folder `shots` that consist of one small file, and what is done with each."""
    for name, act in acts.items():
        (folder / name).mkdir(parents=True)
        (folder / name / "transforms.json").write_text("{}")
        (folder / name / "act").write_text(act)
    return folder


def make_template(folder: Path, capture: Path) -> Path:
    """A finished result of such a capture, as far as a batch looks at it."""
    paths = JobPaths(folder)
    for stage in STAGES:
        write_json(paths.manifest(stage), {"stage": stage, "fingerprint": "0", "outputs": {}})
    paths.config.write_text(toml_from_settings(RunConfig()))
    fingerprint = capture_fingerprint(capture, None, folder)
    about = {"name": capture.name, "place": "0", "masks": None, "fingerprint": fingerprint}
    run = {"state": "done", "capture": about, "seconds": {}, "warnings": []}
    write_json(paths.run, run | {"peak_memory_bytes": {}})
    report = {
        "held_out": {"psnr": 24.0}, "trust": {"is_trusted": True, "doubts": []},
        "capture": {"train_views": 20}, "seconds": {"geometry": {"cpu": 60.0, "wall": 60.0}},
    }  # fmt: skip
    write_json(paths.report_json, report)
    paths.report.write_text("<p>report</p>")
    paths.contact.write_bytes(b"")
    paths.library_asset.parent.mkdir()
    paths.library_asset.write_bytes(b"")
    facts = table_from_settings(AssetFacts(catalogue="shots"))
    write_json(paths.library_facts, facts | {"revision": REVISION, "export": "0"})
    return folder


def run_batch(template: Path, words: list[str]) -> int:
    """Run `robir batch WORDS` in this process with the engine that copies a template."""
    options = _parser().parse_args(["batch", *words])
    return batch(options, [sys.executable, "-I", "-S", str(ENGINE), str(template)])


if __name__ == "__main__":
    sys.exit(run_batch(Path(sys.argv[1]), [word for word in sys.argv[2:] if word != "batch"]))
