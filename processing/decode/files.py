"""One camera's photographs decoded: what is known already is kept, the rest done in threads."""

from __future__ import annotations

import collections
import concurrent.futures
import dataclasses
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.errors import FormatError
from lightstage.formats.npz import UNREADABLE_NPZ
from lightstage.formats.session import Frame, Session
from processing.decode.session_photographs import Calibrated, Photograph, open_photograph
from processing.frames.drafts import Draft, Marks, frames_path, read_facts, read_marks
from processing.frames.read import power_of_two, read_frames
from processing.frames.small import SmallPictures
from processing.frames.window import Window
from processing.parallel import cores
from processing.raw.region import find_window
from processing.records import hash_of
from processing.stage_inputs import stage_code

MOST_THREADS = 4
"""Each holds one photograph's counts in memory."""
BAND_ROWS = 128
"""Rows that are developed, checked and written before the next: they stay in the cache."""
SURROUNDED = 0.3
"""A pattern whose lights' mean direction is shorter than this lights the face from all around."""


@dataclasses.dataclass(frozen=True)
class CameraJob:
    """What is to be decoded.

    Attributes:
        session: whose.
        camera: id.
        frames: by pattern, dark ones and those that were photographed.
        lit: P patterns with light, in the session's order, also missing ones.
        dark: patterns without light.
        calibrated: how RAW becomes light; None for a camera without RAW.
        factors: by pattern, of exposure.
        clip_share: see DecodeConfig.
        foreground_share: see DecodeConfig.
    """

    session: Session
    camera: str
    frames: Mapping[str, Frame]
    lit: tuple[str, ...]
    dark: tuple[str, ...]
    calibrated: Calibrated | None
    factors: Mapping[str, float]
    clip_share: float
    foreground_share: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns by rig.json."""
        camera = self.session.rig.camera(self.camera)
        return camera.height_px, camera.width_px

    def open(self, pattern: str) -> Photograph:
        """Open a photograph.

        Raises:
            FormatError: unreadable, or of another size than the camera's.
        """
        frame = self.frames[pattern]
        opened = open_photograph(
            self.session, frame, self.calibrated, self.factors[pattern], self.clip_share
        )
        if opened.shape != self.shape:
            rows, columns = opened.shape
            opened.close()
            raise FormatError(
                self.session.frame_path(frame),
                found=f"{columns} x {rows} pixels",
                expected=f"{self.shape[1]} x {self.shape[0]} as {self.camera} has in rig.json",
            )
        return opened

    def key(self, pattern: str, *more: object) -> str:
        """Hash of all that a photograph's values depend on."""
        frame = self.frames[pattern]
        known = None if self.calibrated is None else self.calibrated.identity()
        return hash_of(
            stage_code("decode"),
            frame.sha256,
            frame.encoding,
            known,
            self.factors[pattern],
            self.clip_share,
            list(more),
        )


@dataclasses.dataclass
class Look:
    """What a first reading of the photographs finds.

    Attributes:
        key: hash of what it depends on.
        window: that holds the face.
        scale: a power of two for the half floats.
        opened: photographs that it left open.
    """

    key: str
    window: Window
    scale: float
    opened: dict[str, Photograph] = dataclasses.field(default_factory=dict)


def first_look(job: CameraJob, out: Path, limit: Window, *, crop: bool) -> Look:
    """Find the window, on the pattern that lights the face from all around, else on all.

    Args:
        job: what is to be decoded.
        out: processed folder; what an earlier run found is used where nothing changed.
        limit: the largest window.
        crop: whether the face is searched for, or all of `limit` is taken.
    """
    on = patterns_to_search(job.session, [name for name in job.lit if name in job.frames])
    keys = [job.key(name) for name in on]
    key = hash_of(keys, job.foreground_share, crop, dataclasses.asdict(limit))
    known = _written_facts(job, out).get("look")
    if known is not None and known["key"] == key:
        return Look(key, Window(**known["window"]), float(known["scale"]))
    looks: list[np.ndarray] = []
    opened: dict[str, Photograph] = {}
    peak, side = 0.0, 1
    for name in on:
        photograph = job.open(name)
        look, side = photograph.look()
        looks.append(look)
        peak = max(peak, photograph.peak())
        if len(on) == 1:
            opened[name] = photograph
        else:
            photograph.close()
    window = limit
    if crop:
        brightest = np.maximum.reduce(looks)
        found = find_window(brightest, side, job.shape, job.foreground_share).and_also(limit)
        window = limit if found.empty else found
    return Look(key, window, power_of_two(peak), opened)


def patterns_to_search(session: Session, patterns: Sequence[str]) -> list[str]:
    """Patterns in which the face is searched for.

    That is the one that lights from all around with the most light, or all where none does.
    """
    places = session.rig.positions_mm
    towards = places / np.linalg.norm(places, axis=1, keepdims=True)
    best, most = None, 0.0
    for name in patterns:
        levels = np.asarray(session.levels(name), float).reshape(len(places), -1).mean(axis=1)
        total = float(levels.sum())
        if total > most and np.linalg.norm(levels @ towards) < SURROUNDED * total:
            best, most = name, total
    return list(patterns) if best is None else [best]


