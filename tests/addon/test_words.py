# SPDX-License-Identifier: Apache-2.0
"""Every text that a user reads can be translated, and the catalogues know all of them."""

from __future__ import annotations

import shutil
import string
import subprocess
from pathlib import Path

import pytest
from addon.blenders import ROOT, run
from addon.test_panels import script
from addon.texts import texts_of

from robir_addon.words import read_catalogue

pytestmark = pytest.mark.blender

ADDON = ROOT / "robir_addon"
CATALOGUES = sorted((ADDON / "locale").glob("*.po"))


@pytest.fixture(scope="module")
def needed(own_blender, extension_zip, tmp_path_factory) -> dict[tuple[str, str], list[str]]:
    """Texts with the places that say them: of the source, and of what is registered."""
    texts = dict(texts_of(ADDON).texts)
    session = script("texts_session.py")
    user = tmp_path_factory.mktemp("user")
    for context, text, who in run(own_blender, session, str(extension_zip), user=user):
        if text:
            texts.setdefault((context, text), []).append(who)
    return texts


@pytest.fixture(params=CATALOGUES, ids=lambda file: file.stem)
def catalogue(request) -> Path:
    return request.param


def entry(key: tuple[str, str], places: list[str]) -> str:
    """An entry of a .po file to be filled in."""
    context, text = key
    lines = [f"#: {' '.join(sorted(set(places)))}"]
    if context != "*":
        lines.append(f'msgctxt "{context}"')
    quoted = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return "\n".join([*lines, f'msgid "{quoted}"', 'msgstr ""', ""])


def test_nothing_is_said_that_cannot_be_translated():
    faults = texts_of(ADDON).faults
    assert not faults, "\n".join(faults)


def test_no_text_is_missing(needed, catalogue):
    missing = {
        key: places for key, places in needed.items() if key not in read_catalogue(catalogue)
    }
    stubs = "\n".join(entry(key, places) for key, places in sorted(missing.items(), key=by_text))
    assert not missing, f"{catalogue.name} lacks {len(missing)} texts:\n\n{stubs}"


def test_no_translation_is_left_over(needed, catalogue):
    unused = [key for key in read_catalogue(catalogue) if key not in needed]
    assert not unused, f"nothing says these texts of {catalogue.name} any more: {unused}"


def test_fields_and_cures_survive_the_translation(catalogue):
    """Fields may stand in another order; what follows a semicolon is shown as the cure."""
    for (_, text), translated in read_catalogue(catalogue).items():
        assert fields(translated) == fields(text), text
        assert translated.count("; ") == text.count("; "), text


@pytest.mark.skipif(shutil.which("msgfmt") is None, reason="GNU gettext is not on this machine")
def test_gettext_reads_the_same(catalogue, tmp_path):
    """msgunfmt and msgfmt are another reader of the format."""
    compiled = tmp_path / "catalogue.mo"
    subprocess.run(["msgfmt", "-c", "-o", compiled, catalogue], check=True, capture_output=True)
    again = tmp_path / "again.po"
    subprocess.run(["msgunfmt", "-o", again, compiled], check=True)
    assert read_catalogue(again) == read_catalogue(catalogue)


def test_a_catalogue_is_read_as_gettext_means_it(tmp_path):
    file = tmp_path / "xx.po"
    file.write_text(
        '# comment\nmsgid ""\nmsgstr "Language: xx\\n"\n\n'
        'msgid "one"\nmsgstr "eins"\n\n'
        'msgctxt "Operator"\nmsgid "one"\nmsgstr "eine"\n\n'
        '#, python-brace-format\nmsgid ""\n"long \\"{name}\\" "\n"text\\n"\n'
        'msgstr ""\n"lang \\\\"\n" {name}"\n\n'
        '#, fuzzy\nmsgid "guess"\nmsgstr "geraten"\n\n'
        'msgid "later"\nmsgstr ""\n\n'
        '#~ msgid "old"\n#~ msgstr "alt"\n',
        encoding="utf-8",
    )
    assert read_catalogue(file) == {
        ("*", "one"): "eins",
        ("Operator", "one"): "eine",
        ("*", 'long "{name}" text\n'): "lang \\ {name}",
    }


@pytest.mark.parametrize(
    ("line", "text", "fault"),
    [
        ("layout.operator('robir.x', text='Go')", ("Operator", "Go"), ""),
        ("layout.label(text='Here')", ("*", "Here"), ""),
        ("layout.label(text=f'{n} faults')", None, "put together"),
        ("text = 'a {b}' if n else 'c'\n    told(text, b=n)", ("*", "c"), ""),
        ("layout.label(text=NAMES.get(n))", ("*", "Second"), ""),
        ("raise ResultError(f'{n} is gone')", None, "put together"),
        ("raise ResultError('gone')", ("*", "gone"), ""),
        ("paragraph(layout, n, 'said')", None, "without being looked up"),
        ("cls.poll_message_set('no')", None, "without being looked up"),
        ("state.message = 'done'", None, "without being looked up"),
        ("self.report({'INFO'}, f'saved {n}')", None, "put together"),
        ("layout.label(text=f'{n}: {m}')", None, ""),
    ],
)
def test_the_reader_notices_what_is_planted(tmp_path, line, text, fault):
    """Without this, the tests above would prove nothing."""
    source = f"NAMES = {{1: 'First', 2: 'Second'}}\n\ndef draw(n):\n    {line}\n"
    (tmp_path / "panel.py").write_text(source, encoding="utf-8")
    found = texts_of(tmp_path)
    if text is not None:
        assert text in found.texts
    assert [fault in said for said in found.faults] == ([True] if fault else [])


def by_text(item: tuple[tuple[str, str], list[str]]) -> tuple[str, str]:
    (context, text), _ = item
    return text, context


def fields(text: str) -> list[tuple[str, str | None, str | None]]:
    parts = string.Formatter().parse(text)
    return sorted(
        (name, spec or "", kind or "") for _, name, spec, kind in parts if name is not None
    )
