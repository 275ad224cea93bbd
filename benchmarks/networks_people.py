"""Heads that the networks are measured on: simulated, of ICT's model, scanned, captured.

Each comes to our template's texels: a mesh of its topology, the true maps there, and the places of
the head's own surface that the texels show. A head of another topology is registered as a captured
one is, from its mesh and landmarks, and a texel shows the place of the true surface closest to it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import open3d

from benchmarks.networks_lights import LitPoints, Points, starts, unit
from lightstage.formats.mesh import Mesh, read_mesh, vertex_normals
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path, load_template
from processing.dataset import read_head_pose
from processing.registration.config import RegisterConfig
from processing.registration.stage import head_pose, register_mesh
from sim.light.scene import Scene
from sim.light.texture import raster_uv, sample
from sim.people.dataset import Person, make_plan
from sim.people.person import parametric_subject
from sim.people.subject import Subject
from sim.people.table import load_table
from sim.scans.ict import ict_folder, load_ict
from sim.scans.ict_subject import ict_subject
from sim.scans.ict_tile import LEFT_EYE, RIGHT_EYE, SKIN_PARTS, parts_of
from sim.scans.lps import load_scan, scan_folder

SEED, ICT_SEED, ICT_APART_SEED = 900, 910, 911
KINDS = ("simulated", "ict", "scan")
FARTHEST_MM = 2.0
"""A texel farther from the true surface shows nothing of it: the inside of the mouth."""
LEAST_AGREEMENT = 0.5
"""Cosine between the registered mesh's normal and the true surface's, for the same reason."""
LEAST_OPEN = 0.1
"""What sees less of the sky, such as behind a closed lid, is neither photographed nor scored."""
OWN_ROUGHNESS = 0.25
"""Of a captured head without a map of it."""
SHARPER = 2
"""Another head's textures have so many times our rows: its tile holds more than our face."""


@dataclasses.dataclass(frozen=True)
class Who:
    """A head by name, to be made where it is needed.

    Attributes:
        kind: of `KINDS`, or ``captured``.
        name: of the head.
        person: seed and traits of a person of a model.
        folder: processed folder of a captured head.
        expression: of a person of a model.
    """

    kind: str
    name: str
    person: Person | None = None
    folder: Path | None = None
    expression: str = "neutral"

    @property
    def tone(self) -> int | None:
        """1 (lightest) to 6, where it is known."""
        return None if self.person is None else self.person.traits.tone


@dataclasses.dataclass(frozen=True)
class Head:
    """A head in our template's texels.

    Attributes:
        who: it is.
        mesh: of our template's topology, world, mm.
        head_from_world: (3, 4).
        maps: true ones by FORMATS' names, (rows, columns[, 3]), normals in the world.
        shown: (rows, columns) bool, texels that show the head's surface.
        skin: (rows, columns) bool, those that are scored.
        lit: the places that they show, in the order of `shown`.
    """

    who: Who
    mesh: Mesh
    head_from_world: np.ndarray
    maps: dict[str, np.ndarray]
    shown: np.ndarray
    skin: np.ndarray
    lit: LitPoints

    def image(self, values: np.ndarray) -> np.ndarray:
        """(n, k) values of the places as (rows, columns, k), zero elsewhere."""
        return on_texels(values, self.shown)


def chosen(kinds: list[str], count: int, unseen: bool) -> list[Who]:
    """Who is measured.

    Args:
        kinds: of `KINDS`, or folders of captured heads.
        count: of the simulated people, and of ICT's; tones in equal shares.
        unseen: the half of ICT's people that is kept apart, in place of the other one.
    """
    found: list[Who] = []
    for kind in kinds:
        if kind == "simulated":
            found += simulated(SEED, count)
        elif kind == "ict":
            if ict_folder() is None:
                print("left out: no ICT Face Model Light under LIGHTSTAGE_DATA")
                continue
            half = _persons(ICT_APART_SEED if unseen else ICT_SEED, count)
            name = "apart" if unseen else "ict"
            found += [Who(kind, p.name.replace("person", name), p) for p in half]
        elif kind == "scan":
            if scan_folder() is None:
                print("left out: no scanned head under LIGHTSTAGE_DATA")
                continue
            found.append(Who(kind, "lps"))
        else:
            found += _captured(Path(kind))
    return found


