# SPDX-License-Identifier: Apache-2.0
"""Fits textures and light to photographs by Mitsuba's path replay backpropagation.

Parameters, priors and the tone curve are torch's; Mitsuba renders random pixels of all photographs
and carries the derivative of the loss back through the light paths.

References:
    [Vicini2021] Path replay backpropagation (Mitsuba's integrator `prb`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import huber_loss

from robir.capture.camera import Camera
from robir.geometry.mesh.triangles import Mesh
from robir.maths.tone_curve import AbstractToneCurve
from robir_bench.peers import prb_scene
from robir_bench.peers.prb_scene import ImagePoints

_STRAY = 0.1
_ALBEDO_RANGE = (0.005, 0.98)
_ROUGHNESS_RANGE = (0.08, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class PrbConfig:
    """How the fit is done."""

    steps: int = 600  # Adam steps
    # the first of them, which leave the material alone: a sun that has not been found when the
    # texture begins to take on shadows is not found at all
    light_steps: int = 200
    batch: int = 4096  # pixels a step, a multiple of 64
    samples: int = 8  # light paths a pixel and step
    max_depth: int = 3  # longest light path, segments from the camera on: 3 has one bounce
    texture_size: int = 256  # side of the textures, texels
    light_rows: int = 64  # rows of the environment map
    albedo_rate: float = 0.02  # first learning rate of base colours
    roughness_rate: float = 0.05  # first learning rate of roughness
    light_rate: float = 0.1  # first learning rate of the logarithm of radiance
    last_rate: float = 0.1  # learning rates in the end, over the first ones
    albedo_smoothness: float = 0.1  # weight of the total variation of base colour
    roughness_smoothness: float = 0.02  # weight of the total variation of roughness
    light_smoothness: float = 0.002  # weight of the total variation of log radiance


# For a light that starts from the sun. Both were tuned on one capture, a cow on a plain disc.
WITH_SUN = PrbConfig(
    steps=400,
    light_steps=60,
    light_rate=0.05,
    albedo_smoothness=0.03,
    light_smoothness=0.001,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """Pixels of photographs that are fitted."""

    pixels: ImagePoints  # where they are
    display: Tensor  # (N, 3) their values, display codes 0..1


@dataclass(slots=True, kw_only=True)
class Material:
    """What is optimised."""

    base: Tensor  # (T, T, 3) base colour, linear Rec.709, row 0 is v = 1
    roughness: Tensor  # (T, T, 1), perceptual
    log_radiance: Tensor  # (H, 2H, 3) natural logarithm of the light's radiance


def photo_loss(linear: Tensor, display: Tensor, curve: AbstractToneCurve) -> Tensor:
    """Difference of a render to photographs as the camera would show it.

    A render beyond white goes on along a straight line, else nothing would pull it back; a white
    photograph says "at least this bright". The noise of few light paths biases the fit (a concave
    curve shows the mean of noisy values too dark: albedo 1 % too bright at 32 paths under an even
    light, so about 5 % at 8). Replacing the curve by its tangent at the photograph would not, but
    lets the dark pixels rule, and shadows bake in.

    Args:
        linear: (N, 3) render, linear Rec.709.
        display: (N, 3) photographs, display codes 0..1.
        curve: The camera's tone curve.

    Returns:
        Mean over pixels and channels of half the squared difference, beyond _STRAY linear in it.
    """
    white = curve.linear_from_display(torch.full_like(linear[:1], curve.saturation_level))
    is_white = display >= curve.saturation_level
    beyond = torch.where(is_white, 0.0, (linear / white - 1.0).clamp_min(0.0))
    shown = curve.display_from_linear(torch.minimum(linear, white)) + beyond
    return huber_loss(shown, display.clamp_max(curve.saturation_level), delta=_STRAY)


def smoothness(field: Tensor, inside: Tensor) -> Tensor:
    """Total variation: mean absolute difference of neighbours along rows and columns.

    Args:
        field: (H, W, C).
        inside: (H, W) bool; differences across its border do not count.
    """
    total = field.new_zeros(())
    for axis in (0, 1):
        last = field.shape[axis] - 1
        both = inside.narrow(axis, 1, last) & inside.narrow(axis, 0, last)
        steps = (field.narrow(axis, 1, last) - field.narrow(axis, 0, last)).abs()
        total = total + (steps * both[..., None]).sum() / (both.sum() * field.shape[2])
    return total


class PrbFit:
    """A fit under way.

    Attributes:
        config: How it is done.
        material: What has been found so far.
    """

    def __init__(self, mesh: Mesh, cameras: Sequence[Camera], config: PrbConfig) -> None:
        """Start from a grey surface under an even light.

        Args:
            mesh: Unwrapped.
            cameras: All that pixels will be asked of, frame of the mesh.
            config: How to go on.

        Raises:
            DeviceError: If Mitsuba or LLVM is missing.
        """
        self.config = config
        self._mi = prb_scene.load_mitsuba()
        self._scene = prb_scene.make_scene(self._mi, mesh, config.texture_size, config.light_rows)
        self._sensor = prb_scene.pixel_sensor(self._mi, cameras, config.batch)
        self._params = self._mi.traverse(self._scene)
        integrator = {"type": "prb", "max_depth": config.max_depth, "rr_depth": 1000}
        self._integrator = self._mi.load_dict(integrator | {"hide_emitters": True})
        side, rows = config.texture_size, config.light_rows
        self.material = Material(
            base=torch.full((side, side, 3), 0.4, requires_grad=True),
            roughness=torch.full((side, side, 1), 0.5, requires_grad=True),
            log_radiance=torch.zeros(rows, 2 * rows, 3, requires_grad=True),
        )

    def render(self, pixels: ImagePoints, seed: int, samples: int) -> Tensor:
        """Linear Rec.709 (N, 3) of any number of pixels."""
        with torch.no_grad():
            self._put()
        pieces = []
        for piece in _filled(pixels, self.config.batch):
            self._sensor.look_at(piece)
            image = self._mi.render(
                self._scene,
                sensor=self._sensor,
                integrator=self._integrator,
                spp=samples,
                seed=seed,
            )
            pieces.append(image.torch().reshape(-1, 3).clone())
        return torch.cat(pieces)[: len(pixels)]

    def hits(self, pixels: ImagePoints) -> NDArray[np.bool_]:
        """Which pixels show the surface at their centre."""
        pieces = []
        for piece in _filled(pixels, self.config.batch):
            self._sensor.look_at(piece)
            pieces.append(np.array(self._scene.ray_test(self._sensor.centre_rays()), bool))
        return np.concatenate(pieces)[: len(pixels)]

    def radiance(self) -> NDArray[np.float64]:
        """The light (rows, 2 rows, 3), linear Rec.709."""
        return self.material.log_radiance.detach().double().exp().numpy()

    def run(
        self, observed: Observed, curve: AbstractToneCurve, inside: Tensor, seed: int
    ) -> Iterator[int]:
        """Fit, step by step; yields the number of each step done.

        Args:
            observed: Photographs.
            curve: Their tone curve.
            inside: (T, T) bool, texels that belong to the surface.
            seed: Of the choice of pixels and paths.
        """
        config, material = self.config, self.material
        named = (
            (material.base, config.albedo_rate),
            (material.roughness, config.roughness_rate),
            (material.log_radiance, config.light_rate),
        )
        groups = [{"params": [field], "lr": rate} for field, rate in named]
        adam = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-12)
        decay = torch.optim.lr_scheduler.ExponentialLR(adam, config.last_rate ** (1 / config.steps))
        rng = np.random.default_rng(seed)
        for step in range(config.steps):
            chosen = rng.integers(0, len(observed.pixels), config.batch)
            adam.zero_grad()
            self.add_gradient(observed, chosen, curve, seed * config.steps + step)
            self._prior(inside).backward()
            if step < config.light_steps:
                material.base.grad, material.roughness.grad = None, None
            adam.step()
            decay.step()
            with torch.no_grad():
                material.base.clamp_(*_ALBEDO_RANGE)
                material.roughness.clamp_(*_ROUGHNESS_RANGE)
            yield step + 1

    def add_gradient(
        self, observed: Observed, chosen: NDArray[Any], curve: AbstractToneCurve, seed: int
    ) -> None:
        """Add the gradient of the loss of some pixels to the material's.

        Args:
            observed: Photographs.
            chosen: (batch,) indices of its pixels.
            curve: Their tone curve.
            seed: Of the light paths.
        """
        dr = prb_scene.load_drjit()
        fields = self._put()
        self._sensor.look_at(observed.pixels.chosen(chosen))
        image = self._mi.render(
            self._scene,
            self._params,
            sensor=self._sensor,
            integrator=self._integrator,
            spp=self.config.samples,
            seed=seed,
        )
        linear = image.torch().detach().clone().reshape(-1, 3).requires_grad_()
        photo_loss(linear, observed.display[chosen], curve).backward()
        dr.backward(dr.sum(image * self._mi.TensorXf(linear.grad.reshape(image.shape))))
        for field, leaf in fields:
            field.backward(dr.grad(leaf).torch())

    def _put(self) -> list[tuple[Tensor, Any]]:
        """Hand the material to Mitsuba: each field as torch and as Mitsuba know it.

        The derivative is to be read from these leaves: what the scene then holds may be a copy.
        """
        dr = prb_scene.load_drjit()
        fields = {
            prb_scene.BASE: self.material.base * 1.0,
            prb_scene.ROUGHNESS: self.material.roughness * 1.0,
            prb_scene.LIGHT: prb_scene.light_data(self.material.log_radiance.exp()),
        }
        leaves = []
        for name, field in fields.items():
            leaf = self._mi.TensorXf(field.detach().contiguous())
            dr.enable_grad(leaf)
            self._params[name] = leaf
            leaves.append((field, leaf))
        self._params.update()
        return leaves

    def _prior(self, inside: Tensor) -> Tensor:
        """Smoothness of all that is optimised."""
        config, material = self.config, self.material
        everywhere = torch.ones(material.log_radiance.shape[:2], dtype=torch.bool)
        return (
            config.albedo_smoothness * smoothness(material.base, inside)
            + config.roughness_smoothness * smoothness(material.roughness, inside)
            + config.light_smoothness * smoothness(material.log_radiance, everywhere)
        )


def _filled(pixels: ImagePoints, size: int) -> Iterator[ImagePoints]:
    """The pixels in pieces of exactly one size; the last is filled up with the first pixels."""
    for start in range(0, len(pixels), size):
        yield pixels.chosen(np.arange(start, start + size) % len(pixels))
