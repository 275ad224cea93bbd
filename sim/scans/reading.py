"""Any scan's file, read by its suffix."""

from __future__ import annotations

from pathlib import Path

from sim.errors import SimError
from sim.scans.gltf import read_gltf
from sim.scans.obj import read_textured_obj
from sim.scans.scan_file import ScanFile


def read_scan(path: Path) -> ScanFile:
    """Read .glb, .gltf or .obj by its suffix; SimError or FormatError when it is none."""
    suffix = path.suffix.lower()
    if not path.is_file():
        raise SimError(path, found="no such file", expected="a scan: .glb, .gltf or .obj")
    if suffix in (".glb", ".gltf"):
        return read_gltf(path)
    if suffix == ".obj":
        return read_textured_obj(path)
    raise SimError(path, found=f"suffix {path.suffix!r}", expected=".glb, .gltf or .obj")
