# SPDX-License-Identifier: Apache-2.0
"""Structure from motion step by step: what has been done stays in the database of the work folder.

SIFT (Lowe 2004) with brute-force matches, verified by epipolar geometry, and incremental mapping
(Schoenberger and Frahm 2016) as pycolmap does them. Everything runs in small portions, so that
progress is shown and a request to stop is heard; a portion in the database is not redone.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robir.capture.views import Progress

if TYPE_CHECKING:
    import pycolmap

Pair = tuple[str, str]  # names of two photographs

MIN_PHOTOGRAPHS = 6  # fewer cannot be placed dependably, nor do they show an object
# the cure for too few photographs
MORE_PHOTOGRAPHS = (
    "Walk around the object and take 30 to 100, each with at least two thirds of what the one "
    "before shows."
)
MAX_EXHAUSTIVE = 120  # photographs of which all pairs are compared (7140 of them)
_TILE = 12  # photographs in a row and a column of one portion; each is loaded once a portion
_NEIGHBOURS = 10  # pictures before and after one in a sequence that it is compared with
_LOOP_PICTURES = 40  # of a sequence, evenly spaced, compared with each other to close loops
_MIN_FEATURES, _MAX_FEATURES = 2048, 8192  # number of features looked for in a photograph
# pairs that can be matched at `_MIN_FEATURES` in about 100 CPU-seconds; fewer pairs, more features,
# for the time of a pair goes with the square of their number
_CHEAP_PAIRS = 2500
_CAMERA_MODEL = "SIMPLE_RADIAL"  # what few photographs can still fix
_UNKNOWN_FOCAL = 1.2  # longer sides, where nothing is known; a phone's is about 0.8, a portrait 2
_MIN_MODEL = 3  # photographs of the smallest model worth hearing about
_ROBUST_SCALE = 0.7  # of the Cauchy loss in mean reprojection errors: about the median one
_ITERATIONS = 50  # of the last adjustment at most
_MIN_TO_CENTRE = 15  # photographs of a lens from which on its axis is looked for
_MAX_OFF_CENTRE = 0.06  # longer sides from the middle at which a lens's axis is a wrong solution
_THREADS = min(4, os.cpu_count() or 1)  # each holds a pyramid of its own in memory


@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """A copy that features are looked for in."""

    relative: str  # path of the photograph below the capture's folder
    copy: str  # file name of its copy
    width: int  # of the copy, pixels
    height: int  # of the copy, pixels
    lens: int  # number of its lens; photographs of one lens share intrinsics
    focal: float | None  # focal length in pixels of the copy as EXIF states it, or None


class Workplace:
    """Files of a work folder: copies, database of features and matches, models as mapped."""

    def __init__(self, root: Path) -> None:
        self.copies, self.database = root / "copies", root / "database.db"
        self.models, self.pairs = root / "models", root / "pairs.txt"


def is_available() -> bool:
    """Whether pycolmap is installed."""
    return find_spec("pycolmap") is not None


def library() -> Any:
    """pycolmap, silent: what it has to say is said in our findings."""
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    return pycolmap


def all_pairs(names: Sequence[str]) -> list[list[Pair]]:
    """All pairs, in portions."""
    return _portions(names, set(combinations(range(len(names)), 2)))


def sequence_pairs(names: Sequence[str]) -> list[list[Pair]]:
    """Pairs of a sequence, in portions: neighbours, steps of powers of two, and closed loops."""
    count = len(names)
    steps = {*range(1, _NEIGHBOURS + 1), *(2**k for k in range(count.bit_length()))}
    pairs = {(i, i + step) for step in steps for i in range(count - step)}
    pairs.update(combinations(range(0, count, max(1, count // _LOOP_PICTURES)), 2))
    return _portions(names, pairs)


def _portions(names: Sequence[str], pairs: set[tuple[int, int]]) -> list[list[Pair]]:
    tiles: dict[tuple[int, int], list[Pair]] = {}
    for i, j in sorted(pairs):
        tiles.setdefault((i // _TILE, j // _TILE), []).append((names[i], names[j]))
    return [tiles[key] for key in sorted(tiles)]


def find_features(
    place: Workplace, photographs: Sequence[Prepared], num_pairs: int, progress: Progress
) -> None:
    """Bring the features of all copies into the database, for so many pairs to be matched."""
    pycolmap = library()
    with closing(pycolmap.Database.open(place.database)) as database:
        if database.num_images() < len(photographs):
            _enter(pycolmap, database, photographs)
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = _THREADS
    affordable = round(_MIN_FEATURES * math.sqrt(_CHEAP_PAIRS / num_pairs))
    options.sift.max_num_features = min(max(affordable, _MIN_FEATURES), _MAX_FEATURES)
    names = [photograph.copy for photograph in photographs]
    for first in range(0, len(names), 2 * _THREADS):
        progress(first / len(names), f"features of photograph {first + 1} of {len(names)}")
        some = names[first : first + 2 * _THREADS]
        pycolmap.extract_features(
            *(place.database, place.copies),
            image_names=some,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )


def match(
    place: Workplace, portions: Sequence[Sequence[Pair]], seed: int, progress: Progress
) -> None:
    """Bring the verified matches of pairs of copies, in portions, into the database."""
    pycolmap = library()
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = 1  # the robust estimators draw from one generator a thread
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    total, done = sum(len(portion) for portion in portions), 0
    with closing(pycolmap.Database.open(place.database)) as database:
        names = {image.image_id: image.name for image in database.read_all_images()}
        numbers, _ = database.read_two_view_geometries()
    ids = (pycolmap.pair_id_to_image_pair(number) for number in numbers)
    matched = {frozenset((names[a], names[b])) for a, b in ids}
    for portion in portions:
        progress(done / total, f"matches of pair {done + 1} of {total}")
        done += len(portion)
        missing = [pair for pair in portion if frozenset(pair) not in matched]
        if not missing:
            continue
        place.pairs.write_text("".join(f"{a} {b}\n" for a, b in missing), encoding="utf-8")
        pycolmap.match_image_pairs(
            place.database,
            matching_options=matching,
            pairing_options=pycolmap.ImportedPairingOptions(match_list_path=place.pairs),
            verification_options=verification,
            device=pycolmap.Device.cpu,
        )


def map_cameras(
    place: Workplace, count: int, seed: int, progress: Progress
) -> list[pycolmap.Reconstruction]:
    """Place so many cameras on one thread, for the sums' order; models, the largest first."""
    pycolmap = library()
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.min_model_size = _MIN_MODEL
    options.extract_colors = False
    for part in (options, options.mapper, options.triangulation):
        part.random_seed = seed
    place.models.mkdir(exist_ok=True)
    token = pycolmap.CancellationToken()
    placed, most, faults = 0, 0, list[BaseException]()
    models: dict[int, Any] = {}

    def tell(number: int) -> None:
        nonlocal placed, most
        placed, most = number, max(most, number)
        try:
            progress(min(1.0, most / count), f"camera {placed} of {count} placed")
        except BaseException as fault:  # it must not unwind through the mapper
            faults.append(fault)
            token.cancel()

    try:
        models = pycolmap.incremental_mapping(
            *(place.database, place.copies, place.models, options),
            initial_image_pair_callback=lambda: tell(2),
            next_image_callback=lambda: tell(placed + 1),
            cancellation_token=token,
        )
    except InterruptedError:
        if not faults:
            raise
    if faults:
        raise faults[0]
    return sorted(models.values(), key=lambda m: (-m.num_reg_images(), -m.num_points3D()))


