# SPDX-License-Identifier: Apache-2.0
"""The report: it needs nothing but itself, and shows the asset, its verdict and its numbers."""

import base64
import html
import re
import shutil
import sys
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from evaluation import sphere_run
from export.browser import SAY, faults_of, needs_chromium, visit
from export.test_stage import Recorder, context

from robir import cli
from robir.capture.store import load_capture
from robir.evaluation.light import load_light
from robir.export import stage
from robir.export.report.pictures import VIEWER_SCRIPT, embedded_lights, start_orbit
from robir.jobs.paths import JobPaths, read_json, write_json
from robir.maths.vectors import equirect_directions


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    paths = sphere_run.make_run(tmp_path_factory.mktemp("run") / "out")
    stage.run(context(paths, Recorder(), renders=False))
    return paths


class Page(HTMLParser):
    """What a page shows and names: each start tag with its attributes."""

    def __init__(self, text):
        super().__init__()
        self.tags = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def content(address):
    """Media type and bytes of a data address."""
    head, _, data = address.partition(",")
    kind = re.fullmatch(r"data:([\w/.-]+);base64", head)
    assert kind
    return kind[1], base64.b64decode(data.partition("#")[0], validate=True)


@pytest.fixture(scope="module")
def page(exported):
    return Page(exported.report.read_text(encoding="utf-8"))


def test_the_page_needs_nothing_but_itself(exported, page):
    addresses = [
        attributes[key] for _, attributes in page.tags for key in ("src",) if key in attributes
    ]
    kinds = [content(address)[0] for address in addresses]
    # three views of photo, re-render, albedo, roughness, normals; each to choose, one to wait with
    assert kinds.count("image/webp") == 3 * 5 + 3 + 1
    assert kinds.count("image/png") == 2 + 4  # two plots, four textures
    assert kinds.count("model/gltf-binary") == 1
    assert len(kinds) == 26
    own = exported.report.read_text(encoding="utf-8").replace(VIEWER_SCRIPT.read_text("utf-8"), "")
    assert not re.findall(r"url\(|https?://|@import", own)
    assert exported.report.stat().st_size < 4e6


def test_a_browser_runs_the_scripts_of_the_page_alone(exported, page):
    (policy,) = (m["content"] for m in page.all("meta") if "http-equiv" in m)
    assert policy.startswith("default-src 'none'")
    assert policy.count("'sha256-") == 2 == len(page.all("script"))
    assert "unsafe-inline" not in policy.partition("script-src")[2].partition(";")[0]


def test_the_lights_are_where_the_recovered_one_shows_them(exported):
    lights = dict(embedded_lights(load_light(exported.stage("appearance") / "light.json")))
    assert list(lights) == ["Recovered", "Studio", "Sunny day", "Evening"]
    for name, address in lights.items():
        assert address.endswith("#.hdr"), name  # the viewer knows the kind of file by that
        image = cv2.imdecode(np.frombuffer(content(address)[1], np.uint8), -1)[..., ::-1]
        up = equirect_directions(len(image)).numpy()
        weight = np.sqrt(1 - up[..., 2:] ** 2)
        assert (image * weight).sum() / (3 * weight.sum()) == pytest.approx(1.0, rel=0.02)
        if name == "Recovered":
            at = np.unravel_index(image.sum(-1).argmax(), image.shape[:2])
            assert up[at] @ sphere_run.SUN_DIRECTION > np.cos(np.radians(3.0))


def test_the_viewer_looks_first_from_where_the_photograph_was_taken():
    mesh, (camera, *_) = sphere_run.world_mesh(), sphere_run.cameras(4, 0.25)
    around, down, far = start_orbit(camera, mesh).split()
    assert far == "auto"
    # the viewer's angles: from its +Z towards its +X, and from its +Y; ours are -Y, +X and +Z
    theta, phi = (np.radians(float(word.removesuffix("deg"))) for word in (around, down))
    towards = [np.sin(phi) * np.sin(theta), -np.sin(phi) * np.cos(theta), np.cos(phi)]
    back = camera.camera_to_world[:3, 2]
    assert np.array(towards) == pytest.approx(back, abs=5e-3)


