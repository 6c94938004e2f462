# SPDX-License-Identifier: Apache-2.0
"""Our surface, cameras and textures as a Mitsuba 3 scene.

Everything here is in the frame where the capture's bounding sphere is the unit sphere, and images
are linear Rec.709 (Mitsuba's variant knows nothing else). Mitsuba and Dr.Jit are optional: where
one is missing, `load_mitsuba` says which lines install it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.errors import DeviceError
from robir.geometry.mesh.triangles import Mesh

Floats = NDArray[np.floating[Any]]

VARIANT = "llvm_ad_rgb"

OLDEST_LLVM = 17  # dr.Jit 1.5 emits an instruction that 15 lacks, which ends the process; 19 works

LLVM_HELP = (
    f"it needs LLVM {OLDEST_LLVM} or newer; on Debian or Ubuntu: sudo apt-get install libllvm19, "
    "and where an older one is found first, set DRJIT_LIBLLVM_PATH to the new libLLVM.so"
)

# mitsuba's names of what is optimised
BASE, ROUGHNESS, LIGHT = (
    "surface.bsdf.brdf_0.base_color.data",
    "surface.bsdf.brdf_0.roughness.data",
    "light.data",
)

_FILM_WIDTH = 64

# Local axes of Mitsuba's maps to ours: its up is +Y, ours +Z, and column 0 starts at our -X.
_MAP_TO_WORLD = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], np.float64)


def load_mitsuba() -> Any:
    """The module `mitsuba` with its variant set, on one thread.

    Raises:
        DeviceError: If Mitsuba or a usable LLVM is missing; the message says how to get it.
    """
    try:
        mitsuba, drjit = import_module("mitsuba"), load_drjit()
    except ImportError as fault:
        raise DeviceError(
            f"Mitsuba 3 is missing ({fault}): pip install 'robir[peers]'; {LLVM_HELP}"
        ) from fault
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        given = os.environ.get("DRJIT_LIBLLVM_PATH")
        where = "on this machine" if given is None else f"at DRJIT_LIBLLVM_PATH={given}"
        raise DeviceError(f"Mitsuba 3 finds no LLVM {where}: {LLVM_HELP}")
    version = drjit.detail.llvm_version()
    if version[0] < OLDEST_LLVM:
        found = ".".join(map(str, version))
        raise DeviceError(f"Mitsuba 3 found LLVM {found}: {LLVM_HELP}")
    mitsuba.set_variant(VARIANT)
    drjit.set_thread_count(1)
    return mitsuba


def load_drjit() -> Any:
    """The module `drjit`, which comes with Mitsuba."""
    return import_module("drjit")


@dataclass(frozen=True, slots=True, kw_only=True)
class ImagePoints:
    """Image points of some cameras."""

    view: NDArray[np.integer[Any]]  # (N,) index of the camera
    column: NDArray[np.integer[Any]]  # (N,) whole pixels from the left
    row: NDArray[np.integer[Any]]  # (N,) whole pixels from the top

    def __len__(self) -> int:
        """Number of pixels."""
        return len(self.view)

    def chosen(self, which: NDArray[Any]) -> ImagePoints:
        """Some of the pixels, by index or mask."""
        return ImagePoints(view=self.view[which], column=self.column[which], row=self.row[which])

    def of_view(self, index: int) -> ImagePoints:
        """The same image points of another camera."""
        return ImagePoints(view=np.full_like(self.view, index), column=self.column, row=self.row)


def all_pixels(cameras: Sequence[Camera]) -> ImagePoints:
    """Every pixel of every camera, row by row."""
    grids = [np.mgrid[: camera.height, : camera.width].reshape(2, -1) for camera in cameras]
    view = np.repeat(np.arange(len(cameras)), [grid.shape[1] for grid in grids])
    row, column = np.concatenate(grids, axis=1)
    return ImagePoints(view=view, column=column, row=row)


def pixel_sensor(mi: Any, cameras: Sequence[Camera], size: int) -> Any:
    """A sensor whose film is any list of `size` pixels of any of the cameras.

    Its method `look_at(pixels)` says which; so a step can see all views at once, and nothing is
    spent on the background.

    Args:
        mi: From `load_mitsuba`.
        cameras: In the frame of the scene.
        size: Pixels on the film, a multiple of 64.
    """
    dr = load_drjit()

    class PixelSensor(mi.Sensor):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.origin, self.corner, self.right, self.up = (
                mi.TensorXf(table).array for table in _lens_tables(cameras)
            )
            self.look_at(all_pixels(cameras).chosen(np.zeros(size, int)))

        def look_at(self, pixels: ImagePoints) -> None:
            """Put these pixels on the film, exactly as many as it has."""
            self.view = mi.UInt32(pixels.view.astype(np.uint32))
            self.column = mi.Float(pixels.column.astype(np.float32))
            self.row = mi.Float(pixels.row.astype(np.float32))

        def centre_rays(self) -> Any:
            """One ray through the middle of every pixel."""
            row, column = np.divmod(np.arange(size), _FILM_WIDTH)
            x, y = (column + 0.5) / _FILM_WIDTH, (row + 0.5) / (size // _FILM_WIDTH)
            return self.sample_ray(0.0, 0.0, mi.Point2f(x, y), 0.0)[0]

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> Any:
            del sample1, sample3
            film = mi.Point2f(sample2.x * _FILM_WIDTH, sample2.y * (size // _FILM_WIDTH))
            cell = mi.Vector2u(film)
            index = dr.minimum(cell.y * _FILM_WIDTH + cell.x, size - 1)
            view = dr.gather(mi.UInt32, self.view, index, active)
            x = dr.gather(mi.Float, self.column, index, active) + film.x - cell.x
            y = dr.gather(mi.Float, self.row, index, active) + film.y - cell.y
            origin, corner, right, up = (
                dr.gather(mi.Vector3f, table, view, active)
                for table in (self.origin, self.corner, self.right, self.up)
            )
            ray = mi.Ray3f(mi.Point3f(origin), dr.normalize(corner + right * x - up * y), time)
            return ray, mi.Spectrum(1.0)

        def sample_ray_differential(self, **words: Any) -> Any:
            ray, weight = self.sample_ray(**words)
            return mi.RayDifferential3f(ray), weight

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

    mi.register_sensor("robir_pixels", PixelSensor)
    sampler = {"type": "independent"}
    return mi.load_dict({"type": "robir_pixels", "film": _film(size), "sampler": sampler})


def _lens_tables(cameras: Sequence[Camera]) -> tuple[NDArray[np.float32], ...]:
    """Of each camera, (V, 3): its place, the way to the image's corner, a pixel right and up.

    The ray through the image point (x, y) runs along corner + x right - y up.
    """
    pose = np.stack([camera.camera_to_world for camera in cameras])
    lens = np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras])
    right = pose[:, :3, 0] / lens[:, :1]
    up = pose[:, :3, 1] / lens[:, 1:2]
    corner = -pose[:, :3, 2] - right * lens[:, 2:3] + up * lens[:, 3:4]
    tables = (pose[:, :3, 3], corner, right, up)
    return tuple(np.ascontiguousarray(table, np.float32) for table in tables)


def _film(size: int) -> dict[str, Any]:
    """A film of so many pixels that keeps each one's mean."""
    return {
        "type": "hdrfilm",
        "width": _FILM_WIDTH,
        "height": size // _FILM_WIDTH,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }


def make_scene(mi: Any, mesh: Mesh, texture_size: int, light_rows: int) -> Any:
    """The surface with a grey principled material under an even light of radiance 1.

    Args:
        mi: From `load_mitsuba`.
        mesh: Unwrapped.
        texture_size: Side of its two textures, texels; row 0 is v = 1.
        light_rows: Rows of the light, half its columns; see `light_data`.
    """
    textures = {
        name: {
            "type": "bitmap",
            "data": mi.TensorXf(np.full((texture_size, texture_size, bands), 0.5, np.float32)),
            "raw": True,
            "wrap_mode": "clamp",
        }
        for name, bands in (("base_color", 3), ("roughness", 1))
    }
    even = np.ones((light_rows, 2 * light_rows, 3), np.float32)
    return mi.load_dict(
        {
            "type": "scene",
            "surface": _mitsuba_mesh(mi, mesh, mi.load_dict(material(**textures))),
            "light": {
                "type": "envmap",
                "bitmap": mi.Bitmap(even),
                "to_world": mi.ScalarTransform4f(_MAP_TO_WORLD),
            },
        }
    )


def material(base_color: dict[str, Any], roughness: dict[str, Any]) -> dict[str, Any]:
    """Mitsuba's principled BSDF of two textures, F0 = 0.04, seen alike from both sides."""
    textures = {"base_color": base_color, "roughness": roughness}
    return {"type": "twosided", "brdf": {"type": "principled", "specular": 0.5, **textures}}


def _mitsuba_mesh(mi: Any, mesh: Mesh, bsdf: Any) -> Any:
    """The mesh with a vertex for every pair of position and texture coordinate."""
    pairs = np.stack([mesh.faces.ravel(), mesh.uv_faces.ravel()], axis=1)
    unique, index = np.unique(pairs, axis=0, return_inverse=True)
    uv = mesh.uvs[unique[:, 1]].copy()
    uv[:, 1] = 1.0 - uv[:, 1]
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    shape = mi.Mesh(
        "surface",
        len(unique),
        len(mesh.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    fields = mi.traverse(shape)
    for name, table in (
        ("vertex_positions", mesh.vertices[unique[:, 0]]),
        ("vertex_normals", mesh.normals[unique[:, 0]]),
        ("vertex_texcoords", uv),
    ):
        fields[name] = mi.Float(np.ravel(table).astype(np.float32))
    fields["faces"] = mi.UInt32(index.ravel().astype(np.uint32))
    fields.update()
    return shape


def light_directions(rows: int) -> Floats:
    """Direction of every texel of a light, (rows, 2 rows, 3), unit, world.

    Mitsuba's rows reach from pole to pole, its columns lie at half integers.
    """
    polar = np.linspace(0.0, np.pi, rows)
    azimuth = np.pi * (1.0 - (2.0 * np.arange(2 * rows) + 1.0) / (2 * rows))
    directions = np.empty((rows, 2 * rows, 3))
    directions[..., 0] = np.outer(np.sin(polar), np.cos(azimuth))
    directions[..., 1] = np.outer(np.sin(polar), np.sin(azimuth))
    directions[..., 2] = np.cos(polar)[:, None]
    return directions


def light_solid_angles(rows: int) -> Floats:
    """Solid angle that each row's texels stand for, (rows,); all texels make 4 pi."""
    edges = np.clip((np.arange(rows + 1) - 0.5) / (rows - 1), 0.0, 1.0) * np.pi
    return (np.cos(edges[:-1]) - np.cos(edges[1:])) * np.pi / rows


def light_data(radiance: torch.Tensor) -> torch.Tensor:
    """Mitsuba's array of a light (rows, 2 rows, 3): a column of the other end on both sides."""
    return torch.cat([radiance[:, -1:], radiance, radiance[:, :1]], dim=1)


def sun_texels(direction: Floats, irradiance: Floats, rows: int) -> NDArray[np.float64]:
    """A sun as radiance (rows, 2 rows, 3) of the four texels about its direction.

    Their shares put its centre where it belongs; a surface that faces the sun gets its irradiance
    but for the few degrees that the texels are wide.

    Args:
        direction: (3,) unit, world, towards the sun.
        irradiance: (3,) of a surface that faces it, linear Rec.709.
        rows: Of the light.
    """
    down = np.arccos(np.clip(direction[2], -1.0, 1.0)) / np.pi * (rows - 1)
    along = (0.5 - np.arctan2(direction[1], direction[0]) / (2 * np.pi)) * 2 * rows - 0.5
    radiance = np.zeros((rows, 2 * rows, 3))
    solid_angle = light_solid_angles(rows)
    top, left = int(min(down, rows - 2)), int(np.floor(along))
    for row, row_share in ((top, top + 1 - down), (top + 1, down - top)):
        for column, share in ((left, left + 1 - along), (left + 1, along - left)):
            radiance[row, column % (2 * rows)] += row_share * share * irradiance / solid_angle[row]
    return radiance
