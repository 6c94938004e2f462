# SPDX-License-Identifier: Apache-2.0
"""Structure from motion step by step: what has been done stays in the database of the work folder.

SIFT (Lowe 2004) with brute-force matches, verified by epipolar geometry, and incremental mapping
(Schoenberger and Frahm 2016) as pycolmap does them. Everything runs in small portions, so that
progress is told and a request to stop is heard; a portion that is in the database is not redone.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robir.capture.poses.pairs import Pair
from robir.capture.poses.prepare import Prepared
from robir.capture.views import Progress

if TYPE_CHECKING:
    import pycolmap

# bounds of the number of features looked for in a photograph
MIN_FEATURES, MAX_FEATURES = 2048, 8192
# pairs that can be matched at `MIN_FEATURES` in about 100 CPU-seconds; fewer pairs, more features,
# for the time of a pair goes with the square of their number
CHEAP_PAIRS = 2500
# one focal length and one coefficient of distortion: what few photographs can still fix
CAMERA_MODEL = "SIMPLE_RADIAL"
# focal length in longer sides where nothing is known; a phone's is about 0.8, a portrait 2
UNKNOWN_FOCAL = 1.2
MIN_MODEL = 3  # photographs of the smallest model worth hearing about
ROBUST_SCALE = 0.7  # scale of the Cauchy loss in mean reprojection errors: about the median one
REFINE_ITERATIONS = 50  # iterations of the last adjustment at most
MIN_TO_CENTRE = 15  # photographs of a lens from which on its axis is looked for
# a lens's axis this far from the middle, in longer sides, is a wrong solution
MAX_OFF_CENTRE = 0.06
# each thread that looks for features holds a pyramid of its own in memory
_THREADS = min(4, os.cpu_count() or 1)
_PORTION = 2 * _THREADS


@dataclass(frozen=True, slots=True)
class Workplace:
    """Names of a work folder's files.

    Attributes:
        root: The folder.
    """

    root: Path

    @property
    def copies(self) -> Path:
        """Upright grey copies of the photographs."""
        return self.root / "copies"

    @property
    def database(self) -> Path:
        """Features and matches."""
        return self.root / "database.db"

    @property
    def models(self) -> Path:
        """Models as the mapper writes them."""
        return self.root / "models"

    @property
    def pairs(self) -> Path:
        """Pairs of photographs that are being matched."""
        return self.root / "pairs.txt"


def is_available() -> bool:
    """Whether pycolmap is installed."""
    return find_spec("pycolmap") is not None


def find_features(
    place: Workplace, photographs: Sequence[Prepared], num_pairs: int, progress: Progress
) -> None:
    """Bring the features of all copies into the database.

    Args:
        place: Work folder with the copies.
        photographs: What the copies are of.
        num_pairs: Pairs that will be matched.
        progress: Told after every portion.
    """
    pycolmap = _pycolmap()
    with closing(pycolmap.Database.open(place.database)) as database:
        if database.num_images() < len(photographs):
            _enter(database, photographs)
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = _THREADS
    affordable = round(MIN_FEATURES * math.sqrt(CHEAP_PAIRS / num_pairs))
    options.sift.max_num_features = min(max(affordable, MIN_FEATURES), MAX_FEATURES)
    names = [photograph.copy for photograph in photographs]
    for first in range(0, len(names), _PORTION):
        progress(first / len(names), f"features of photograph {first + 1} of {len(names)}")
        pycolmap.extract_features(
            place.database,
            place.copies,
            image_names=names[first : first + _PORTION],
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )


def match(
    place: Workplace, portions: Sequence[Sequence[Pair]], seed: int, progress: Progress
) -> None:
    """Bring the verified matches of pairs of photographs into the database.

    Args:
        place: Work folder whose database holds the features.
        portions: Pairs of names of copies, in portions of pairs that share photographs.
        seed: Seed of the robust estimators.
        progress: Told after every portion.
    """
    pycolmap = _pycolmap()
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = 1  # the robust estimators draw from one generator a thread
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    total = sum(len(portion) for portion in portions)
    done = 0
    matched = _matched(place)
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
    """Place cameras one by one.

    One thread, for sums in another order would give another model from the same seed.

    Args:
        place: Work folder whose database holds the matches.
        count: Number of photographs.
        seed: Seed of the robust estimators.
        progress: Told after every camera.

    Returns:
        Models, the one with the most photographs first.
    """
    pycolmap = _pycolmap()
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.min_model_size = MIN_MODEL
    options.extract_colors = False
    for part in (options, options.mapper, options.triangulation):
        part.random_seed = seed
    place.models.mkdir(exist_ok=True)
    steps = _Steps(count, progress, pycolmap.CancellationToken())
    try:
        models = pycolmap.incremental_mapping(
            place.database,
            place.copies,
            place.models,
            options,
            initial_image_pair_callback=steps.begin,
            next_image_callback=steps.next,
            cancellation_token=steps.token,
        )
    except InterruptedError:
        steps.reraise()
        raise
    steps.reraise()
    return sorted(models.values(), key=lambda m: (-m.num_reg_images(), -m.num_points3D()))


def refine(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """Adjust all cameras and points together once more, robustly, and centre the lenses.

    The mapper minimises squares, so that a few false matches bend focal length and distortion; and
    it takes the middle of the picture for the lens's axis. The Cauchy loss cares for the first;
    for the second there must be enough photographs of each lens.

    Args:
        model: As mapped; it is left as it is.

    Returns:
        The refined model.
    """
    pycolmap = _pycolmap()
    counts = Counter(image.camera_id for image in model.images.values() if image.has_pose)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = ROBUST_SCALE * model.compute_mean_reprojection_error()
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.max_num_iterations = REFINE_ITERATIONS
    # Not pycolmap.bundle_adjustment: that prints, and leaves a log among the temporary files.
    adjusted = pycolmap.BundleAdjustmentConfig()
    for image in model.images.values():
        if image.has_pose:
            adjusted.add_image(image.image_id)
    adjusted.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    for centres in (True, False) if min(counts.values()) >= MIN_TO_CENTRE else (False,):
        options.refine_principal_point = centres
        refined = pycolmap.Reconstruction(model)
        pycolmap.create_default_bundle_adjuster(options, adjusted, refined).solve()
        refined.update_point_3d_errors()
        if max(_off_centre(refined.camera(number)) for number in counts) <= MAX_OFF_CENTRE:
            return refined
    return model


class _Steps:
    """Counts what the mapper does; an exception of the listener stops it and is kept for later."""

    def __init__(self, count: int, progress: Progress, token: Any) -> None:
        self.token = token
        self._count = count
        self._progress = progress
        self._placed = self._most = 0
        self._fault: BaseException | None = None

    def begin(self) -> None:
        """A model begins, with two photographs."""
        self._placed = 2
        self._tell()

    def next(self) -> None:
        """A photograph was placed."""
        self._placed += 1
        self._tell()

    def reraise(self) -> None:
        """Raise what the listener raised."""
        if self._fault is not None:
            raise self._fault

    def _tell(self) -> None:
        self._most = max(self._most, self._placed)
        try:
            message = f"camera {self._placed} of {self._count} placed"
            self._progress(min(1.0, self._most / self._count), message)
        except BaseException as fault:
            # It must not unwind through the mapper.
            self._fault = self._fault or fault
            self.token.cancel()


def _off_centre(camera: pycolmap.Camera) -> float:
    """How far the lens's axis is from the middle of the picture, in longer sides."""
    off = (
        camera.principal_point_x - camera.width / 2,
        camera.principal_point_y - camera.height / 2,
    )
    return math.hypot(*off) / max(camera.width, camera.height)


