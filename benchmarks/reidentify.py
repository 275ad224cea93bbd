"""Who is who in a published set: what an attacker can go by, against chance, for 40 people.

    python -m benchmarks.reidentify [PEOPLE]

Two releases of the same people are attacked: one as `dataset publish` writes it, and a plain one
without what it does against this. PEOPLE is a folder of `lightstage-sim dataset --maps-only` with
40 people; without it they are made. It takes about ten minutes on two cores.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import zarr
from scipy.cluster.hierarchy import fcluster, linkage

from benchmarks.dataset_attack import Patches, join
from benchmarks.record import record
from lightstage.formats.files import write_json
from processing.dataset import PublishConfig, Store, build_store, open_store, publish, read_about
from processing.dataset.places import Layout, Place
from processing.dataset.publish import published_places, read_patch
from processing.dataset.release_files import CHANNELS, ZarrRelease, kind_of

PEOPLE, ROWS, SEED = 40, 768, 5
ABOUT = Path(__file__).parents[1] / "demo" / "about.toml"
PLAIN = PublishConfig(gap=0.0, wander=0.0, turned=False, drop=0.0)
WITH = PublishConfig()
BANDS = (0.0, 0.7, 1.4, 2.8, 5.6, 11.2)
"""Gaussian widths, texels: what is between two of them is a band of sizes of pores."""
RIDGE = 0.05
"""Of the variance within people, added to it."""


@dataclasses.dataclass(frozen=True)
class Release:
    """A published folder, and what the judge knows of its patches.

    Attributes:
        folder: as it was published.
        patches: in the order of the release.
        packed: whether its parts are to be taken for packed ones.
    """

    folder: Path
    patches: Patches
    packed: bool


@dataclasses.dataclass(frozen=True)
class Score:
    """Shares in which an attacker is right about two patches that he joins, and by chance."""

    right: float
    chance: float

    def __str__(self) -> str:
        return f"{self.right:.1%} ({self.chance:.1%})"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("people", nargs="*", help="folder of simulated people, made already")
    folders = parser.parse_args().people
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        people = Path(folders[0]) if folders else root / "people"
        if not folders:
            words = ["--subjects", PEOPLE, "--expressions", 1, "--seed", SEED, "--rows", ROWS]
            words = ["-m", "sim", "dataset", *words, "--maps-only", "--out", people]
            subprocess.run([sys.executable, *map(str, words)], check=True, capture_output=True)
        processed = sorted(path.parent for path in people.glob("*/report.json"))
        store = open_store(build_store(processed, root / "store"))
        releases = [
            plain_release(store, root / "plain"),
            published_release(store, root / "with"),
        ]
        show(store, releases, [dict(attacks(release)) for release in releases])


def show(store: Store, releases: Sequence[Release], columns: Sequence[dict[str, Score]]) -> None:
    """Record how often each attack is right on both releases."""
    before, after = (len(release.patches.person) for release in releases)
    record(
        "Dataset: who is who in a published set",
        ("the attacker puts together", "without", "as published"),
        [(name, *(str(column[name]) for column in columns)) for name in columns[0]],
        f"{len(store.scans)} simulated people, {store.scans[0].rows} atlas rows, patches of "
        f"{releases[1].patches.layout.size} texels: {before} without what `publish` does (no gap, "
        f"no turns, in order, nothing left out, packed), {after} as published. In brackets: by "
        "chance. Edges and looks are learnt from one half of the people and tried on the other, "
        "both ways round. Right is the true neighbour in the first row, the same person elsewhere.",
    )


def plain_release(store: Store, folder: Path) -> Release:
    """All patches in the order of the store, with nothing done against an attacker."""
    layout = PLAIN.layout(store)
    places = published_places(store, layout, PLAIN.most_face)
    folder.mkdir()
    writer = ZarrRelease(folder, len(places), layout.size, PLAIN.shard_patches)
    for first in range(0, len(places), PLAIN.shard_patches):
        some = places[first : first + PLAIN.shard_patches]
        patches = [read_patch(store, place, layout.size)[0] for place in some]
        writer.write(first, {name: np.stack([p[name] for p in patches]) for name in CHANNELS})
    write_json(folder / "dataset.json", {})
    writer.close()
    return opened(folder, places, layout, packed=True)


def published_release(store: Store, folder: Path) -> Release:
    """The release of `dataset publish`; the judge finds each patch's place by its bytes."""
    publish(store, folder, about=read_about(ABOUT))
    layout = WITH.layout(store)
    known = {
        read_patch(store, place, layout.size)[0]["shape"].astype(kind_of("shape")).tobytes(): place
        for place in published_places(store, layout, WITH.most_face)
    }
    shapes = np.asarray(zarr.open_array(folder / "shape", mode="r")[:])
    return opened(folder, [known[shape.tobytes()] for shape in shapes], layout, packed=False)


