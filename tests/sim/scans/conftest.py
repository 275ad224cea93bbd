"""An egg of a head's size with UV and a texture, and writers of the files that scans come in."""

from __future__ import annotations

import dataclasses
import json
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lightstage.formats.mesh import Mesh
from sim.head.mesh import landmarks, neutral_mesh

GREEN = (60, 120, 200)


def egg_mesh(rows: int = 24, columns: int = 32) -> Mesh:
    """Triangles, 140 x 200 x 180 mm, closed but for the neck: the lowest ring."""
    v, u = np.meshgrid(
        np.linspace(0.15, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij"
    )
    polar, azimuth = np.pi * (1 - v), 2 * np.pi * (u - 0.5)
    points = np.stack(
        [
            70 * np.sin(polar) * np.sin(azimuth),
            100 * np.cos(polar),
            90 * np.sin(polar) * np.cos(azimuth),
        ],
        axis=-1,
    ).reshape(-1, 3)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    step = columns + 1
    lower = np.stack([corner, corner + 1, corner + step + 1], axis=1)
    upper = np.stack([corner, corner + step + 1, corner + step], axis=1)
    # The topmost ring is the crown, a point: its upper triangles have no area.
    upper = upper[: len(upper) - columns]
    faces = np.concatenate([lower, upper]).astype(np.int32)
    _, first, inverse = np.unique(
        np.round(points, 6), axis=0, return_index=True, return_inverse=True
    )
    uvs = np.stack([u.ravel(), v.ravel()], axis=1)
    return Mesh(points[first], inverse.ravel()[faces].astype(np.int32), uvs, faces)


def picture_bytes(rows: int = 16, columns: int = 16, bgr: tuple[int, int, int] = GREEN) -> bytes:
    """A PNG of one colour with a darker left half."""
    image = np.full((rows, columns, 3), bgr, np.uint8)
    image[:, : columns // 2] //= 2
    return cv2.imencode(".png", image)[1].tobytes()


def gltf_scene(mesh: Mesh, texture: bytes | None = None) -> tuple[dict, bytes]:
    """glTF's JSON and binary data of a mesh, one vertex a corner's UV."""
    assert mesh.uvs is not None
    points = np.zeros((len(mesh.uvs), 3))
    points[mesh.face_uvs] = mesh.vertices[mesh.faces]
    uv = np.stack([mesh.uvs[:, 0], 1 - mesh.uvs[:, 1]], axis=1)
    parts = [
        points.astype("<f4").tobytes(),
        uv.astype("<f4").tobytes(),
        np.asarray(mesh.face_uvs).astype("<u4").tobytes(),
    ]
    if texture is not None:
        parts.append(texture + b"\0" * (-len(texture) % 4))
    starts = np.cumsum([0] + [len(part) for part in parts])
    data = b"".join(parts)
    scene: dict = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2}]}
        ],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(start), "byteLength": len(part)}
            for start, part in zip(starts[:-1], parts, strict=True)
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5126, "count": len(points), "type": "VEC2"},
            {
                "bufferView": 2,
                "componentType": 5125,
                "count": 3 * len(mesh.faces),
                "type": "SCALAR",
            },
        ],
    }
    if texture is not None:
        scene["images"] = [{"bufferView": 3, "mimeType": "image/png"}]
        scene["textures"] = [{"source": 0}]
        scene["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        scene["meshes"][0]["primitives"][0]["material"] = 0
    return scene, data


def glb_bytes(scene: dict, data: bytes) -> bytes:
    """A .glb of a scene and its data."""
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    body += struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def write_glb(path: Path, mesh: Mesh, texture: bytes | None = None) -> Path:
    """A .glb of a mesh in metres."""
    scaled = mesh.with_vertices(mesh.vertices / 1000)
    path.write_bytes(glb_bytes(*gltf_scene(scaled, texture)))
    return path


def write_textured_obj(path: Path, mesh: Mesh, texture: bytes | None = None) -> Path:
    """A .obj with .mtl and .png beside it."""
    assert mesh.uvs is not None
    lines = [] if texture is None else ["mtllib skin.mtl"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in mesh.uvs]
    if texture is not None:
        lines.append("usemtl skin")
        (path.parent / "skin.png").write_bytes(texture)
        (path.parent / "skin.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd -bm 1 skin.png\n")
    for face, face_uv in zip(mesh.faces, mesh.face_uvs, strict=True):
        corners = zip(face, face_uv, strict=True)
        lines.append("f " + " ".join(f"{i + 1}/{t + 1}" for i, t in corners))
    path.write_text("\n".join(lines) + "\n")
    return path


def own_head() -> tuple[Mesh, np.ndarray]:
    """Our own neutral head as a scan in mm, and its landmarks."""
    mesh = neutral_mesh()
    split = dataclasses.replace(mesh, faces=mesh.triangles(), face_uvs=mesh.triangle_uvs())
    return split, mesh.vertices[landmarks()]


def landmarks_file(path: Path, points: np.ndarray, field: str = "points_mm") -> Path:
    """JSON as import-scan takes it; NaN rows become null."""
    entries = [row.tolist() if np.isfinite(row).all() else None for row in points]
    path.write_text(json.dumps({"scheme": "ibug68", field: entries}))
    return path


@pytest.fixture(scope="session")
def egg() -> Mesh:
    return egg_mesh()


@pytest.fixture(scope="session")
def files() -> dict[str, Callable]:
    """The writers of this module by name."""
    chosen = (picture_bytes, gltf_scene, glb_bytes, write_glb, write_textured_obj, landmarks_file)
    return {function.__name__: function for function in chosen}


@pytest.fixture(scope="session")
def head() -> tuple[Mesh, np.ndarray]:
    return own_head()
