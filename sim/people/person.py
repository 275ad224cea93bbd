"""A parametric person: head, skin and place in the stage, all from one seed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from sim.errors import SimError
from sim.head.maps import surface_normals
from sim.head.mesh import landmarks
from sim.head.parametric import random_head
from sim.people.subject import Subject
from sim.people.traits import Traits, random_traits
from sim.skin.paint import Skin, face_of, make_skin, random_complexion

FACE_MIDDLE_MM = np.array([0.0, -40.0, 72.0])
"""The place of the head that is put near the stage's centre."""

SOURCE = "parametric person of lightstage-sim"


def parametric_subject(
    name: str,
    seed: int,
    expression: str = "neutral",
    texture_rows: int = 1536,
    traits: Traits | None = None,
) -> Subject:
    """A made-up person, sitting in the stage a few mm and degrees off.

    The same seed and traits give the same person to the byte, whatever the expression: head, skin,
    pose and who it is each have their own stream of random numbers.

    Args:
        name: pseudonym.
        seed: chooses the person.
        expression: ``neutral`` or one of `sim.head.modes.EXPRESSIONS`.
        texture_rows: rows of the maps, a multiple of 3 of at least 96; columns are two thirds.
        traits: who the person is; None draws it from the seed.

    Raises:
        SimError: an unknown expression or a size that the tile cannot have.
    """
    return next(person_expressions(name, seed, [expression], texture_rows, traits))


def person_expressions(
    name: str,
    seed: int,
    expressions: Sequence[str],
    texture_rows: int = 1536,
    traits: Traits | None = None,
) -> Iterator[Subject]:
    """One person in several expressions: the skin is painted once, each expression is cheap.

    The subjects share all maps but the normals; arguments and errors as `parametric_subject`.

    Returns:
        The subjects in the order asked for, each equal to what `parametric_subject` gives.
    """
    require_rows(texture_rows, f"subject {name}, texture_rows")
    who = random_traits(_stream(seed, 3)) if traits is None else traits
    heads = [random_head(_stream(seed, 0), expression, who) for expression in expressions]
    turn, shift = sitting(_stream(seed, 2))
    skin = person_skin(seed, who, texture_rows)
    for head, expression in zip(heads, expressions, strict=True):
        mesh = head.with_vertices(head.vertices @ turn.T + shift)
        yield Subject(
            name=name,
            expression=expression,
            mesh=mesh,
            diffuse_albedo=skin.diffuse_albedo,
            specular_albedo=skin.specular_albedo,
            roughness=skin.roughness,
            normal=surface_normals(mesh, skin.height_mm(expression)),
            translucency=skin.translucency,
            landmarks_mm=mesh.vertices[landmarks()],
            skin=skin.skin,
            head_from_world=np.concatenate([turn.T, -(turn.T @ shift)[:, None]], axis=1),
            source=SOURCE,
            distribution=skin.distribution,
            anisotropy=skin.anisotropy,
            synthetic=True,
        )


def sitting(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """How someone sits in the stage, a few mm and degrees off.

    Returns:
        (3, 3) turn and (3,) mm shift: world = turn @ head + shift.
    """
    turn = Rotation.from_rotvec(np.radians(np.clip(rng.normal(0, 2.0, 3), -4, 4))).as_matrix()
    place = np.clip(rng.normal(0, 3.0, 3), -6, 6) + np.array([0.0, 0.0, 6.0])
    return turn, place - turn @ FACE_MIDDLE_MM


def person_skin(seed: int, traits: Traits, texture_rows: int) -> Skin:
    """The skin of a person on our own tile: what all expressions share."""
    rng = _stream(seed, 1)
    complexion = random_complexion(rng, traits)
    face = face_of(texture_rows, texture_rows * 2 // 3, int(rng.integers(2**20)))
    return make_skin(complexion, face, rng)


def _stream(seed: int, part: int) -> np.random.Generator:
    """Head, skin, pose and traits draw from streams 0 to 3 of the seed."""
    return np.random.default_rng([seed, part])


def require_rows(rows: int, where: str) -> None:
    """SimError unless a texture can have so many rows: their columns are two thirds of them."""
    if rows < 96 or rows % 3:
        raise SimError(where, found=str(rows), expected="a multiple of 3, at least 96")
