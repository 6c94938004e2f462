# SPDX-License-Identifier: Apache-2.0
"""What each error costs: the same run with one quantity taken from the truth.

`robir bench --population DIR --oracle level metal` runs every capture as it is, and once more for
each quantity named. Curve, suns and surface are told by settings. The others are put right after
the step that estimates them: `python -m robir_bench.judge.oracles NAME CAPTURE OUT ARGUMENTS` runs
`robir reconstruct` so.

Metal and roughness are known where a test view shows them; elsewhere the estimate stays. Metal is
told with its base colour, as the mask alone would leave that open.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial import cKDTree
from skimage.transform import resize_local_mean

from robir.appearance.light.lobes import Amplitudes, lobes_of, log_sent, soft_lobes
from robir.appearance.light.solver import Light
from robir.appearance.material.metal import SOLVED_WITHOUT
from robir.appearance.material.specular import with_material
from robir.appearance.smooth_normals import LitSurface
from robir.appearance.solution import Solution
from robir.capture.store import load_settled
from robir.errors import UsageError
from robir.evaluation.light import RecoveredLight, read_exr
from robir.geometry.mesh.triangles import vertex_normals
from robir.jobs.paths import JobPaths
from robir.maths.vectors import equirect_directions, equirect_solid_angles
from robir.steps import Correction, corrected
from robir_bench.truth.aligned import Alignment, truth_of
from robir_bench.truth.files import Truth, lamps_of, load_truth, true_environment
from robir_bench.truth.light import level_and_hue, true_curve

Floats = NDArray[np.float32]

# quantities that can be told, each on its own
ORACLES = ("family", "sun", "level", "metal", "roughness", "normals", "surface", "light")

_REACH = 0.02  # distance, unit frame, up to which a pixel of a test view tells of a sample

_FACING = 0.5  # cosine between their normals from which it does

_SPOT = 5.0  # degrees about the sun's direction that belong to a sun in the map

_ROWS = 32  # rows of the map by which the sky's lobes are fitted

_CERTAIN = 0.01  # error of a level that is told, natural logarithm

_LEAST_RADIUS = 0.5  # least radius of a sun, degrees


def settings_of(name: str, capture: Path) -> tuple[str, ...]:
    """Settings that tell a quantity, or leave out what would change it again.

    Args:
        name: One of `ORACLES`.
        capture: With its truth.
    """
    if name == "family":
        scene = load_truth(capture).scene
        curve = true_curve(scene)
        # a camera's response is drawn about the mean of cameras, which is the nearest family; a
        # look of Blender's comes before Filmic, which no family has
        nearest = "camera" if scene.get("response") else "filmic"
        return (f'appearance.families=["{curve.name if curve is not None else nearest}"]',)
    if name == "sun":
        truth = load_truth(capture)
        if truth.scene.get("classes", {}).get("sun") != "sun":
            return ("appearance.num_sharp_lobes=0",)
        return (f"appearance.sun={[round(float(v), 6) for v in truth.sun_direction]}",)
    return ()


def mesh_of(name: str, capture: Path) -> Path | None:
    """The surface that is told, if it is."""
    return capture / "truth" / "mesh.ply" if name == "surface" else None


def is_set_after_step(name: str) -> bool:
    """Whether a quantity is put right after the step that estimates it."""
    return name in _CORRECTIONS


@dataclass(frozen=True, slots=True)
class _Known:
    """What test views show of the surface, unit frame."""

    tree: cKDTree  # of the points
    normal: Floats  # (N, 3)
    albedo: Floats  # (N, 3) linear Rec.709
    roughness: Floats  # (N,)
    metallic: Floats  # (N,) share of the pixel

    @classmethod
    def of(cls, truth: Truth, unit: Callable[[Floats], Floats]) -> _Known:
        """All pixels of the test views; `unit` brings their places to the unit frame."""
        hits = [view.hit for view in truth.views]
        folder = truth.root / "truth" / "test"
        metallic = [read_exr(folder / f"{view.name}.exr")["metallic"] for view in truth.views]

        def pooled(images: Sequence[Any]) -> Floats:
            return np.concatenate([image[hit] for image, hit in zip(images, hits, strict=True)])

        return cls(
            tree=cKDTree(unit(pooled([view.position for view in truth.views]))),
            normal=pooled([view.normal for view in truth.views]),
            albedo=pooled([view.albedo for view in truth.views]),
            roughness=pooled([view.roughness for view in truth.views]),
            metallic=pooled(metallic),
        )

    def at(self, position: Floats, normal: Floats) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """The nearest point (N,) to each sample, and whether it tells of that."""
        distance, nearest = self.tree.query(position)
        nearest = np.minimum(nearest, len(self.normal) - 1)
        facing = np.einsum("nd,nd->n", self.normal[nearest], normal)
        return nearest, (distance < _REACH) & (facing > _FACING)


class Oracle:
    """The truth of one capture, put where a step left its estimate."""

    def __init__(self, capture: Path, out: Path) -> None:
        """Nothing is read before a step asks.

        Args:
            capture: With its truth.
            out: Result folder of the run that is put right.
        """
        self._capture, self._out = capture, out
        self._known: _Known | None = None

    @cached_property
    def _aligned(self) -> tuple[Truth, Alignment | None]:
        """The truth where the result stands; its cameras are there once the steps run."""
        return truth_of(self._capture, JobPaths(self._out))

    @property
    def _truth(self) -> Truth:
        return self._aligned[0]

    @property
    def _turn(self) -> NDArray[np.float64]:
        """From the truth's frame to the result's."""
        alignment = self._aligned[1]
        return np.eye(3) if alignment is None else alignment.place.turn

    def _points(self, state: Solution) -> tuple[_Known, NDArray[np.int64], NDArray[np.bool_]]:
        if self._known is None:
            self._known = _Known.of(self._truth, self._unit)
        surfels = state.problem.scene.transport.surfels
        return self._known, *self._known.at(surfels.position, surfels.normal)

    def _unit(self, points: Floats) -> Floats:
        """Places of the truth in the stage's frame, in which the object's sphere is the unit."""
        bounds = load_settled(JobPaths(self._out)).bounds
        return ((points - bounds.centre) / bounds.radius).astype(np.float32)

    def normals(self, state: LitSurface) -> LitSurface:
        """True normals of samples and vertices, from the nearest place on the true mesh."""
        truth, mesh, surfels = self._truth, state.mesh, state.transport.surfels
        corners = truth.vertices[truth.faces]
        weights = np.random.default_rng(0).dirichlet(np.ones(3), (len(corners), 8))
        sides = corners[:, 1:] - corners[:, :1]
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        some = np.random.default_rng(1).choice(len(corners), 300_000, p=area / area.sum())
        points = np.einsum("nc,ncd->nd", weights[some, np.arange(len(some)) % 8], corners[some])
        smooth = vertex_normals(truth.vertices, truth.faces)[truth.faces[some]].mean(1)
        tree = cKDTree(self._unit(points))

        def true(position: Floats, normal: Floats) -> Floats:
            _, near = tree.query(position, k=6)
            facing = np.einsum("nkd,nd->nk", smooth[near], normal)
            best = near[np.arange(len(near)), facing.argmax(1)]
            found = np.where(facing.max(1)[:, None] > 0, smooth[best], normal)
            return (found / np.linalg.norm(found, axis=1, keepdims=True)).astype(np.float32)

        own = true(surfels.position, surfels.normal)
        vertices = true(mesh.vertices.astype(np.float32), mesh.normals)
        return replace(
            state,
            mesh=replace(mesh, normals=vertices),
            transport=replace(state.transport, surfels=replace(surfels, normal=own)),
        )

    def metal(self, state: Solution) -> Solution:
        """Where metal is, and its base colour."""
        known, nearest, known_here = self._points(state)
        specular = state.material
        metallic = np.where(known_here, known.metallic[nearest] > 0.5, specular.metallic > 0.5)
        base = np.where(known_here[:, None], known.albedo[nearest], specular.metal).astype(
            np.float32
        )
        is_new = metallic & (specular.metallic < 0.5) & ~specular.has_highlights
        roughness = np.where(is_new, known.roughness[nearest], specular.roughness)
        return self._with(state, roughness, metallic, base)

    def roughness(self, state: Solution) -> Solution:
        """How rough everything is; all of it then has a specular layer, as it does in Blender."""
        known, nearest, known_here = self._points(state)
        specular = state.material
        roughness = np.where(known_here, known.roughness[nearest], specular.roughness)
        state = replace(state, specular=replace(specular, has_highlights=True))
        # whole steps: each roughness is a table of its own
        return self._with(
            state, np.round(roughness * 20) / 20, specular.metallic > 0.5, specular.metal
        )

    def _with(
        self, state: Solution, roughness: Any, metallic: NDArray[np.bool_], base: Floats
    ) -> Solution:
        """The solution with another specular material, taken out of what it is solved by."""
        problem, every = state.problem, np.ones(len(metallic), bool)
        material = roughness.astype(np.float32).clip(0.05, 1), metallic.astype(np.float32)
        specular, diffuse = with_material(problem, state.light, state.material, every, material)
        matte, rows = problem.without_highlights(diffuse), problem.scene.rows
        dielectric = specular.solved_by(rows, SOLVED_WITHOUT)
        if len(dielectric) < len(rows):
            matte = matte.by_samples(dielectric, np.random.default_rng(state.seed))
        return replace(state, specular=replace(specular, metal=base), matte=matte)

    def level(self, state: Solution) -> Solution:
        """How bright the light is as a whole."""
        light, rows = state.light, state.matte.scene.rows
        lobes = lobes_of(light.amplitudes, light.axes, light.sharpness)
        is_sharp = np.arange(len(lobes.axis)) >= len(lobes.axis) - len(light.axes)
        ours = RecoveredLight(lobes=lobes, is_sharp=is_sharp).environment(64)
        true = self._truth.environment_linear * self._truth.exposed
        normals = np.concatenate([view.normal[view.hit] for view in self._truth.views])
        off = level_and_hue(ours, true, normals)["level_log_error"]
        irradiance = light.irradiance(state.matte, rows)
        sent = log_sent(irradiance, state.matte.indirect[rows])
        prior = replace(state.prior, level=float(sent.mean()) - off, level_error=_CERTAIN)
        return replace(state, prior=prior)

    def light(self, state: Solution) -> Solution:
        """The whole light: the map as soft lobes, lamps and the map's spot as suns."""
        return replace(state, light=self._true_light(state.light))

    def _true_light(self, light: Light) -> Light:
        truth, turn = self._truth, self._turn
        scene, factor = truth.scene, truth.exposed
        lamps = lamps_of(scene)
        sizes = [lamp.get("size", 2 * _LEAST_RADIUS) for lamp in scene.get("lamps", [])]
        sizes += [2 * _LEAST_RADIUS] * (len(lamps) - len(sizes))
        suns = [(turn @ d, e, size) for (d, e), size in zip(lamps, sizes, strict=True)]
        linear = true_environment(truth.root, scene | {"lamps": []}, turn)
        directions = equirect_directions(len(linear)).numpy()
        if not scene.get("sun_is_lamp") and scene.get("classes", {}).get("sun") == "sun":
            inside = directions @ truth.sun_direction > np.cos(np.radians(_SPOT))
            around = np.median(linear[~inside], axis=0)
            suns.append((truth.sun_direction, scene["sun_irradiance_rgb"], 2 * _LEAST_RADIUS))
            linear = np.where(inside[..., None], np.minimum(linear, around), linear)
        small = resize_local_mean(linear, (_ROWS, 2 * _ROWS)).reshape(-1, 3)
        # square roots of solid angles, as least squares square them
        solid = np.sqrt(np.broadcast_to(equirect_solid_angles(_ROWS), (_ROWS, 2 * _ROWS)).ravel())
        axes, sharpness = soft_lobes(light.amplitudes.soft.shape[0])
        towards = equirect_directions(_ROWS).reshape(-1, 3)
        basis = torch.exp(sharpness * (towards @ axes.T - 1)).numpy() * solid[:, None]
        soft = np.stack([nnls(basis, small[:, c] * solid)[0] for c in range(3)], axis=1)
        radii = np.radians(np.maximum([0.5 * size for *_, size in suns], _LEAST_RADIUS))
        return replace(
            light,
            axes=np.array([direction for direction, *_ in suns], np.float32).reshape(-1, 3),
            # a disc's mean squared angle from its middle is half its radius squared
            sharpness=(2 / radii**2).astype(np.float32).reshape(-1),
            amplitudes=Amplitudes(
                soft=torch.from_numpy((soft * factor).clip(1e-6)).float(),
                sharp=torch.from_numpy(
                    (np.array([e for _, e, _ in suns]).reshape(-1, 3) * factor).astype(np.float32)
                ),
            ),
        )


# steps after which a quantity is put right
_CORRECTIONS: dict[str, tuple[str, ...]] = {
    "level": ("level",),
    "metal": ("gloss",),
    "roughness": ("gloss",),
    "normals": ("smooth-normals",),
    "light": ("every-sample", "refit"),
}


def corrections(name: str, oracle: Oracle) -> dict[str, Correction]:
    """What is done after which step."""
    correction: Correction = getattr(oracle, name)
    return dict.fromkeys(_CORRECTIONS[name], correction)


def main(words: Sequence[str]) -> int:
    """Run `robir reconstruct` with one quantity told; `NAME CAPTURE OUT ARGUMENTS`."""
    from robir.cli import main as robir

    name, capture, out, *arguments = words
    if name not in _CORRECTIONS:
        raise UsageError(f"{name!r} is not told after a step; {', '.join(_CORRECTIONS)} are")
    with corrected(corrections(name, Oracle(Path(capture), Path(out)))):
        return robir(["reconstruct", capture, "-o", out, *arguments])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
