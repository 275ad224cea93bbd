"""How far is the fast light from the path-traced one, and what does the latter cost?

`python -m benchmarks.sim_reference` measures small pictures and extrapolates; with `--session` it
also takes nine cameras of 1.5 MP, four independent states, and prints what that took.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

import numpy as np

from benchmarks.record import record
from lightstage.patterns import pattern_levels
from lightstage.rig import Rig, default_rig
from sim.light.lamps import LampConfig, Lamps, lamps_of
from sim.light.world import World
from sim.people.person import parametric_subject
from sim.people.subject import Subject
from sim.people.traits import Traits
from sim.reference.config import ReferenceConfig
from sim.reference.world import ReferenceWorld
from sim.scans.lps import load_scan, scan_folder

SMALL = 0.1
"""Share of the rig's pixels a side, 402 x 602."""
WHOLE = (1.5e6 / (6016 * 4016)) ** 0.5
"""The same for 1.5 MP."""
COARSE_MM = 0.7
STATES = ("full", "x+", "y+", "z+")
REGIONS = {"jaw": (0, 17), "brows": (17, 27), "nose": (27, 36), "eyes": (36, 48), "lips": (48, 68)}
NEAR_MM = 12.0
DIRECT = ReferenceConfig(bounces=0, subsurface=False, samples=1)
HEADER = ("what", "case", "seconds", "error", "remark")
Row = tuple[object, ...]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--session", action="store_true")
    whole = parser.parse_args().session
    people = make_people()
    rig = default_rig().scaled(SMALL)
    rows: list[Row] = []
    for name, person in people.items():
        rows += fast_against_reference(name, person, rig)
    rows += noise_and_cost(people["light"], rig)
    if whole:
        rows += session(people["light"])
    record(
        "Reference light",
        HEADER,
        rows,
        "Fast and reference in direct light of point lamps, pixel centres, cam0 and cam3: median "
        "of |fast - reference| / reference over skin, `full` and x+ together. What bounces and "
        "subsurface add is the median of |change| as a share of the region's median radiance "
        "(red, green, blue), `full` / x+. Standard error: of one run, from repeats with other "
        "seeds, median over the face as a share of the face's median radiance.",
    )


def make_people() -> dict[str, Subject]:
    """A light and a dark parametric person and, where it is there, the scanned head."""
    people = {
        "light": parametric_subject("light", 1, traits=Traits("female", 25.0, 1, "plain")),
        "dark": parametric_subject("dark", 2, traits=Traits("male", 40.0, 6, "plain")),
    }
    folder = scan_folder()
    return people if folder is None else {**people, "lps": load_scan(folder)}


def regions_of(person: Subject, position: np.ndarray) -> np.ndarray:
    """(n,) name of each point's region: that of the nearest landmark, `rest` where none is near."""
    apart = np.linalg.norm(position[:, None] - person.landmarks_mm[None], axis=2)
    nearest, distance = apart.argmin(axis=1), apart.min(axis=1)
    out = np.full(len(position), "rest", object)
    for name, (first, last) in REGIONS.items():
        out[(nearest >= first) & (nearest < last) & (distance < NEAR_MM)] = name
    return out


