# SPDX-License-Identifier: Apache-2.0
"""The five stages of RobIR in numbers: both published schedules, and one for a CPU.

Names of the stages in RobIR's own programs: NeuS, Norm, Vis, PBR, CESR (the paper calls the last
one regularised visibility estimation, RVE). Where paper and programs disagree:

=====================  ==================================  =====================================
what                   taken here                          left
=====================  ==================================  =====================================
image loss             programs: L1, summed over channels  paper: L2
loss weights           programs, by schedule               paper: those of `published_truck`
order of stages        programs: material learnt anew      paper: one run, RVE joins after a while
display gamma          programs: codes to the power 2.2    paper: not mentioned
F0                     programs: one scalar from 0.05      paper: 0.02, fixed
white light            programs: 0.01 while PBR            paper: none
smooth loss            programs: L1, roughness at 0.2      paper: L2
NDF as a lobe          paper: integrates to 1              programs: twice as bright
visibility ratio       paper: diffuse and specular share   programs: a cone for specular
its estimator          exact lobe weights on directions    programs: biased samples in a cone
indirect light         paper: 24 lobes for both parts      programs: extra head for the diffuse
radiance of a hit      paper: the field at the hit         programs: 16 samples about it
normals in RVE         paper: those of Norm                programs: one more network
batches                pixels of all photographs           programs: of one photograph
edge loss              programs: of mean residuals         paper: of signed differences
tone scalar            sigmoid, gradient everywhere        programs: clamp, none at 0 and 1
=====================  ==================================  =====================================

Lengths are those of the unit frame; the programs' are half of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace


@dataclass(frozen=True, slots=True, kw_only=True)
class NeusConfig:
    """Surface and radiance field.

    Attributes:
        iterations: Steps of Adam.
        rays: Rays a step.
        coarse_samples: Even samples of a ray.
        fine_samples: Samples added where the surface may be.
        rounds: Rounds in which they are added.
        depth: Hidden layers of the distance network.
        width: Their width, also the length of the feature.
        octaves: Of its positional encoding.
        colour_depth: Hidden layers of the colour network.
        colour_width: Their width.
        learning_rate: Highest; it falls to a hundredth, log-linearly.
        steepness_rate: The same for the logarithm of the opacity's steepness.
        warm_up: Steps over which both rise.
        image_side: Longer side the photographs are reduced to, pixels.
        cells: Cells along the unit sphere's diameter, of the mesh and of the tracer.
    """

    iterations: int = 200_000
    rays: int = 512
    coarse_samples: int = 64
    fine_samples: int = 64
    rounds: int = 4
    depth: int = 8
    width: int = 256
    octaves: int = 10
    colour_depth: int = 4
    colour_width: int = 256
    learning_rate: float = 5e-4
    steepness_rate: float = 5e-4
    warm_up: int = 2500
    image_side: int = 800
    cells: int = 512


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalsConfig:
    """Smooth normals.

    Attributes:
        iterations: Steps of Adam.
        smooth_after: Step from which the normals are also made smooth.
        points: Surface points a step.
        width: Width of the encoder.
    """

    iterations: int = 10_100
    smooth_after: int = 500
    points: int = 1024
    width: int = 512


@dataclass(frozen=True, slots=True, kw_only=True)
class VisibilityConfig:
    """Visibility and indirect light.

    Attributes:
        iterations: Steps of Adam.
        pixels: Surface points a step.
        directions: Directions traced from each, over the whole sphere.
        width: Width of the visibility network.
        indirect_width: Width of the network of indirect light.
        offset: How far above the surface rays start.
    """

    iterations: int = 10_100
    pixels: int = 256
    directions: int = 512
    width: int = 256
    indirect_width: int = 512
    offset: float = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class LossWeights:
    """Weights against the image loss.

    Attributes:
        smooth: Of materials that change with noise on their code.
        sparse: Of codes that are not sparse.
        white: Of coloured light.
        edge: Of visibility ratios that leave those of the visibility network.
    """

    smooth: float
    sparse: float
    white: float = 0.0
    edge: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MaterialConfig:
    """Light, tone curve and material under the visibility network (PBR).

    Attributes:
        iterations: Steps of Adam.
        pixels: Pixels a step.
        width: Width of the material's encoder.
        light_rate: Learning rate of light, F0 and tone curve. Adam moves a number by about this a
            step: times the number of steps, it is how bright a lamp can become.
        weights: Of the losses.
    """

    iterations: int = 20_100
    pixels: int = 1024
    width: int = 512
    light_rate: float = 5e-4
    weights: LossWeights = LossWeights(smooth=0.1, sparse=1.0, white=0.01)


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinementConfig:
    """The material anew, under learnt visibility ratios (CESR, RVE).

    Attributes:
        iterations: Steps of Adam.
        warm_up: Steps at the start that only fit the ratios, to those of the visibility network.
        pixels: Pixels a step.
        depth: Hidden layers of the ratio network.
        width: Their width.
        light_rate: As in `MaterialConfig`.
        weights: Of the losses after the warm-up.
    """

    iterations: int = 10_100
    warm_up: int = 500
    pixels: int = 1024
    depth: int = 8
    width: int = 512
    light_rate: float = 5e-4
    weights: LossWeights = LossWeights(smooth=0.1, sparse=1.0, edge=1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One of the published methods.

    Attributes:
        has_aces: RobIR's tone curve with its scalar; without, sRGB.
        has_rve: Learnt visibility ratios; without, those of the visibility network.
    """

    has_aces: bool
    has_rve: bool


