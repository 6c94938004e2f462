# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked for: the values that decide the pixels of a capture, and their fingerprint."""

import ast
import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from blender_scenes.recipe import Recipe
from blender_scenes.variation import AS_BUILT, Variation

SCENES = ("truck", "chessboard", "still_life", "hotdog", "asset", "drawn")
NAMED_SCENES = SCENES[:-1]
"""Those that a command line can ask for by name; the other one needs a recipe."""

GROUNDS = ("checker", "plain", "none")
LIGHTS = ("lamp", "hdri-sun")
PRESETS = ("high_illumination",)

DEFAULT_GROUND = {"truck": "checker"}
"""Ground of a scene where none is asked for; every other scene stands on a plain disc."""

_STREAMS = ("layout", "ground", "light", "train", "test")
_NOT_PIXELS = frozenset({"__main__.py", "format.py", "view_transform.py", "cache.py"})


class SceneError(Exception):
    """A request that cannot be fulfilled; the message says what was found and what to do."""


@dataclass(frozen=True)
class SceneRequest:
    """Everything that decides the linear pixels of a capture (the tone mapping does not).

    Attributes:
        scene: one of SCENES.
        ground: one of GROUNDS.
        light: one of LIGHTS.
        preset: None or one of PRESETS.
        hdri: environment file; None takes the one from the bpy wheel that suits `light`.
        asset: OBJ or glTF file of scene "asset", else None.
        resolution: width and height of a view in pixels.
        views: number of training views.
        test_views: number of test views, at other positions.
        samples: Cycles samples per pixel, denoised afterwards.
        seed: decides layout, colours, cameras and light direction.
        variation: what differs from the scene as its file builds it.
        recipe: all of scene "drawn", else None.
    """

    scene: str
    ground: str
    light: str
    preset: str | None = None
    hdri: Path | None = None
    asset: Path | None = None
    resolution: int = 160
    views: int = 40
    test_views: int = 8
    samples: int = 64
    seed: int = 0
    variation: Variation = AS_BUILT
    recipe: Recipe | None = None

    def __post_init__(self) -> None:
        """Refuses contradictions and impossible values, in words."""
        for value, allowed, name in (
            (self.scene, SCENES, "SCENE"),
            (self.ground, GROUNDS, "--ground"),
            (self.light, LIGHTS, "--light"),
            (self.preset, (None, *PRESETS), "--preset"),
        ):
            if value not in allowed:
                raise SceneError(
                    f"{name} is {value!r}; choose one of {', '.join(map(str, allowed))}"
                )
        if self.scene == "asset" and self.asset is None:
            raise SceneError("scene 'asset' needs --asset FILE (an .obj, .gltf or .glb file)")
        if self.scene != "asset" and self.asset is not None:
            raise SceneError(
                f"--asset belongs to scene 'asset'; scene {self.scene!r} does not use it"
            )
        if self.preset == "high_illumination" and self.light != "lamp":
            raise SceneError(
                "preset 'high_illumination' strengthens the lamp; use it with --light lamp"
            )
        self._refuse_lamps()
        if self.asset is not None and self.asset.suffix.lower() not in (".obj", ".gltf", ".glb"):
            raise SceneError(
                f"--asset {self.asset}: unknown kind {self.asset.suffix!r}; use .obj, .gltf or .glb"
            )
        if self.hdri is not None and self.hdri.suffix.lower() not in (".hdr", ".exr"):
            raise SceneError(
                f"--hdri {self.hdri}: unknown kind {self.hdri.suffix!r}; use .hdr or .exr"
            )
        for path, name in ((self.asset, "--asset"), (self.hdri, "--hdri")):
            if path is not None and not path.is_file():
                raise SceneError(f"{name} {path}: no such file")
        for name, low in (
            ("resolution", 8),
            ("views", 1),
            ("test_views", 0),
            ("samples", 1),
            ("seed", 0),
        ):
            if getattr(self, name) < low:
                option = "--" + name.replace("_", "-")
                raise SceneError(f"{option} is {getattr(self, name)}; it must be at least {low}")

    def _refuse_lamps(self) -> None:
        """Refuses variations of a lamp that is not there, or that the preset decides."""
        if self.variation.is_of_lamp and self.light != "lamp":
            raise SceneError(
                "--vary sun_share, sun_size and suns are of the lamp; use --light lamp"
            )
        if self.preset is not None and self.variation.sun_share is not None:
            raise SceneError(
                f"preset {self.preset!r} decides the share of the lamp; leave out --vary sun_share"
            )


def random_stream(request: SceneRequest, part: str) -> np.random.Generator:
    """An own generator for each part, so that a choice in one leaves the others as they were.

    Args:
        request: gives the seed and the scene.
        part: "layout", "ground", "light", "train" or "test".
    """
    return np.random.default_rng([request.seed, _STREAMS.index(part), SCENES.index(request.scene)])


def fingerprint(request: SceneRequest, wheel_version: str) -> str:
    """Hash of everything that decides the linear pixels: request, file contents, code, renderer.

    Args:
        request: what is asked for; files enter by content, not by name.
        wheel_version: version of the renderer.

    Returns:
        24 hexadecimal digits.
    """
    facts = asdict(request) | {
        "hdri": _content_hash([request.hdri] if request.hdri else []),
        "asset": _content_hash(_asset_files(request.asset)),
        "recipe": _recipe_facts(request.recipe),
        "bpy": wheel_version,
        "code": code_version(Path(__file__).parent, request.scene),
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:24]


def _recipe_facts(recipe: Recipe | None) -> dict | None:
    """A recipe as plain values, its files by content."""
    if recipe is None:
        return None
    facts = asdict(recipe)
    for part in facts["parts"]:
        part["file"] = _content_hash(_asset_files(part["file"]))
    facts["second_light"]["file"] = _content_hash([recipe.second_light.file])
    return facts


def code_version(package: Path, scene: str) -> str:
    """Hash of the program that makes the pixels of a scene.

    Comments, layout and docstrings do not count.

    Args:
        package: folder of the program.
        scene: its file enters, those of the other scenes do not.

    Returns:
        16 hexadecimal digits.
    """
    digest = hashlib.sha256()
    shared = sorted(p for p in package.glob("*.py") if p.name not in _NOT_PIXELS)
    for source in [*shared, package / "scenes" / f"{scene}.py"]:
        tree = ast.parse(source.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):
                body[:] = [s for s in body if not _is_text(s)]
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()[:16]


def _is_text(statement: ast.AST) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def _asset_files(asset: Path | None) -> list[Path]:
    """The asset and its neighbours: textures and buffers decide the pixels as much as the mesh."""
    if asset is None:
        return []
    kinds = {".png", ".jpg", ".jpeg", ".bin", ".mtl"}
    return [asset, *sorted(p for p in asset.parent.iterdir() if p.suffix.lower() in kinds)]


def _content_hash(files: list[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]