def simulated(seed: int, count: int) -> list[Who]:
    """Simulated people of a seed."""
    return [Who("simulated", person.name, person) for person in _persons(seed, count)]


def _persons(seed: int, count: int) -> list[Person]:
    return list(make_plan(Path(), load_table("balanced"), count, 1, seed, 96).persons)


def _captured(folder: Path) -> Iterator[Who]:
    """Processed folders: this one, or those in it."""
    roots = [folder] if (folder / "report.json").is_file() else []
    roots += sorted(path.parent for path in folder.glob("*/report.json"))
    if not roots:
        raise SystemExit(f"{folder}: no processed folder (report.json), and none of {KINDS}")
    for root in roots:
        yield Who("captured", root.name, folder=root)


def make(who: Who, rows: int, change: Callable[[Subject], Subject] | None = None) -> Head:
    """Make a head's maps at so many rows, a multiple of 3.

    Args:
        who: it is.
        rows: of the maps.
        change: of the maps of a subject that is no captured head, such as paint on the skin.
    """
    if who.folder is not None:
        return _of_folder(who, who.folder, rows)
    if who.kind in ("scan", "ict"):
        subject, kept = of_other_topology(who, SHARPER * rows)
        return _registered(who, subject if change is None else change(subject), kept, rows)
    assert who.person is not None
    seed, traits = who.person.seed, who.person.traits
    subject = parametric_subject(who.name, seed, who.expression, rows, traits)
    return _own(who, subject if change is None else change(subject))


def of_other_topology(who: Who, rows: int) -> tuple[Subject, np.ndarray]:
    """A scanned head or one of ICT's model, with textures of so many rows.

    Returns:
        The head, and which of its triangles a camera sees: without the sockets, gums and teeth
        behind the lips.
    """
    if who.kind == "scan":
        folder = scan_folder()
        assert folder is not None
        scan = load_scan(folder, rows)
        return scan, np.arange(len(scan.mesh.triangles()))
    path = ict_folder()
    assert path is not None
    assert who.person is not None
    person = who.person
    subject = ict_subject(who.name, path, person.seed, who.expression, rows, person.traits)
    parts = parts_of(load_ict(path)).triangle_parts()
    return subject, np.flatnonzero(np.isin(parts, (*SKIN_PARTS, LEFT_EYE, RIGHT_EYE)))


def outside_of(subject: Subject, kept: np.ndarray) -> Mesh:
    """A head's mesh of these triangles alone, as a scanner would see it."""
    used, corners = np.unique(subject.mesh.triangles()[kept], return_inverse=True)
    return Mesh(subject.mesh.vertices[used], corners.reshape(-1, 3).astype(np.int32))


def _own(who: Who, subject: Subject) -> Head:
    """A subject of our own topology: its texels are ours."""
    face, weights = raster_uv(subject.mesh, *subject.skin.shape)
    shown = face >= 0
    return _head(
        who, subject, subject.mesh, subject.head_from_world, shown, face[shown], weights[shown]
    )


