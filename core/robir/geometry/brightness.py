# SPDX-License-Identifier: Apache-2.0
"""Photographs brought to one brightness before a surface is fitted to them.

The surface is found where photographs agree on colours. Where they were not exposed alike they
agree nowhere, and of a plain ground least of all: the fit digs it wherever that explains a few
photographs, and the picture by which ground is told is doubted away.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robir.capture.capture import Capture, View
from robir.capture.checks.sightings import POWER, sight
from robir.capture.checks.uneven_exposure import uneven_exposures


def evened(capture: Capture) -> Capture:
    """A capture whose training photographs are equally bright at the points they share.

    The tone curve is not known yet: a power stands for it, in the measure as in the cure, so that
    what is left is what the curve's slope differs by between dark and bright.

    Args:
        capture: Capture in any frame.

    Returns:
        The capture itself where its photographs count as exposed alike, or are too few to tell;
        held-out views are as they were in any case.
    """
    views = capture.train
    offsets = uneven_exposures(views, capture.bounds, sight(views, capture.bounds))
    if offsets is None:
        return capture
    dimmed = {
        view.name: _brighter(view, -steps) for view, steps in zip(views, offsets, strict=True)
    }
    return replace(capture, views=tuple(dimmed.get(v.name, v) for v in capture.views))


def _brighter(view: View, steps: float) -> View:
    """A view whose display values tell of so many steps (log2) more light."""
    display = np.rint(view.image_display * 2.0 ** (steps / POWER)).clip(0, 255)
    return replace(view, image_display=display.astype(np.uint8))