PROBE = """<script>
setTimeout(async () => {
  const said = {}, range = document.querySelector(".wipe input");
  const viewer = document.querySelector("model-viewer");
  range.value = 20; range.dispatchEvent(new Event("input"));
  said.at = range.parentElement.style.getPropertyValue("--at");
  const before = document.querySelector(".wipe img").src;
  document.getElementById("view-1").click();
  said.changed = document.querySelector(".wipe img").src !== before;
  document.querySelector(".grid button").click();
  said.open = document.getElementById("large").open;
  said.large = document.getElementById("large-name").textContent;
  document.getElementById("large").dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowRight"}));
  said.next = document.getElementById("large-name").textContent;
  document.getElementById("close").click();
  said.closed = !document.getElementById("large").open;
  await customElements.whenDefined("model-viewer");
  if (!viewer.loaded) await new Promise(done => viewer.addEventListener("load", done));
  const light = viewer.getAttribute("environment-image");
  document.querySelectorAll("input[name=light]")[2].click();
  said.relit = viewer.getAttribute("environment-image") !== light;
  said.wide = document.documentElement.scrollWidth <= innerWidth;
  say(said);
}, 200);
</script>"""

AXE = Path(sys.prefix) / "node_modules" / "axe-core" / "axe.min.js"
WIDTHS = (390, 800, 1400)
FRAMED = "".join(
    f'<iframe src="/report" width="{width}" height="900"></iframe>' for width in WIDTHS
)
CHECK = """<script>
(async () => {
  const found = [], frames = [...document.querySelectorAll("iframe")];
  await Promise.all(frames.map(frame => new Promise(done => { frame.onload = done; })));
  for (const frame of frames) {
    const shown = frame.contentDocument;
    for (const part of shown.querySelectorAll("details")) part.open = true;
    const {violations} = await frame.contentWindow.axe.run(shown, {resultTypes: ["violations"]});
    const serious = violations.filter(({impact}) => ["serious", "critical"].includes(impact));
    found.push({
      faults: serious.map(({id, nodes}) => [id, nodes[0].html, nodes[0].failureSummary]),
      wide: shown.documentElement.scrollWidth > frame.contentWindow.innerWidth,
    });
  }
  say(found);
})();
</script>"""


def probed(exported, probe):
    """The page with something to run in it, which its policy would forbid."""
    text = exported.report.read_text(encoding="utf-8").replace("</main>", f"{probe}</main>", 1)
    text = re.sub(
        r"script-src [^;]*", "script-src 'wasm-unsafe-eval' 'unsafe-inline' 'self'", text, count=1
    )
    text = text.replace("img-src", "img-src 'self'", 1)
    return text.replace("connect-src", "connect-src 'self'", 1)


@pytest.mark.slow
@needs_chromium
def test_a_browser_shows_the_page_without_a_fault(exported, tmp_path):
    seen = visit({"/page": probed(exported, SAY + PROBE)}, tmp_path / "profile")
    assert not seen.faults + faults_of(exported.report.as_uri(), tmp_path / "profile")
    assert not seen.asked
    said = seen.said
    assert [said.pop(one).split()[0] for one in ("large", "next")] == ["photograph", "re-render"]
    assert said.pop("at") == "20%"
    assert all(said.values()), said


@pytest.mark.slow
@needs_chromium
@pytest.mark.skipif(
    not AXE.is_file(), reason="NOT TRIED WITH AXE-CORE: `make validator` fetches it"
)
def test_everybody_can_read_the_page_at_every_width(exported, tmp_path):
    pages = {
        "/frames": f"<!doctype html><title>Frames</title>{SAY}{FRAMED}{CHECK}",
        "/report": probed(exported, '<script src="/axe.js"></script>'),
        "/axe.js": AXE.read_text(encoding="utf-8"),
    }
    seen = visit(pages, tmp_path / "profile")
    assert seen.said == [{"faults": [], "wide": False}] * len(WIDTHS)


