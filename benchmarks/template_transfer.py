"""Maps carried from our texture to ICT's and back: error and run time by rows.

python -m benchmarks.template_transfer
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks.record import record
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import vertex_normals, write_obj
from lightstage.formats.template import Template, default_template_path, load_template
from processing.atlas.raster import rasterise
from processing.atlas.skin import skin_vertices
from processing.atlas.tangents import tangent_frames, to_tangent_space
from processing.registration.config import RegisterConfig
from processing.template.config import TransferConfig
from processing.template.import_ict import import_ict
from processing.template.transfer import Pair, read_of, registered_pair, transfer
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.scans.ict import ict_folder

ROWS = (384, 768, 1536)
BY_REGISTRATION = 768
"""Rows at which both ways are registered."""
SETTINGS = TransferConfig()


def main() -> None:
    clone = ict_folder()
    if clone is None:
        raise SystemExit("ICT Face Model Light is not at ../shared/data (or LIGHTSTAGE_DATA)")
    ours = load_template(default_template_path())
    theirs, _ = import_ict(clone)
    lines = []
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        there: Pair | None = None
        for rows in ROWS:
            person = load_subject("anna", 3, "neutral", rows)
            maps = write_maps(person, work / f"maps {rows}")
            mesh = maps / "registered_mesh.obj"
            if there is None:
                start = time.perf_counter()
                there = registered_pair(ours, theirs, mesh, RegisterConfig(), SETTINGS)
                print(f"registered in {time.perf_counter() - start:.0f} s")
            start = time.perf_counter()
            transfer(maps, there, work / f"there {rows}", None, SETTINGS)
            seconds = time.perf_counter() - start
            same = read_of(work / f"there {rows}" / "registered_mesh.obj", theirs)
            mine = ours.mesh.with_vertices(person.mesh.vertices)
            back = Pair(same, mine, same.vertices, mine.vertices, {})
            transfer(work / f"there {rows}", back, work / f"back {rows}", None, SETTINGS)
            found = scored(maps, work / f"back {rows}", ours)
            lines.append([rows, "its pair of meshes", *found, f"{seconds:.1f}"])
            if rows == BY_REGISTRATION:
                alone = registered_pair(
                    theirs, ours, work / f"there {rows}" / "registered_mesh.obj",
                    RegisterConfig(), SETTINGS,
                )  # fmt: skip
                transfer(work / f"there {rows}", alone, work / "alone", None, SETTINGS)
                found = scored(maps, work / "alone", ours)
                lines.append([rows, "a registration of its own", *found, f"{seconds:.1f}"])
    record(
        "Maps carried to another template's texture",
        [
            "rows",
            "back by",
            "face carried, %",
            "albedo, dB",
            "normals, deg",
            "tangent normals, deg",
            "place, median, mm",
            "place, 95 %, mm",
            "one way, five maps, s",
        ],
        lines,
        "A parametric person's maps from our texture to that of ICT Face Model Light and back; "
        "over the skin above the chin.",
    )


def write_maps(person: Subject, folder: Path) -> Path:
    """A person's maps and mesh, as an atlas has them."""
    mesh = person.mesh
    assert mesh.uvs is not None  # of a subject
    rows, columns = person.diffuse_albedo.shape[:2]
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), rows, columns)
    triangles, normals = mesh.triangles(), vertex_normals(mesh.vertices, mesh.triangles())
    frames = tangent_frames(mesh.vertices, triangles, mesh.uvs, mesh.triangle_uvs(), normals)
    texels = raster.texels()
    tangent, position = np.zeros((2, rows * columns, 3), np.float32)
    world = person.normal.reshape(-1, 3)[texels]
    tangent[texels] = to_tangent_space(world, raster, texels, triangles, normals, frames)
    position[texels] = raster.at(mesh.vertices, triangles)
    write_exr(folder / "diffuse_albedo.exr", person.diffuse_albedo)
    write_exr(folder / "roughness.exr", person.roughness)
    write_exr(folder / "specular_normal.exr", person.normal)
    write_exr(folder / "tangent_normal.exr", tangent.reshape(rows, columns, 3))
    write_exr(folder / "position.exr", position.reshape(rows, columns, 3), half=False)
    write_obj(mesh, folder / "registered_mesh.obj")
    return folder


def scored(before: Path, after: Path, template: Template) -> list[str]:
    """Cells of one line, over the skin above the chin that came back."""
    mask = cv2.imread(str(after / "mask.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None  # transfer writes it
    mesh = template.mesh
    assert mesh.uvs is not None  # of a template
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), *mask.shape)
    face = skin_vertices(template, 2.0)
    face &= mesh.vertices[:, 1] > mesh.vertices[template.landmarks[8], 1]
    wanted = (raster.face >= 0) & face[mesh.triangles()].all(axis=1)[raster.face]
    both = wanted & (np.asarray(mask) > 0)

    def values(folder: Path, name: str) -> np.ndarray:
        return np.asarray(read_exr(folder / f"{name}.exr")[both], float)

    def degrees(name: str) -> float:
        a, b = values(before, name), values(after, name)
        length = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        cos = np.einsum("nk,nk->n", a, b) / np.maximum(length, 1e-9)
        return float(np.rad2deg(np.arccos(np.clip(cos, -1, 1))).mean())

    error = values(before, "diffuse_albedo") - values(after, "diffuse_albedo")
    away = np.linalg.norm(values(before, "position") - values(after, "position"), axis=1)
    return [
        f"{100 * both.sum() / wanted.sum():.1f}",
        f"{-10 * np.log10((error**2).mean()):.1f}",
        f"{degrees('specular_normal'):.2f}",
        f"{degrees('tangent_normal'):.2f}",
        f"{np.median(away):.3f}",
        f"{np.quantile(away, 0.95):.2f}",
    ]


if __name__ == "__main__":
    main()
