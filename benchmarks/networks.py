"""The whole-face network on heads it has not seen, refined and alone, beside plain guesses.

Heads are simulated people of a seed of their own, people of ICT's model and a scanned head, which
are registered to our template as captured ones are, and folders of captured heads (whatever
``--people`` names besides); each under ten lights, which `sim`'s light transport renders and
`learning`'s does not. Errors are of sRGB-encoded colours over skin, raw and after the best gain a
channel, which nobody knows of a real person. People of ICT's model come in two halves: ``--unseen``
measures the one that is kept apart while networks are changed.

The scanned head is Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, based on a work at
www.triplegangers.com. Its true albedo is its texture, with some shading baked in.

`benchmarks.training` measures the networks of patches.
"""

from __future__ import annotations

import argparse
import functools
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.networks_lights import GROUPS, light_of, random_light
from benchmarks.networks_people import KINDS, Who, chosen, make, simulated
from lightstage.counting import counted

if TYPE_CHECKING:
    from benchmarks.networks_guesses import Neighbours
    from benchmarks.networks_head import Lit, Refining, Task

COUNT, ROWS = 20, 768
ICT_COUNT = 4
FLAWED = 3
"""Simulated people whose textures are spoiled, of different tones."""
LEARNED_SEED, LEARNED, LEARNED_LIGHTS, LEARNED_ROWS = 901, 4, 3, 288
"""Whom the regression on neighbours is fitted to: people, lights of each, rows."""
QUICK_LIGHTS = ("hard-oblique", "studio", "from-behind")
TIMED_LIGHTS = ("front", "hard-oblique")
SETTLES_SECONDS = 900.0
"""Refinement ends by itself long before on a quiet machine; a busy one then finds the same."""


def main() -> None:
    # Before torch is imported: threads that wait for each other give their core away.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    from benchmarks.networks_head import Task
    from benchmarks.networks_sheet import write_sheet
    from benchmarks.networks_tables import write_flaws, write_guesses, write_others

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--people", default=",".join(KINDS), help="kinds of heads, or folders of captured ones"
    )
    parser.add_argument("--count", type=int, help=f"simulated people ({COUNT}), and of ICT's")
    parser.add_argument("--rows", type=int, help=f"of the textures, a multiple of 3 ({ROWS})")
    parser.add_argument("--lights", help=f"of {', '.join(GROUPS)}, or groups of them; all else")
    parser.add_argument("--unseen", action="store_true", help="ICT's people that are kept apart")
    parser.add_argument("--quick", action="store_true", help="a head a kind, three lights, 384")
    parser.add_argument("--checkpoint", type=Path, help="a run; the shipped weights else")
    parser.add_argument(
        "--mesostructure", type=Path, help="a run of pores and folds; the shipped weights else"
    )
    parser.add_argument("--sheet", type=Path, help="a sheet of pictures, .png")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    arguments = parser.parse_args()
    count = arguments.count or (1 if arguments.quick else None)
    heads = []
    for kind in arguments.people.split(","):
        usual = ICT_COUNT if kind == "ict" else COUNT
        heads += chosen([kind], count or usual, arguments.unseen)
    if not heads:
        raise SystemExit("--people: no head of these kinds is there")
    task = Task(
        rows=arguments.rows or (384 if arguments.quick else ROWS),
        lights=_lights(arguments.lights, QUICK_LIGHTS if arguments.quick else tuple(GROUPS)),
        refine_seconds=SETTLES_SECONDS,
        checkpoint=arguments.checkpoint,
        mesostructure=arguments.mesostructure,
        neighbours=neighbours(),
        pictures=arguments.sheet is not None,
        flawed=frozenset([who.name for who in heads if who.kind == "simulated"][:FLAWED]),
    )
    lit = _all(heads, task, arguments.jobs)
    title = "Learning, whole-face network"
    title += f" of {arguments.checkpoint.name}" if arguments.checkpoint else ""
    title += f", folds of {arguments.mesostructure.name}" if arguments.mesostructure else ""
    title += ", quick" if arguments.quick else ""
    title += ", kept apart" if arguments.unseen else ""
    # What is measured in part is beside the whole table, not in its place, nor in another part's.
    kinds = list(dict.fromkeys(each.kind for each in lit))
    chose = (arguments.count, arguments.rows, arguments.lights)
    of_some = arguments.people != ",".join(KINDS)
    if of_some or any(value is not None for value in chose):
        title += f", a part, {counted(task.rows, 'row')}"
    for kind in kinds:
        write_guesses(f"{title}: {kind}", [e for e in lit if e.kind == kind], task.rows)
    write_others(
        f"{title}: other maps{' of ' + ', '.join(kinds) if of_some else ''}",
        lit,
        seconds(heads[0], task),
    )
    write_flaws(f"{title}: textures that people have", lit)
    if arguments.sheet:
        strips = {(each.name, each.light): each.strip for each in lit if each.strip is not None}
        write_sheet(strips, arguments.sheet)