def test_exposures_of_photographs_are_reported(tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    names = [view.name for view in load_capture(paths.stage("capture")).views]
    steps = {name: [0.1 * n, 0.1 * n, 0.1 * n + 0.3] for n, name in enumerate(names)}
    table = {"steps": steps, "corner_steps": 0.25, "slope_steps": {}, "other_light": []}
    write_json(paths.stage("appearance") / "exposure.json", table)
    stage.run(context(paths, Recorder(), renders=False))
    exposure = read_json(paths.report_json)["exposure"]
    assert not exposure["is_even"]
    assert list(exposure["views"]) == names[::-1]
    assert exposure["views"][names[0]] == {"exposure": 0.1, "white_balance": [0.0, 0.3]}
    spread = 0.1 * np.arange(len(names)).std()
    assert exposure["spread_steps"] == pytest.approx(spread, abs=1e-3)
    assert exposure["corner_steps"] == 0.25
    page = paths.report.read_text(encoding="utf-8")
    assert "darkens the corners of all photographs by 0.25 steps" in page
    assert f"differ in exposure by {spread:.2f} steps" in page
    assert f'<td>{names[0]}</td><td class="n">+0.10</td>' in page


def test_photographs_under_another_light_are_named_and_not_scored(tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    views = load_capture(paths.stage("capture")).views
    odd = [next(v.name for v in views if v.split == split) for split in ("train", "held_out")]
    table = {"steps": {}, "corner_steps": 0.0, "slope_steps": {}, "other_light": odd}
    write_json(paths.stage("appearance") / "exposure.json", table)
    stage.run(context(paths, Recorder(), renders=False))
    numbers = read_json(paths.report_json)
    kept_aside = sum(view.split == "held_out" for view in views)
    assert numbers["exposure"]["other_light"] == odd
    assert numbers["held_out"]["views"] == kept_aside - 1
    assert numbers["capture"]["train_views"] == len(views) - kept_aside - 1
    assert f"left out of albedo, light and scores: {', '.join(odd)}" in paths.report.read_text(
        encoding="utf-8"
    )
    # the cameras are all there still
    assert len(read_json(paths.cameras)["views"]) == len(views)


def test_a_name_from_outside_cannot_write_html(tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    file = paths.stage("appearance") / "choices.json"
    choices = read_json(file)
    choices[0]["why"] = "<script>alert(1)</script>"
    write_json(file, choices)
    stage.run(context(paths, Recorder(), renders=False))
    assert "<script>alert" not in paths.report.read_text(encoding="utf-8")


def test_the_levels_come_into_the_report_and_replace_those_before(exported, tmp_path, capsys):
    source = exported
    paths = JobPaths(tmp_path / "out")
    shutil.copytree(source.root, paths.root)
    write_json(paths.manifest("export"), {"stage": "export"})
    before = paths.report.read_text(encoding="utf-8")
    assert "Where it is lost" not in before
    for _ in range(2):
        assert cli.main(["evaluate", str(paths.root)]) == 0
        told = capsys.readouterr().out
        page = paths.report.read_text(encoding="utf-8")
        assert page.count("Where it is lost") == 1
        verdict = read_json(paths.levels)["verdict"]
        assert verdict in told and verdict in html.unescape(page)
        start, end = (
            page.index('<section id="levels">'),
            page.index("</section>", page.index('<section id="levels">')),
        )
        assert before == page[:start] + '<section id="levels">' + page[end:]
    assert page[start:end].count("data:image/png") == 1
    assert paths.levels_strip.is_file()
    assert not paths.scores.exists()
