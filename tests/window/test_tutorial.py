# SPDX-License-Identifier: Apache-2.0
"""The tutorial of docs/blender.md: done as it says, with the pictures taken on the way.

`ROBIR_TUTORIAL=1 bash .ci/window -k tutorial` does it, which takes minutes: words and pictures come
to build/window/tutorial, and are copied from there to docs. `test_click_path.py` and
`test_by_hand.py` press the same buttons in every run, but for *Picture All Lights*, which
`tests/addon/test_film_and_report.py` calls.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from window.blender_window import PATIENCE, BlenderWindow
from window.conftest import BUILD, ROOT, opened
from window.screen import Screen

pytestmark = pytest.mark.slow

IS_FOR_DOCS = os.environ.get("ROBIR_TUTORIAL") == "1"
TUTORIAL = BUILD / "tutorial"
WIDTH = 1080
STATE = "bpy.context.window_manager.robir"
SETTINGS = "bpy.context.scene.robir"
WORLD_FILE = (
    "next(n for n in bpy.context.scene.world.node_tree.nodes if n.type == 'TEX_ENVIRONMENT')"
    ".image.filepath"
)

LEAD = """# From photographs to a relit object, in two minutes of clicks

Everything happens in one tab: open the sidebar of the 3D viewport with N and click *RobIR*. The
panel shows the next step, and folds finished ones. A reconstruction needs the engine: *Install
Engine* shows the size of its download. It takes minutes; Blender stays usable. These pictures are
taken by a test that clicks through Blender in the order of this page
(`tests/window/test_tutorial.py`), under software rendering.
"""

STEPS = (
    (
        "sample",
        "Press *Try the Sample*. A finished object arrives under another light, without an engine "
        "and without a download. Choose a light in *Relight*, turn it, make it stronger.",
    ),
    (
        "reconstructing",
        "Press *Reconstruct It Yourself*, or drop a capture of your own into the viewport: one of "
        "its photographs, a video, or a file of COLMAP, nerfstudio, RealityScan and others. You "
        "see the cameras, the format that was recognised, and any faults. Press *Reconstruct*. "
        "Photograph and reconstruction appear side by side and become more alike, and the surface "
        "grows inside the bounds. Esc asks whether to stop; *Reconstruct* continues. You may work "
        "on, or close Blender.",
    ),
    (
        "arrived",
        "The object arrives by itself, with its textures, the cameras and the recovered light as "
        "the scene's World. The panel *Result* shows its quality. Click another result, and "
        "the panels show that one.",
    ),
    (
        "lights",
        "Press *Picture All Lights*: this object under the recovered light and each that Blender "
        "ships, to choose by. Below, *Photograph, Film, Own Lights* takes a folder of your maps, "
        "and *Put into Photograph* lays the photograph behind and a ground that catches the "
        "shadow.",
    ),
    (
        "placed",
        "In *Size and Place*: *Set Real Size* needs two clicks and a length, *Stand on Floor* "
        "moves the origin to the foot, *Drop Ground* deletes the ground around the object, "
        "and what stood stands again. "
        "A newer result keeps size and place, and stays without its ground.",
    ),
)
END = """
## More in the panels

- **Photographs** has a tick for each photograph. *Leave Out* removes photographs with findings.
- **De-light Object** gives your own mesh a texture without light: [delight.md](delight.md).
- **Good**, **Check this** or **Doubtful**, in *Result*, has one reason and one remedy. *Open
  Report* turns the asset in your browser.
- **Compare**, in *Result*, shows photograph, re-render, albedo and roughness. Arrow keys and the
  buttons above change the view, show single pixels and wipe one picture over another.
- **What You Know** accepts a known colour, a Sun lamp or a tone curve, and so fixes the scale of
  brightness: [uncertainty.md](uncertainty.md).
- **Where to photograph next**: *Capture* tints the sides of the bounds that no photograph shows. A
  button under *Details* of *Result* tints the parts that no or few photographs show.
- **Export for Games** writes GLB and USD in levels of detail. The object stands on the floor,
  without its ground, and a normal map holds its fine shape. A menu below it writes what stands in
  the scene as GLB, USD and textures, and marks the object as an asset. **Library** runs many
  captures: [batch.md](batch.md).

- **Quads** are made on request: `pip install 'robir[quads]'`, then `--set geometry.quads=true`.
  Faces have one size and follow the bends. The asset holds each as two triangles. In Edit Mode
  *Face > Tris to Quads* joins them, and the texture stays.

## Search, scripts and installation

F3 finds every command. Scripts can call them too, and a command returns when it is done:
`bpy.ops.robir.choose_capture(directory=...)`, `bpy.ops.robir.reconstruct()`. Without a window use
`blender -b --command robir CAPTURE -o OUT`, with the options and exit codes of
[command_line.md](command_line.md).

