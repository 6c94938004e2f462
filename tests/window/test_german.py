# SPDX-License-Identifier: Apache-2.0
"""The installed add-on in a whole Blender that speaks German; the wheels know no languages."""

from __future__ import annotations

import json
import os
import re
import string
import subprocess
from pathlib import Path

import pytest
from addon.blenders import ROOT
from addon.finished import make_result

from robir_addon.words import read_catalogue

TESTS = Path(__file__).parents[1]
PARTS = (
    "addon/recording.py",
    "addon/panel_session.py",
    "addon/texts_session.py",
    "window/german_session.py",
)
DRIVER = """
with open({answer!r}, "w", encoding="utf-8") as file:
    json.dump(main(*{arguments!r}), file)
"""
CATALOGUE = read_catalogue(ROOT / "robir_addon/locale/de.po")


@pytest.fixture(scope="module")
def said(package: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What the session answered."""
    folder = tmp_path_factory.mktemp("german")
    result = make_result(folder / "result").root
    ours = re.compile(r"from \w*(recording|_session) import")
    lines = [line for part in PARTS for line in (TESTS / part).read_text("utf-8").splitlines()]
    script, answer = folder / "session.py", folder / "answer.json"
    code = [line for line in lines if not ours.match(line)]
    code.append(DRIVER.format(answer=str(answer), arguments=(str(package), str(result))))
    script.write_text("\n".join(code), encoding="utf-8")
    done = subprocess.run(
        ["blender", "-b", "--factory-startup", "--python-exit-code", "3", "--python", script],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env={**os.environ, "HOME": str(folder / "home")},
    )
    assert answer.exists(), f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return json.loads(answer.read_text(encoding="utf-8"))


def left_english() -> list[re.Pattern[str]]:
    """English texts as they look when their fields are filled, where German has other words."""
    return [
        re.compile(filled(text))
        for (_, text), translated in CATALOGUE.items()
        if not re.fullmatch(filled(text), translated)
    ]


def filled(text: str) -> str:
    parts = string.Formatter().parse(text)
    return "".join(re.escape(said) + ("" if name is None else ".+") for said, name, _, _ in parts)


def test_panels_speak_german_in_every_state(said):
    patterns = left_english()
    for state, texts in said["seen"].items():
        english = [t for t in texts if any(pattern.fullmatch(t) for pattern in patterns)]
        assert not english, (state, english)


def test_what_is_put_together_is_german(said):
    def all_of(state):
        return said["seen"][state]

    assert {"Aufnahme", "Aufnahme wählen", "Beispiel ausprobieren"} <= set(all_of("nothing"))
    assert "Fotos (2 von 3)" in all_of("lacking")
    assert "42 %, noch 1 h 33 min" in all_of("running")
    assert "Form" in all_of("running")
    assert "Zweifelhaft" in all_of("doubtful")
    assert any("zurückgehaltenen Fotos" in text for text in all_of("done"))


def test_german_fits_a_narrow_sidebar(said):
    assert not said["wide"]


def test_names_and_descriptions_are_those_of_the_catalogue(said):
    """Blender prefers its own words where it has some: the catalogue shall say the same."""
    other = [
        (text, found, CATALOGUE[context, text])
        for context, text, _, found in said["names"]
        if text and found != CATALOGUE[context, text]
    ]
    assert not other


def test_who_refuses_says_why_in_german(said):
    refused = said["refusals"]
    assert refused["nothing"]["look_at_capture"] == "Zuerst eine Aufnahme wählen"
    assert refused["nothing"]["export_glb"] == "Zuerst ein Ergebnis importieren"
    english = {text for (_, text), translated in CATALOGUE.items() if translated != text}
    for reasons in refused.values():
        assert not english & set(reasons.values())


def test_reports_are_german_and_lose_blenders_word_before_them(said):
    raw, plain, _, _ = said["reports"]["choose_capture"]
    assert plain == "Es gibt keinen Ordner '/nowhere'; einen anderen wählen"
    assert raw.endswith(plain)
    assert raw != plain
    _, _, error, cure = said["reports"]["import_result"]
    assert error.startswith("/nowhere/export/tone_curve.json lässt sich nicht lesen")
    assert cure == "Einen Ordner wählen, den `robir reconstruct` fertiggestellt hat"


def test_english_comes_back(said):
    """And the patterns above find it, without which they would prove nothing."""
    patterns = left_english()
    found = [t for t in said["english"] if any(pattern.fullmatch(t) for pattern in patterns)]
    assert {"Capture", "Photographs (2 of 3)"} <= set(found)
