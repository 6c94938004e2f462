# SPDX-License-Identifier: Apache-2.0
"""A finished result folder of the sphere that has everything known."""

from pathlib import Path

from evaluation import sphere_run

from robir.config import RunConfig
from robir.export import stage
from robir.export.config import ExportConfig
from robir.jobs.context import StageContext
from robir.jobs.paths import JobPaths
from robir.settings import toml_from_settings


class Quiet:
    def progress(self, fraction, message):
        pass

    def warn(self, message):
        raise AssertionError(message)


def make_result(folder: Path) -> JobPaths:
    """Export the sphere without pictures of Blender's."""
    paths = sphere_run.make_run(folder)
    paths.config.write_text(toml_from_settings(RunConfig()), encoding="utf-8")
    stage.run(
        StageContext(
            paths=paths,
            config=ExportConfig(renders=False),
            source=Path("capture"),
            masks=None,
            seed=0,
            device="cpu",
            reporter=Quiet(),
        )
    )
    return paths
