"""Errors of reflectance on people whose truth is known: ours beside the published formulas.

Run `python -m benchmarks.reflectance_accuracy` for the whole tables, which go into RESULTS.md, or
with `--people tone3,tone6 --light direct --methods refine` for some, which are printed alone. A
long run may be done in parts with `--results FILE`. Methods: `coarse` (the stage `separate`),
`refine` (with the true mesh), `own-mesh` (with that of `reconstruct`), `peers` (their grids tried
first), `polarised` (the yardstick: `refine` of polarised photographs) and `ceiling` (truth's own
maps, re-rendered).
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from benchmarks.record import record, table
from benchmarks.reflectance_case import Case, Result
from benchmarks.reflectance_peers import PEERS, Peer, Settings
from benchmarks.reflectance_people import PEOPLE, SCALE, Known, person
from benchmarks.reflectance_store import Store
from benchmarks.reflectance_tables import (
    DECILE_HEADER,
    PEOPLE_HEADER,
    TARGET_HEADER,
    Results,
    decile_rows,
    people_rows,
    target_rows,
)
from benchmarks.reflectance_tuning import HEADER as TUNING_HEADER
from benchmarks.reflectance_tuning import Kept, kept_of, tuned

LIGHTS = ("direct", "reference")
BINARY, THROUGH = "binary", "binary-polarised"
METHODS = ("coarse", "refine", "own-mesh", "peers", "polarised", "ceiling")
POLARISED = ("tone3", "tone6")
"""Who is photographed through polarisers, too; the simulator has them for direct light alone."""

CEILING_ROUGHNESS = 0.28

Measurement = tuple[str, Callable[[], Result]]
"""A method and what measures it."""


def measurements(
    known: Known, light: str, methods: Sequence[str], kept: Sequence[Kept], out: Path, scale: float
) -> Iterator[Measurement]:
    """Methods on one person; photographs get their noise when the first is measured.

    Args:
        known: who.
        light: ``direct`` or ``reference``.
        methods: of METHODS.
        kept: settings of the peers.
        out: an empty folder, or that of an earlier run.
        scale: of the pictures.
    """

    @functools.cache
    def case(sequence: str) -> Case:
        return Case(known, light, out / sequence, sequence=sequence, scale=scale)

    def of_peer(peer: Peer, settings: Settings, pictures: bool) -> Result:
        return case(BINARY).result(peer.maps(case(BINARY), settings), pictures=pictures)

    if "coarse" in methods:
        yield "coarse", lambda: case(BINARY).result(case(BINARY).separated())
    if "refine" in methods:
        yield "refine", lambda: case(BINARY).result(case(BINARY).refined())
    if "own-mesh" in methods:
        yield (
            "own-mesh",
            lambda: case(BINARY).result(case(BINARY).refined_on_own_mesh(), own_mesh=True),
        )
    if "peers" in methods:
        for how, peer, settings in kept:
            # Only re-rendered where a row asks for it.
            pictures = light == "reference"
            yield how, functools.partial(of_peer, peer, settings, pictures)
    if "polarised" in methods and light == "direct" and known.name in POLARISED:
        yield (
            "polarised, refine",
            lambda: case(THROUGH).result(case(THROUGH).refined()),
        )
    if "ceiling" in methods:
        yield (
            f"true maps, roughness {CEILING_ROUGHNESS:g} everywhere",
            lambda: case(BINARY).result(case(BINARY).true_maps(CEILING_ROUGHNESS)),
        )


@contextlib.contextmanager
def _folder(keep: Path | None, name: str) -> Iterator[Path]:
    """A folder to work in, kept below `keep` where that is given."""
    if keep is not None:
        yield keep / name
        return
    with tempfile.TemporaryDirectory() as made:
        yield Path(made)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", default=",".join(known.name for known in PEOPLE))
    parser.add_argument("--light", default=",".join(LIGHTS))
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--scale", type=float, default=SCALE)
    parser.add_argument("--keep", type=Path, help="leave the processed folders here")
    parser.add_argument("--results", type=Path, help="JSON: continue with what the same code left")
    parser.add_argument("--record", action="store_true", help="put the tables into RESULTS.md")
    arguments = parser.parse_args()
    whole = all(getattr(arguments, name) == parser.get_default(name)
                for name in ("people", "light", "methods", "scale"))  # fmt: skip
    methods, lights = arguments.methods.split(","), arguments.light.split(",")
    unknown = sorted({*methods} - {*METHODS} | {*lights} - {*LIGHTS})
    if unknown:
        parser.error(f"{', '.join(unknown)}: expected {', '.join((*METHODS, *LIGHTS))}")
    store = Store(arguments.results, arguments.scale)
    if "peers" in methods and not store.grid:
        store.put_grid(tuned(PEERS))
        print("settings of the peers\n" + table(TUNING_HEADER, store.grid), flush=True)
    kept = kept_of(PEERS, store.grid)
    for light in lights:
        for name in arguments.people.split(","):
            with _folder(arguments.keep, f"{name}-{light}") as folder:
                for method, call in measurements(
                    person(name), light, methods, kept, folder, arguments.scale
                ):
                    if (light, name, method) in store.results:
                        continue
                    start = time.perf_counter()
                    store.put((light, name, method), call())
                    seconds = time.perf_counter() - start
                    print(f"  {name} {light} {method}: {seconds:.0f} s", flush=True)
    titled = tables(store.results)
    for title, header, rows, _ in titled:
        print(f"\n{title}\n" + table(header, rows))
    if whole or arguments.record:
        if store.grid:
            titled.append(("Reflectance: settings of the peers", TUNING_HEADER, store.grid, TUNED))
        for title, header, rows, note in titled:
            record(title, header, rows, note)


NOTE = (
    "Three views of 1504 x 1004, pixel noise .001 sqrt(.25 + I), default rig; all skin seen at "
    "less than 70 deg. `ours / peer` against the peer that is best in that row."
)
TUNED = (
    "Tried on two people at 602 x 402, direct light; kept are the fewest settings that hold the "
    "best of every row, within 5 %."
)


def tables(results: Results) -> list[tuple[str, Sequence[str], list[list[str]], str]]:
    """Title, header, rows and note of every table."""
    methods = dict.fromkeys(key[2] for key in results)
    titled: list[tuple[str, Sequence[str], list[list[str]], str]] = []
    for method in methods:
        if method in METHODS and (rows := target_rows(results, method)):
            titled.append((f"Reflectance: {method} against the targets", TARGET_HEADER, rows, NOTE))
    for light in dict.fromkeys(key[0] for key in results):
        rows = people_rows(results, light)
        titled.append((f"Reflectance: every person, {light} light", PEOPLE_HEADER, rows, NOTE))
    ours = {key: found for key, found in results.items() if key[2] in METHODS}
    if ours:
        title = "Reflectance: errors by confidence"
        titled.append((title, DECILE_HEADER, decile_rows(ours), NOTE))
    return titled


if __name__ == "__main__":
    main()