def opened(folder: Path, places: list[Place], layout: Layout, *, packed: bool) -> Release:
    """A release as anybody reads it, and where its patches were."""
    group = zarr.open_group(folder, mode="r")
    maps = {name: np.asarray(group[name][:], np.float32) for name in CHANNELS}
    person = np.array([place.scan for place in places])
    return Release(folder, Patches(maps, places, person, layout), packed)


def attacks(release: Release) -> list[tuple[str, Score]]:
    """Each attack and how often it is right."""
    patches = release.patches
    low = patches.person < (patches.person.max() + 1) // 2
    halves = (some_of(patches, low), some_of(patches, ~low))
    joined = join(halves)
    found = [
        ("neighbours, by edges", Score(joined.right / joined.tried, joined.chance)),
        ("one person's, by edges", Score(joined.person / joined.tried, nearest_chance(halves))),
    ]
    looks = {"tone": tones, "noise": noises, "pores": pores}
    seen = [{name: look(half) for name, look in looks.items()} for half in halves]
    for names in (("tone",), ("noise",), ("pores",), tuple(looks)):
        both = [np.concatenate([each[name] for name in names], axis=1) for each in seen]
        inputs = " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
        found.append((f"the most alike, by {inputs}", alike(halves, both, nearest)))
    found.append((f"groups, by {', '.join(looks)}", alike(halves, both, grouped)))
    found += [
        ("neighbours in the order", in_order(patches)),
        ("what shares a file", in_one_file(release)),
        ("files written one after the other", by_time(release)),
        ("parts of like size", by_size(release)),
        ("parts that the attacker packs to like size", by_packed_size(patches)),
    ]
    return found


def some_of(patches: Patches, chosen: np.ndarray) -> Patches:
    """The patches where (n,) bool is true."""
    maps = {name: image[chosen] for name, image in patches.maps.items()}
    places = [patches.places[i] for i in np.flatnonzero(chosen)]
    return Patches(maps, places, patches.person[chosen], patches.layout)


def pair_chance(person: np.ndarray) -> float:
    """Share of all pairs that are of one person."""
    counts = np.bincount(person).astype(float)
    return float((counts * (counts - 1)).sum() / (len(person) * (len(person) - 1)))


def nearest_chance(halves: Sequence[Patches]) -> float:
    """`pair_chance` over both halves, by their patches."""
    sizes = [len(half.person) for half in halves]
    return float(np.average([pair_chance(half.person) for half in halves], weights=sizes))


def tones(patches: Patches) -> np.ndarray:
    """(n, 8) mean colour and gloss, and how far they spread."""
    colour = np.log(np.maximum(patches.maps["diffuse_albedo"], 0.01))
    values = np.concatenate([colour, 30 * patches.maps["specular_albedo"]], axis=3)
    found = []
    for image, seen in zip(values, clear(patches), strict=True):
        found.append([*image[seen].mean(axis=0), *np.log(image[seen].std(axis=0) + 1e-4)])
    return np.array(found)


def noises(patches: Patches) -> np.ndarray:
    """(n, 4) logarithm of the finest differences: what a camera's noise would be."""
    return np.array([[*bands[0]] for bands in all_bands(patches)])


def pores(patches: Patches) -> np.ndarray:
    """(n, 16) logarithm of the strength of each band of sizes, in colour, gloss and relief."""
    return np.array([bands[1:].ravel() for bands in all_bands(patches)])


def all_bands(patches: Patches) -> list[np.ndarray]:
    """Of each patch (5, 4): by band, of luminance, redness, gloss and the surface's direction."""
    found = []
    colour = np.log(np.maximum(patches.maps["diffuse_albedo"], 0.01))
    for index, seen in enumerate(clear(patches)):
        red, green, blue = np.moveaxis(colour[index], 2, 0)
        gloss = 30 * patches.maps["specular_albedo"][index][:, :, 0]
        images = [red + green + blue, red - green, gloss]
        normal = patches.maps["specular_normal"][index]
        rows = [[_spread(image[..., None], seen, band) for image in images]
                + [_spread(normal, seen, band)] for band in range(len(BANDS) - 1)]  # fmt: skip
        found.append(np.log(np.array(rows) + 1e-6))
    return found


def clear(patches: Patches) -> np.ndarray:
    """(n, size, size) bool, where skin is shown."""
    return np.asarray(np.linalg.norm(patches.maps["specular_normal"], axis=3) > 0.5)


def _spread(image: np.ndarray, seen: np.ndarray, band: int) -> float:
    """Root mean square of an image (size, size, c) between two widths."""
    fine, coarse = (_blurred(image, seen, BANDS[band + step]) for step in (0, 1))
    inside = cv2.erode(seen.astype(np.uint8), np.ones((3, 3))) > 0
    inside = inside if inside.any() else seen
    return float(np.sqrt(((fine - coarse)[inside] ** 2).sum(axis=1).mean()))


def _blurred(image: np.ndarray, seen: np.ndarray, width: float) -> np.ndarray:
    if width == 0:
        return image
    weight = seen.astype(np.float32)
    over = [cv2.GaussianBlur(image[..., c] * weight, (0, 0), width) for c in range(image.shape[2])]
    return (
        np.stack(over, axis=2)
        / np.maximum(cv2.GaussianBlur(weight, (0, 0), width), 1e-3)[..., None]
    )


