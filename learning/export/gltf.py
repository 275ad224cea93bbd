"""A head as binary glTF 2.0 [GLTF20], with KHR_materials_ior and KHR_materials_specular."""

from __future__ import annotations

import dataclasses
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from learning.export.encode import perceptual
from learning.export.parts.furnish import Furnished
from learning.export.parts.part import Part, directed
from learning.export.pictures import CONSTANT_ROUGHNESS, NORMAL, Pictures
from learning.export.source import Source
from learning.render.dielectric import INDEX
from lightstage.formats.files import atomic_path
from lightstage.formats.mesh import vertex_normals

METRES = 0.001
"""glTF is in metres; ours in mm."""
FLOAT, UNSIGNED = 5126, 5125
VERTICES, INDICES = 34962, 34963
SAID = {
    "units": "metres, +y up, +z out of the face; the axes of the registered mesh",
    "base_color": "diffuse albedo, sRGB; 1 = perfect white, without shadow or occlusion",
    "normal": f"{NORMAL}, MikkTSpace, green up",
    "roughness": "root of Beckmann's m",
    "specular": "specular albedo over that of n = 1.4 in alpha; what is above 1 in the colour",
}


@dataclasses.dataclass(frozen=True)
class Corners:
    """A mesh with one index for place, texture coordinate and tangent.

    Attributes:
        vertex: (g,) which vertex of the mesh each is.
        uv: (g,) which texture coordinate.
        tangent: (g, 4) unit, and the sign of the bitangent.
        triangles: (t, 3) uint32.
    """

    vertex: np.ndarray
    uv: np.ndarray
    tangent: np.ndarray
    triangles: np.ndarray


def corners_of(source: Source) -> Corners:
    """A vertex for each group of corners that share a tangent; MikkTSpace's groups."""
    corner = source.frames.corner
    _, first = np.unique(corner, return_index=True)
    vertex = source.mesh.triangles().ravel()[first]
    sign = source.frames.sign[first // 3]
    tangent = source.frames.tangents.copy()
    # Where the texture has no area any tangent will do, as long as it has a direction.
    lost = np.linalg.norm(tangent, axis=1) < 0.5
    normal = unit_normals(source)[vertex[lost]]
    axis = np.where(abs(normal[:, :1]) < 0.6, [[1.0, 0, 0]], [[0, 1.0, 0]])
    across = np.cross(normal, axis)
    tangent[lost] = across / np.linalg.norm(across, axis=1, keepdims=True)
    uv = source.mesh.triangle_uvs().ravel()[first]
    return Corners(vertex, uv, np.column_stack([tangent, sign]), corner.astype(np.uint32))


def unit_normals(source: Source) -> np.ndarray:
    """(n, 3) normals of the mesh's vertices; +z where all triangles of one are degenerate."""
    return directed(source.normals)


def turned_normals(source: Source, offsets: np.ndarray) -> np.ndarray:
    """(n, 3) what an expression adds to the normals of `unit_normals`.

    Without it a lowered lid is lit as an open one, since programs keep a mesh's own normals.

    Args:
        source: the head.
        offsets: (n, 3) of its vertices, mm.
    """
    normals = vertex_normals(source.mesh.vertices + offsets, source.mesh.triangles())
    has_one = np.linalg.norm(normals, axis=1, keepdims=True) > 0.5
    return np.where(has_one, normals - unit_normals(source), 0)


class Buffer:
    """The binary part: views of it, and accessors that describe their contents."""

    def __init__(self) -> None:
        """Empty."""
        self.parts: list[bytes] = []
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self._length = 0

    @property
    def length(self) -> int:
        """Bytes so far, a multiple of 4."""
        return self._length

    def view(self, data: bytes, target: int | None = None) -> int:
        """Add bytes; returns the view's index."""
        found: dict[str, Any] = {
            "buffer": 0, "byteOffset": self._length, "byteLength": len(data),
        }  # fmt: skip
        self.views.append(found if target is None else {**found, "target": target})
        self.parts.append(data + bytes(-len(data) % 4))
        self._length += len(self.parts[-1])
        return len(self.views) - 1

    def vectors(self, values: np.ndarray, bounds: bool = False) -> int:
        """Add (g, 2 to 4) float32 vertex attributes; returns the accessor's index."""
        single = np.ascontiguousarray(values, "<f4")
        found: dict[str, Any] = {
            "bufferView": self.view(single.tobytes(), VERTICES),
            "componentType": FLOAT,
            "count": len(single),
            "type": f"VEC{single.shape[1]}",
        }
        if bounds:
            found |= {"min": single.min(axis=0).tolist(), "max": single.max(axis=0).tolist()}
        self.accessors.append(found)
        return len(self.accessors) - 1

    def indices(self, triangles: np.ndarray) -> int:
        """Add (t, 3) indices of vertices; returns the accessor's index."""
        view = self.view(np.ascontiguousarray(triangles, "<u4").tobytes(), INDICES)
        self.accessors.append(
            {
                "bufferView": view, "componentType": UNSIGNED, "count": triangles.size,
                "type": "SCALAR",
            }
        )  # fmt: skip
        return len(self.accessors) - 1


def write_glb(
    path: Path,
    head: Furnished,
    pictures: Pictures,
    opens_with: str | None = None,
) -> Path:
    """Write a head as .glb, atomically.

    Args:
        path: the file.
        head: skin, morphs, and parts, which are primitives with materials of their own.
        pictures: of the skin.
        opens_with: the morph that has weight 1; None for none.

    Returns:
        `path`.
    """
    buffer = Buffer()
    mesh = _mesh(head, buffer, opens_with)
    images: list[dict[str, Any]] = []
    materials = [_material(pictures, head.source, buffer, images)]
    for part in head.parts:
        mesh["primitives"].append(_primitive(part, buffer, list(head.morphs), len(materials)))
        rough = {"roughnessFactor": part.roughness, "metallicFactor": 0.0}
        materials.append({"name": part.name, "pbrMetallicRoughness": rough, "doubleSided": True})
    document = {
        "asset": {"version": "2.0", "generator": "lightstage", "extras": SAID},
        "extensionsUsed": ["KHR_materials_ior", "KHR_materials_specular"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "head"}],
        "meshes": [mesh],
        "materials": materials,
        "textures": [{"sampler": 0, "source": k} for k in range(len(images))],
        "images": images,
        # Linear, with mipmaps; the tile does not repeat.
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.length}],
    }
    text = json.dumps(document, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + buffer.length
    with atomic_path(path, total) as beside, beside.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, total))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", buffer.length, b"BIN\0"))
        file.writelines(buffer.parts)
    return path


