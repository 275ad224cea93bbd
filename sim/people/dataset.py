"""Many parametric people: maps and meshes alone, or whole sessions; resumable, on all cores."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import itertools
import json
import multiprocessing
import os
import shutil
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.files import atomic_folder, leftovers, read_json, write_json
from lightstage.formats.lock import locked
from lightstage.formats.people import PEOPLE_LIST, PEOPLE_LOCK, PEOPLE_SCHEMA, people_counts
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.values import parse_json
from lightstage.rig import default_rig
from sim.errors import SimError
from sim.head.modes import EXPRESSIONS
from sim.light.scene import Scene
from sim.light.world import World
from sim.people.person import person_expressions, require_rows
from sim.people.table import PeopleTable, people
from sim.people.traits import Traits
from sim.session import SessionConfig, truth_path, write_direct
from sim.truth import vertex_occlusion, write_atlas, write_truth

DEMO_SCALE = 0.1795
"""Sessions of a data set have the demo's picture size: 1080 rows of the default rig's 6016."""
BYTES_A_TEXEL = 400
"""About what a worker needs for each texel of a person's maps, besides `BYTES_A_WORKER`."""
BYTES_A_WORKER = 0.6 * 2**30
TEXELS_A_SCAN = 300_000
"""Head and occlusion of a scan take as long as painting so many texels of its skin."""
TEXELS_A_WORKER = 1_000_000
"""A process takes seconds to begin: less work does not justify it."""
MADE_FROM = "made_from.json"
SEED_LIMIT = 2**32


@dataclasses.dataclass(frozen=True)
class Person:
    """One person of a data set.

    Attributes:
        name: pseudonym.
        seed: of the person alone; what the others are changes nothing.
        traits: sex, age, tone, look.
    """

    name: str
    seed: int
    traits: Traits


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a data set is made of.

    Attributes:
        out: folder of PERSON-EXPRESSION folders.
        persons: the simulated people.
        expressions: of each, neutral first.
        rows: of the maps.
    """

    out: Path
    persons: tuple[Person, ...]
    expressions: tuple[str, ...]
    rows: int

    @property
    def scans(self) -> int:
        """How many scans there will be."""
        return len(self.persons) * len(self.expressions)

    def made_from(self, person: Person, expression: str) -> dict[str, object]:
        """What a scan follows from: with the same, the same bytes."""
        return {
            "seed": person.seed,
            "traits": dataclasses.asdict(person.traits),
            "expression": expression,
            "rows": self.rows,
            "code": code_version(),
        }


def make_plan(
    out: Path, table: PeopleTable, subjects: int, expressions: int, seed: int, rows: int
) -> Plan:
    """Who is made.

    Args:
        out: folder.
        table: shares of the people.
        subjects: how many people.
        expressions: of each, neutral first.
        seed: of all of them, 0 or more.
        rows: of the maps.

    Raises:
        SimError: more expressions than there are, a negative seed, or rows of no texture.
    """
    names = ("neutral", *EXPRESSIONS)
    if not 1 <= expressions <= len(names):
        raise SimError(
            "--expressions", found=str(expressions), expected=f"at most {len(names)} ({names})"
        )
    if seed < 0:
        raise SimError("--seed", found=str(seed), expected="0 or more")
    require_rows(rows, "--rows")
    persons = tuple(
        Person(f"person-{index:04d}", _person_seed(seed, index), traits)
        for index, traits in enumerate(people(table, subjects, seed))
    )
    return Plan(out, persons, names[:expressions], rows)


def write_people(plan: Plan, jobs: int = 0, progress: ProgressCallback = quiet) -> int:
    """Write each person's truth as a processed folder without views.

    A scan that is there already and follows from the same seed, traits, size and code is kept.

    Args:
        plan: the people and their expressions.
        jobs: processes, 1 for this one alone; 0 for as many as cores and memory allow.
        progress: of scans.

    Returns:
        How many scans were made now.

    Raises:
        SimError: a process was killed.
    """
    with _own(plan) as todo:
        kept = plan.scans - sum(len(expressions) for _, expressions in todo)
        if kept:
            progress(kept, plan.scans)
        made = 0
        jobs = min(jobs or workers(plan.rows, plan.scans - kept), max(1, len(todo)))
        try:
            for count in _counts(plan, todo, jobs):
                made += count
                progress(kept + made, plan.scans)
        except BrokenProcessPool:
            raise SimError(
                plan.out,
                field="--jobs",
                found=f"one of {jobs} processes was ended from outside, as a system does where "
                "memory runs out",
                expected="all of them to come to their end",
                hint="Run it again with a smaller --jobs or fewer --rows: scans that are whole "
                "are kept.",
            ) from None
    return made


def write_sessions(plan: Plan, progress: ProgressCallback = quiet) -> int:
    """Write a session of linear frames and its truth for each scan, one after another.

    Args:
        plan: the people and their expressions.
        progress: of scans.

    Returns:
        How many sessions were made now; those that were whole already are kept.
    """
    rig = default_rig().scaled(DEMO_SCALE)
    made = 0
    with _own(plan, session=True) as todo:
        kept = plan.scans - sum(len(expressions) for _, expressions in todo)
        for person, expressions in todo:
            for subject in person_expressions(
                person.name, person.seed, expressions, plan.rows, person.traits
            ):
                expression = subject.expression
                path = plan.out / f"{person.name}-{expression}"
                # session.json is written last: what lacks it was cut short, and is no session.
                for part in (path, truth_path(path)):
                    shutil.rmtree(part, ignore_errors=True)
                world = World(subject, rig)
                write_truth(world, truth_path(path))
                write_json(truth_path(path) / MADE_FROM, plan.made_from(person, expression))
                write_direct(world, path, SessionConfig(), person.seed, quiet)
                made += 1
                progress(kept + made, plan.scans)
    return made


def workers(rows: int, scans: int) -> int:
    """How many processes the cores, the free memory and the work justify.

    Args:
        rows: of the maps.
        scans: to be made.
    """
    texels = rows * (rows * 2 // 3)
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    allowed = min(
        len(os.sched_getaffinity(0)), int(free / (BYTES_A_WORKER + BYTES_A_TEXEL * texels))
    )
    return max(1, min(allowed, scans * (TEXELS_A_SCAN + texels) // TEXELS_A_WORKER))


@functools.lru_cache(maxsize=1)
def code_version() -> str:
    """Digest of this package's sources: another version may draw other people."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _person_seed(seed: int, index: int) -> int:
    """A person's own seed: of the data set's seed and the person's number, nothing else."""
    text = f"lightstage person {seed} {index}".encode()
    return int.from_bytes(hashlib.sha256(text).digest()[:8], "big") % SEED_LIMIT


