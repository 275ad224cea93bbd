"""A missing pattern from the others: full less its complement, or full from a pair."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from lightstage.errors import LightstageError, one_error
from lightstage.formats.scale import full_levels
from lightstage.formats.session import Driven, Session, missing_frames
from lightstage.formats.sums import LEVEL_STEP
from lightstage.patterns import pattern_levels
from lightstage.patterns.names import BINARY, LINEAR, bank_mask, complement
from processing.errors import ProcessingError

Recipe = tuple[tuple[str, float], ...]
"""Patterns that were photographed and the factors under which their sum is the missing one."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """Two patterns whose levels sum to a whole's."""

    first: str
    second: str
    whole: str

    @property
    def axis(self) -> str:
        """What it is called: x for x+ and x-, x@cross for those of a bank."""
        base, at, bank = self.first.partition("@")
        return base.rstrip("+-") + at + bank


def pairs_of(session: Session) -> list[Pair]:
    """Pairs of a session's sequence that sum to its `full` of the same polarisation.

    Names decide which may, the levels that were driven decide which do.
    """
    names = session.file.sequence
    out = []
    for name in names:
        other, whole = complement(name), "full" + "".join(name.partition("@")[1:])
        if other is None or other not in names or whole not in names:
            continue
        if names.index(name) > names.index(other):
            continue
        apart = session.levels(name) + session.levels(other) - session.levels(whole)
        if np.abs(apart).max() <= LEVEL_STEP:
            first, second = sorted((name, other))
            out.append(Pair(first, second, whole))
    return out


def with_complements(session: Session) -> Session:
    """The session as if every gradient's complement had been in its sequence.

    Where a gradient was taken with `full` and its complement was not, the complement's light is
    known as well: it joins the sequence, without a photograph.

    Returns:
        The same session where nothing is to be added.
    """
    file = session.file
    sequence, patterns = list(file.sequence), dict(file.patterns)
    for name in file.sequence:
        other = complement(name)
        base, at, bank = name.partition("@")
        if base not in (*BINARY, *LINEAR) or other is None or other in sequence:
            continue
        whole = "full" + at + bank
        if whole not in sequence:
            continue
        full = session.levels(whole) if whole in patterns else full_levels(session)
        if whole not in patterns and at:
            full = full * bank_mask(whole, session.rig)
        left = full - session.levels(name)
        if left.min() < -LEVEL_STEP or left.max() <= LEVEL_STEP:
            continue
        if np.abs(left - pattern_levels(other, session.rig)).max() > LEVEL_STEP:
            patterns[other] = Driven(levels=np.clip(left, 0, 1).tolist())
        sequence.insert(sequence.index(name) + 1, other)
    if len(sequence) == len(file.sequence):
        return session
    changed = file.model_copy(update={"sequence": sequence, "patterns": patterns})
    return Session(session.root, changed, session.rig)


def missing_patterns(session: Session) -> dict[str, dict[str, Recipe]]:
    """How each camera's missing photographs follow from those that are there.

    Args:
        session: of `with_complements`.

    Returns:
        For every camera, missing pattern to recipe; empty where nothing is missing.

    Raises:
        LightstageError: every photograph that is missing and does not follow from the others, both
            of one axis among them, in one message.
    """
    recipes, problems = _plan(session)
    if problems:
        raise one_error(problems)
    return recipes


def unmendable_frames(session: Session) -> list[LightstageError]:
    """One error for each photograph that is missing and does not follow from the others."""
    return _plan(session)[1]


def completed_in_words(recipes: dict[str, dict[str, Recipe]]) -> list[str]:
    """Sentences for the report: what was rebuilt from what, for which cameras."""
    cameras: dict[tuple[str, Recipe], list[str]] = {}
    for camera, own in recipes.items():
        for name, recipe in own.items():
            cameras.setdefault((name, recipe), []).append(camera)
    return [
        f"{name} has no photograph by {', '.join(which)}: rebuilt as {_formula(recipe)}; "
        "its noise is larger"
        for (name, recipe), which in cameras.items()
    ]


def fill(images: np.ndarray, patterns: tuple[str, ...], recipes: dict[str, Recipe]) -> None:
    """Fill the rows of missing patterns, in place.

    Args:
        images: (P, h, w, 3) halves or floats, ambient light taken off; a missing row's content is
            not read.
        patterns: P names.
        recipes: of one camera.
    """
    for name, recipe in recipes.items():
        total = np.zeros(images.shape[1:], np.float32)
        for part, factor in recipe:
            total += np.float32(factor) * images[patterns.index(part)].astype(np.float32)
        images[patterns.index(name)] = total


def _plan(session: Session) -> tuple[dict[str, dict[str, Recipe]], list[LightstageError]]:
    pairs = pairs_of(session)
    recipes: dict[str, dict[str, Recipe]] = {}
    problems: list[LightstageError] = []
    if not missing_frames(session):
        return {camera.id: {} for camera in session.rig.cameras}, []
    for camera in session.rig.cameras:
        there = {
            frame.pattern
            for frame in session.file.frames
            if frame.camera == camera.id and session.frame_path(frame).is_file()
        }
        known: dict[str, Recipe] = {name: ((name, 1.0),) for name in there}
        own: dict[str, Recipe] = {}
        for name in sorted(set(session.file.sequence) - there, key=lambda n: "full" not in n):
            recipe = _recipe(name, pairs, known)
            if recipe is None:
                problems.append(_gone(session, camera.id, name, pairs, there))
            else:
                own[name] = known[name] = recipe
        recipes[camera.id] = own
    return recipes, problems


def _recipe(name: str, pairs: list[Pair], known: dict[str, Recipe]) -> Recipe | None:
    """From a whole and the other part, or a whole from the mean of its pairs."""
    sums: list[dict[str, float]] = []
    for pair in pairs:
        parts = {pair.first, pair.second}
        if name == pair.whole and parts <= set(known):
            sums.append(_added(((p, 1.0) for p in sorted(parts)), known))
        elif name in parts:
            (other,) = parts - {name}
            if other in known and pair.whole in known:
                sums.append(_added(((pair.whole, 1.0), (other, -1.0)), known))
    if not sums:
        return None
    names = sorted({part for total in sums for part in total})
    mean = [(part, sum(total.get(part, 0.0) for total in sums) / len(sums)) for part in names]
    return tuple((part, factor) for part, factor in mean if factor)


def _added(terms: Iterable[tuple[str, float]], known: dict[str, Recipe]) -> dict[str, float]:
    total: dict[str, float] = {}
    for name, factor in terms:
        for part, own in known[name]:
            total[part] = total.get(part, 0.0) + factor * own
    return total


def _gone(
    session: Session, camera_id: str, name: str, pairs: list[Pair], there: set[str]
) -> LightstageError:
    mates = [p for p in pairs if name in (p.first, p.second, p.whole)]
    lost = sorted({x for p in mates for x in (p.first, p.second, p.whole)} - there - {name})
    also = f" nor of {', '.join(lost)}" if lost else ""
    return ProcessingError(
        session.root / "session.json",
        field="frames",
        found=f"no photograph of {name} by {camera_id}{also}",
        expected="two of the three of a pair and full" if mates else "one by each camera",
        hint="Copy them back from the camera or take that shot again.",
    )


def _formula(recipe: Recipe) -> str:
    words = ""
    for name, factor in sorted(recipe, key=lambda term: -term[1]):
        sign = "- " if factor < 0 else "+ " if words else ""
        size = "" if abs(factor) == 1 else f"{abs(factor):.3g} "
        words += f"{' ' if words else ''}{sign}{size}{name}"
    return words