def _mesh(head: Furnished, buffer: Buffer, opens_with: str | None) -> dict[str, Any]:
    source, morphs = head.source, head.morphs
    corners = corners_of(source)
    assert source.mesh.uvs is not None  # read_source refuses a mesh without
    # glTF's v runs down.
    uv = source.mesh.uvs[corners.uv] * [1, -1] + [0, 1]
    primitive: dict[str, Any] = {
        "attributes": {
            "POSITION": buffer.vectors(METRES * source.mesh.vertices[corners.vertex], bounds=True),
            "NORMAL": buffer.vectors(unit_normals(source)[corners.vertex]),
            "TANGENT": buffer.vectors(corners.tangent),
            "TEXCOORD_0": buffer.vectors(uv),
        },
        "indices": buffer.indices(corners.triangles),
        "material": 0,
    }
    found: dict[str, Any] = {"name": "head", "primitives": [primitive]}
    if morphs:
        primitive["targets"] = [
            {
                "POSITION": buffer.vectors(METRES * offsets[corners.vertex], bounds=True),
                "NORMAL": buffer.vectors(turned_normals(source, offsets)[corners.vertex]),
            }
            for offsets in morphs.values()
        ]
        weights = [float(name == opens_with) for name in morphs]
        found |= {"weights": weights, "extras": {"targetNames": list(morphs)}}
    return found


def _primitive(part: Part, buffer: Buffer, names: list[str], material: int) -> dict[str, Any]:
    """A part with the skin's morph targets, zeros where it stays."""
    found: dict[str, Any] = {
        "attributes": {
            "POSITION": buffer.vectors(METRES * part.places, bounds=True),
            "NORMAL": buffer.vectors(part.normals()),
            "COLOR_0": buffer.vectors(part.colours),
        },
        "indices": buffer.indices(part.triangles),
        "material": material,
    }
    targets = {
        name: {
            "POSITION": buffer.vectors(METRES * offsets, bounds=True),
            "NORMAL": buffer.vectors(part.turned(offsets)),
        }
        for name, offsets in part.morphs.items()
    }
    if set(names) - set(targets):
        zero = buffer.vectors(np.zeros_like(part.places), bounds=True)
        still = {"POSITION": zero, "NORMAL": zero}
        targets = {name: targets.get(name, still) for name in names}
    return {**found, "targets": [targets[name] for name in names]} if names else found


def _material(
    pictures: Pictures, source: Source, buffer: Buffer, images: list[dict[str, Any]]
) -> dict[str, Any]:
    def texture(name: str, data: bytes) -> dict[str, int]:
        images.append({"name": name, "mimeType": "image/png", "bufferView": buffer.view(data)})
        return {"index": len(images) - 1}

    base = {"baseColorTexture": texture("base_color", pictures.base_colour), "metallicFactor": 0.0}
    found: dict[str, Any] = {
        "name": "skin",
        "pbrMetallicRoughness": base,
        "normalTexture": texture("normal", pictures.normal),
    }
    rough = "roughness" in source.maps
    base["roughnessFactor"] = 1.0 if rough else float(perceptual(np.array(CONSTANT_ROUGHNESS)))
    packed = pictures.occlusion_roughness
    if packed is not None:
        where = texture("occlusion_roughness", packed)
        if rough:
            base["metallicRoughnessTexture"] = where
        if "ambient_occlusion" in source.maps:
            found["occlusionTexture"] = where
    specular = texture("specular", pictures.specular_gltf)
    found["extensions"] = {
        "KHR_materials_ior": {"ior": INDEX},
        "KHR_materials_specular": {
            "specularFactor": 1.0,
            "specularTexture": specular,
            "specularColorFactor": [pictures.highest_specular] * 3,
            "specularColorTexture": specular,
        },
    }
    return found
