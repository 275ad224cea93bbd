"""The parametric head: identity and expression to a mesh in the template's topology and UV."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh
from sim.errors import SimError
from sim.head_mesh import neutral_mesh
from sim.head_modes import EXPRESSIONS, expression_modes, identity_fields, identity_modes


def parametric_head(identity: np.ndarray, expression: str | None = None) -> Mesh:
    """A head of the linear model.

    Args:
        identity: (k,) coefficients of the first k identity modes, in standard deviations.
        expression: one of `EXPRESSIONS`, at full strength; None or ``neutral`` for none.

    Returns:
        Mesh in the head frame, mm.

    Raises:
        SimError: more coefficients than modes, not finite, or an unknown expression.
    """
    coefficients = np.atleast_1d(np.asarray(identity, float))
    modes = identity_modes()
    if coefficients.ndim != 1 or len(coefficients) > len(modes):
        raise SimError(
            "parametric head",
            field="identity",
            found=f"shape {coefficients.shape}",
            expected=f"at most {len(modes)} coefficients",
        )
    if not np.isfinite(coefficients).all():
        raise SimError("parametric head", field="identity", found="NaN", expected="finite numbers")
    mesh = neutral_mesh()
    offset = np.tensordot(coefficients, modes[: len(coefficients)], axes=1)
    return mesh.with_vertices(mesh.vertices + offset + expression_offset(expression))


def expression_offset(expression: str | None) -> np.ndarray:
    """(n, 3) mm displacement of an expression at full strength; SimError when unknown."""
    if expression in (None, "neutral"):
        return np.zeros_like(neutral_mesh().vertices)
    if expression not in EXPRESSIONS:
        raise SimError(
            "parametric head",
            field="expression",
            found=repr(expression),
            expected="neutral, " + ", ".join(EXPRESSIONS),
        )
    return expression_modes()[EXPRESSIONS.index(expression)]


def random_head(rng: np.random.Generator, expression: str | None = None) -> Mesh:
    """A head drawn over all anatomical fields, so not quite within the modes' span; head frame."""
    _, fields = identity_fields()
    draws = np.clip(rng.normal(size=len(fields)), -2.0, 2.0)
    mesh = neutral_mesh()
    offset = np.tensordot(draws, fields, axes=1)
    return mesh.with_vertices(mesh.vertices + offset + expression_offset(expression))
