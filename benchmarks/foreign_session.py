"""A scene of `benchmarks.foreign_cases` as a session on disk, with what it is scored against."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from benchmarks.foreign_cases import Case
from benchmarks.reflectance_people import NEW_LIGHTS, new_rig
from lightstage.commands import quiet
from lightstage.formats.files import atomic_folder
from lightstage.formats.landmarks import write_points_mm
from lightstage.formats.mesh import Mesh, write_ply
from lightstage.formats.processed import ProcessedFolder
from sim.foreign.world import ForeignWorld
from sim.light.lamps import lamps_of
from sim.people.subject import Subject
from sim.session import SessionConfig, truth_path, write_direct

LIT_CAMERAS = ("cam0", "cam1", "cam2")
"""Views that are also photographed under lights that no pattern uses."""
SKIN = "skin.ply"
"""The person's own mesh, without what is worn."""


def session_of(case: Case, name: str, rows: int, keep: Path) -> Path:
    """A scene's session, made where it is missing; truth is beside it, and `SKIN`."""
    root = keep / f"{name}-{case.seed}-{rows}"
    if not root.is_dir():
        with atomic_folder(root, "session") as beside:
            _make(case, rows, beside)
    return root / "session"


def _make(case: Case, rows: int, root: Path) -> None:
    rig, person = case.stage(rows), case.person()
    wearing = case.dressed(person)
    world = case.world(wearing, rig)
    write_direct(world, root / "session", SessionConfig(sequence="binary"), case.seed, quiet)
    write_ply(Mesh(person.mesh.vertices, person.mesh.triangles()), root / SKIN)
    truth = truth_path(root / "session")
    _write_truth(world, person, ProcessedFolder(truth))
    others = new_rig(rig)
    lamps = dataclasses.replace(lamps_of(others), weights=np.ones((NEW_LIGHTS, 3)), radius_mm=0.0)
    lone = case.world(wearing, others, lamps)
    (truth / "new_lights").mkdir()
    for camera_id in LIT_CAMERAS:
        surface = world.surfaces[camera_id]
        skin = surface.picture(surface.skin)
        pictures = lone.photograph(camera_id, np.eye(NEW_LIGHTS))[:, skin]
        np.save(truth / "new_lights" / f"{camera_id}.npy", pictures.astype(np.float16))


def _write_truth(world: ForeignWorld, person: Subject, folder: ProcessedFolder) -> None:
    """Views and landmarks alone: atlas, occlusion and relit pictures are not scored here."""
    for camera_id, surface in world.surfaces.items():
        maps = {
            "diffuse_albedo": surface.albedo,
            "specular_albedo": surface.specular,
            "diffuse_normal": surface.normal,
            "specular_normal": surface.normal,
            "position": surface.position,
        }
        for name, values in maps.items():
            folder.write_view(camera_id, name, surface.picture(values))
        folder.write_mask(camera_id, surface.picture(surface.skin))
    write_points_mm(person.landmarks_mm, folder.true_landmarks)