def fast_against_reference(name: str, person: Subject, rig: Rig) -> list[Row]:
    """One person's rows: difference by region and angle, and what the rest of the light adds."""
    rig = dataclasses.replace(rig, cameras=(rig.cameras[0], rig.cameras[3]))
    lamps = lamps_of(rig, LampConfig(radius_mm=0.0))
    weights = state_weights(rig, lamps)
    begun = time.perf_counter()
    fast = World(person, rig, lamps=lamps)
    seen, light = skin_light(fast, weights)
    fast_s = time.perf_counter() - begun
    begun = time.perf_counter()
    world = ReferenceWorld(person, rig, lamps, DIRECT)
    known = np.concatenate([world.pixels(c, weights, k)[:2] for c, k in seen.items()], axis=1)
    slow_s = time.perf_counter() - begun
    surfaces = [(world.surfaces[c], k) for c, k in seen.items()]
    position = np.concatenate([s.position[k] for s, k in surfaces])
    facing = np.concatenate([np.einsum("nk,nk->n", s.normal[k], s.view[k]) for s, k in surfaces])
    regions = regions_of(person, position)
    floor = 1e-3 * np.median(known[0])
    off = np.abs(light[:2] - known) / np.maximum(known, floor)
    lit = known.min(axis=2) > floor
    bias = (light[:2] - known) / np.maximum(known, floor)

    def row(case: str, chosen: np.ndarray, seconds: str = "") -> Row:
        there = lit & chosen
        if there.sum() < 20:
            return (f"{name}: fast - reference", case, seconds, "", "too few pixels")
        ninth = np.quantile(off[there], 0.9)
        return (
            f"{name}: fast - reference",
            case,
            seconds,
            f"{np.median(off[there]):.2%}",
            f"signed {np.median(bias[there]):+.2%}, ninth decile {ninth:.1%}",
        )

    ratio = f"{slow_s:.1f}, fast {fast_s:.1f}, ratio {slow_s / fast_s:.1f}"
    rows: list[Row] = [row("all skin", np.ones(len(regions), bool), ratio)]
    rows += [row(region, regions == region) for region in (*REGIONS, "rest")]
    angle = np.degrees(np.arccos(np.clip(facing, 0, 1)))
    for low, high in ((0, 30), (30, 50), (50, 65), (65, 80), (80, 90)):
        rows.append(row(f"seen at {low} to {high} deg", (angle >= low) & (angle < high)))
    rows += what_is_added(name, person, rig, lamps, weights, seen, known, regions)
    return rows


def what_is_added(
    name: str,
    person: Subject,
    rig: Rig,
    lamps: Lamps,
    weights: np.ndarray,
    seen: dict[str, np.ndarray],
    direct: np.ndarray,
    regions: np.ndarray,
) -> list[Row]:
    """Rows on bounces and subsurface, by region."""
    before = direct
    rows: list[Row] = []
    for what, subsurface in (("bounces", False), ("subsurface", True)):
        begun = time.perf_counter()
        config = dataclasses.replace(DIRECT, bounces=3, subsurface=subsurface, texel_mm=COARSE_MM)
        world = ReferenceWorld(person, rig, lamps, config)
        after = np.concatenate([world.pixels(c, weights, k)[:2] for c, k in seen.items()], axis=1)
        seconds = time.perf_counter() - begun
        for region in ("all skin", *REGIONS, "rest"):
            there = np.ones(len(regions), bool) if region == "all skin" else regions == region
            shares = [
                np.median(np.abs(after - before)[k][there], axis=0)
                / np.median(before[k][there], axis=0)
                for k in (0, 1)
            ]
            text = " / ".join(" ".join(f"{s:.2%}" for s in share) for share in shares)
            seconds_cell = f"{seconds:.1f}" if region == "all skin" else ""
            rows.append((f"{name}: {what} add", region, seconds_cell, "", text))
        before = after
    return rows


def state_weights(rig: Rig, lamps: Lamps) -> np.ndarray:
    levels = np.stack([pattern_levels(state, rig) for state in STATES])
    return levels[:, :, None] * lamps.weights


