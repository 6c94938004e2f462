# SPDX-License-Identifier: Apache-2.0
"""What bench and stability sweep leave behind: charts, Markdown, one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from robir.evaluation.levels import level_notes
from robir.export.page import page_template
from robir.export.report.pictures import inline_lossless
from robir.jobs.paths import replacing, write_json
from robir_bench.ablation import ablation_chart, ablation_table, worths
from robir_bench.chart import cost_growth, speed_accuracy
from robir_bench.curves import calibration, tone_curves
from robir_bench.distribution import CONFIDENCE
from robir_bench.heat import Case, cases, cause, heat_map, heat_table, told, vigilance, worst_cases
from robir_bench.judge.oracle_table import oracle_table
from robir_bench.pictures import PHOTOGRAPHED_TILES, TILES, tile
from robir_bench.plan import OURS, BenchRun
from robir_bench.population import (
    MISSED_SUN,
    capture_classes,
    distribution,
    population_tables,
    verdicts,
)
from robir_bench.runs import picture_file
from robir_bench.table import (
    Record,
    Table,
    bench_tables,
    failures,
    is_rendered,
    split,
    value,
)
from robir_bench.truth.scores import ALBEDO


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureRow:
    """Pictures side by side."""

    title: str  # what the row shows
    tiles: Sequence[tuple[str, str]]  # label and data address of each picture
    notes: Sequence[str] = ()  # paragraphs below


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """A chart that also lies beside the page as a file."""

    title: str  # heading
    file: str  # name of the file
    drawing: str  # SVG text


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """A page: pictures first, then the charts, then the tables."""

    title: str  # heading
    lead: str  # one paragraph
    rows: Sequence[PictureRow]  # pictures
    charts: Sequence[Chart]  # the first is the main one
    tables: Sequence[Table]  # below


def write_bench(folder: Path, runs: Sequence[BenchRun], records: Mapping[str, Record]) -> Path:
    """Write the charts, scores.md and index.html of a bench; returns the page."""
    tried = [records[run.name] for run in runs if run.name in records]
    done, _failed = split(tried)
    rendered = [record for record in done if is_rendered(record)]
    scored = [run for run in runs if "scores" in records.get(run.name, {})]
    photographed = [run for run in scored if not is_rendered(records[run.name])]
    page = Page(
        title="Speed against accuracy",
        lead=f"{len(done)} of {len(runs)} runs are scored. Albedos are scaled to the truth channel "
        "by channel; every method is charged for all stages it needs, shared or not. Captures "
        "without truth are judged by their held-out photographs alone.",
        rows=[
            *_method_rows(folder, [run for run in scored if is_rendered(records[run.name])]),
            *(_photographed_row(folder, run, records[run.name]) for run in photographed),
        ],
        charts=_bench_charts(rendered) if rendered or not photographed else [],
        tables=bench_tables(tried),
    )
    return _write(folder, "scores.md", page)


def write_population(folder: Path, runs: Sequence[BenchRun], records: Mapping[str, Record]) -> Path:
    """Write population.md, distribution.json and index.html of a population; returns the page."""
    tried = [records[run.name] for run in runs if run.name in records]
    done, _failed = split(tried)
    classes, kept = capture_classes(runs), verdicts(runs)
    page = Page(
        title="A population",
        lead=f"{len(done)} of {len(runs)} captures are scored, {len(tried) - len(done)} failed; "
        f"{kept} are of seeds for verdicts. In brackets {100 * CONFIDENCE:.0f} % percentile "
        "bootstrap intervals over captures, too narrow where these are few. One in ten is worse "
        "than the worst tenth. Where there is a sun and none was found its angle counts as "
        f"{MISSED_SUN:.0f} degrees; shadow and sun are told of captures with a sun alone; a run "
        "without a result counts as below the photo, and in no other figure.",
        rows=_method_rows(folder, [run for run in runs if "scores" in records.get(run.name, {})]),
        charts=_bench_charts(done) if done else [],
        tables=population_tables(tried, classes),
    )
    write_json(folder / "distribution.json", distribution(tried, classes))
    return _write(folder, "population.md", page)


def write_ablation(folder: Path, runs: Sequence[BenchRun], records: Mapping[str, Record]) -> Path:
    """Write ablation.md, its chart and index.html of a population with steps left out."""
    tried = [records[run.name] for run in runs if run.name in records]
    done, failed = split(tried)
    classes, kept = capture_classes(runs), verdicts(runs)
    found = worths(tried, classes)
    whole = sum(record["method"] == OURS for record in done)
    page = Page(
        title="What each step is worth",
        lead=f"{whole} captures, {kept} of seeds for verdicts; {len(done)} of {len(runs)} runs are "
        f"scored. Figures say how much better a run is with the step than without, over the "
        f"captures where both were scored: mean and {100 * CONFIDENCE:.0f} % percentile bootstrap "
        "interval.",
        rows=[],
        charts=[Chart(title="Albedo", file="ablation.svg", drawing=ablation_chart(found))],
        tables=[ablation_table(found), *([failures(failed)] if failed else [])],
    )
    return _write(folder, "ablation.md", page)


def write_oracles(folder: Path, runs: Sequence[BenchRun], records: Mapping[str, Record]) -> Path:
    """Write oracles.md and index.html of a population with quantities told."""
    tried = [records[run.name] for run in runs if run.name in records]
    done, failed = split(tried)
    page = Page(
        title="What each error costs",
        lead=f"{len(done)} of {len(runs)} runs are scored. Each quantity was taken from the truth "
        "on its own, all else as it is. Figures say what that gains: mean and "
        f"{100 * CONFIDENCE:.0f} % percentile bootstrap interval over captures.",
        rows=[],
        charts=[],
        tables=[
            oracle_table(tried, capture_classes(runs)),
            *([failures(failed)] if failed else []),
        ],
    )
    return _write(folder, "oracles.md", page)


def write_stability(folder: Path, runs: Sequence[BenchRun], records: Mapping[str, Record]) -> Path:
    """Write the charts, stability.md and index.html of a sweep; returns the page."""
    tried = [records[run.name] for run in runs if run.name in records]
    found = cases(tried)
    counts = vigilance(tried)
    done, failed = split(tried)
    growth = Chart(
        title="What more of each costs and brings", file="cost.svg", drawing=cost_growth(done)
    )
    page = Page(
        title="Stability",
        lead=f"{len(tried)} of {len(runs)} runs were tried. Of {counts['wrong']} wrong ones "
        f"(refused, or more than 6 dB of albedo below the unperturbed runs) the program told "
        f"{counts['told']}; of {counts['sound']} sound ones it doubted {counts['alarms']}.",
        rows=[_case_row(folder, case, runs) for case in worst_cases(found)],
        charts=[
            Chart(title="Albedo lost and shadow ratio", file="chart.svg", drawing=heat_map(found)),
            *([growth] if growth.drawing else []),
            *_own_charts([record for record in done if record["method"] == OURS]),
        ],
        tables=[
            heat_table(found),
            _worst_table(worst_cases(found)),
            *([failures(failed)] if failed else []),
        ],
    )
    return _write(folder, "stability.md", page)


def _bench_charts(records: Sequence[Record]) -> list[Chart]:
    """What is drawn of runs that were compared with the truth."""
    return [
        Chart(
            title="CPU seconds against accuracy",
            file="chart.svg",
            drawing=speed_accuracy(records),
        ),
        *_own_charts([record for record in records if record["method"] == OURS]),
    ]


def _own_charts(records: Sequence[Record]) -> list[Chart]:
    """What is drawn of our own method only: uncertainty and tone curves, where known."""
    drawings = (
        ("Uncertainty of albedo: promised and held", "calibration.svg", calibration(records)),
        ("Tone curves, recovered and true", "tone.svg", tone_curves(records)),
    )
    return [Chart(title=t, file=f, drawing=d) for t, f, d in drawings if d is not None]


def _write(folder: Path, markdown: str, page: Page) -> Path:
    html = page_template("robir_bench", "page.html")
    parts = [f"# {page.title}", page.lead]
    parts += [f"![{chart.title}]({chart.file})" for chart in page.charts]
    texts = {
        **{chart.file: chart.drawing for chart in page.charts},
        markdown: "\n\n".join([*parts, *(table.markdown() for table in page.tables)]) + "\n",
        "index.html": html.render(page=page),
    }
    for name, text in texts.items():
        with replacing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return folder / "index.html"


def _method_rows(folder: Path, runs: Sequence[BenchRun]) -> list[PictureRow]:
    """Photograph, truth and each method's albedo, a row each capture and seed."""
    rows = []
    for key in dict.fromkeys((run.capture, run.seed) for run in runs):
        members = [run for run in runs if (run.capture, run.seed) == key]
        first = picture_file(members[0], folder)
        tiles = [(name, _inline(first, name)) for name in ("photograph", "true albedo")]
        tiles += [(run.method, _inline(picture_file(run, folder), "albedo")) for run in members]
        rows.append(PictureRow(title=f"{key[0].name}, seed {key[1]}", tiles=tiles))
    return rows


