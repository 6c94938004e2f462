# SPDX-License-Identifier: GPL-3.0-or-later
"""The table: from what a capture of the population is drawn.

A dictionary holds weights of choices, which need not add up to 1. A pair is a range, drawn evenly,
or evenly in the logarithm where its name says so. Lengths are in scene units: a lone thing is 1.
"""

VERDICT_SEED = 1000
"""Seeds below are for development; from here on they are for verdicts, run to report alone."""

# things
THINGS = {"asset": 5, "monkey": 2, "solid": 3, "lathe": 4, "boolean": 2, "clutter": 4}
SOLIDS = {"box": 2, "cylinder": 2, "cone": 1, "sphere": 1, "tube": 1}
CLUTTER_COUNT = (2, 5)
CLUTTER_SIZE = (0.35, 0.7)
CLUTTER_GAP = 0.45
"""Least distance of two things of a heap, in halves of the sum of their sizes."""
TIPPED = 0.3
"""Chance that a thing, but for assets, lies on its side."""

# paint
PATTERNED = 0.5
"""Chance that a capture has any pattern; else all its things are of one colour each."""
PATTERNED_PART = 0.75
"""Chance of a pattern on each thing of such a capture; the first has one."""
PATTERNS = {
    "checker": 2, "stripes": 2, "speckled": 3, "clouds": 3, "wood": 2,
    "noise": 2, "cells": 2, "waves": 1,
}  # fmt: skip
OWN_PAINT = 0.8
"""Chance that an asset of a patterned capture keeps its own textures."""
ALBEDO_LOG = (0.02, 0.9)
"""Largest channel of a base colour."""
SATURATION = (0.0, 0.95)
CONTRAST = 1.5
"""Least ratio of the two colours of a pattern, in the channel where they differ most."""
CELLS_LOG = (2, 12)
"""How often a pattern repeats along a thing."""
ROUGHNESS = (0.05, 1.0)
TWO_ROUGHNESSES = 0.3
"""Chance that the roughness of a patterned thing follows its pattern."""

# metal
METAL = 0.25
"""Chance that at least one thing of a capture is of metal."""
METALS = ("d8d8da", "d6b26a", "c98a6b", "8f9298", "e8e6e0")
"""sRGB codes of reflectances: steel, brass, copper, dark steel, silver."""
METAL_ROUGHNESS = (0.05, 0.6)

# ground
GROUND = 0.5
GROUND_SHAPES = {"disc": 1, "mat": 1, "table": 1}
GROUND_PATTERNS = {"plain": 1, "checker": 1, "wood": 1}
GROUND_SIZE = {"disc": (1.0, 1.3), "mat": (0.9, 1.1), "table": (1.1, 1.4)}
"""Radius, or half of the side, over the reach of what stands on it."""
GROUND_ALBEDO_LOG = (0.08, 0.8)
GROUND_ROUGHNESS = (0.3, 1.0)
GROUND_CELLS = (2, 8)

# light
SUNS = {"the map alone": 7, "one sun": 7, "two suns": 3, "no sun": 3}
SUN_ELEVATION = (5.0, 80.0)
SUN_SIZE_LOG = (0.53, 20.0)
"""Full angle in degrees, from the sun's own up."""
SUN_SHARE = (0.4, 0.95)
"""Of the lamp in the irradiance of a surface that faces it, beside the softened map."""
SECOND_SUN = (0.3, 0.8)
"""The second lamp's share over the first's."""

# photographs
TONES = {"Standard": 3, "Filmic": 2, "Filmic with a look": 2, "AgX": 2, "Khronos PBR Neutral": 2,
         "EMoR mean": 2}  # fmt: skip
EXPOSURE = (-1.5, 1.5)
CLIPPED = (0.0, 0.1)
"""Share of the object's pixels at code 255; the exposure is lowered until no more are clipped."""
LEAST_CODE = 30
"""The exposure is raised until half of the object's pixels reach this code: no black pictures."""
BACKDROPS = {"none": 3, "black": 1, "white": 1}

# cameras
CAMERAS = {"dome": 4, "ring": 2, "half dome": 2, "handheld": 2}
DOME_LOW = (5.0, 15.0)
DOME_HIGH = (50.0, 80.0)
RING_ELEVATION = (12.0, 40.0)
RING_WIDTH = 6.0
HALF_DOME_WIDTH = (170.0, 230.0)
MARGIN = (1.02, 1.3)
"""Distance over the one at which the scene's sphere fills the picture."""

# size
RESOLUTION_LOG = (96, 256)
VIEWS_LOG = (16, 80)
TEST_VIEWS = 6
MOST_SAMPLES = 64
LEAST_SAMPLES = 16
PIXEL_SAMPLES = 40e6
"""Pixels times samples that a capture may cost; many large views share them, and get fewer."""