def refine(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """A copy of a model, adjusted once more with a Cauchy loss, lenses centred if they show it."""
    pycolmap = library()
    counts = Counter(image.camera_id for image in model.images.values() if image.has_pose)
    scale = _ROBUST_SCALE * model.compute_mean_reprojection_error()
    options = adjustment_options(pycolmap, scale, _ITERATIONS)
    for centres in (True, False) if min(counts.values()) >= _MIN_TO_CENTRE else (False,):
        options.refine_principal_point = centres
        refined = pycolmap.Reconstruction(model)
        solve(pycolmap, options, refined)
        refined.update_point_3d_errors()
        if max(_off_centre(refined.camera(number)) for number in counts) <= _MAX_OFF_CENTRE:
            return refined
    return model


def adjustment_options(pycolmap: Any, scale: float, iterations: int) -> Any:
    """A bundle adjustment with a Cauchy loss of a scale in pixels, on one thread."""
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = scale
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.max_num_iterations = iterations
    return options


def solve(pycolmap: Any, options: Any, model: pycolmap.Reconstruction) -> None:
    """Adjust a model; not `pycolmap.bundle_adjustment`, which prints and leaves a log behind."""
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.images.values():
        if image.has_pose:
            config.add_image(image.image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()


def _off_centre(camera: pycolmap.Camera) -> float:
    """How far the lens's axis is from the middle of the picture, in longer sides."""
    x, y = camera.principal_point_x - camera.width / 2, camera.principal_point_y - camera.height / 2
    return math.hypot(x, y) / max(camera.width, camera.height)


def _enter(pycolmap: Any, database: pycolmap.Database, photographs: Sequence[Prepared]) -> None:
    """Enter lenses and photographs; all of them or, if interrupted, none."""
    with pycolmap.DatabaseTransaction(database):
        lenses: dict[int, tuple[int, int]] = {}
        for one in photographs:
            if one.lens not in lenses:
                focal = one.focal or _UNKNOWN_FOCAL * max(one.width, one.height)
                camera = pycolmap.Camera.create_from_model_name(
                    0, _CAMERA_MODEL, focal, one.width, one.height
                )
                camera.has_prior_focal_length = one.focal is not None
                camera.camera_id = database.write_camera(camera)
                rig = pycolmap.Rig()
                rig.add_ref_sensor(camera.sensor_id)
                lenses[one.lens] = camera.camera_id, database.write_rig(rig)
            camera_id, rig_id = lenses[one.lens]
            image = pycolmap.Image(name=one.copy, camera_id=camera_id)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rig_id
            frame.add_data_id(image.data_id)
            database.write_frame(frame)
