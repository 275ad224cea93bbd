"""A parametric person: head, skin and place in the stage, all from one seed."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from sim.errors import SimError
from sim.head import random_head
from sim.head_maps import surface_normals
from sim.head_mesh import landmarks
from sim.skin import make_skin, random_complexion
from sim.subject import Subject

FACE_MIDDLE_MM = np.array([0.0, -40.0, 72.0])
"""The place of the head that is put near the stage's centre."""

SOURCE = "parametric person of lightstage-sim"


def parametric_subject(
    name: str, seed: int, expression: str = "neutral", texture_rows: int = 1536
) -> Subject:
    """A made-up person, sitting in the stage a few mm and degrees off.

    The same seed gives the same person to the byte, whatever the expression: head, skin and pose
    each have their own stream of random numbers.

    Args:
        name: pseudonym.
        seed: chooses the person.
        expression: ``neutral`` or one of `sim.head_modes.EXPRESSIONS`.
        texture_rows: rows of the maps, a multiple of 3 of at least 96; columns are two thirds.

    Raises:
        SimError: an unknown expression or a size that the tile cannot have.
    """
    if texture_rows < 96 or texture_rows % 3:
        raise SimError(
            f"subject {name}",
            field="texture_rows",
            found=str(texture_rows),
            expected="a multiple of 3, at least 96",
        )
    head_rng, skin_rng, pose_rng = (np.random.default_rng([seed, part]) for part in range(3))
    head = random_head(head_rng, expression)
    skin = make_skin(random_complexion(skin_rng), texture_rows, skin_rng)
    turn = Rotation.from_rotvec(np.radians(np.clip(pose_rng.normal(0, 2.0, 3), -4, 4))).as_matrix()
    place = np.clip(pose_rng.normal(0, 3.0, 3), -6, 6) + np.array([0.0, 0.0, 6.0])
    # world = turn (head - middle) + place
    shift = place - turn @ FACE_MIDDLE_MM
    mesh = head.with_vertices(head.vertices @ turn.T + shift)
    return Subject(
        name=name,
        expression=expression,
        mesh=mesh,
        diffuse_albedo=skin.diffuse_albedo,
        specular_albedo=skin.specular_albedo,
        roughness=skin.roughness,
        normal=surface_normals(mesh, skin.height_mm),
        translucency=skin.translucency,
        landmarks_mm=mesh.vertices[landmarks()],
        skin=skin.skin,
        head_from_world=np.concatenate([turn.T, -(turn.T @ shift)[:, None]], axis=1),
        source=SOURCE,
    )