def _photographed_row(folder: Path, run: BenchRun, record: Record) -> PictureRow:
    """A result beside a held-out photograph, where most is lost, and what the program said."""
    file = picture_file(run, folder)
    trust = record["trust"] or {"doubts": []}
    doubts = [f"Not to be trusted: {doubt}." for doubt in trust["doubts"]]
    return PictureRow(
        title=f"{run.capture.name}, {run.method}, seed {run.seed}",
        tiles=[(name, _inline(file, name, PHOTOGRAPHED_TILES)) for name in PHOTOGRAPHED_TILES],
        notes=[*level_notes(record["scores"]["levels"]), *doubts],
    )


def _case_row(folder: Path, case: Case, runs: Sequence[BenchRun]) -> PictureRow:
    """The worst case of a factor: what was given, what came out, what was said."""
    spoilt = next(run for run in runs if run.name == case.record["name"])
    tiles = []
    if "scores" in case.record:
        file = picture_file(spoilt, folder)
        labels = {"photograph": "photograph", "true albedo": "true albedo", "albedo": "its albedo"}
        tiles = [(label, _inline(file, name)) for name, label in labels.items()]
    if case.base is not None:
        base = next(run for run in runs if run.name == case.base["name"])
        tiles.append(("albedo unperturbed", _inline(picture_file(base, folder), "albedo")))
    return PictureRow(
        title=f"{case.record['factor']} {case.record['value']}: {case.record['capture']}, "
        f"{case.record['method']}, {_lost(case)}",
        tiles=tiles,
        notes=[cause(case), "The program said: " + (" ".join(told(case.record)) or "nothing.")],
    )


def _worst_table(worst: Sequence[Case]) -> Table:
    return Table(
        title="The worst case of each factor",
        head=["factor", "value", "capture", "albedo", "what happened", "what the program said"],
        rows=[
            [
                *case.row,
                case.record["capture"],
                _lost(case),
                cause(case).replace("|", "/"),
                (" ".join(told(case.record)) or "nothing").replace("|", "/"),
            ]
            for case in worst
        ],
    )


def _lost(case: Case) -> str:
    if "error" in case.record:
        return "failed"
    now = ALBEDO.text(value(ALBEDO, case.record))
    return f"{now} dB" if case.lost is None else f"{now} dB, {case.lost:.1f} lost"


def _inline(picture: Path, name: str, names: Sequence[str] = TILES) -> str:
    return inline_lossless(tile(picture, name, names))
