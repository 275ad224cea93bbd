"""Another head model's people as a template's population: its mean head and modes, carried over."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh
from lightstage.formats.population import Population
from lightstage.formats.template import Template
from processing.errors import ProcessingError
from processing.laplacian import cotangent_laplacian
from processing.registration.config import RegisterConfig
from processing.registration.stage import head_pose, register_mesh
from processing.registration.start import named
from processing.template.config import PopulationConfig, TransferConfig
from processing.template.correspond import carried_vertices
from processing.template.surveyed import moved

LOOSE = [*range(7), *range(10, 27)]
"""Landmarks in iBUG's order that do not hold the two heads together: makers of models put those of
the jaw's line and of the brows centimetres apart."""


def population_of(
    template: Template,
    other: Template,
    config: PopulationConfig,
    progress: ProgressCallback = quiet,
    surveyed: bool = False,
) -> tuple[Population, dict[str, Any]]:
    """Fit a template to another one's mean head, and carry that one's identity modes to it.

    Args:
        template: that is given a population.
        other: whose mesh is the mean head of its people, with modes.
        config: settings.
        progress: called with (done, total).
        surveyed: whether the people are moved to the measures of surveys, for models that state no
            population.

    Returns:
        The population, and facts.

    Raises:
        ProcessingError: another template without modes.
        RegistrationError: templates that do not fit each other.
    """
    if other.modes is None or not len(other.modes.identity):
        raise ProcessingError(
            other.name,
            field="modes.npz",
            found="no identity modes",
            expected="a head model of people, with modes",
            hint="`template import-ict` and `import-makehuman` make one.",
        )
    landmarks = other.mesh.vertices[other.landmarks].astype(float)
    landmarks[LOOSE] = np.nan
    scan = Mesh(other.mesh.vertices, other.mesh.triangles())
    with named(f"template {other.name}"):
        fitted, _ = register_mesh(scan, landmarks, template, RegisterConfig())
    placed = template.mesh.with_vertices(fitted)
    chosen = other.modes.identity[: None if surveyed else config.modes]
    transfer = TransferConfig()
    rest, known = carried_vertices(other.mesh, other.mesh.vertices, placed, transfer)
    offsets = np.zeros((len(chosen), *fitted.shape))
    # Beside lips and nostrils, neighbours have places that are far apart on the other mesh.
    stiffness, areas = cotangent_laplacian(fitted, placed.triangles())
    # A vertex of no triangle has no area, and stays where it is.
    areas = np.maximum(areas, 1e-9 * areas.max())
    smoothed = splu((sp.diags(areas) + config.smooth_mm**2 * stiffness).tocsc())
    for index, mode in enumerate(chosen):
        there, _ = carried_vertices(other.mesh, other.mesh.vertices + mode, placed, transfer)
        offsets[index] = smoothed.solve(areas[:, None] * (there - rest))
        progress(index + 1, len(chosen))
    pose = head_pose(fitted, template)
    population = Population(
        pose.apply(fitted), offsets @ pose.rotation.T, other.licence, other.source
    )
    facts: dict[str, Any] = {"carried_share": float(known.mean())}
    if surveyed:
        population, facts["surveyed"] = moved(template, population, config)
    away = np.linalg.norm(population.mean_mm - template.mesh.vertices, axis=1)
    facts |= {
        "modes": len(population.identity_mm),
        "from_mesh_mm": float(np.median(away)),
        "deviation_mm": float(np.sqrt((population.identity_mm**2).sum(axis=(0, 2)).mean())),
    }
    return population, facts