VARIANTS = {
    "paper": Variant(has_aces=True, has_rve=True),
    "paper without ACES": Variant(has_aces=False, has_rve=True),
    "paper without RVE": Variant(has_aces=True, has_rve=False),
    "invrender": Variant(has_aces=False, has_rve=False),
}
"""RobIR, its ablations, and its parent; all on NeuS, where InvRender itself had IDR."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperConfig:
    """All five stages.

    Attributes:
        learning_rate: Of every network after the first stage, constant.
        light_lobes: Lobes of the environment.
        indirect_lobes: Lobes of indirect light at a point.
        code_length: Length of the auto-encoders' codes.
        pool: Pixels whose surface points are kept for the last two stages.
        ratio_directions: Directions the visibility network is read at for the ratios; the programs
            draw 32 for each of 128 lobes.
    """

    neus: NeusConfig = field(default_factory=NeusConfig)
    normals: NormalsConfig = field(default_factory=NormalsConfig)
    visibility: VisibilityConfig = field(default_factory=VisibilityConfig)
    material: MaterialConfig = field(default_factory=MaterialConfig)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)
    learning_rate: float = 5e-4
    light_lobes: int = 128
    indirect_lobes: int = 24
    code_length: int = 32
    pool: int = 100_000
    ratio_directions: int = 4096


def published() -> PaperConfig:
    """The schedule of RobIR's synthetic and DTU scenes, which "explores": hotdog.conf, dtu.conf.

    For 100 photographs: an epoch is one step a photograph.
    """
    return PaperConfig()


def published_truck() -> PaperConfig:
    """The schedule of RobIR's truck, which "projects": truck.conf."""
    base = published()
    weights = LossWeights(smooth=0.001, sparse=0.01, edge=0.2)
    return replace(base, refinement=replace(base.refinement, weights=weights))


def shrunken() -> PaperConfig:
    """What a CPU finishes in minutes: `published_truck` with fewer, larger steps of less.

    Lobes, losses, weights and codes are the published ones.
    """
    base = published_truck()
    return replace(
        base,
        neus=NeusConfig(
            iterations=2200,
            rays=256,
            coarse_samples=16,
            fine_samples=12,
            rounds=2,
            depth=4,
            width=96,
            octaves=6,
            colour_depth=2,
            colour_width=64,
            learning_rate=3e-3,
            steepness_rate=5e-3,
            warm_up=30,
            image_side=200,
            cells=112,
        ),
        normals=NormalsConfig(iterations=250, smooth_after=50, points=1024, width=128),
        visibility=VisibilityConfig(
            iterations=400, pixels=128, directions=64, width=128, indirect_width=128
        ),
        material=replace(base.material, iterations=700, pixels=384, width=192, light_rate=1e-2),
        refinement=replace(
            base.refinement,
            iterations=1200,
            warm_up=100,
            pixels=384,
            depth=3,
            width=128,
            light_rate=4e-3,
        ),
        learning_rate=2e-3,
        pool=12_000,
        ratio_directions=320,
    )
