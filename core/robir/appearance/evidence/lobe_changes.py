# SPDX-License-Identifier: Apache-2.0
"""Lobes of the sky changed until they show what views show, and light what they light.

Lobes change by factors, so that none turns negative; the likeliest are found by Gauss and Newton,
views that agree with none counting little (Cauchy's weights).

Batch letters: M observations, K soft lobes, U samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from robir.appearance.evidence.config import LobeChangesConfig
from robir.maths.daylight import PART


@dataclass(frozen=True, slots=True, kw_only=True)
class Mirrored:
    """What views show of the sky.

    Attributes:
        seen: (M, 3) radiance, or what of it differs from view to view.
        fixed: (M, 3) of it, what the lobes do not send.
        lobes: (M, 3, K) of it, what each lobe of amplitude 1 sends.
        error: (M, 3) usual deviation.
        base_freedom: Usual change of the logarithm of a factor on all of it, one a channel.
    """

    seen: Tensor
    fixed: Tensor
    lobes: Tensor
    error: Tensor
    base_freedom: float

    def of(self, chosen: Tensor) -> Mirrored:
        """Some of the observations."""
        return Mirrored(
            seen=self.seen[chosen],
            fixed=self.fixed[chosen],
            lobes=self.lobes[chosen],
            error=self.error[chosen],
            base_freedom=self.base_freedom,
        )


def _prior(count: int, freedom: float, base_freedom: float) -> Tensor:
    """Inverse covariance of the changes: of each channel `count` lobes and the base colour."""
    mean = torch.full((3, 3), 1 / 3, dtype=torch.float64)
    # gold mirrors hardly any blue: what it does not show of a lobe's hue is that of lights
    unlike = PART.precision().double()
    prior = torch.zeros(3, count + 1, 3, count + 1, dtype=torch.float64)
    lobe, channel = torch.arange(count), torch.arange(3)
    prior[:, lobe, :, lobe] = mean / freedom**2 + unlike
    prior[channel, -1, channel, -1] = base_freedom**-2
    return prior.reshape(3 * count + 3, 3 * count + 3)


def changed(
    soft: Tensor, mirrored: Mirrored, kept: Tensor, kept_error: float, config: LobeChangesConfig
) -> Tensor:
    """Amplitudes (K, 3) that show what is seen.

    Args:
        soft: (K, 3) before.
        mirrored: What is seen.
        kept: (3, U, K) share of the irradiance of diffuse samples that each amplitude sends.
        kept_error: Share by which that irradiance may change.
        config: How freely lobes change.
    """
    soft = soft.double().clamp(min=1e-6)
    held = kept.double() * soft.T[:, None]
    keeping = config.kept_samples / held.shape[1] / kept_error**2
    count = len(soft)
    prior = _prior(count, config.freedom, mirrored.base_freedom)
    # sums over many views in single precision, half the time; the system itself in double
    seen, fixed, error = mirrored.seen, mirrored.fixed, mirrored.error
    sent = [mirrored.lobes[:, c] * soft[:, c].float() for c in range(3)]
    change = torch.zeros(3, count + 1, dtype=torch.float64)
    for _ in range(config.num_rounds):
        system, wanted = prior.clone(), -prior @ change.view(-1)
        for c in range(3):
            factor, base = change[c, :-1].exp(), float(change[c, -1].exp())
            now = sent[c] * factor.float()
            shown = base * (fixed[:, c] + now.sum(1))
            slope = torch.cat([base * now, shown[:, None]], 1) / error[:, c, None]
            off = (seen[:, c] - shown) / error[:, c]
            weight = 1 / (1 + off.square()) / config.alike_views
            apart = held[c] * factor
            own = slice(c * (count + 1), (c + 1) * (count + 1))
            lobe = slice(own.start, own.stop - 1)
            system[own, own] += (slope.T @ (weight[:, None] * slope)).double()
            wanted[own] += (slope.T @ (weight * off)).double()
            system[lobe, lobe] += keeping * apart.T @ apart
            wanted[lobe] -= keeping * apart.T @ (apart - held[c]).sum(1)
        step = torch.linalg.solve(system, wanted).view(3, count + 1)
        most = float(step.abs().max())
        change = change + step * min(1.0, config.most_step / max(most, 1e-9))
        if most < config.settled:
            break
    return (soft * change[:, :-1].exp().T).float()