Judge = Callable[[np.ndarray, np.ndarray], float]


def alike(halves: Sequence[Patches], looks: Sequence[np.ndarray], judge: Judge) -> Score:
    """Learn from one half how looks vary within a person, and judge the other by it."""
    rights = []
    for known, attacked in ((0, 1), (1, 0)):
        person = halves[known].person
        mean, scale = looks[known].mean(axis=0), looks[known].std(axis=0) + 1e-9
        theirs, ours = (looks[known] - mean) / scale, (looks[attacked] - mean) / scale
        within = np.concatenate(
            [theirs[person == who] - theirs[person == who].mean(axis=0) for who in set(person)]
        )
        covariance = within.T @ within / len(within) + RIDGE * np.eye(within.shape[1])
        whitened = ours @ np.linalg.cholesky(np.linalg.inv(covariance))
        rights.append(judge(whitened, halves[attacked].person))
    sizes = [len(halves[1].person), len(halves[0].person)]
    return Score(float(np.average(rights, weights=sizes)), nearest_chance(halves))


def nearest(looks: np.ndarray, person: np.ndarray) -> float:
    """Share of patches whose most alike is of the same person."""
    apart = np.linalg.norm(looks[:, None] - looks[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return float((person[apart.argmin(axis=1)] == person).mean())


def grouped(looks: np.ndarray, person: np.ndarray) -> float:
    """Of pairs in one of as many groups as there are people, those of one person."""
    groups = fcluster(linkage(looks, "ward"), len(set(person)), "maxclust")
    same = groups[:, None] == groups[None]
    np.fill_diagonal(same, False)
    return float((person[:, None] == person[None])[same].mean())


def in_order(patches: Patches) -> Score:
    """Patches that follow each other."""
    person = patches.person
    return Score(float((person[1:] == person[:-1]).mean()), pair_chance(person))


def in_one_file(release: Release) -> Score:
    """Patches that share a file."""
    person = release.patches.person
    right, tried = 0.0, 0
    for numbers in files(release).values():
        own = person[numbers]
        tried += len(own) * (len(own) - 1)
        right += len(own) * (len(own) - 1) * pair_chance(own) if len(own) > 1 else 0
    return Score(right / tried, pair_chance(person))


def by_time(release: Release) -> Score:
    """Patches of files that were written one after the other; of any two where times are equal."""
    person, held = release.patches.person, files(release)
    times = {path: path.stat().st_mtime_ns for path in held}
    if len(set(times.values())) == 1:
        return Score(pair_chance(person), pair_chance(person))
    order = sorted(held, key=lambda path: times[path])
    same = [
        (person[held[one]][:, None] == person[held[other]][None]).mean()
        for one, other in itertools.pairwise(order)
    ]
    return Score(float(np.mean(same)), pair_chance(person))


def files(release: Release) -> dict[Path, np.ndarray]:
    """Of one array's files the patches that each holds."""
    array = zarr.open_array(release.folder / "shape", mode="r")
    count = array.shards[0]
    paths = (release.folder / "shape" / "c").glob("*/0/0/0")
    numbers = np.arange(array.shape[0])
    return {
        path: numbers[int(path.parts[-4]) * count :][:count]
        for path in sorted(paths, key=lambda path: int(path.parts[-4]))
    }


def by_size(release: Release) -> Score:
    """Patches whose parts of all arrays have the most like sizes, by the files' indices.

    The plain release represents one whose parts are packed.
    """
    if release.packed:
        return by_packed_size(release.patches)
    sizes = []
    for name in CHANNELS:
        array = zarr.open_array(release.folder / name, mode="r")
        own: list[int] = []
        for number in range(-(-array.shape[0] // array.shards[0])):
            data = (release.folder / name / "c" / f"{number}" / "0" / "0" / "0").read_bytes()
            # At the end an index: offset and bytes of each part, and a checksum.
            index = struct.unpack(f"<{2 * array.shards[0]}Q", data[-16 * array.shards[0] - 4 : -4])
            own += index[1::2]
        sizes.append(own[: array.shape[0]])
    return nearest_sizes(np.array(sizes, float).T, release.patches.person)


def by_packed_size(patches: Patches) -> Score:
    """The same, of sizes that the attacker finds out by packing what he reads."""
    packed = [
        [len(zlib.compress(image.astype(kind_of(name)).tobytes())) for image in patches.maps[name]]
        for name in CHANNELS
    ]
    return nearest_sizes(np.array(packed, float).T, patches.person)


def nearest_sizes(sizes: np.ndarray, person: np.ndarray) -> Score:
    """Patches whose (n, arrays) sizes are the most alike; anybody where all are equal."""
    if not sizes.std(axis=0).any():
        return Score(pair_chance(person), pair_chance(person))
    return Score(nearest(sizes / (sizes.std(axis=0) + 1e-9), person), pair_chance(person))


if __name__ == "__main__":
    main()
