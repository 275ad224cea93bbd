"""A population moved to the measures that surveys have of people, changed as little as can be.

Heads are normally distributed, mean + modes . z. As their measures are known, the mean moves along
the modes' regression on the measures, and the covariance changes in the measured directions alone:
whatever the measures do not show is distributed as before, given them (Jeffrey's rule; of all
normal distributions with these measures it is nearest to the old one by relative entropy).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from lightstage.formats.population import Population
from lightstage.formats.template import Template
from processing.registration.both_ways import vertex_areas
from processing.template.config import PopulationConfig
from processing.template.makehuman_modes import principal
from processing.template.measures import HeadMeasures
from processing.template.surveys import NAMES, SURVEYED, covariance, deviations, means

ROUNDS = 8
"""Of the mean, since a measure's places move from vertex to vertex; and of the covariance, which a
round moves as far as measuring is certain."""


def moved(
    template: Template, people: Population, config: PopulationConfig
) -> tuple[Population, dict[str, Any]]:
    """The population whose measures are those of the surveys.

    Args:
        template: whose topology it has.
        people: with more modes than measures.
        config: settings; `modes` are kept.

    Returns:
        The population, and facts: how far the measures were and are from the surveyed means, root
        mean square in surveyed deviations, and what the kept modes have of the deviations.
    """
    measures = HeadMeasures(template, people.mean_mm)
    met = np.array([each.met for each in SURVEYED])
    aim, spread = means()[met], deviations()[met]
    uncertain = np.diag((config.measure_share * spread) ** 2)
    # Sliders that are drawn independently leave the size of whole heads nearly the same.
    around = NAMES.index("head circumference")
    size = deviations()[around] / means()[around]
    centred = people.mean_mm - people.mean_mm[template.landmarks].mean(axis=0)
    rows = np.concatenate([people.identity_mm, size * centred[None]])
    slope = measures.gradient(people.mean_mm, rows)[met]
    # So large that the measures' variance is the surveyed one on average.
    scale = float(((slope**2).sum(axis=1) / spread**2).mean()) ** -0.5
    rows, slope = scale * rows, scale * slope

    def off(mean_mm: np.ndarray) -> np.ndarray:
        found: np.ndarray = measures.of(mean_mm)[met] - aim
        return found

    mean = people.mean_mm
    strength = np.zeros(len(rows))
    for _ in range(ROUNDS):
        wanted = slope @ strength - off(mean)
        strength = slope.T @ np.linalg.solve(slope @ slope.T + uncertain, wanted)
        mean = people.mean_mm + np.tensordot(strength, rows, 1)
    slope = measures.gradient(mean, rows)[met]
    surveyed = _surveyed(slope @ slope.T, met)
    among = np.eye(len(rows))
    for _ in range(ROUNDS):
        found = slope @ among @ slope.T
        learned = np.linalg.solve(found + uncertain, slope @ among).T
        among = among - learned @ slope @ among + learned @ surveyed @ learned.T
    spectrum, mix = np.linalg.eigh(among)
    rows = np.tensordot((mix * np.sqrt(np.maximum(spectrum, 0))).T, rows, 1)
    area = vertex_areas(mean, template.mesh.triangles())
    modes = principal(rows, area)[: config.modes]
    kept = np.sqrt((measures.gradient(mean, modes)[met] ** 2).sum(axis=1)) / spread
    facts = {
        "before_deviations": float(np.sqrt(((off(people.mean_mm) / spread) ** 2).mean())),
        "off_deviations": float(np.sqrt(((off(mean) / spread) ** 2).mean())),
        "kept_share": float(np.median(kept)),
    }
    return dataclasses.replace(people, mean_mm=mean, identity_mm=modes), facts


def _surveyed(found: np.ndarray, met: np.ndarray) -> np.ndarray:
    """(m, m) surveyed covariance; correlations that nobody has surveyed are the population's.

    Args:
        found: (m, m) the population's, of the measures that are met.
        met: (q,) bool.
    """
    size = np.sqrt(np.diag(found))
    whole = np.eye(len(met))
    whole[np.ix_(met, met)] = found / np.outer(size, size)
    return covariance(whole)[np.ix_(met, met)]
