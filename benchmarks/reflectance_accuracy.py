"""Errors of reflectance on people whose truth is known: ours beside the published formulas.

Run `python -m benchmarks.reflectance_accuracy` for the whole tables, which go into RESULTS.md, or
with `--people tone3,tone6 --light direct --methods refine` for some, which are printed alone.
Methods: `coarse` (the stage `separate`), `refine` (with the true mesh), `own-mesh` (with that of
`reconstruct`), `peers` (their grids tried first) and `polarised` (the yardstick).
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.record import record, table
from benchmarks.reflectance_case import Case, Result
from benchmarks.reflectance_peers import PEERS, YARDSTICK
from benchmarks.reflectance_people import PEOPLE, SCALE, Known, person
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
from benchmarks.reflectance_tuning import Kept, label, tuned

LIGHTS = ("direct", "reference")
METHODS = ("coarse", "refine", "own-mesh", "peers", "polarised")
POLARISED = ("tone3", "tone6")
"""Who is photographed through polarisers, too; the simulator has them for direct light alone."""


def measure(
    known: Known, light: str, methods: Sequence[str], kept: Sequence[Kept], out: Path, scale: float
) -> Iterator[tuple[str, Result]]:
    """Errors of methods on one person.

    Args:
        known: who.
        light: ``direct`` or ``reference``.
        methods: of METHODS.
        kept: settings of the peers.
        out: an empty folder, or that of an earlier run.
        scale: of the pictures.
    """
    case = Case(known, light, out / "binary", scale=scale)
    if "coarse" in methods:
        yield "coarse", case.result(case.separated())
    if "refine" in methods:
        yield "refine", case.result(case.refined())
    if "own-mesh" in methods:
        yield "own-mesh", case.result(case.refined_on_own_mesh(), own_mesh=True)
    if "peers" in methods:
        for how, peer, settings in kept:
            yield how, case.result(peer.maps(case, settings), pictures=light == "reference")
    if "polarised" in methods and light == "direct" and known.name in POLARISED:
        through = Case(known, light, out / "polarised", sequence="binary-polarised", scale=scale)
        for settings in YARDSTICK.grid:
            yield label(YARDSTICK, settings), through.result(YARDSTICK.maps(through, settings))


@contextlib.contextmanager
def _folder(keep: Path | None, name: str) -> Iterator[Path]:
    """A folder to work in, kept below `keep` where that is told."""
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
    parser.add_argument("--record", action="store_true", help="put the tables into RESULTS.md")
    told = parser.parse_args()
    whole = all(getattr(told, name) == parser.get_default(name)
                for name in ("people", "light", "methods", "scale"))  # fmt: skip
    methods, lights = told.methods.split(","), told.light.split(",")
    unknown = sorted({*methods} - {*METHODS} | {*lights} - {*LIGHTS})
    if unknown:
        parser.error(f"{', '.join(unknown)}: expected {', '.join((*METHODS, *LIGHTS))}")
    kept, grid = tuned(PEERS) if "peers" in methods else ([], [])
    if grid:
        print("settings of the peers\n" + table(TUNING_HEADER, grid), flush=True)
    results: Results = {}
    for light in lights:
        for name in told.people.split(","):
            with _folder(told.keep, f"{name}-{light}") as folder:
                start = time.perf_counter()
                for method, found in measure(
                    person(name), light, methods, kept, folder, told.scale
                ):
                    results[light, name, method] = found
                    seconds = time.perf_counter() - start
                    print(f"  {name} {light} {method}: {seconds:.0f} s", flush=True)
                    start = time.perf_counter()
    titled = tables(results)
    for title, header, rows, _ in titled:
        print(f"\n{title}\n" + table(header, rows))
    if whole or told.record:
        if grid:
            titled.append(("Reflectance: settings of the peers", TUNING_HEADER, grid, TUNED))
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
