# SPDX-License-Identifier: Apache-2.0
"""A ball with a pit, whose colours change with the view or do not."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from robir.capture.camera import Camera
from robir.geometry.fit import mirror_pits, optimise
from robir.geometry.fit.field import Field
from robir.geometry.fit.mirror_pits import Mirroring, change_with_view
from robir.geometry.lattice import Lattice, Sampled
from robir.maths.vectors import fibonacci_sphere

LATTICE = Lattice(lower=(-1.0, -1.0, -1.0), cell=0.05, shape=(41, 41, 41))
RADIUS = 0.6
SOFT = optimise._SOFT_PASSES


class Colours(torch.nn.Module):
    """A colour network that knows only how much the view matters."""

    def __init__(self, change: float, everywhere: bool = False) -> None:
        super().__init__()
        self._change, self._everywhere = change, everywhere

    def forward(self, features, normals, directions):
        """Grey, at +x or everywhere brighter where what is mirrored comes from +x."""
        cosine = (normals * directions).sum(1, keepdim=True)
        mirrored = directions - 2.0 * cosine * normals
        change = self._change * mirrored[:, :1]
        if not self._everywhere:
            change = change * features[:, :1]
        return (0.5 + change).expand(-1, 3)


def ball() -> torch.Tensor:
    return LATTICE.nodes().norm(dim=1) - RADIUS


def pitted() -> Field:
    """A ball with a pit of three cells' depth at +x."""
    pit = 0.2 - (LATTICE.nodes() - torch.tensor([RADIUS + 0.05, 0.0, 0.0])).norm(dim=1)
    return marked(torch.maximum(ball(), pit))


def marked(sdf: torch.Tensor) -> Field:
    """A field whose first feature is 1 about +x, else 0."""
    field = Field(LATTICE, sdf, 4, SOFT)
    field.place_features(torch.ones(LATTICE.count, dtype=torch.bool))
    with torch.no_grad():
        about = (LATTICE.nodes() - torch.tensor([RADIUS, 0.0, 0.0])).norm(dim=1) < 0.4
        field.features[1:, 0] = about.float()
    return field


def depth(sdf: torch.Tensor, lattice: Lattice) -> float:
    """How far the surface lies below the ball's at +x, cells."""
    along = torch.linspace(0.3, RADIUS + 0.1, 400)
    points = torch.stack([along, torch.zeros(400), torch.zeros(400)], dim=1)
    inside = lattice.trilinear(sdf, points) < 0
    return float(RADIUS - along[inside].max()) / lattice.cell


class Verdict:
    """Photographs that say what they are told to, and of which surfaces they were asked."""

    def __init__(self, mirrors: bool, prefers_more: bool = False) -> None:
        self._mirrors, self._prefers_more = mirrors, prefers_more
        self.asked: list[float] = []

    def is_mirror(self, surface: Sampled) -> bool:
        """As told; the pit's depth is kept."""
        self.asked.append(depth(surface.values, LATTICE))
        return self._mirrors

    def is_better(self, surface: Sampled, other: Sampled) -> bool:
        """As told; of the surface of which more is filled."""
        assert (surface.values <= other.values + 1e-6).all()
        return self._prefers_more


@pytest.fixture
def cameras():
    result = []
    for place in 3.0 * fibonacci_sphere(24).double().numpy():
        back = place / np.linalg.norm(place)
        right = np.cross([0.1, 0.2, 1.0], back)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
        pose[:3, 3] = place
        result.append(
            Camera(width=8, height=8, fx=8.0, fy=8.0, cx=4.0, cy=4.0, camera_to_world=pose)
        )
    return result


def test_change_is_the_mean_difference_from_the_median(cameras):
    field = Field(LATTICE, ball(), 4, SOFT)
    change = change_with_view(field, Colours(0.2, everywhere=True), cameras)
    near = ball().abs() < 0.5 * LATTICE.cell
    expected = []
    for point in torch.nn.functional.normalize(LATTICE.nodes()[near], dim=1):
        views = [torch.from_numpy(c.position).float() - RADIUS * point for c in cameras]
        towards = torch.stack([view / view.norm() for view in views])
        cosine = towards @ point
        shown = 0.2 * (2 * cosine[:, None] * point - towards)[cosine > mirror_pits._LEAST_COSINE, 0]
        expected.append((shown - shown.median()).abs().mean())
    # a region's mean differs from a spot's
    assert float((change[near] - torch.stack(expected)).mean().abs()) < 0.004


def test_a_pit_in_what_mirrors_is_filled_to_the_hull(cameras):
    field = pitted()
    filled = Mirroring(cameras, (LATTICE, ball()), Verdict(mirrors=False)).filled(
        field, Colours(0.3)
    )
    assert depth(field.sdf, LATTICE) > 2.5
    assert depth(filled, LATTICE) < 0.75
    assert bool((filled >= torch.minimum(ball(), field.sdf.detach()) - 1e-6).all())


def test_a_pit_in_paint_stays(cameras):
    field = pitted()
    filled = Mirroring(cameras, (LATTICE, ball()), Verdict(mirrors=False)).filled(
        field, Colours(0.2 * mirror_pits._MIRRORING)
    )
    assert torch.equal(filled, field.sdf.detach())


@pytest.mark.parametrize("is_proven", [False, True])
def test_where_most_changes_metal_must_be_proven(cameras, is_proven):
    field, verdict = pitted(), Verdict(is_proven)
    mirroring = Mirroring(cameras, (LATTICE, ball()), verdict)
    filled = mirroring.filled(field, Colours(0.3, everywhere=True))
    assert verdict.asked == [pytest.approx(0.0, abs=0.75)], "of the filled surface, once"
    assert depth(filled, LATTICE) < 0.75 if is_proven else torch.equal(filled, field.sdf.detach())
    again = mirroring.filled(field, Colours(0.3, everywhere=True))
    assert torch.equal(again, filled) and len(verdict.asked) == 1