*Install Engine* needs Blender's permission to go online (*Preferences > System*). The engine lives
in a folder of its own, and Blender's Python is not changed. If that is too new, another Python of
the machine is used. The add-on's preferences accept an existing environment with `robir`, or a
folder of wheels for a machine without network. The panels speak German where Blender does; messages
of the engine stay English.
"""


@pytest.fixture(scope="module")
def window(
    screen: Screen, home: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[BlenderWindow]:
    """Blender with the add-on installed; its engine is of this checkout."""
    with opened(screen, home, tmp_path_factory.mktemp("user"), "pictures-tutorial") as window:
        window.choose_engine()
        yield window


def shade(window: BlenderWindow, kind: str) -> None:
    """Shade the viewport, and wait until it is drawn: its shaders take a processor a minute."""
    window.run(
        "for area in window.screen.areas:\n"
        f"    if area.type == 'VIEW_3D': area.spaces.active.shading.type = {kind!r}",
        timeout=PATIENCE,
    )
    window.settle()


def wait_for_colour(window: BlenderWindow) -> None:
    """Wait until the viewport shows the object: its shaders may take a busy machine minutes."""
    before, still = np.zeros(0), 0
    for _ in range(100):
        with Image.open(window.picture("waiting")) as picture:
            shown = np.asarray(picture.convert("RGB")).astype(int)
        is_coloured = (np.ptp(shown, axis=2) > 40).mean() > 0.1
        still = still + 1 if is_coloured and np.array_equal(shown, before) else 0
        if still == 10:  # one shader may take half a minute
            return
        before = shown
        time.sleep(6.0)
    pytest.fail("the object is not drawn after ten minutes")


def keep(window: BlenderWindow, name: str) -> None:
    """Take one of the tutorial's pictures."""
    TUTORIAL.mkdir(parents=True, exist_ok=True)
    with Image.open(window.picture(name)) as picture:
        size = (WIDTH, round(WIDTH * picture.height / picture.width))
        small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    small.save(TUTORIAL / f"blender_{name}.jpg", quality=82, optimize=True)


def text() -> str:
    """The page."""
    steps = (
        f"\n{number}. {words}\n\n   ![{name}](blender_{name}.jpg)\n"
        for number, (name, words) in enumerate(STEPS, 1)
    )
    return LEAD + "".join(steps) + END


@pytest.mark.skipif(not IS_FOR_DOCS, reason="takes pictures for docs: ROBIR_TUTORIAL=1")
def test_the_sample_is_reconstructed_relit_and_placed(window: BlenderWindow) -> None:
    clicks = window.screen.clicks
    window.press("bpy.ops.robir.try_sample")
    window.wait_until(f"{SETTINGS}.result")
    window.settle()
    wait_for_colour(window)
    keep(window, "sample")
    shade(window, "SOLID")  # which a processor draws fast enough to click on
    place = window.find("robir.light")
    window.screen.click(place.x, place.y)
    time.sleep(1.0)
    window.screen.key("e")  # underlined in Sunset
    window.wait_until(f"'sunset' in {WORLD_FILE}")
    # the zip's dialog and the tab are two clicks before these
    assert window.screen.clicks - clicks <= 2
    window.press("bpy.ops.robir.reconstruct_sample")
    window.wait_until(f"{STATE}.recognised and not {STATE}.task", 120.0)
    window.press("bpy.ops.robir.reconstruct")
    window.wait_until(f"{STATE}.preview_serial > 2", 400.0)
    keep(window, "reconstructing")
    window.wait_until(f"not {STATE}.task and {SETTINGS}.result", 1500.0)
    window.settle()
    keep(window, "arrived")
    shade(window, "SOLID")
    window.press("bpy.ops.robir.picture_lights")
    window.wait_until(f"{STATE}.task == 'lights'")
    window.wait_until(f"not {STATE}.task", 600.0)
    shade(window, "MATERIAL")
    keep(window, "lights")
    faces = "len(bpy.context.object.data.polygons)"
    before = window.get(faces)
    window.run(
        "bpy.ops.robir.stand_on_floor()\n"
        "bpy.ops.robir.drop_ground()\n"
        "area = next(a for a in window.screen.areas if a.type == 'VIEW_3D')\n"
        "area.tag_redraw()",
        timeout=PATIENCE,
    )
    window.settle()
    assert 0.1 * before < window.get(faces) < before
    keep(window, "placed")


def test_the_page_says_what_was_done() -> None:
    TUTORIAL.mkdir(parents=True, exist_ok=True)
    (TUTORIAL / "blender.md").write_text(text(), encoding="utf-8")
    assert (ROOT / "docs" / "blender.md").read_text(encoding="utf-8") == text(), (
        "copy build/window/tutorial/* to docs"
    )
    for name, _ in STEPS:
        assert (ROOT / "docs" / f"blender_{name}.jpg").is_file()
