"""Measures of the heads that `fit` expects beside those of people, as surveys have them.

`python -m benchmarks.anthropometry` measures the population of our template and the whole prior of
`fit` (mean and draws), and as a check that the measuring is right ICT's mean head and the scanned
head, fitted in our topology, where their data are.
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.networks_people import chosen, make
from benchmarks.photo import in_head
from benchmarks.record import record
from learning.photo.config import FitConfig
from learning.photo.model import shape_model
from lightstage.formats.template import default_template_path, load_template
from processing.template.config import PopulationConfig
from processing.template.import_ict import import_ict
from processing.template.measures import HeadMeasures
from processing.template.population import population_of
from processing.template.surveys import CORRELATED, NAMES, SURVEYED, covariance, deviations, means
from sim.scans.ict import ict_folder

SEED = 5


def drawn(
    measures: HeadMeasures, mean_mm: np.ndarray, modes_mm: np.ndarray, count: int
) -> np.ndarray:
    """(count, q) measures of heads drawn from modes of one standard deviation."""
    rng = np.random.default_rng(SEED)
    return np.array(
        [
            measures.of(mean_mm + np.tensordot(rng.standard_normal(len(modes_mm)), modes_mm, 1))
            for _ in range(count)
        ]
    )


def correlation_off(found: np.ndarray) -> float:
    """Root mean square difference of the surveyed correlations, of (m, q) measures."""
    here = [NAMES.index(name) for name in CORRELATED]
    true = covariance(np.eye(len(NAMES)))[np.ix_(here, here)]
    size = np.sqrt(np.diag(true))
    off = np.corrcoef(found[:, here].T) - true / np.outer(size, size)
    return float(np.sqrt((off[~np.eye(len(here), dtype=bool)] ** 2).mean()))


def main() -> None:
    """Measure, print, record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=300, help="heads of each kind")
    arguments = parser.parse_args()
    template = load_template(default_template_path())
    people = template.population
    assert people is not None
    config = FitConfig()
    prior = shape_model(template, config)
    kinds = {
        "population": (people.mean_mm, people.identity_mm.astype(float)),
        "all that fit may draw": (prior.mean, prior.identity),
    }
    columns: dict[str, list[str]] = {}
    off = {}
    for name, (mean, modes) in kinds.items():
        measures = HeadMeasures(template, mean)
        found = drawn(measures, mean, modes, arguments.draws)
        columns[name] = [
            f"{value:.1f} ({spread:.1f})"
            for value, spread in zip(measures.of(mean), found.std(axis=0), strict=True)
        ]
        off[name] = correlation_off(found)
    others = {}
    folder = ict_folder()
    if folder is not None:
        carried, _ = population_of(template, import_ict(folder)[0], PopulationConfig())
        others["ICT's mean"] = carried.mean_mm
    for who in chosen(["scan"], 1, False):
        head = make(who, 192)
        others["the scanned head"] = in_head(head, head.mesh.vertices)
    for name, head_mm in others.items():
        columns[name] = [f"{value:.1f}" for value in HeadMeasures(template, head_mm).of(head_mm)]
    body = []
    for index, each in enumerate(SURVEYED):
        body.append(
            [
                each.name + ("" if each.met else " *"),
                each.source,
                *(f"{mean:.1f} ({spread:.1f})" for mean, spread in (each.men, each.women)),
                f"{means()[index]:.1f} ({deviations()[index]:.1f})",
                *(column[index] for column in columns.values()),
            ]
        )
    record(
        "Measures of heads",
        ["mm, mean (deviation)", "source", "men", "women", "both", *columns],
        body,
        f"`python -m benchmarks.anthropometry`: {arguments.draws} draws. Surveyed correlations of "
        f"{len(CORRELATED)} measures are "
        + ", ".join(f"{value:.2f} ({name})" for name, value in off.items())
        + " off (RMS). \\*: measured on people in another way.",
    )


if __name__ == "__main__":
    main()
