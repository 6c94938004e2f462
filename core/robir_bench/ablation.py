# SPDX-License-Identifier: Apache-2.0
"""What each step of the stages is worth: a population once more with one step left out at a time.

The runs come from the stages' own lists of steps; stages before the step are borrowed, and what the
whole run says that a step has not changed is not run again. A step earns its place by the rule of
`verdict`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from robir.appearance import stage as appearance
from robir.errors import UsageError
from robir.geometry import stage as geometry
from robir.steps import Step
from robir_bench.chart import SVG_STYLE, svg, tidy
from robir_bench.distribution import PopulationFigure, estimate, mean
from robir_bench.plan import OURS, BenchRun
from robir_bench.population import figure, groups
from robir_bench.table import Record, Table, split
from robir_bench.truth.scores import (
    ALBEDO,
    HUE,
    LEVEL,
    NORMALS,
    RAW_ALBEDO,
    ROUGHNESS,
    SECONDS,
    SHADOW,
    SUN,
    Score,
)

# figures by which a step earns its place
HEADLINES = (ALBEDO, RAW_ALBEDO, SHADOW, ROUGHNESS, NORMALS, LEVEL, HUE, SUN)

# Degrees. A sun counts by the logarithm of its error, no smaller than this: the mean of degrees is
# that of suns which are wrong altogether, and moves by chance with any step.
SMALLEST_ANGLE = 0.1

DRAWN = (ALBEDO, RAW_ALBEDO)

ENOUGH = 40  # captures that a verdict needs

# captures of a class that count, dB of albedo that a step must bring one, and may cost another
CLASS_SIZE, CLASS_GAIN, CLASS_LOSS = 5, 1.0, 0.3

Classes = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOutStep:
    """A step that can be left out."""

    stage: str  # name of its stage
    step: Step[Any]  # the step

    @property
    def method(self) -> str:
        """Name of the runs without it."""
        return f"without {self.stage} {self.step.name}"


def trials() -> list[LeftOutStep]:
    """All steps on trial, stage by stage."""
    lists = {"geometry": geometry.STEPS, "appearance": appearance.STEPS}
    return [
        LeftOutStep(stage=stage, step=step)
        for stage, steps in lists.items()
        for step in steps
        if step.is_on_trial
    ]


def chosen_trials(names: Sequence[str]) -> list[LeftOutStep]:
    """The steps of these names, STAGE.STEP, stage by stage; all on trial where none is named.

    Raises:
        UsageError: If there is no such step on trial.
    """
    known = {f"{trial.stage}.{trial.step.name}": trial for trial in trials()}
    if unknown := sorted(set(names) - set(known)):
        raise UsageError(
            f"--ablate: no step on trial is called {unknown[0]}; there are {', '.join(known)}"
        )
    return [trial for name, trial in known.items() if name in names or not names]


def ablated(runs: Sequence[BenchRun], chosen: Sequence[LeftOutStep]) -> list[BenchRun]:
    """After each run the same without each of some steps, not relit."""
    return [
        one
        for run in runs
        for one in (
            run,
            *(
                replace(
                    run,
                    method=trial.method,
                    settings=(*run.settings, f'{trial.stage}.without=["{trial.step.name}"]'),
                    is_relit=False,
                    left_out=(trial.stage, trial.step.name),
                )
                for trial in chosen
            ),
        )
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """What a step brings."""

    trial: LeftOutStep  # the step
    # records with and without it, of captures where both were scored
    pairs: Sequence[tuple[Record, Record]]
    classes: Classes  # of the captures

    def gain(self, score: Score) -> PopulationFigure | None:
        """Mean over captures of how much better a figure is with the step, in its unit."""
        return estimate(gains(score, self.pairs, self.classes), mean)

    @property
    def seconds(self) -> PopulationFigure | None:
        """Mean CPU seconds that it takes, where it changes nothing as well."""
        stage, name = self.trial.stage, self.trial.step.name
        spent = (one.get("step_seconds", {}).get(stage, {}).get(name) for one, _ in self.pairs)
        return estimate([seconds for seconds in spent if seconds is not None], mean)

    @property
    def changed(self) -> int:
        """Captures whose albedo it changes."""
        return sum(abs(gain) > 1e-9 for gain in gains(ALBEDO, self.pairs, self.classes))

    @property
    def verdict(self) -> str:
        """Whether it earns its place.

        It does if on ENOUGH captures the interval of one headline figure lies above 0, or if it
        brings a class of captures CLASS_GAIN of albedo and costs no other CLASS_LOSS. Where another
        figure's interval lies below 0 that is open: of eight figures one often leads by chance.
        """
        if len(self.pairs) < ENOUGH:
            return f"open: fewer than {ENOUGH} captures"
        found = {score.title: self.gain(score) for score in HEADLINES}
        better = [name for name, gain in found.items() if gain and (gain.low or 0) > 0]
        worse = [name for name, gain in found.items() if gain and (gain.high or 0) < 0]
        if better and worse:
            return f"open: {better[0]} better, {worse[0]} worse"
        if better:
            return f"stays: {better[0]}"
        gains = self._by_class()
        best = max(gains, key=lambda name: gains[name], default=None)
        if best is not None and gains[best] >= CLASS_GAIN and min(gains.values()) > -CLASS_LOSS:
            return f"stays: {best}"
        return "goes"

    def _by_class(self) -> dict[str, float]:
        """Mean gain of albedo of each class that has enough captures."""
        members = groups([one for one, _ in self.pairs], self.classes)
        found = {}
        for name, records in members.items():
            names = {record["capture"] for record in records}
            pairs = [pair for pair in self.pairs if pair[0]["capture"] in names]
            gained = gains(ALBEDO, pairs, self.classes)
            if name != "all" and len(gained) >= CLASS_SIZE:
                found[name] = sum(gained) / len(gained)
        return found


def worths(records: Sequence[Record], classes: Classes) -> list[Worth]:
    """What each step brings, in the stages' order."""
    done, _failed = split(records)
    whole = {record["capture"]: record for record in done if record["method"] == OURS}
    return [
        Worth(
            trial=trial,
            pairs=[
                (whole[record["capture"]], record)
                for record in done
                if record["method"] == trial.method and record["capture"] in whole
            ],
            classes=classes,
        )
        for trial in trials()
    ]


