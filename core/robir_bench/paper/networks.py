# SPDX-License-Identifier: Apache-2.0
"""The networks of RobIR. Batch letters: P points, D directions, K lobes, M lobes of indirect light.

All positions are in the unit frame, all directions unit, world space.
"""

from __future__ import annotations

import itertools
import math

import torch
from torch import Tensor, nn
from torch.nn.functional import relu, softplus
from torch.nn.utils.parametrizations import weight_norm

from robir.maths.spherical_gaussian import SphericalGaussians

ENCODING_VARIANCE = 1e-5  # variance of the Gaussian that integrated encodings average over

START_RADIUS = 0.5  # radius of the sphere the distance network starts from

_OCTAVES = 10
_VIEW_OCTAVES = 4
_SOFTNESS = 100.0


def encode(values: Tensor, octaves: int) -> Tensor:
    """Values, then sin and cos of 2^k times them: (..., C (1 + 2 octaves)); NeRF Eq. 4, no pi."""
    angles = _angles(values, octaves)
    return torch.cat([values, angles.sin(), angles.cos()], dim=-1)


def integrated_encode(values: Tensor, octaves: int, variance: float) -> Tensor:
    """Means of sin and cos of 2^k x over normally distributed x: (..., 2 C octaves).

    E[sin(s x)] = sin(s m) exp(-s^2 v / 2); mip-NeRF Eq. 14.
    """
    angles = _angles(values, octaves)
    fading = torch.exp(-0.5 * variance * 4.0 ** torch.arange(octaves, device=values.device))
    weight = fading.repeat_interleave(values.shape[-1])
    return torch.cat([weight * angles.sin(), weight * angles.cos()], dim=-1)


def _angles(values: Tensor, octaves: int) -> Tensor:
    scale = 2.0 ** torch.arange(octaves, device=values.device, dtype=values.dtype)
    return (scale[:, None] * values[..., None, :]).flatten(-2)


