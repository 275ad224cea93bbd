"""Settings of the peers: tried on one light and one dark person, those best in some row kept."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.reflectance_case import Case
from benchmarks.reflectance_peers import Peer, Settings
from benchmarks.reflectance_people import person
from benchmarks.reflectance_scores import scores

PEOPLE = ("tone3", "tone6")
SCALE = 0.1
"""Small pictures: 602 x 402."""
ROWS = {
    "albedo_rmse": "albedo RMSE",
    "specular_2mm_share": "specular 2 mm",
    "specular_pixel_share": "specular px",
    "diffuse_normal_deg": "n_d deg",
    "fine_deg": "fine n_s deg",
    "specular_normal_deg": "n_s deg",
}
"""Errors of `scores` that settings are chosen by, each smaller for the better."""

NEAR = 1.05
"""Settings whose error is this near to the best one's count as the best."""

Kept = tuple[str, Peer, Settings]
"""Label, peer, settings."""


def label(peer: Peer, settings: Settings) -> str:
    """A peer with its settings as one line."""
    in_words = ", ".join(f"{key} {value}" for key, value in settings.items())
    return f"{peer.name} ({in_words})"


def tuned(peers: Sequence[Peer]) -> list[list[str]]:
    """Try every peer's grid.

    Args:
        peers: with their grids.

    Returns:
        The grids' rows: what was tried, errors of each person, and the rows for which it was kept,
        empty where it was not.
    """
    errors: dict[str, dict[str, dict[str, float]]] = {}
    tried: dict[str, Peer] = {}
    for name in PEOPLE:
        with tempfile.TemporaryDirectory() as folder:
            case = Case(person(name), "direct", Path(folder), scale=SCALE)
            for peer in peers:
                for settings in peer.grid:
                    how = label(peer, settings)
                    tried[how] = peer
                    found = scores(case.samples(peer.maps(case, settings)))
                    errors.setdefault(how, {})[name] = found
    won: dict[str, list[str]] = {how: [] for how in tried}
    for peer in peers:
        own = [how for how, whose in tried.items() if whose is peer]
        for how, cells in chosen({how: errors[how] for how in own}).items():
            won[how] = cells
    return [
        [
            how,
            *(
                f"{errors[how][PEOPLE[0]][key]:.3f} / {errors[how][PEOPLE[1]][key]:.3f}"
                for key in ROWS
            ),
            "; ".join(won[how]),
        ]
        for how in tried
    ]


def kept_of(peers: Sequence[Peer], rows: Sequence[Sequence[str]]) -> list[Kept]:
    """The settings that were kept by `tuned`'s rows."""
    tried = {label(peer, settings): (peer, settings) for peer in peers for settings in peer.grid}
    return [(row[0], *tried[row[0]]) for row in rows if row[-1]]


def chosen(errors: dict[str, dict[str, dict[str, float]]]) -> dict[str, list[str]]:
    """The fewest settings that hold the best of every row for every person, within NEAR of it.

    Args:
        errors: of one peer, by settings, person and row.

    Returns:
        By settings that are kept, the rows that they are kept for.
    """
    cells = [(key, name) for key in ROWS for name in PEOPLE]
    best = {(k, n): min(found[n][k] for found in errors.values()) for k, n in cells}
    holds = {
        how: {(k, n) for k, n in cells if found[n][k] <= NEAR * best[k, n]}
        for how, found in errors.items()
    }
    kept: dict[str, list[str]] = {}
    left = set(cells)
    while left:
        how = max(holds, key=lambda one: len(holds[one] & left))
        kept[how] = [f"{ROWS[k]} {n}" for k, n in cells if (k, n) in holds[how] & left]
        left -= holds[how]
    return kept


HEADER = ("peer and settings", *(f"{title}, {' / '.join(PEOPLE)}" for title in ROWS.values()),
          "kept for")  # fmt: skip