def _registered(who: Who, subject: Subject, kept: np.ndarray, rows: int) -> Head:
    """A subject of another topology, our template fitted to it.

    Args:
        who: it is.
        subject: the head.
        kept: its triangles that a camera sees.
        rows: of our maps.
    """
    triangles = subject.mesh.triangles()
    template = load_template(default_template_path())
    scan = outside_of(subject, kept)
    vertices, _ = register_mesh(scan, subject.landmarks_mm, template, RegisterConfig())
    mesh = template.mesh.with_vertices(vertices)
    pose = head_pose(vertices, template).matrix()
    face, weights = raster_uv(mesh, rows, rows * 2 // 3)
    covered = face >= 0
    own = mesh.triangles()[face[covered]]
    place = np.einsum("nck,nc->nk", vertices[own], weights[covered])
    normal = unit(
        np.einsum("nck,nc->nk", vertex_normals(vertices, mesh.triangles())[own], weights[covered])
    )
    hit, share, distance_mm = _closest(subject.mesh.vertices, triangles[kept], place)
    hit = kept[hit]
    smooth = vertex_normals(subject.mesh.vertices, triangles)[triangles[hit]]
    there = unit(np.einsum("nck,nc->nk", smooth, share))
    near = (distance_mm < FARTHEST_MM) & ((there * normal).sum(axis=1) > LEAST_AGREEMENT)
    shown = covered.copy()
    shown[covered] = near
    return _head(who, subject, mesh, np.asarray(pose)[:3], shown, hit[near], share[near])


def _of_folder(who: Who, root: Path, rows: int) -> Head:
    """A captured head: its atlas is the truth, its registered mesh its surface."""
    folder = ProcessedFolder(root)
    names = ["diffuse_albedo", "specular_albedo", "specular_normal", "confidence", "roughness"]
    maps = {n: folder.read_atlas(n) for n in names if folder.atlas_path(n).is_file()}
    if len(maps["diffuse_albedo"]) > rows:
        size = (rows * 2 // 3, rows)
        maps = {n: cv2.resize(m, size, interpolation=cv2.INTER_AREA) for n, m in maps.items()}
    shape = maps["diffuse_albedo"].shape[:2]
    constant = np.full(shape, OWN_ROUGHNESS, np.float32)
    subject = Subject(
        name=who.name,
        expression="neutral",
        mesh=read_mesh(folder.registered_mesh),
        diffuse_albedo=maps["diffuse_albedo"],
        specular_albedo=maps["specular_albedo"],
        roughness=maps.get("roughness", constant),
        normal=maps["specular_normal"],
        translucency=constant,
        landmarks_mm=np.zeros((68, 3)),
        skin=maps["confidence"] > 0,
        head_from_world=read_head_pose(folder.head_pose),
        source=root.name,
    )
    return _own(who, subject)


def _closest(
    vertices: np.ndarray, triangles: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closest places on a surface: (n,) triangle, (n, 3) weights, (n,) distance in mm."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
        open3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
    )
    found = scene.compute_closest_points(open3d.core.Tensor(points.astype(np.float32)))
    b, c = found["primitive_uvs"].numpy().astype(float).T
    distance_mm = np.linalg.norm(found["points"].numpy() - points, axis=1)
    face = found["primitive_ids"].numpy().astype(np.int64)
    return face, np.stack([1 - b - c, b, c], axis=1), distance_mm


def _head(
    who: Who,
    subject: Subject,
    mesh: Mesh,
    head_from_world: np.ndarray,
    shown: np.ndarray,
    face: np.ndarray,
    weights: np.ndarray,
) -> Head:
    """A head from its subject and, for each texel that shows it, the triangle and place there."""
    scene = Scene(subject)
    corners = scene.triangles[face]
    assert subject.mesh.uvs is not None
    uv = np.einsum("nck,nc->nk", subject.mesh.uvs[subject.mesh.triangle_uvs()[face]], weights)
    smooth = unit(np.einsum("nck,nc->nk", scene.normals[corners], weights))
    fine = sample(subject.normal, uv)
    # Where the texture has no normal the mesh's own shades.
    fine = np.where(np.linalg.norm(fine, axis=1, keepdims=True) < 0.25, smooth, unit(fine))
    points = Points(
        np.einsum("nck,nc->nk", scene.vertices[corners], weights).astype(np.float32),
        starts(scene, face, weights).astype(np.float32),
        smooth.astype(np.float32),
        fine.astype(np.float32),
        sample(subject.diffuse_albedo, uv),
        sample(subject.specular_albedo, uv),
        sample(subject.roughness, uv),
        subject.distribution,
    )
    lit = LitPoints(scene, points)
    seen = lit.openness() > LEAST_OPEN
    lit, shown = lit.kept(seen), on_texels(seen, shown)
    points = lit.points
    scored = sample(subject.skin.astype(np.float32), uv[seen]) > 0.5
    maps = {
        "diffuse_albedo": points.albedo,
        "specular_albedo": points.specular,
        "diffuse_normal": points.normal,
        "specular_normal": points.normal,
    }
    return Head(
        who,
        mesh,
        head_from_world,
        {name: on_texels(values, shown) for name, values in maps.items()},
        shown,
        on_texels(scored, shown),
        lit,
    )


def on_texels(values: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """(n[, k]) values at the texels of a mask, zero elsewhere."""
    out = np.zeros((*shown.shape, *values.shape[1:]), values.dtype)
    out[shown] = values
    return out