class SdfNetwork(nn.Module):
    """Signed distance and a feature; starts as the distance to a sphere.

    Softplus layers with weight norm; the encoded position enters again half-way. The start: hidden
    weights normal with variance 2 / width, none on the sines, last weights sqrt(pi / width), last
    bias minus the radius.

    References:
        Atzmon and Lipman, SAL, CVPR 2020, Theorem 1; Wang et al., NeuS, NeurIPS 2021.
    """

    def __init__(self, depth: int, width: int, octaves: int) -> None:
        """Make it.

        Args:
            depth: Hidden layers, at least 2.
            width: Their width and the feature's length.
            octaves: Of the encoding.
        """
        super().__init__()
        self._octaves = octaves
        self._again = depth // 2
        encoded = 3 + 6 * octaves
        sizes = [encoded, *[width] * depth]
        layers = []
        for index in range(depth):
            is_again = index + 1 == self._again
            layer = nn.Linear(sizes[index], sizes[index + 1] - (encoded if is_again else 0))
            _start(layer, num_raw=3 if index == 0 else None)
            if index == self._again:
                nn.init.zeros_(layer.weight[:, 3 - encoded :])
            layers.append(weight_norm(layer))
        last = nn.Linear(width, 1 + width)
        nn.init.normal_(last.weight, math.sqrt(math.pi / width), 1e-4)
        nn.init.constant_(last.bias, -START_RADIUS)
        self._layers = nn.ModuleList([*layers, weight_norm(last)])

    def forward(self, points: Tensor) -> Tensor:
        """Distance, then the feature: (P, 1 + width)."""
        encoded = encode(points, self._octaves)
        hidden = encoded
        for index, layer in enumerate(self._layers):
            if index == self._again:
                hidden = torch.cat([hidden, encoded], dim=-1) / math.sqrt(2.0)
            hidden = layer(hidden)
            if index + 1 < len(self._layers):
                hidden = softplus(hidden, beta=_SOFTNESS)
        return hidden

    def with_gradient(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Distance (P,), feature (P, width) and gradient (P, 3), itself differentiable."""
        with torch.enable_grad():
            points = points.detach().requires_grad_()
            out = self(points)
            (gradient,) = torch.autograd.grad(out[:, 0].sum(), points, create_graph=True)
        return out[:, 0], out[:, 1:], gradient


@torch.no_grad()
def _start(layer: nn.Linear, num_raw: int | None) -> None:
    nn.init.zeros_(layer.bias)
    nn.init.normal_(layer.weight, 0.0, math.sqrt(2.0 / layer.out_features))
    if num_raw is not None:
        nn.init.zeros_(layer.weight[:, num_raw:])


class RadianceNetwork(nn.Module):
    """Display codes that leave a point towards a camera."""

    def __init__(self, depth: int, width: int, feature: int) -> None:
        """Make it.

        Args:
            depth: Hidden layers.
            width: Their width.
            feature: Length of the distance network's feature.
        """
        super().__init__()
        inputs = 3 + 3 + 6 * _VIEW_OCTAVES + 3 + feature
        sizes = [inputs, *[width] * depth, 3]
        pairs = itertools.pairwise(sizes)
        self._layers = nn.ModuleList([weight_norm(nn.Linear(*pair)) for pair in pairs])

    def forward(self, points: Tensor, ray: Tensor, normal: Tensor, feature: Tensor) -> Tensor:
        """Codes (P, 3) in [0, 1]; `ray` (P, 3) points away from the camera."""
        hidden = torch.cat([points, encode(ray, _VIEW_OCTAVES), normal, feature], dim=-1)
        for layer in self._layers[:-1]:
            hidden = relu(layer(hidden))
        return torch.sigmoid(self._layers[-1](hidden))


class AutoEncoder(nn.Module):
    """Encoder of positions to a short code, and its decoder (RobIR's "SparseAE")."""

    def __init__(self, inputs: int, outputs: int, width: int, code_length: int) -> None:
        """Make it.

        Args:
            inputs: Length of the encoded position.
            outputs: Values a point.
            width: Of the four layers of the encoder.
            code_length: Of the code.
        """
        super().__init__()
        sizes = [inputs, *[width] * 4]
        layers: list[nn.Module] = []
        for pair in itertools.pairwise(sizes):
            layers += [nn.Linear(*pair), nn.LeakyReLU(0.2)]
        self._encoder = nn.Sequential(*layers, nn.Linear(width, code_length))
        self._decoder = nn.Sequential(
            nn.Linear(code_length, 128),
            nn.LeakyReLU(0.2),
            nn.Linear(128, 128),
            nn.LeakyReLU(0.2),
            nn.Linear(128, outputs),
        )

    def code(self, encoded: Tensor) -> Tensor:
        """Code (P, code_length) in (0, 1)."""
        return torch.sigmoid(self._encoder(encoded))

    def decode(self, code: Tensor) -> Tensor:
        """Values (P, outputs), unbounded."""
        return self._decoder(code)


class NormalNetwork(nn.Module):
    """Smooth unit normals of positions."""

    def __init__(self, width: int, code_length: int) -> None:
        """Make it; see AutoEncoder."""
        super().__init__()
        self._net = AutoEncoder(6 * _OCTAVES, 3, width, code_length)

    def encode(self, points: Tensor) -> Tensor:
        """Encoded positions (P, 60)."""
        return integrated_encode(points, _OCTAVES, ENCODING_VARIANCE)

    def from_encoded(self, encoded: Tensor) -> Tensor:
        """Unit normals (P, 3)."""
        values = self._net.decode(self._net.code(encoded))
        return torch.nn.functional.normalize(values, dim=-1)

    def forward(self, points: Tensor) -> Tensor:
        """Unit normals (P, 3)."""
        return self.from_encoded(self.encode(points))


class MaterialNetwork(nn.Module):
    """Albedo and roughness of positions, by way of a code."""

    def __init__(self, width: int, code_length: int) -> None:
        """Make it; see AutoEncoder."""
        super().__init__()
        self._net = AutoEncoder(3 + 6 * _OCTAVES, 4, width, code_length)

    def code(self, points: Tensor) -> Tensor:
        """Code (P, code_length) in (0, 1)."""
        return self._net.code(encode(points, _OCTAVES))

    def decode(self, code: Tensor) -> tuple[Tensor, Tensor]:
        """Albedo (P, 3), linear, 0 to 1, and roughness (P,), 0.09 to 0.99."""
        out = torch.sigmoid(self._net.decode(code))
        return out[:, :3], 0.9 * out[:, 3] + 0.09

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Albedo and roughness of positions."""
        return self.decode(self.code(points))


class VisibilityNetwork(nn.Module):
    """Whether a point sees the environment in a direction."""

    def __init__(self, width: int) -> None:
        """Make it: four layers of this width."""
        super().__init__()
        inputs = 3 + 6 * _OCTAVES
        # One layer of the joined encodings, split so that shared directions pass it once.
        self._point = nn.Linear(inputs, width)
        self._direction = nn.Linear(inputs, width, bias=False)
        self._rest = nn.Sequential(
            nn.ReLU(),
            nn.Linear(width, width),
            nn.ReLU(),
            nn.Linear(width, width),
            nn.ReLU(),
            nn.Linear(width, width),
            nn.ReLU(),
            nn.Linear(width, 2),
        )

    def logits(self, points: Tensor, directions: Tensor) -> Tensor:
        """Logits (P, D, 2) of "blocked" and "free"; directions (P, D, 3) or (D, 3)."""
        first = self._point(encode(points, _OCTAVES))[:, None]
        return self._rest(first + self._direction(encode(directions, _OCTAVES)))

    def forward(self, points: Tensor, directions: Tensor) -> Tensor:
        """Visibility (P, D) in [0, 1]."""
        return torch.softmax(self.logits(points, directions), dim=-1)[..., 1]


class IndirectNetwork(nn.Module):
    """Lobes of the light that other surfaces send to a point, for every tone scalar."""

    def __init__(self, width: int, num_lobes: int) -> None:
        """Make it: four layers of this width."""
        super().__init__()
        sizes = [3 + 6 * _OCTAVES + 1, *[width] * 4]
        layers: list[nn.Module] = []
        for pair in itertools.pairwise(sizes):
            layers += [nn.Linear(*pair), nn.ReLU()]
        self._net = nn.Sequential(*layers, nn.Linear(width, 6 * num_lobes))
        self._num_lobes = num_lobes

    def forward(self, points: Tensor, tone_gamma: Tensor) -> SphericalGaussians:
        """Lobes of each point: axis (P, M, 3), sharpness (P, M), amplitude (P, M, 3).

        Args:
            points: (P, 3).
            tone_gamma: (P, 1) or (), scalar of the tone curve that the radiance is under.
        """
        gamma = tone_gamma.to(points).expand(len(points), 1)
        out = self._net(torch.cat([encode(points, _OCTAVES), gamma], dim=-1))
        out = out.view(len(points), self._num_lobes, 6)
        azimuth = 2.0 * math.pi * torch.sigmoid(out[..., 0])
        polar = math.pi * torch.sigmoid(out[..., 1])
        flat = polar.sin()
        axis = torch.stack([flat * azimuth.cos(), flat * azimuth.sin(), polar.cos()], dim=-1)
        return SphericalGaussians(
            axis=axis,
            sharpness=30.0 * torch.sigmoid(out[..., 2]) + 0.1,
            amplitude=relu(out[..., 3:]),
        )


class RatioNetwork(nn.Module):
    """Visibility ratio of every lobe at a position, Q(x) in [0, 1]^K.

    RobIR feeds the position with a one-hot vector of the lobe, K times; rows of the last layer
    that stand for the lobes are the same map in one pass.
    """

    def __init__(self, depth: int, width: int, num_lobes: int) -> None:
        """Make it: so many softplus layers of this width."""
        super().__init__()
        sizes = [3 + 6 * _OCTAVES, *[width] * depth, num_lobes]
        pairs = itertools.pairwise(sizes)
        self._layers = nn.ModuleList([weight_norm(nn.Linear(*pair)) for pair in pairs])

    def forward(self, points: Tensor) -> Tensor:
        """Ratios (P, K)."""
        hidden = encode(points, _OCTAVES)
        for layer in self._layers[:-1]:
            hidden = softplus(layer(hidden), beta=_SOFTNESS)
        return torch.sigmoid(self._layers[-1](hidden))
