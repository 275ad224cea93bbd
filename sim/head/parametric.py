"""The parametric head: a person and an expression to a mesh in the template's topology and UV."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh
from sim.errors import SimError
from sim.head.expressions import EXPRESSIONS, expressed
from sim.head.eyes import clear_of_eyes, eye_centres, seat_balls
from sim.head.fields import BROAD, LOCAL, identity_fields
from sim.head.mesh import grid_vertices, neutral_mesh
from sim.people.traits import Traits, random_traits


def random_head(
    rng: np.random.Generator, expression: str | None = None, traits: Traits | None = None
) -> Mesh:
    """A head drawn over all anatomical fields, so not quite within the modes' span; head frame.

    Its lids rest on its own eyeballs and close over them.

    Args:
        rng: of the draw; the same state gives the same person whatever the expression.
        expression: one of `EXPRESSIONS`, at full strength; None or ``neutral`` for none.
        traits: sex and age shift the means of the draw; None draws them too.

    Raises:
        SimError: an unknown expression.
    """
    if expression not in (None, "neutral", *EXPRESSIONS):
        raise SimError(
            "parametric head",
            field="expression",
            found=repr(expression),
            expected="neutral, " + ", ".join(EXPRESSIONS),
        )
    mesh = neutral_mesh()
    vertices = mesh.vertices + _random_offset(rng, traits or random_traits(rng))
    index = grid_vertices()
    neutral = mesh.vertices[index]
    centres = eye_centres(vertices[index], neutral)
    vertices[index] = seat_balls(clear_of_eyes(vertices[index], centres), centres)
    if expression not in (None, "neutral"):
        vertices = expressed(vertices, str(expression))
    return mesh.with_vertices(vertices)


def _random_offset(rng: np.random.Generator, traits: Traits) -> np.ndarray:
    names, fields = identity_fields()
    table = {**BROAD, **LOCAL}
    male = 1.0 if traits.sex == "male" else -1.0
    # What sags has not begun to in the young, who differ little in it from one another.
    years = np.clip((traits.age_years - 45.0) / 18.0, -1.0, 2.2)
    chance = np.clip(rng.normal(size=len(fields)), -2.0, 2.0)
    draws = [
        table[name].male * male + table[name].age * years + table[name].rest * part
        for name, part in zip(names, chance, strict=True)
    ]
    return np.tensordot(np.array(draws), fields, axes=1)