def skin_light(world: World, weights: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Which pixels are skin, by camera, and the fast path's light (s, n, 3) there."""
    seen = {name: np.flatnonzero(surface.skin) for name, surface in world.surfaces.items()}
    light = [world.pixels(name, weights, chosen) for name, chosen in seen.items()]
    return seen, np.concatenate(light, axis=1)


def noise_and_cost(person: Subject, rig: Rig) -> list[Row]:
    """Noise against time; cost against lamps, pixels and bounces; the session extrapolated."""
    rig = dataclasses.replace(rig, cameras=rig.cameras[:1])
    rows: list[Row] = []
    for samples, rays in ((1, 32), (1, 128), (4, 128), (9, 256)):
        config = ReferenceConfig(samples=samples, bounce_rays=rays, texel_mm=COARSE_MM)
        pictures, seconds = [], []
        for seed in range(3):
            world = ReferenceWorld(person, rig, None, dataclasses.replace(config, seed=seed))
            took, picture = photographs(world, rig)
            pictures.append(picture)
            seconds.append(took)
        case = f"{samples} samples, {rays} bounce rays"
        error = standard_error(pictures)
        rows.append(("noise", case, f"{np.median(seconds):.1f}", f"{error:.2%}", "3 repeats"))
    for count in (42, 84, 168):
        some = dataclasses.replace(rig, lights=rig.lights[:: 168 // count])
        took, _ = photographs(ReferenceWorld(person, some, None, DIRECT), some)
        rows.append(("cost of direct light", f"{count} lights", f"{took:.2f}", "", ""))
    costs = []
    for scale in (SMALL / 2, SMALL, 2 * SMALL):
        sized = default_rig().scaled(scale)
        sized = dataclasses.replace(sized, cameras=sized.cameras[:1])
        world = ReferenceWorld(person, sized, None, DIRECT)
        took, picture = photographs(world, sized)
        count = int((picture[0].max(axis=-1) > 0).sum())
        costs.append((count, took))
        rows.append(("cost of direct light", f"{count} pixels of skin", f"{took:.2f}", "", ""))
    solved = 0.0
    for bounces in (0, 1, 3, 6):
        config = dataclasses.replace(DIRECT, bounces=bounces, subsurface=True, texel_mm=COARSE_MM)
        world = ReferenceWorld(person, rig, None, config)
        solved, _ = photographs(world, rig)
        rows.append(("cost of bounces", f"{bounces} and subsurface", f"{solved:.1f}", "", ""))
    (few, short), (many, long) = costs[0], costs[-1]
    default = ReferenceConfig()
    pixels = many * (WHOLE / (2 * SMALL)) ** 2 * 9 * default.samples
    total = pixels * (long - short) / (many - few)
    total += solved * (COARSE_MM / default.texel_mm) ** 2
    note = f"{default.samples} samples, texels of {default.texel_mm} mm; cam0's face for all nine"
    rows.append(("session, extrapolated", "9 x 1.5 MP x 4 states", f"{total:.0f}", "", note))
    return rows


def photographs(world: ReferenceWorld, rig: Rig) -> tuple[float, np.ndarray]:
    levels = np.stack([pattern_levels(state, rig) for state in STATES])
    begun = time.perf_counter()
    picture = world.photograph(rig.cameras[0].id, levels)
    return time.perf_counter() - begun, picture


def standard_error(pictures: list[np.ndarray]) -> float:
    """The worst state's median standard error, as a share of that state's median radiance.

    Pixels on the outline, which some repeats see and others miss, are left out.
    """
    stack = np.stack(pictures)
    shares = []
    for state in range(stack.shape[1]):
        face = (stack[:, 0] > 0).all(axis=(0, 3))
        seen = stack[:, state][:, face]
        shares.append(np.median(seen.std(axis=0, ddof=1)) / np.median(seen))
    return float(max(shares))


def session(person: Subject) -> list[Row]:
    """Nine cameras of 1.5 MP, four states, at the default settings; the first one once more."""
    rig = default_rig().scaled(WHOLE)
    levels = np.stack([pattern_levels(state, rig) for state in STATES])
    begun = time.perf_counter()
    world = ReferenceWorld(person, rig)
    world.prepare(levels)
    seconds = time.perf_counter() - begun
    alone = dataclasses.replace(rig, cameras=rig.cameras[:1])
    again = ReferenceWorld(person, alone, None, ReferenceConfig(seed=1))
    pictures = [w.photograph(rig.cameras[0].id, levels) for w in (world, again)]
    error = f"{standard_error(pictures):.2%}"
    note = f"{world.variant}, standard error of cam0 from 2 repeats"
    return [("session, measured", "9 x 1.5 MP x 4 states", f"{seconds:.0f}", error, note)]


if __name__ == "__main__":
    main()
