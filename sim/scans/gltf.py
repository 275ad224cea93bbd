"""glTF 2.0 (.glb and .gltf) as a scan comes in it: triangles, UV, textures, the nodes' transforms.

Read after the specification [GLTF20]. What a scan does not need (skins, animations, morph targets,
cameras, vertex colours) is passed over; what would be shown wrongly (compressed meshes, transformed
textures, several colour textures) is refused.

Neither trimesh nor pygltflib does all of this: trimesh 5.2 knows neither KHR_mesh_quantization nor
KHR_texture_transform, and decodes pictures by PIL, which nothing here installs; pygltflib leaves
accessors, nodes, pictures and limits to its caller.
"""

from __future__ import annotations

import base64
import binascii
import struct
import urllib.parse
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.counting import counted
from lightstage.formats.paths import path_inside
from lightstage.formats.values import parse_json, read_regular
from sim.errors import SimError
from sim.scans.scan_file import Picture, ScanFile, decode_picture, merged

MAGIC = b"glTF"
SCENE_BYTES = 1 << 31
"""A scan with its pictures; a larger one fits no memory several times over."""
MM_PER_UNIT = 1000.0
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES = 4
COLOUR, ROUGHNESS = "baseColorTexture", "metallicRoughnessTexture"
_HARMLESS = (
    "KHR_mesh_quantization",
    "KHR_materials_unlit",
    "KHR_materials_specular",
    "KHR_materials_ior",
    "KHR_lights_punctual",
)


def read_gltf(path: Path) -> ScanFile:
    """Read a scan.

    Args:
        path: a binary .glb, or a .gltf with its buffers and textures beside it or within.

    Returns:
        All meshes of the scene as one, in the scene's axes (+y up, +z front) and metres.

    Raises:
        SimError: not a glTF, damaged, without triangles, with NaN, with several colour textures,
            or with an extension that cannot be passed over.
    """
    try:
        return _read(path, _Reader(path))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        # Whatever stands where the format has something else.
        raise SimError(
            path, found=f"a damaged scene ({error!r})", expected="a glTF scene"
        ) from None


def _read(path: Path, reader: _Reader) -> ScanFile:
    parts = list(reader.primitives())
    if not parts:
        raise SimError(path, found="no triangles", expected="a mesh")
    points, faces, uvs, count = [], [], [], 0
    for place, corners, texture in parts:
        points.append(place)
        faces.append(corners + count)
        uvs.append(texture)
        count += len(place)
    everything = np.concatenate(points)
    bad = ~np.isfinite(everything).all(axis=1)
    if bad.any():
        raise SimError(
            path,
            field=f"vertex {int(np.flatnonzero(bad)[0])}",
            found=counted(int(bad.sum()), "NaN or infinite vertex", "NaN or infinite vertices"),
            expected="finite places",
        )
    known = [texture for texture in uvs if texture is not None]
    if known and len(known) < len(uvs):
        raise SimError(
            path,
            field="TEXCOORD_0",
            found=f"UV on {len(known)} of {counted(len(uvs), 'part')}",
            expected="all or none",
            hint="Remove the parts without UV, or unwrap them.",
        )
    flat = np.concatenate(known) if known else None
    corners = np.concatenate(faces)
    return ScanFile(
        where=path,
        mesh=merged(everything, corners, flat, corners),
        mm_per_unit=MM_PER_UNIT,
        colour=reader.picture(("pbrMetallicRoughness", COLOUR)),
        colour_factor=reader.colour_factor(),
        normals=reader.picture(("normalTexture",)),
        roughness=reader.picture(("pbrMetallicRoughness", ROUGHNESS)),
        roughness_factor=reader.roughness_factor(),
    )


