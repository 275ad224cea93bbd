"""What a session must show: whole and unchanged photographs that its patterns explain."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError, LightstageError, one_error
from lightstage.formats.exr import read_exr
from lightstage.formats.landmarks import read_points_px
from lightstage.formats.session import (
    Frame,
    Session,
    changed_frames,
    load_session,
    missing_frames,
)
from lightstage.photograph import identify

SUM_TOLERANCE = 0.1
"""Light adds up: patterns that sum to a third must, in every camera's mean, up to this share."""
DARK_LEVEL = 1e-3
"""Mean, as a share of white, below which a photograph is noise and compared as this bright."""
MAX_CLIPPED = 0.02
"""Share of a photograph's pixels at the sensor's white level above which it is overexposed."""


@dataclasses.dataclass(frozen=True)
class CheckReport:
    """What was checked.

    Attributes:
        frames: photographs.
        sums: pattern sums compared, over all cameras.
        worst_sum: largest deviation found in them, as a share.
        clipped: largest share of clipped pixels in a photograph.
    """

    frames: int
    sums: int
    worst_sum: float
    clipped: float


def check_session(root: Path, progress: ProgressCallback = quiet) -> CheckReport:
    """Check every photograph of a session: there, unchanged, readable, sized, lit as recorded.

    Raises:
        FormatError: every fault found, in one message.
    """
    session = _load(root)
    problems = missing_frames(session) + changed_frames(session) + _doubled(session)
    if (root / "landmarks.json").exists():
        try:
            read_points_px(root / "landmarks.json")
        except FormatError as error:
            problems.append(error)
    broken = {problem.where for problem in problems}
    means: dict[tuple[str, str], float] = {}
    clipped: dict[tuple[str, str], float] = {}
    frames = session.file.frames
    for done, frame in enumerate(frames, 1):
        path = session.frame_path(frame)
        if path.is_file() and str(path) not in broken:
            try:
                key = frame.pattern, frame.camera
                means[key], clipped[key] = _measure(session, frame, path)
            except FormatError as error:
                problems.append(error)
        progress(done, len(frames))
    problems += _overexposed(session, clipped)
    worst, sums, unlike = _compare_sums(session, means)
    problems += unlike
    if problems:
        raise one_error(problems)
    return CheckReport(len(frames), sums, worst, max(clipped.values(), default=0.0))


def _doubled(session: Session) -> list[LightstageError]:
    """RAW photographs with the same bytes: a sensor's noise never repeats, so one is stale."""
    problems: list[LightstageError] = []
    seen: dict[str, Frame] = {}
    for frame in session.file.frames:
        first = seen.setdefault(frame.sha256, frame)
        if first is not frame and frame.encoding == "raw":
            problems.append(
                FormatError(
                    session.frame_path(frame),
                    field="sha256",
                    found=f"the bytes of {first.path}",
                    expected="a photograph of its own",
                    hint="The camera gave an old picture; take that shot again.",
                )
            )
    return problems


def _load(root: Path) -> Session:
    unfinished = (root / "journal.jsonl").is_file() and not (root / "session.json").is_file()
    if unfinished:
        raise FormatError(
            root / "session.json",
            found="only a journal",
            expected="a finished session",
            hint="The capture was interrupted; what it took is in frames/. Capture again.",
        )
    return load_session(root)


def _measure(session: Session, frame: Frame, path: Path) -> tuple[float, float]:
    """Mean above black and share of clipped pixels of a photograph; FormatError when unreadable."""
    camera = session.rig.camera(frame.camera)
    kind = identify(path.read_bytes(), path)
    if kind.encoding != frame.encoding:
        raise FormatError(
            path, field="encoding", found=kind.encoding, expected=f"{frame.encoding} (session.json)"
        )
    if frame.encoding == "linear":
        image = read_exr(path, finite=True)
        shape, mean, clipped = image.shape[:2], float(image.mean()), 0.0
    else:
        shape, mean, clipped = _measure_raw(path)
    if shape != (camera.height_px, camera.width_px):
        raise FormatError(
            path,
            field="size",
            found=f"{shape[1]} x {shape[0]} pixels",
            expected=f"{camera.width_px} x {camera.height_px} (rig.json, {camera.id})",
        )
    return mean, clipped


def _measure_raw(path: Path) -> tuple[tuple[int, int], float, float]:
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            counts = raw.raw_image_visible
            black = float(np.mean(raw.black_level_per_channel))
            white = float(raw.white_level)
            mean = float(counts.mean(dtype=float)) - black
            clipped = float(np.count_nonzero(counts >= white)) / counts.size
            # A portrait camera stores landscape rows and a tag; the rig's rows are upright.
            size = (raw.sizes.height, raw.sizes.width)
            return size[::-1] if raw.sizes.flip in (5, 6) else size, mean / (white - black), clipped
    except (rawpy.LibRawError, ValueError) as error:
        raise FormatError(
            path,
            found=error.args[0].decode() if isinstance(error.args[0], bytes) else str(error),
            expected="a RAW that LibRaw reads",
            hint="Is the file truncated, or the camera too new for LibRaw?",
        ) from None


def _overexposed(session: Session, clipped: dict[tuple[str, str], float]) -> list[LightstageError]:
    return [
        FormatError(
            session.frame_path(session.frame(pattern, camera)),
            field="exposure",
            found=f"{100 * share:.1f} % of the pixels clipped",
            expected=f"at most {100 * MAX_CLIPPED:g} %",
            hint="Shorten the exposure or lower ISO for all cameras, and capture again.",
        )
        for (pattern, camera), share in clipped.items()
        if share > MAX_CLIPPED
    ]


def _compare_sums(
    session: Session, means: dict[tuple[str, str], float]
) -> tuple[float, int, list[LightstageError]]:
    """Compare photographs whose driven levels add up (x+ and x- to full): light is linear."""
    levels = {pattern: session.levels(pattern) for pattern in session.file.sequence}
    lit = {pattern: levels[pattern] for pattern in levels if levels[pattern].any()}
    wholes = {_rounded(level): pattern for pattern, level in lit.items()}
    sums = [
        (first, second, wholes[_rounded(lit[first] + lit[second])])
        for first, second in itertools.combinations(lit, 2)
        if _rounded(lit[first] + lit[second]) in wholes
    ]
    problems: list[LightstageError] = []
    worst, count = 0.0, 0
    for (first, second, whole), camera in itertools.product(sums, session.camera_ids()):
        keys = [(pattern, camera) for pattern in (first, second, whole)]
        if not all(key in means for key in keys):
            continue
        parts, total = means[keys[0]] + means[keys[1]], means[keys[2]]
        off = abs(parts - total) / max(abs(total), DARK_LEVEL)
        worst, count = max(worst, off), count + 1
        if off > SUM_TOLERANCE:
            problems.append(
                FormatError(
                    session.root / "session.json",
                    field=f"patterns of {camera}",
                    found=f"{first} + {second} = {parts:.4g} on average, {whole} = {total:.4g}",
                    expected=f"equal within {100 * SUM_TOLERANCE:g} %",
                    hint="Was a pattern not lit, or a photograph of another one?",
                )
            )
    return worst, count, problems


def _rounded(levels: np.ndarray) -> bytes:
    """Levels to a thousandth, as a key: devices round to steps of their own."""
    return bytes(np.round(levels * 1000).astype(np.int32).tobytes())