def ablation_table(found: Sequence[Worth]) -> Table:
    """A row a step."""
    rows = []
    for worth in found:
        gains = [worth.gain(score) for score in HEADLINES]
        cells = [_text(score, gain) for score, gain in zip(HEADLINES, gains, strict=True)]
        count, step = len(worth.pairs), worth.trial.step
        seconds = _text(SECONDS, worth.seconds)
        rows.append(
            [
                f"{worth.trial.stage}: {step.name}",
                step.purpose,
                f"{worth.changed}/{count}",
                *cells,
                seconds,
                worth.verdict,
            ]
        )
    titles = ["sun (ln of degrees)" if score is SUN else score.title for score in HEADLINES]
    head = ["step", "what it does", "changed", *titles]
    return Table(
        title="What each step brings, against the same run without it",
        head=[*head, "costs (CPU-s)", "verdict"],
        rows=rows,
    )


def ablation_chart(found: Sequence[Worth]) -> str:
    """Gains of albedo with their intervals, a line a step, as SVG text."""
    shown = [worth for worth in found if worth.pairs]
    with rc_context(SVG_STYLE):
        figure = Figure(figsize=(11.0, 1.2 + 0.28 * len(shown)), layout="constrained")
        panels = figure.subplots(1, len(DRAWN), sharey=True)
        for axes, score in zip(panels, DRAWN, strict=True):
            for row, worth in enumerate(shown):
                gain = worth.gain(score)
                if gain is not None:
                    ends = [gain.value if end is None else end for end in (gain.low, gain.high)]
                    axes.plot(ends, [row, row], color="#2f6db0", linewidth=2.0)
                    axes.plot([gain.value], [row], "o", color="#c8502d", markersize=5)
            axes.axvline(0.0, color="#20262d", linewidth=0.8)
            axes.set_yticks(range(len(shown)), [worth.trial.step.name for worth in shown])
            axes.set_xlabel(f"{score.title}: gained by the step")
            tidy(axes)
        panels[0].invert_yaxis()
        return svg(figure)


def gains(score: Score, pairs: Sequence[tuple[Record, Record]], classes: Classes) -> list[float]:
    """How much better a figure of each capture is with a step than without."""
    sign = 1.0 if score.best == "high" else -1.0
    found = []
    for one, other in pairs:
        own = classes[one["capture"]]
        with_it, without = figure(score, one, own), figure(score, other, own)
        if with_it is None or without is None:
            continue
        if score is SUN:
            with_it, without = (
                math.log(max(angle, SMALLEST_ANGLE)) for angle in (with_it, without)
            )
        found.append(sign * (with_it - without))
    return found


def _text(score: Score, found: PopulationFigure | None) -> str:
    return "-" if found is None else found.text(max(score.digits, 1) + (score is not SECONDS))