class _Reader:
    def __init__(self, path: Path) -> None:
        self.path = path
        data = read_regular(path, SCENE_BYTES, "a glTF scene", SimError)
        text, self.chunk = self._chunks(data) if data[:4] == MAGIC else (data, None)
        if path.suffix.lower() == ".glb" and data[:4] != MAGIC:
            raise self.wrong("something else", "a binary glTF, which begins with 'glTF'")
        try:
            self.root: dict[str, Any] = parse_json(text, path, error=SimError)
            version = str(self.root["asset"]["version"])
        except (ValueError, KeyError, TypeError) as error:
            raise self.wrong(f"no glTF JSON ({error})", "a glTF scene") from None
        if not version.startswith("2."):
            raise self.wrong(f"glTF {version}", "glTF 2.0", "Export it again as glTF 2.0.")
        unknown = [n for n in self.root.get("extensionsRequired", []) if n not in _HARMLESS]
        if unknown:
            raise self.wrong(
                f"required extension {', '.join(unknown)}",
                "plain glTF 2.0",
                "Export it again without compression and without texture transforms.",
            )
        self.materials: list[dict[str, Any]] = []

    def wrong(self, found: str, expected: str, hint: str = "", field: str = "") -> SimError:
        return SimError(self.path, field=field, found=found, expected=expected, hint=hint)

    def _chunks(self, data: bytes) -> tuple[bytes, bytes | None]:
        """JSON and binary chunk of a .glb."""
        if len(data) < 20 or struct.unpack_from("<I", data, 8)[0] > len(data):
            raise self.wrong(
                counted(len(data), "byte"), "a whole file", "Is it truncated? Copy again."
            )
        found: list[bytes] = []
        at = 12
        while at + 8 <= len(data) and len(found) < 2:
            size = struct.unpack_from("<I", data, at)[0]
            found.append(data[at + 8 : at + 8 + size])
            at += 8 + size
        return found[0], found[1] if len(found) > 1 else None

    def primitives(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray | None]]:
        """Places (n, 3) in the scene, corners (t, 3) and UV (n, 2) of each part."""
        try:
            scenes = self.root.get("scenes", [{"nodes": range(len(self.root.get("nodes", [])))}])
            nodes = scenes[self.root.get("scene", 0)].get("nodes", [])
            return [part for node in nodes for part in self._node(int(node), np.eye(4), 0)]
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise self.wrong(f"a damaged scene ({error!r})", "a glTF scene") from None

    def _node(
        self, index: int, above: np.ndarray, depth: int
    ) -> list[tuple[np.ndarray, np.ndarray, np.ndarray | None]]:
        if depth > 64:
            raise self.wrong("nodes within nodes without end", "a tree", field=f"nodes[{index}]")
        node = self.root["nodes"][index]
        motion = above @ _transform(node)
        out = []
        if "mesh" in node:
            for part in self.root["meshes"][node["mesh"]]["primitives"]:
                out.append(self._primitive(part, motion))
        for child in node.get("children", []):
            out += self._node(int(child), motion, depth + 1)
        return out

    def _primitive(
        self, part: dict[str, Any], motion: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        mode = part.get("mode", _TRIANGLES)
        if mode != _TRIANGLES:
            raise self.wrong(f"mode {mode}", "triangles (4)", field="primitive")
        attributes = part["attributes"]
        local = self._accessor(attributes["POSITION"]).astype(float)
        place = local @ motion[:3, :3].T + motion[:3, 3]
        corners = np.arange(len(place), dtype=np.int64)
        if "indices" in part:
            corners = self._accessor(part["indices"])[:, 0].astype(np.int64)
        if len(corners) % 3 or (len(corners) and corners.max() >= len(place)):
            raise self.wrong("indices of no vertex", "triangles", field="indices")
        triangles = corners.reshape(-1, 3)
        if np.linalg.det(motion[:3, :3]) < 0:
            # A mirroring transform turns the winding over.
            triangles = triangles[:, ::-1]
        if "material" in part:
            material = self.root["materials"][part["material"]]
            if material not in self.materials:
                self.materials.append(material)
        name = f"TEXCOORD_{self._uv_set()}"
        if name not in attributes:
            return place, triangles, None
        uv = self._accessor(attributes[name]).astype(float)
        # glTF's v runs downward, OBJ's upward.
        return place, triangles, np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)

    def _accessor(self, index: int) -> np.ndarray:
        """(count, components) of an accessor."""
        field = f"accessors[{index}]"
        accessor = self.root["accessors"][index]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise self.wrong("a sparse accessor", "plain data", "Export it again.", field)
        kind, count = np.dtype(_TYPES[accessor["componentType"]]), int(accessor["count"])
        size = _SIZES[accessor["type"]]
        view = self.root["bufferViews"][accessor["bufferView"]]
        data = self._view(view)
        stride = int(view.get("byteStride", size * kind.itemsize))
        start = int(accessor.get("byteOffset", 0))
        if start + (count - 1) * stride + size * kind.itemsize > len(data):
            raise self.wrong(
                counted(len(data), "byte"), counted(count, "value"), "Is the file truncated?", field
            )
        values = np.ndarray((count, size), kind, data, start, (stride, kind.itemsize))
        if not accessor.get("normalized", False):
            return values
        return np.maximum(values.astype(float) / np.iinfo(kind).max, -1.0)

    def _view(self, view: dict[str, Any]) -> bytes:
        start = int(view.get("byteOffset", 0))
        return self._buffer(int(view["buffer"]))[start : start + int(view["byteLength"])]

    def _buffer(self, index: int) -> bytes:
        uri = self.root["buffers"][index].get("uri")
        if uri is not None:
            return self._bytes_of(uri)
        if self.chunk is None or index:
            raise self.wrong("no binary chunk", "the mesh's data", field=f"buffers[{index}]")
        return self.chunk

    def _bytes_of(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2], validate=True)
            except binascii.Error as error:
                raise self.wrong(str(error), "base64", field="uri") from None
        folder, name = self.path.parent, urllib.parse.unquote(uri)
        beside = path_inside(folder, name, self.path, "uri", SimError)
        if not beside.is_file():
            raise SimError(beside, found="no such file", expected=f"a part of {self.path.name}")
        return beside.read_bytes()

    def _uv_set(self) -> int:
        """The number of the UV that all textures of the materials so far are laid out in."""
        pbr = "pbrMetallicRoughness"
        kinds: list[tuple[str, ...]] = [("normalTexture",), (pbr, COLOUR), (pbr, ROUGHNESS)]
        numbers = {int(t.get("texCoord", 0)) for keys in kinds for t in self._textures(keys)}
        if len(numbers) > 1:
            raise self.wrong(
                f"UV {', '.join(map(str, sorted(numbers)))}",
                "one UV for all textures",
                "Bake all textures into one UV.",
                "texCoord",
            )
        return numbers.pop() if numbers else 0

    def _textures(self, keys: tuple[str, ...]) -> list[dict[str, Any]]:
        """The materials' texture references of one kind."""
        out = []
        for material in self.materials:
            value: Any = material
            for key in keys:
                value = value.get(key, {})
            if value:
                out.append(value)
        return out

    def roughness_factor(self) -> float:
        """Factor of the roughness texture, the same for all materials; 1 where there is none."""
        key = "roughnessFactor"
        pbr = [m.get("pbrMetallicRoughness", {}) for m in self.materials]
        factors = {float(p.get(key, 1.0)) for p in pbr if ROUGHNESS in p} or {1.0}
        if len(factors) > 1:
            raise self.wrong(f"{len(factors)} different", "one", field=key)
        return factors.pop()

    def colour_factor(self) -> tuple[float, float, float]:
        """Linear factor of the colour, the same for all materials."""
        key = "baseColorFactor"
        pbr = [m.get("pbrMetallicRoughness", {}) for m in self.materials]
        factors = {tuple(float(c) for c in m.get(key, (1, 1, 1))[:3]) for m in pbr} or {(1.0,) * 3}
        if len(factors) > 1:
            raise self.wrong(f"{len(factors)} different", "one", field=key)
        red, green, blue = factors.pop()
        return red, green, blue

    def picture(self, keys: tuple[str, ...]) -> Picture | None:
        """The one texture of a kind, None where there is none."""
        references = self._textures(keys)
        if any("KHR_texture_transform" in r.get("extensions", {}) for r in references):
            raise self.wrong(
                "KHR_texture_transform", "plain UV", "Apply the transform to the UV.", keys[-1]
            )
        scales = {float(r.get("scale", 1.0)) for r in references} - {1.0}
        if scales:
            raise self.wrong(
                f"a scale of {scales.pop():g}", "1", "Bake the scale into the map.", keys[-1]
            )
        try:
            used = {int(self.root["textures"][r["index"]]["source"]) for r in references}
            if len(used) > 1 or (used and len(references) < len(self.materials)):
                raise self.wrong(
                    f"{len(used)} of them on {counted(len(self.materials), 'material')}",
                    "one texture for the whole mesh",
                    "Bake all materials into one texture with one UV.",
                    keys[-1],
                )
            if not used:
                return None
            image = self.root["images"][used.pop()]
            if "uri" in image:
                data = self._bytes_of(image["uri"])
            else:
                data = self._view(self.root["bufferViews"][image["bufferView"]])
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise self.wrong(f"a damaged texture ({error!r})", "a picture", "", keys[-1]) from None
        return decode_picture(data, f"{self.path}, {keys[-1]}")


def _transform(node: dict[str, Any]) -> np.ndarray:
    """(4, 4) of a node: its matrix, or translation, rotation and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = (float(c) for c in node.get("rotation", (0, 0, 0, 1)))
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    out = np.eye(4)
    out[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), float)
    out[:3, 3] = node.get("translation", (0, 0, 0))
    return out
