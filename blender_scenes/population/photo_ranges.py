# SPDX-License-Identifier: GPL-3.0-or-later
"""The table's second section: from what a capture of photographs is drawn.

As in `ranges`: a dictionary holds weights, a pair a range, drawn evenly, or evenly in the logarithm
where its name says so. Lengths are in scene units: the thing's longest side is 1.
"""

# things
THINGS = {
    "asset": 4, "box": 3, "bottle": 3, "tin": 2, "mug": 3, "bowl": 2, "vase": 3, "egg": 2,
    "cushion": 2, "toy": 3, "carving": 3, "tool": 2, "figure": 2,
}  # fmt: skip
MATERIALS = {
    "box": {"print": 5, "card": 1, "wood": 1},
    "bottle": {"print": 3, "plastic": 3, "glaze": 1},
    "tin": {"print": 5, "paint": 1},
    "mug": {"glaze": 2, "printed glaze": 3},
    "bowl": {"glaze": 3, "wood": 1, "clay": 1},
    "vase": {"glaze": 2, "clay": 2, "spotted glaze": 2},
    "egg": {"shell": 1},
    "cushion": {"cloth": 1},
    "toy": {"plastic": 3, "wood": 1},
    "carving": {"wood": 3, "clay": 2},
    "tool": {"plastic": 2, "wood": 2},
    "figure": {"clay": 2, "plastic": 1, "car paint": 1, "spotted glaze": 1},
    "asset": {"own": 5, "clay": 1, "car paint": 1},
}
"""What the body of each thing is of."""

METAL_TRIM = {"tin": 1.0, "tool": 0.9, "toy": 0.5, "carving": 0.5, "bottle": 0.4, "box": 0.1,
              "mug": 0.1}  # fmt: skip
"""Chance that caps, handles, rims and screws are of metal; otherwise they are of plastic."""

ALBEDO_LOG = (0.04, 0.85)
SATURATION = (0.0, 0.9)
SHELL_ALBEDO_LOG = (0.2, 0.75)
GLOSS = (0.08, 0.35)
"""Roughness of plastic and print with a finish."""

MATTE = (0.45, 0.95)
COAT = (0.5, 1.0)
COATED = 0.5
"""Chance of a clear coat on paint and print."""

SHEEN = (0.3, 1.0)
METAL_ROUGHNESS = (0.12, 0.5)
CELLS = (3, 8)

# table
TABLES = {"wood": 4, "weave": 3, "stone": 3, "label": 2, "checker": 1, "clouds": 1, "plain": 2}
TABLE_ROUGHNESS = (0.35, 0.95)
TABLE_SIZE = (0.95, 2.2)
TABLE_ALBEDO_LOG = (0.08, 0.75)
TABLE_SATURATION = (0.0, 0.55)
TABLE_CONTRAST = 1.7
"""Least ratio of its two colours, in the channel where they differ most."""

# light
LIGHTS = {"window": 4, "lamp": 3, "sun": 3, "overcast": 3}
UNFIT_MAPS = ("studio", "night")
"""Maps of Blender's that are black for the most part: nothing is seen behind the thing."""

WINDOW_WIDTH = (2.0, 4.0)
LAMP_RADIUS_LOG = (0.12, 0.45)
LAMP_ELEVATION = (60.0, 80.0)
WINDOW_TINT = (0.8, 1.0)
"""Red over blue of a window's light, and of a lamp's."""

LAMP_TINT = (1.1, 2.2)
SUN_ELEVATION = (15.0, 70.0)
SUN_SIZE_LOG = (0.53, 3.0)
SUN_SHARE = (0.5, 0.9)
WALL_ALBEDO_LOG = (0.25, 0.8)
WALL_SATURATION = (0.0, 0.3)
PATTERNED_WALL = 0.5

# camera
LONGER_LOG = (400, 1000)
SHAPES = {"4:3": 4, "3:4": 3, "3:2": 3, "2:3": 2, "1:1": 1}
ANGLE = (38.0, 66.0)
"""Full angle of the longer side, degrees."""

FILL = (0.5, 0.8)
"""Of the thing's sphere in half of the shorter side."""

PHOTOGRAPHS_LOG = (20, 70)
LOW = (10.0, 24.0)
HIGH = (32.0, 55.0)
"""Elevations of the two walks, degrees."""

LOW_SHARE = (0.45, 0.65)
"""Of the photographs in the lower walk."""

GAPS = 0.4
"""Chance that a walk does not close; then it is of so many degrees."""

WALKED = (220.0, 320.0)

# developing
RESPONSE_SPREAD = (0.15, 0.1, 0.05)
"""Of the numbers of `photographs.response`."""

ISO_LOG = (50, 1600)
FULL_WELL_LOG = (4000, 40000)
READ_NOISE = (2.0, 6.0)
QUALITY = (85, 97)
BRIGHTNESS = (-0.4, 0.5)
JITTERED = 1 / 3
EXPOSURE_JITTER = (0.05, 0.4)
WHITE_BALANCE = 0.15
"""The most that each channel is off."""

BALANCE_JITTER = (0.0, 0.012)
VIGNETTED = 1 / 3
VIGNETTING = (0.4, 1.0)
EXIF = 0.7

# handover
POSES = {"exact": 1, "errors": 1, "none": 1}
POSED_LAYOUTS = {"transforms.json": 1, "colmap": 1}
MASKS = {"given": 1, "off": 1, "none": 1}
GROWTH = (1.0, 2.0)
"""Pixels by which masks are off, either way."""

FOCAL_ERROR = 0.003
"""Relative, standard deviation, one draw for all photographs."""

AIM_ERROR = (0.25, 0.6)
"""Pixels at 1000 pixels: standard deviations are drawn from these ranges, one for a capture.
To be measured by pycolmap on captures of this table."""

ORBIT_ERROR = (0.02, 0.08)
DISTANCE_ERROR = (0.0005, 0.0015)
ROLL_ERROR = (0.01, 0.04)

# size
MOST_SAMPLES = 6
LEAST_SAMPLES = 2
"""Cycles samples of a pixel, denoised by what it sees of colour and normal."""

PIXEL_SAMPLES = 12e6
"""Pixels times photographs times samples that a capture may cost: many are small."""

SHOWCASES = {7: "vase", 11: "egg"}
"""Seeds whose thing is not left to chance: one deep and dark inside, one plain and convex under a
strong sun."""

SHOWCASE_LIGHTS = {7: "window", 11: "sun"}
DARK_TONES = ((0.035, 0.032, 0.03), (0.1, 0.085, 0.07))
