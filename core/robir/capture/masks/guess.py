# SPDX-License-Identifier: Apache-2.0
"""Masks from photographs with poses alone: colours, a common volume, and edges, in turns.

Each round learns the colours of object and background, cuts every photograph along its edges, and
carves the volume that all cuts allow; its picture in each photograph is where the next round
expects the object. The turns of colour model and cut are those of GrabCut (Rother, Kolmogorov and
Blake 2004), the volume ties the photographs together as in Campbell et al. 2010.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robir.capture.images.opencv import cv2
from robir.capture.masks.colours import Palette
from robir.capture.masks.region import Region
from robir.capture.masks.sight import Array, Layer, Picture, Posed, reduced, sampled
from robir.capture.masks.soft_hull import Volume
from robir.capture.masks.walker import walk

SIDE = 320  # longer side at which masks are made, pixels
# share of the photographs that may call a part of the object background, round by round
DISSENT = (0.15, 0.10, 0.07, 0.05)
# belief in the object that the volume alone can give a pixel, round by round
TRUST = (0.62, 0.62, 0.75, 0.85)
# evidence for the object taken off every pixel, round by round: what both sides may have is
# background until the other photographs say otherwise
CAUTION = (1.0, 1.0, 0.5, 0.0)
SURE = 0.6  # belief from which the volume decides against the colours in the end
DEEP = 4  # pixels from the outline of the volume's picture at which it is believed
OUTSIDE = 0.02  # belief below which the volume leaves no room for the object
SEED = 1.5  # evidence of a surface point of the object in a pixel, natural logarithm of a ratio
CONTAINED = 0.85  # share of the masks that must contain a surface point of the object
LEAST_CONTRAST = 0.65  # contrast below which object and background look too alike
LEAST_AGREEMENT = 0.75  # agreement below which the masks show no common object
MOST = 0.9  # share of the photograph that no object covers in most of them
ODD = 0.6  # agreement below which a single mask is named
RING = 10  # pixels on both sides of an outline by which colours are judged


@dataclass(frozen=True, slots=True, kw_only=True)
class Guess:
    """Masks and how far they are to be trusted.

    Attributes:
        masks: Belief in the object at each pixel, (H, W) float32 in [0, 1], at most `SIDE` long.
        agreement: (V,) intersection over union of each mask with the volume all masks allow.
        contrast: (V,) share of the pixels along each outline that colours learnt from the other
            photographs put on the right side, both sides weighing the same; one half where object
            and background look alike.
        region: Where the object was looked for.
        volume: (N, 3) points that fill what all masks allow, capture frame.
    """

    masks: tuple[Layer, ...]
    agreement: NDArray[np.float64]
    contrast: NDArray[np.float64]
    region: Region
    volume: NDArray[np.float64]

    def fault(self) -> str | None:
        """Why the masks are not to be trusted, a clause for the user, or None."""
        shares = [float((mask > 0.5).mean()) for mask in self.masks]
        if np.median(shares) < 0.002 or len(self.volume) == 0:
            return "nothing stands out from the background where the cameras aim"
        if np.median(shares) > MOST:
            return "everything the cameras see looks like the object"
        contrast = float(np.median(self.contrast))
        if contrast < LEAST_CONTRAST:
            return (
                "object and background look alike: along the outlines found, colour puts only "
                f"{100 * contrast:.0f} % of the pixels on the right side"
            )
        agreement = float(np.median(self.agreement))
        if agreement < LEAST_AGREEMENT:
            return (
                "what was cut out of the photographs has no common shape: it agrees to "
                f"{100 * agreement:.0f} %"
            )
        return None

    @property
    def odd(self) -> NDArray[np.bool_]:
        """(V,) which masks do not agree with the others."""
        return self.agreement < ODD


def guess_masks(views: Sequence[Posed], region: Region, progress: Callable[[float], None]) -> Guess:
    """Cut the object of a region out of photographs.

    Args:
        views: Photographs with cameras.
        region: Where the object is.
        progress: Told the share of the work done.

    Returns:
        The masks and their agreement.
    """
    pictures = reduced(views, SIDE)
    volume = Volume(region, [picture.camera for picture in pictures])
    priors = [volume.picture(k) for k in range(len(pictures))]
    points, masks = region.points, priors
    palette = Palette(pictures, [_first_lesson(prior) for prior in priors])
    for number, (dissent, trust) in enumerate(zip(DISSENT, TRUST, strict=True)):
        masks = []
        seeds = [_seeds(picture, points) for picture in pictures]
        for k, picture in enumerate(pictures):
            odds = palette.evidence(k, picture.lab.shape[:2]) - CAUTION[number] + seeds[k]
            belief = 1 / (1 + np.exp(-odds - _log_odds(priors[k], trust)))
            masks.append(walk(picture.lab, np.where(priors[k] < OUTSIDE, 1e-3, belief)))
            progress((number + (k + 1) / len(pictures)) / len(DISSENT))
        volume.carve(masks, dissent)
        priors = [volume.picture(k) for k in range(len(pictures))]
        palette = Palette(pictures, masks)
        points = _within_masks(region.points, pictures, masks)
    agreement = np.array([_overlap(*pair) for pair in zip(masks, priors, strict=True)])
    # one hole drills through the whole visual hull, so what all others see is put back
    masks = [_mended(*pair) for pair in zip(masks, priors, strict=True)]
    return Guess(
        masks=tuple(masks),
        agreement=agreement,
        contrast=np.array(
            [
                _contrast(mask, palette.evidence_of_others(k, mask.shape))
                for k, mask in enumerate(masks)
            ]
        ),
        region=region,
        volume=volume.points(),
    )


def _first_lesson(prior: Layer) -> Layer:
    """Where colours are learnt before the first cut: deep within the region and well outside."""
    return np.select([prior > 0.75, prior < 0.35], [1.0, 0.0], 0.5).astype(np.float32)


def _log_odds(belief: Layer, trust: float) -> Layer:
    bounded = np.clip(belief, OUTSIDE, trust)
    return np.log(bounded / (1 - bounded))


def _seeds(picture: Picture, points: Array) -> Layer:
    """Evidence of the object's surface points, (H, W): even hidden ones lie in its silhouette."""
    camera = picture.camera
    pixels, depth = camera.project(points)
    column, row = pixels[camera.in_picture(pixels, depth)].astype(np.int64).T
    count = np.zeros((camera.height, camera.width), dtype=np.float32)
    np.add.at(count, (row, column), 1)
    near = cv2.boxFilter(count, -1, (5, 5), normalize=False, borderType=cv2.BORDER_CONSTANT)
    # a point on its own may be a mistake
    return np.float32(SEED) * np.clip(near - 1, 0, 2)