def _counts(plan: Plan, todo: Sequence[tuple[Person, tuple[str, ...]]], jobs: int) -> Iterator[int]:
    """Write everybody; yields each person's number of scans."""
    write = functools.partial(_write_person, plan)
    if jobs == 1:
        # A fresh process would spend seconds on reading the libraries again.
        yield from itertools.starmap(write, todo)
        return
    # Forking a process whose libraries run threads can hang; a fresh one cannot.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, _calm, (jobs,)) as pool:
        yield from pool.map(write, *zip(*todo, strict=True))


def _write_person(plan: Plan, person: Person, expressions: tuple[str, ...]) -> int:
    """One person's scans; returns how many."""
    for subject in person_expressions(
        person.name, person.seed, expressions, plan.rows, person.traits
    ):
        expression = subject.expression
        occlusion = vertex_occlusion(Scene(subject))
        with atomic_folder(plan.out / f"{person.name}-{expression}", MADE_FROM) as beside:
            write_atlas(subject, occlusion, ProcessedFolder(beside), person.traits)
            write_json(beside / MADE_FROM, plan.made_from(person, expression))
    return len(expressions)


def _calm(jobs: int) -> None:
    """Share the cores between the processes of a pool."""
    import cv2
    import numba

    threads = max(1, len(os.sched_getaffinity(0)) // jobs)
    cv2.setNumThreads(threads)
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))


@contextlib.contextmanager
def _own(plan: Plan, session: bool = False) -> Iterator[list[tuple[Person, tuple[str, ...]]]]:
    """Lock the folder, write who is in it, and yield what is still to be made."""
    busy = SimError(plan.out, found="a run that is making it", expected="one run at a time")
    with locked(plan.out / PEOPLE_LOCK, busy):
        for left in leftovers(plan.out, "person-*"):
            shutil.rmtree(left, ignore_errors=True)
        todo = []
        for person in plan.persons:
            left_over = tuple(e for e in plan.expressions if not _is_made(plan, person, e, session))
            if left_over:
                todo.append((person, left_over))
        # Only now: a folder that was made otherwise is refused, with its list as it was.
        _write_list(plan)
        yield todo


def _is_made(plan: Plan, person: Person, expression: str, session: bool) -> bool:
    """Whether a scan is whole; SimError when it was made from something else."""
    folder = plan.out / f"{person.name}-{expression}"
    record = (truth_path(folder) if session else folder) / MADE_FROM
    if session and not (folder / "session.json").is_file():
        return False
    if not record.is_file():
        if session:
            raise SimError(folder, found="another session", expected=f"a record in {record}")
        return False
    found, wanted = read_json(record), plan.made_from(person, expression)
    as_read = parse_json(json.dumps(wanted), record)
    if not isinstance(found, dict):
        raise SimError(record, found=type(found).__name__, expected="an object")
    differing = [key for key in wanted if found.get(key) != as_read[key]]
    if differing:
        key = differing[0]
        raise SimError(
            record,
            field=key,
            found=str(found.get(key)),
            expected=str(wanted[key]),
            hint="This folder was made otherwise. Name another one, or remove it.",
        )
    return True


def _write_list(plan: Plan) -> None:
    """The list: everyone, and how many there are of each kind."""
    persons = [
        {"name": p.name, "seed": p.seed, **dataclasses.asdict(p.traits)} for p in plan.persons
    ]
    value = {
        "schema": PEOPLE_SCHEMA,
        "expressions": list(plan.expressions),
        "rows": plan.rows,
        "counts": people_counts(persons),
        "people": persons,
    }
    write_json(plan.out / PEOPLE_LIST, value)