def fill_draft(
    job: CameraJob,
    out: Path,
    look: Look,
    draft: Draft,
    pictures: SmallPictures,
    step: Callable[[], None],
) -> int:
    """Decode into a draft what did not change since the last run, and keep the rest.

    Args:
        job: what is to be decoded.
        out: processed folder with what the last run left.
        look: of the photographs; those it left open are closed.
        draft: with a row for each of `job.lit`; rows of missing patterns stay zero.
        pictures: small ones of `job.lit`, filled beside it.
        step: called for each photograph.

    Returns:
        How many photographs were kept from the last run.
    """
    place = [dataclasses.asdict(look.window), look.scale]
    keys = {name: job.key(name, place) for name in job.dark}
    darkness = sorted(keys.values())
    keys |= {n: job.key(n, place, darkness) for n in job.lit if n in job.frames}
    kept = _kept(job, out, keys)
    wanted = [name for name in keys if name not in kept and name not in job.dark]
    before = read_frames(out, job.camera) if kept else None
    for name, marks in kept.items():
        draft.marks[name] = marks
        if before is not None and name in job.lit:
            picture = before.half[before.patterns.index(name)]
            for top, rows in bands(look.window.height, pictures.cell):
                band = np.asarray(picture[top : top + rows])
                draft.write_rows(job.lit.index(name), top, band)
                pictures.add(name, top, band)
        step()
    ambient = None
    if job.dark and wanted:
        ambient = _ambient(job, look, draft, [n for n in job.dark if n not in kept], step)
    _in_threads(job, look, draft, pictures, wanted, ambient, step)
    for photograph in look.opened.values():
        photograph.close()
    for marks in draft.marks.values():
        marks.add_to(draft.clipped)
    draft.facts["keys"] = keys
    draft.facts["look"] = {
        "key": look.key,
        "window": dataclasses.asdict(look.window),
        "scale": look.scale,
    }
    return len(kept)


def _written_facts(job: CameraJob, out: Path) -> dict[str, Any]:
    """What the last run wrote of itself; nothing where it left none or another form of it."""
    try:
        return dict(read_facts(frames_path(out, job.camera), job.camera)["told"])
    except (FormatError, KeyError, TypeError):
        return {}


def _kept(job: CameraJob, out: Path, keys: Mapping[str, str]) -> dict[str, Marks]:
    """Photographs whose decoded values are there as they were: pattern to clipped pixels."""
    written = _written_facts(job, out)
    changed = set(written.get("changed_later", []))
    same = [
        name
        for name, key in keys.items()
        if written.get("keys", {}).get(name) == key and name not in changed
    ]
    if not same:
        return {}
    try:
        read_frames(out, job.camera)
        return read_marks(frames_path(out, job.camera), same)
    except (FormatError, *UNREADABLE_NPZ):
        return {}


def _ambient(
    job: CameraJob, look: Look, draft: Draft, unmarked: Sequence[str], step: Callable[[], None]
) -> np.ndarray:
    """(h, w, 3) float32 mean of the dark photographs, on the half floats' scale."""
    total = np.zeros((*look.window.shape, 3), np.float32)
    for name in job.dark:
        lit, marks = np.zeros(total.shape, np.float16), np.zeros(look.window.shape, np.uint8)
        photograph = job.open(name)
        photograph.develop(look.window, look.scale, None, lit, marks)
        photograph.close()
        total += lit.astype(np.float32) / np.float32(len(job.dark))
        draft.marks[name] = Marks.of(marks)
        if name in unmarked:
            step()
    return total


def bands(height: int, cell: int) -> list[tuple[int, int]]:
    """First row and number of rows of a window's bands: whole cells, but for the last."""
    rows = cell * max(1, BAND_ROWS // cell)
    return [(top, min(rows, height - top)) for top in range(0, height, rows)]


def _in_threads(
    job: CameraJob,
    look: Look,
    draft: Draft,
    pictures: SmallPictures,
    wanted: Sequence[str],
    ambient: np.ndarray | None,
    step: Callable[[], None],
) -> None:
    """Unpack and develop photographs, as many at a time as there are processors."""
    own = threading.local()
    height, width = look.window.shape
    parts = bands(height, pictures.cell)

    def develop(name: str) -> tuple[str, Marks]:
        if not hasattr(own, "rows"):
            own.rows = np.empty((parts[0][1], width, 3), np.float16)
            own.marks = np.empty((parts[0][1], width), np.uint8)
        found: list[Marks] = []
        photograph = look.opened.get(name) or job.open(name)
        try:
            for top, rows in parts:
                lit, marks = own.rows[:rows], own.marks[:rows]
                marks[:] = 0
                place = Window(look.window.top + top, look.window.left, rows, width)
                dark = None if ambient is None else ambient[top : top + rows]
                photograph.develop(place, look.scale, dark, lit, marks)
                draft.write_rows(job.lit.index(name), top, lit)
                pictures.add(name, top, lit)
                found.append(Marks.of(marks, top * width))
        finally:
            photograph.close()
        return name, Marks.joined(found)

    threads = max(1, min(cores(), MOST_THREADS, len(wanted)))
    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        waiting = collections.deque(wanted)
        running = {pool.submit(develop, waiting.popleft()) for _ in range(threads) if waiting}
        try:
            while running:
                done, running = concurrent.futures.wait(
                    running, return_when=concurrent.futures.FIRST_COMPLETED
                )
                for future in done:
                    name, marks = future.result()
                    draft.marks[name] = marks
                    step()
                    if waiting:
                        running.add(pool.submit(develop, waiting.popleft()))
        except BaseException:
            waiting.clear()
            raise
