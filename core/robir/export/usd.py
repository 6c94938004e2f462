# SPDX-License-Identifier: Apache-2.0
"""Writes a finished result as USD: one text file beside the textures that it names.

The material is UsdPreviewSurface, which every reader of USD knows. Up is z and the origin is the
object's foot, the middle of its bounds' lower side, as in the asset for Blender. Texture
coordinates over UDIM tiles are as they were handed in; a texture's path names all tiles at once.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.evaluation.layers import load_textures, stored_mesh
from robir.jobs.paths import UDIM, JobPaths, of_tile, replacing

_IOR = {True: 1.5, False: 1.0}  # by whether what is no metal reflects (F0 = 0.04)
_FILE = """#usda 1.0
(
    defaultPrim = "{name}"
    metersPerUnit = 1
    upAxis = "Z"
    customLayerData = {{ {facts} }}
)

def Xform "{name}" (kind = "component")
{{
    def Mesh "mesh" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        rel material:binding = </{name}/material>
        uniform bool doubleSided = 1
        uniform token subdivisionScheme = "none"
        float3[] extent = [{extent}]
        int[] faceVertexCounts = [{counts}]
        int[] faceVertexIndices = [{faces}]
        point3f[] points = [{points}]
        normal3f[] normals = [{normals}] (interpolation = "vertex")
        texCoord2f[] primvars:st = [{uvs}] (interpolation = "faceVarying")
        int[] primvars:st:indices = [{uv_faces}]
    }}

    def Material "material"
    {{
        token outputs:surface.connect = </{name}/material/surface.outputs:surface>

        def Shader "surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            float inputs:ior = {ior}
{inputs}
            token outputs:surface
        }}

        def Shader "coordinates"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
{textures}    }}
}}
"""

_INPUT = "            {type} inputs:{input}.connect = </{name}/material/{file}.outputs:{channel}>"

_TEXTURE = """
        def Shader "{file}"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @{path}@
            token inputs:sourceColorSpace = "{space}"
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"
            float2 inputs:st.connect = </{name}/material/coordinates.outputs:result>
            {output} outputs:{channel}
        }}
"""

_IMAGES = (
    {"file": "albedo", "input": "diffuseColor", "type": "color3f", "output": "float3",
     "channel": "rgb", "space": "sRGB"},
    {"file": "roughness", "input": "roughness", "type": "float", "output": "float",
     "channel": "r", "space": "raw"},
    {"file": "metallic", "input": "metallic", "type": "float", "output": "float",
     "channel": "r", "space": "raw"},
)  # fmt: skip


def write_usd(paths: JobPaths, facts: Mapping[str, str]) -> None:
    """Write export/asset.usda of a finished result, with facts by name, or a `StorageError`."""
    mesh = stored_mesh(paths)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    foot = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    points = (mesh.vertices - foot).astype(np.float32)
    name = re.sub(r"^(?=\d)|\W", "_", paths.root.name, flags=re.ASCII)
    tiles = mesh.tiles.tolist()
    first, every = (tiles[0], UDIM) if tiles else (None, None)
    images = [
        image | {"name": name, "path": f"./{os.path.relpath(of_tile(file, every), paths.export)}"}
        for image in _IMAGES
        if of_tile(file := paths.textures / f"{image['file']}.png", first).is_file()
    ]
    text = _FILE.format(
        name=name,
        facts="; ".join(f"string {key} = {json.dumps(facts[key])}" for key in facts),
        extent=_tuples([points.min(axis=0), points.max(axis=0)]),
        counts=_numbers(np.full(len(mesh.faces), 3)),
        faces=_numbers(mesh.faces),
        points=_tuples(points),
        normals=_tuples(mesh.normals),
        uvs=_tuples(mesh.own_uvs()),
        uv_faces=_numbers(mesh.uv_faces),
        ior=_IOR[bool(load_textures(paths).get("specular", 1.0) != 0.0)],
        inputs="\n".join(_INPUT.format(**image) for image in images),
        textures="".join(_TEXTURE.format(**image) for image in images),
    )
    with replacing(paths.usd) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _numbers(values: NDArray[Any]) -> str:
    return ", ".join(map(str, values.ravel().tolist()))


def _tuples(rows: Iterable[NDArray[Any]]) -> str:
    """Rows such as (1, 2, 3), every float32 to the last bit."""
    return ", ".join(f"({', '.join(f'{value:.9g}' for value in row.tolist())})" for row in rows)