def _within_masks(points: Array, pictures: Sequence[Picture], masks: Sequence[Layer]) -> Array:
    """Points that nearly all masks contain, in what looks like a hole or not."""
    inside, seen = np.zeros(len(points)), np.zeros(len(points))
    for picture, mask in zip(pictures, masks, strict=True):
        outlines, _ = cv2.findContours(
            (mask > 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
        )
        filled = cv2.drawContours(np.zeros(mask.shape, np.uint8), outlines, -1, 1, cv2.FILLED)
        pixels, depth = picture.camera.project(points)
        known = picture.camera.in_picture(pixels, depth)
        inside += known * sampled(filled, pixels)
        seen += known
    return points[inside >= CONTAINED * np.maximum(seen, 1)]


def _mended(mask: Layer, prior: Layer) -> Layer:
    """A mask with what lies deep within the picture of the volume put back."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * DEEP + 1, 2 * DEEP + 1))
    deep = cv2.erode((prior > SURE).astype(np.uint8), disc, borderValue=1) == 1
    return np.where(deep, np.maximum(mask, prior), mask)


def _overlap(mask: Layer, prior: Layer) -> float:
    one, two = mask > 0.5, prior > 0.4
    return float((one & two).sum() / max((one | two).sum(), 1))


def _contrast(mask: Layer, evidence: Layer) -> float:
    """Share of the pixels along an outline whose colour is on the right side."""
    inside = (mask > 0.5).astype(np.uint8)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * RING + 1, 2 * RING + 1))
    within = (inside == 1) & (cv2.erode(inside, disc, borderValue=1) == 0)
    beyond = (inside == 0) & (cv2.dilate(inside, disc) == 1)
    if not within.any() or not beyond.any():
        return 0.5
    return float(0.5 * ((evidence[within] > 0).mean() + (evidence[beyond] < 0).mean()))
