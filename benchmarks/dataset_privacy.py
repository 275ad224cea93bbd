"""What an attacker finds out from published patches: their neighbours, and who was removed."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.dataset_attack import Patches, join
from benchmarks.record import record
from processing.dataset import PublishConfig, Store, build_store, open_store
from processing.dataset.places import Layout
from processing.dataset.publish import published_places, read_patch
from processing.dataset.release_files import CHANNELS

PEOPLE, ROWS = 10, 1536
LAYOUTS = (
    # gap and wander as shares of a patch, turned
    (0.0, 0.0, False),
    (0.0, 0.0, True),
    (0.25, 0.0, False),
    (0.5, 0.0, False),
    (0.25, 0.25, False),
    (0.25, 0.25, True),
    (0.0, 0.5, True),
    (0.25, 0.5, True),
    (0.5, 0.5, True),
)
DROPS = (0.0, 0.25, 0.5)
RELEASES = 40
"""Pairs of releases for each share that is left out."""
ALIKE = 8
"""Patches of like tone by which the attacker smooths what is missing."""


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        made = ["sim", "dataset", "--subjects", PEOPLE, "--expressions", 1, "--seed", 5, "--rows"]
        words = [*made, ROWS, "--maps-only", "--out", root / "people"]
        subprocess.run([sys.executable, "-m", *map(str, words)], check=True, capture_output=True)
        processed = sorted(path.parent for path in (root / "people").glob("*/report.json"))
        store = open_store(build_store(processed, root / "store"))
        rows = [neighbour_row(store, *layout) for layout in LAYOUTS]
        record(
            "Dataset: neighbours found by their edges",
            [
                "gap",
                "off the grid by",
                "turned",
                "patches",
                "right",
                "in the first 10",
                "chance",
                "same person",
            ],
            rows,
            f"Patches of {ROWS // 12} texels of {PEOPLE} simulated people, {ROWS} atlas rows; the "
            "attacker learns from one half of the people and is tried on the other, both ways "
            "round. Gap and distance off the grid are shares of a patch's side. Right: the patch "
            "that the attacker puts first beside an edge is the true neighbour; chance is one of "
            "all others. Same person: it is at least of the same person.",
        )
        config = PublishConfig()
        record(
            "Dataset: who was removed between two releases",
            ["left out", "missing patches that are the person's", "the attacker's choice", "share"],
            release_rows(gather(store, config.layout(store), set(range(PEOPLE)))),
            f"Two releases of {PEOPLE} simulated people, the second without one of them, "
            f"{RELEASES} draws each. First figure: of all patches that are missing in the second "
            "release, those of the person removed. Second: of as many patches as the person has, "
            f"those around which, by tone, most are missing ({ALIKE} alike). Last: the person's "
            "share of all patches, which is chance.",
        )


def gather(store: Store, layout: Layout, scans: set[int]) -> Patches:
    """Patches of some scans as they are published, none left out, with their places."""
    found = published_places(store, layout, PublishConfig().most_face)
    places = [place for place in found if place.scan in scans]
    patches = [read_patch(store, place, layout.size)[0] for place in places]
    maps = {name: np.stack([patch[name] for patch in patches]) for name in CHANNELS}
    return Patches(maps, places, np.array([place.scan for place in places]), layout)


def neighbour_row(store: Store, gap: float, wander: float, turned: bool) -> list[str]:
    """One row of the first table."""
    config = PublishConfig(gap=gap, wander=wander, turned=turned)
    layout = config.layout(store)
    first, second = set(range(PEOPLE // 2)), set(range(PEOPLE // 2, PEOPLE))
    patches = (gather(store, layout, first), gather(store, layout, second))
    found = join(patches)
    count = sum(len(half.places) for half in patches)
    tried = found.tried
    shares = [found.right / tried, found.early / tried, found.chance, found.person / tried]
    exact, ten, by_chance, same = (f"{100 * share:.1f} %" for share in shares)
    result = f"{found.right} of {tried}, {exact}"
    return [
        f"{gap:g}",
        f"{wander:g}",
        "yes" if turned else "no",
        str(count),
        result,
        ten,
        by_chance,
        same,
    ]


def release_rows(patches: Patches) -> list[list[str]]:
    """Rows of the second table: two releases, of which the second lacks one person."""
    rng = np.random.default_rng(1)
    person, count = patches.person, len(patches.person)
    alike = np.argsort(_tone_distances(patches), axis=1)[:, :ALIKE]
    rows = []
    for drop in DROPS:
        plain, chosen, chance = [], [], []
        for draw in range(RELEASES):
            removed = person == draw % PEOPLE
            first = rng.random(count) >= drop
            missing = first & ~((rng.random(count) >= drop) & ~removed)
            plain.append(removed[missing].mean())
            # Around each patch of the first release, how many of like tone are missing.
            there = first[alike]
            share = (missing[alike] & there).sum(axis=1) / np.maximum(there.sum(axis=1), 1)
            share[~missing] = -1
            best = np.argsort(-share, kind="stable")[: int((removed & first).sum())]
            chosen.append(removed[best].mean())
            chance.append(removed[first].mean())
        shares = [drop, *(float(np.mean(values)) for values in (plain, chosen, chance))]
        rows.append([f"{100 * share:.0f} %" for share in shares])
    return rows


def _tone_distances(patches: Patches) -> np.ndarray:
    """(n, n) distances of the patches' mean colour and gloss, each by its own spread."""
    albedo, gloss = patches.maps["diffuse_albedo"], patches.maps["specular_albedo"]
    seen = np.linalg.norm(patches.maps["specular_normal"], axis=3) > 0.5
    tones = []
    for index in range(len(albedo)):
        measured = seen[index]
        colour = np.log(np.maximum(albedo[index][measured], 0.01))
        tones.append([*colour.mean(axis=0), gloss[index][measured].mean()])
    tone = np.array(tones)
    tone = (tone - tone.mean(axis=0)) / tone.std(axis=0)
    return np.asarray(np.linalg.norm(tone[:, None] - tone[None], axis=2))


if __name__ == "__main__":
    main()
