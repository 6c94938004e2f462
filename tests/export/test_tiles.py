# SPDX-License-Identifier: Apache-2.0
"""A result over UDIM tiles: files, GLB, USD and report say the same of every tile."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import trimesh
from capture.test_normal_map import rewrite
from evaluation import sphere_run
from export.test_gltf import document, embedded, faults_of
from export.test_stage import Recorder, context
from export.tiled_run import CORNERS, SHADES, SIDE, TILES, make_tiled_run, own_uvs
from export.tiled_run import tiled_textures as arrays
from PIL import Image

from robir.capture.mesh_file import read_mesh
from robir.evaluation.metrics import srgb_from_linear
from robir.export import stage, textures
from robir.export.gltf import write_usd
from robir.export.textures import finished_textures, write_png
from robir.geometry.given.layout import Layout, own_layout
from robir.jobs.paths import of_tile, read_json

KINDS = ("albedo", "roughness", "coverage", "uncertainty")
CODES = np.round(255 * srgb_from_linear(SHADES)).astype(int)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    paths = make_tiled_run(tmp_path_factory.mktemp("tiled") / "sphere run")
    stale = [paths.textures / f"{name}.png" for name in ("albedo", "albedo.1002", "normal.1001")]
    for file in stale:
        write_png(file, np.zeros((4, 4, 3), np.uint8))
    write_png(of_tile(paths.textures / "mine.png", 1002), np.zeros((4, 4, 3), np.uint8))
    stage.run(context(paths, Recorder(), renders=False))
    return paths


def picture(file: Path) -> np.ndarray:
    with Image.open(file) as image:
        return np.array(image)


def test_every_tile_has_its_files_and_no_others_are_left(exported):
    names = {file.name for file in exported.textures.iterdir()}
    wanted = {f"{kind}.{tile}.png" for kind in KINDS for tile in TILES}
    assert names == wanted | {f"albedo.{tile}.exr" for tile in TILES} | {"mine.1002.png"}


def test_no_colour_crosses_from_one_tile_into_another(exported):
    for tile, shade, codes in zip(TILES, SHADES, CODES, strict=True):
        albedo = picture(exported.textures / f"albedo.{tile}.png")
        assert albedo.shape == (SIDE, SIDE, 3)
        assert (albedo == codes).all()
        exr = OpenEXR.File(str(exported.textures / f"albedo.{tile}.exr")).channels()
        linear = next(iter(exr.values())).pixels.astype(float)
        assert linear == pytest.approx(np.broadcast_to(shade, linear.shape), abs=1e-3)
    roughness = [picture(exported.textures / f"roughness.{tile}.png") for tile in TILES]
    assert [set(one.ravel().tolist()) for one in roughness] == [{51}, {102}, {153}]


def test_islands_grow_within_their_tile_only():
    """An island at the border of a tile, and nothing in the one beside it."""
    given = arrays()
    given["inside"][:, SIDE:] = False
    first, second, _ = textures.tile_textures(given, TILES, 6, Path("none.png"))
    assert first.albedo_linear == pytest.approx(np.broadcast_to(SHADES[0], (SIDE, SIDE, 3)))
    grown = finished_textures(given, 6).albedo_linear[SIDE:, SIDE : SIDE + 8]
    assert grown == pytest.approx(np.broadcast_to(SHADES[0], grown.shape)), "else nothing is shown"
    assert second.albedo_linear == pytest.approx(np.broadcast_to(SHADES[1], (SIDE, SIDE, 3)))


def test_the_glb_has_a_primitive_and_a_material_for_each_tile(exported):
    table, _ = document(exported.asset)
    (mesh,) = table["meshes"]
    materials = [table["materials"][one["material"]] for one in mesh["primitives"]]
    assert [material["extras"]["udim"] for material in materials] == TILES.tolist()
    assert [material["name"] for material in materials] == [f"capture.{tile}" for tile in TILES]
    for material, codes, rough in zip(materials, CODES, (51, 102, 153), strict=True):
        of = material["pbrMetallicRoughness"]
        sources = [
            table["textures"][of[key]["index"]]["source"]
            for key in ("baseColorTexture", "metallicRoughnessTexture")
        ]
        assert (embedded(exported.asset, sources[0]) == codes).all()
        assert (embedded(exported.asset, sources[1]) == [255, rough, 0]).all()


def test_a_second_reader_finds_faces_and_places_within_tiles(exported):
    scene = trimesh.load(exported.asset, process=False)
    world, uvs = sphere_run.world_mesh(), own_uvs()
    third = np.floor(uvs.mean(axis=1)).astype(int)
    for index, part in enumerate(scene.geometry.values()):
        chosen = (third == CORNERS[index]).all(axis=1)
        x, y, z = np.asarray(part.vertices).T
        found = np.stack([x, -z, y], axis=1)[part.faces]
        assert found == pytest.approx(world.vertices[world.faces][chosen], abs=1e-6)
        within = np.asarray(part.visual.uv)[part.faces]
        assert within == pytest.approx(uvs[chosen] - CORNERS[index], abs=1e-6)
    assert index == 2


def test_handed_in_again_the_glb_has_the_layout_it_was_made_for(exported):
    given = read_mesh(exported.asset)
    third = np.floor(own_uvs().mean(axis=1)) @ [1, 10]
    expected = own_uvs()[np.argsort(third, kind="stable")]
    assert given.uvs[given.faces] == pytest.approx(expected, abs=1e-6)
    found = own_layout(given)
    assert isinstance(found, Layout), found
    assert found.tiles.tolist() == TILES.tolist()


@pytest.mark.parametrize("name", ["capture.1000", "capture.2001", "capture.001", "capture", "1003"])
def test_other_names_of_materials_stand_for_no_tile(exported, tmp_path, name):
    copy = tmp_path / "scan.glb"
    copy.write_bytes(exported.asset.read_bytes())
    rewrite(copy, lambda table: table["materials"][1].update(name=name))
    assert read_mesh(copy).uvs.max() <= 1


def test_the_khronos_validator_finds_no_fault(exported):
    errors, warnings = faults_of(exported.asset)
    assert not errors and not warnings


def test_usd_has_the_users_coordinates_and_names_all_tiles_at_once(exported):
    write_usd(exported, {})
    text = exported.usd.read_text(encoding="utf-8")
    assert "@./textures/albedo.<UDIM>.png@" in text
    assert "@./textures/roughness.<UDIM>.png@" in text
    assert "metallic" not in text
    line = next(line for line in text.splitlines() if "primvars:st =" in line)
    numbers = line.partition("[] primvars:st = [")[2].partition("]")[0]
    found = np.fromstring(numbers.replace("(", "").replace(")", ""), sep=",").reshape(-1, 2)
    indices = next(line for line in text.splitlines() if "st:indices" in line)
    order = np.fromstring(indices.partition("= [")[2].rstrip("]"), sep=",", dtype=int)
    assert found[order].reshape(-1, 3, 2) == pytest.approx(own_uvs(), abs=1e-6)


def test_the_report_shows_every_tile(exported):
    numbers = read_json(exported.report_json)
    assert (numbers["texture_size"], numbers["tiles"]) == (SIDE, TILES.tolist())
    page = exported.report.read_text(encoding="utf-8")
    assert "3 UDIM tiles of 128&times;128" in page
    assert "albedo, tiles row by row: 1001, 1003, 1011" in page
    sheet = textures.shown_texture(exported, "albedo")
    half = len(sheet) // 2
    middles = [sheet[half // 2, half // 2], sheet[half // 2, 3 * half // 2]]
    middles += [sheet[3 * half // 2, half // 2], sheet[3 * half // 2, 3 * half // 2]]
    assert middles[:3] == pytest.approx(CODES, abs=1)
    assert not middles[3].any()
    assert textures.shown_texture(exported, "metallic") is None