def _enter(database: pycolmap.Database, photographs: Sequence[Prepared]) -> None:
    """Enter lenses and photographs; all of them or, if interrupted, none."""
    pycolmap = _pycolmap()
    with pycolmap.DatabaseTransaction(database):
        cameras: dict[int, Any] = {}
        rigs: dict[int, int] = {}
        for photograph in photographs:
            if photograph.lens not in cameras:
                focal = photograph.focal or UNKNOWN_FOCAL * max(photograph.width, photograph.height)
                camera = pycolmap.Camera.create_from_model_name(
                    0, CAMERA_MODEL, focal, photograph.width, photograph.height
                )
                camera.has_prior_focal_length = photograph.focal is not None
                camera.camera_id = database.write_camera(camera)
                rig = pycolmap.Rig()
                rig.add_ref_sensor(camera.sensor_id)
                cameras[photograph.lens] = camera
                rigs[photograph.lens] = database.write_rig(rig)
            camera = cameras[photograph.lens]
            image = pycolmap.Image(name=photograph.copy, camera_id=camera.camera_id)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rigs[photograph.lens]
            frame.add_data_id(image.data_id)
            database.write_frame(frame)


def _matched(place: Workplace) -> set[frozenset[str]]:
    """Pairs of names whose matches have been verified."""
    pycolmap = _pycolmap()
    with closing(pycolmap.Database.open(place.database)) as database:
        names = {image.image_id: image.name for image in database.read_all_images()}
        numbers, _ = database.read_two_view_geometries()
    pairs = (pycolmap.pair_id_to_image_pair(number) for number in numbers)
    return {frozenset((names[a], names[b])) for a, b in pairs}


def _pycolmap() -> Any:
    """The library, silent: what it has to say is said in our findings."""
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    return pycolmap
