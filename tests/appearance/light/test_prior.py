# SPDX-License-Identifier: Apache-2.0
"""What is told of a light weighs by its error."""

import torch

from robir.appearance.light.lobes import NO_PRIOR, LightPrior

SENT = torch.tensor([0.4, 0.1, -0.2])


def test_what_is_missing_brings_the_light_to_what_is_told():
    hue = torch.tensor([0.1, 0.0, -0.1])
    whole = LightPrior(hue=hue, level=1.5, level_error=0.3)
    torch.testing.assert_close(SENT + whole.missing(SENT), hue + 1.5)
    # the level alone keeps the hue, the hue alone the level
    torch.testing.assert_close(SENT + LightPrior(level=1.5).missing(SENT), SENT - SENT.mean() + 1.5)
    torch.testing.assert_close((SENT + LightPrior(hue=hue).missing(SENT)).mean(), SENT.mean())
    torch.testing.assert_close(SENT + NO_PRIOR.missing(SENT), SENT)