def _lights(chosen: str | None, usual: tuple[str, ...]) -> tuple[str, ...]:
    if chosen is None:
        return usual
    words = chosen.split(",")
    unknown = sorted(set(words) - set(GROUPS) - set(GROUPS.values()))
    if unknown:
        raise SystemExit(f"--lights: {unknown[0]!r} is none of {', '.join(GROUPS)} or their groups")
    return tuple(name for name, group in GROUPS.items() if name in words or group in words)


def _all(heads: list[Who], task: Task, jobs: int) -> list[Lit]:
    """Every head, in processes side by side."""
    from benchmarks.networks_head import measure

    work: Callable[[Who], list[Lit]] = functools.partial(measure, task=task)
    if jobs == 1 or len(heads) == 1:
        return _shown(map(work, heads), len(heads))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, _calm) as pool:
        return _shown(pool.map(work, heads), len(heads))


def _shown(measured: Iterable[list[Lit]], count: int) -> list[Lit]:
    from benchmarks.networks_head import REFINED
    from benchmarks.networks_scores import db

    out: list[Lit] = []
    for done, lit in enumerate(measured, 1):
        out += lit
        refined = db(each.albedo[REFINED].raw for each in lit if each.albedo)
        print(
            f"{done} of {count}: {lit[0].kind} {lit[0].name}, refined {refined:.1f} dB", flush=True
        )
    return out


def _calm() -> None:
    """One core for each process."""
    import cv2
    import numba
    import torch

    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    torch.set_num_threads(1)


def neighbours() -> Neighbours:
    """The regression on neighbours, fitted to simulated people whom nobody is measured on."""
    from benchmarks.networks_guesses import Neighbours, Texture
    from benchmarks.networks_head import Shape

    out = Neighbours()
    rng = np.random.default_rng(LEARNED_SEED)
    for who in simulated(LEARNED_SEED, LEARNED):
        head = make(who, LEARNED_ROWS)
        shape = Shape(head)
        for _ in range(LEARNED_LIGHTS):
            image = head.image(head.lit.under(random_light(rng)))
            lit = Texture(image, shape.head_normal, shape.head_position_mm, head.shown)
            out.add(lit, head.maps["diffuse_albedo"], head.skin, rng)
    return out


def seconds(who: Who, task: Task) -> str:
    """Seconds of network and refinement on one head, nothing beside them."""
    from benchmarks.networks_head import network_of, refining
    from learning.whole.infer import infer_whole_face

    head, network = make(who, task.rows), network_of(task.checkpoint)
    ways: tuple[Refining, ...] = ({}, refining(task))
    taken: list[list[float]] = [[], []]
    for name in TIMED_LIGHTS:
        texture = head.image(head.lit.under(light_of(name, 0)))
        for how, each in zip(ways, taken, strict=True):
            began = time.perf_counter()
            infer_whole_face(network, texture, head.mesh, head.head_from_world, **how)
            each.append(time.perf_counter() - began)
    alone, refined = (float(np.mean(each)) for each in taken)
    return f"network {alone:.1f} s, refined {refined:.1f} s a texture of {task.rows} rows"


if __name__ == "__main__":
    main()
