# SPDX-License-Identifier: Apache-2.0
"""Given cameras on trial: turned while the surface is fitted, if the photographs ask for it.

Early in the fit, when the surface is known coarsely, the cameras are turned by one step. Where this
moves the photographs by next to nothing, the cameras stay as they were given, and so does the fit.
Otherwise cameras and field take turns for a while, and the fit begins anew with the cameras so
found: visual hull and ground suffered from the wrong ones. At the same step of that fit, with the
same pixels, the photographs must differ clearly less from the rendering than they did with the
given cameras, or these are taken again. Cameras that stood the test are turned a few times more as
the field becomes finer.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robir.capture.capture import Capture
from robir.geometry.fit.alignment import Alignment, turned
from robir.geometry.fit.field_preview import Renderer
from robir.geometry.rays import RaySampler

Array = NDArray[np.float64]


_TRIAL_STEP = 75  # step of the fit at which the cameras are tried. Shorter fits try none (steps)
# after which the fit begins anew with the cameras that were turned until then (steps)
_LAST_STEP = 150
_POLISH_EVERY = 100  # between the turns of cameras that stood the test (steps)
_LAST_POLISH = 500  # last step for one (steps)
# root mean square of the training views that the first step must move the photographs to count:
# more than it moves exact cameras (pixels)
_LEAST_SHIFT = 0.13
_LEAST_GAIN = 0.02  # share by which the photographs' difference from the rendering must fall
_MOST_ROUNDS = 3  # how often at most the fit begins anew with turned cameras


class CamerasChangedError(Exception):
    """The fit must begin anew with `PoseTrial.capture`."""


class PoseTrial:
    """Holds the cameras that are tried, and decides about them.

    Args:
        capture: As given, unit frame.
        seed: Of the choice of pixels.
        device: Torch device of the rays.

    Attributes:
        capture: With the cameras that the fit shall use.
        turns: (V, 3) rotation vectors by which the capture's views are turned, each in its given
            camera's axes, radians; zeros where they are as given.
    """

    def __init__(self, capture: Capture, seed: int, device: str) -> None:
        self.capture = capture
        self.turns: Array = np.zeros((len(capture.views), 3))
        self._given = capture
        self._seed = seed
        self._device = device
        self._is_trained = np.array([view.split == "train" for view in capture.views])
        self._misfit = np.inf
        self._before = self.turns
        self._rounds = 0
        self._state: Literal["trial", "moving", "polish", "given"] = "trial"
        self._due: float = _TRIAL_STEP

    @cached_property
    def _alignment(self) -> Alignment:
        # not at the start: where nothing is tried, no photograph need be reduced and sampled for it
        return Alignment(self._given.views, self._seed)

    def look(self, step: int, render: Renderer, sampler: RaySampler) -> None:
        """Try, turn or leave the cameras.

        Args:
            step: Steps of the fit that are done.
            render: Draws the present field.
            sampler: Source of the fit's rays, whose cameras follow.

        Raises:
            CamerasChangedError: If the fit must begin anew.
        """
        if step < self._due:
            return
        misfits = self._alignment.improve(render, self._device)
        if self._state == "trial":
            self._judge(float(misfits[self._is_trained].mean()))
        if self._state == "given":
            return
        cameras = self._alignment.cameras
        sampler.follow([cameras[number] for number in np.flatnonzero(self._is_trained)])
        if self._state == "moving" and step >= _LAST_STEP:
            self._begin_anew()
        if self._state == "polish":
            self._take(self._alignment.turns)
            self._due = step + _POLISH_EVERY
            if self._due > _LAST_POLISH:
                self._due = math.inf

    def _judge(self, misfit: float) -> None:
        """At the trial's step: whether the present cameras stay, move on or are given up."""
        if misfit > (1.0 - _LEAST_GAIN) * self._misfit:
            self._give_up()
        shift = self._alignment.shifts(self._alignment.turns - self.turns)[self._is_trained]
        is_off = np.sqrt((shift**2).mean()) > _LEAST_SHIFT
        if is_off and self._rounds < _MOST_ROUNDS:
            self._state = "moving"
            self._misfit, self._before = misfit, self.turns
        elif self.turns.any():
            self._state = "polish"
        else:
            self._settle()

    def _begin_anew(self) -> None:
        """Let the fit begin anew with the cameras as they were turned, on trial."""
        self._take(self._alignment.turns)
        self._rounds += 1
        self._state, self._due = "trial", _TRIAL_STEP
        raise CamerasChangedError

    def _give_up(self) -> None:
        """Let the fit begin anew with the cameras of before, for good."""
        self._take(self._before)
        self._settle()
        raise CamerasChangedError

    def _settle(self) -> None:
        self._state, self._due = "given", math.inf

    def _take(self, turns: Array) -> None:
        self.turns = turns
        views = zip(self._given.views, turns, strict=True)
        self.capture = replace(
            self._given,
            views=tuple(replace(view, camera=turned(view.camera, turn)) for view, turn in views),
        )
