"""Decoded photographs made ready: missing ones rebuilt, moved ones aligned, light evened out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lightstage.errors import LightstageError, one_error
from lightstage.formats.session import Session
from lightstage.formats.sums import Balance, axes_alike, sum_fault
from processing.decode.completing import Pair, Recipe, fill, pairs_of
from processing.decode.config import PrepareConfig
from processing.decode.diagnosis import Diagnosis, write_diagnosis
from processing.decode.subject_motion import Flow, solve_pair, warp
from processing.decode.sums import (
    ambient_ratio,
    fit_sums,
    lit_cells,
    mean_colour,
    residual,
    wrong_patterns,
)
from processing.frames.small import SmallPictures, cell_side, free_cells, shrunk
from processing.readings import px_per_mm

ALIKE = 0.5
"""Pairs show ambient light alike when they differ by less than this share of it."""
FORCE = "--force continues, with photographs that contradict each other."
WARN_AMBIENT, WARN_APART = 0.01, 0.01
"""Shares of full above which the report warns."""


def prepare_view(
    out: Path,
    camera_id: str,
    patterns: Sequence[str],
    images: np.ndarray,
    usable: np.ndarray,
    session: Session,
    config: PrepareConfig,
    recipes: Mapping[str, Recipe],
    pictures: SmallPictures | None = None,
) -> dict[str, Any]:
    """Check one view's photographs against each other and mend what can be mended, in place.

    Missing photographs are rebuilt. Photographs that moved are placed upon full, complements
    together; where nothing moved nothing is touched. Flicker of single photographs and ambient
    light that all pairs show alike are taken off. Pictures of it all are kept for the report.

    Args:
        out: processed folder; pictures go to its work/diagnosis.
        camera_id: who photographed.
        patterns: P names.
        images: (P, h, w, 3) halves or floats on any common scale, ambient light of a dark frame
            taken off.
        usable: (h, w) bool, nothing clipped and all finite.
        session: its rig, what was driven.
        config: see there.
        recipes: missing patterns of this camera.
        pictures: small ones of `images`, with cells of `cell_px`, where they are there already;
            those of photographs that are changed here are made anew.

    Returns:
        Facts, JSON-ready: ``changed`` patterns, ``displaced_px`` and ``aligned`` patterns,
        ``flicker``, ``ambient`` share of full by colour, ``pairs_apart``, ``left`` per axis,
        ``looks_like``, ``rebuilt``, ``sums_compared``, ``contradictions`` in words.

    Raises:
        FormatError: photographs that do not add up as their patterns do, unless forced.
    """
    names = tuple(patterns)
    fill(images, names, dict(recipes))
    scale = px_per_mm(session.rig.camera(camera_id))
    cell = cell_px(usable.shape, scale, config)
    known = {} if pictures is None else pictures.small
    view = View(images, usable, names, cell, scale, {n: p for n, p in known.items() if n in names})
    view.look([name for name in names if name not in known or name in recipes])
    view.changed.update(recipes)
    facts: dict[str, Any] = {
        "rebuilt": sorted(recipes),
        "displaced_px": {},
        "aligned": [],
        "flicker": {},
        "ambient": None,
        "pairs_apart": None,
        "left": {},
        "looks_like": {},
    }
    diagnosis = Diagnosis(view.small[names[0]], 1 - view.free.astype(np.float32))
    groups = _groups(session, names, recipes)
    compared, faults = compare_sums(view, groups, session, camera_id)
    if faults and not config.forced:
        raise one_error(faults)
    facts |= {"sums_compared": compared, "contradictions": [str(fault) for fault in faults]}
    for place, (whole, pairs) in enumerate(groups.items()):
        if not place:
            diagnosis.whole = view.small[whole]
        gradients = [name for pair in pairs for name in (pair.first, pair.second)]
        found = wrong_patterns(view.small, whole, gradients, view.free, session, camera_id)
        facts["looks_like"] |= found[0]
        diagnosis.unlike |= found[1]
        diagnosis.residuals |= {pair.axis: residual(view.small, pair) for pair in pairs}
        good = [pair for pair in pairs if not {pair.first, pair.second} & set(found[0])]
        if good:
            _align(view, good, config, facts)
            _even_out(view, good, config, facts, diagnosis)
    if recipes and (facts["aligned"] or facts["flicker"] or diagnosis.ambient is not None):
        fill(images, names, dict(recipes))
    write_diagnosis(out, camera_id, diagnosis)
    facts["changed"] = sorted(view.changed)
    return facts


def compare_sums(
    view: View, groups: Mapping[str, Sequence[Pair]], session: Session, camera_id: str
) -> tuple[int, list[LightstageError]]:
    """Whether photographs add up as their levels do, before anything about them is mended.

    Args:
        view: as decoded.
        groups: pairs by their whole.
        session: whose.
        camera_id: who photographed.

    Returns:
        How many sums were compared, and an error for each that is off by more than
        `formats.sums.SUM_TOLERANCE`.
    """
    names = [n for n in view.names if n not in view.changed]
    checked = [Balance((p.first, p.second), (p.whole,)) for ps in groups.values() for p in ps]
    checked += axes_alike({name: session.levels(name) for name in names})
    faults: list[LightstageError] = []
    for balance in checked:
        # All of both sides is lit somewhere: what is bright in any of them is compared.
        brightest = np.maximum.reduce([view.small[name] for name in balance.patterns])
        lit = lit_cells(brightest, view.free)
        if not lit.any():
            continue
        left, right = (
            sum(float(mean_colour(view.small[name][lit]).mean()) for name in side)
            for side in (balance.left, balance.right)
        )
        fault = sum_fault(session.root, camera_id, balance, left, right, FORCE)
        if fault is not None:
            faults.append(fault)
    return len(checked), faults


def cell_px(shape: tuple[int, int], scale: float, config: PrepareConfig) -> int:
    """Pixels a cell of the small pictures.

    Args:
        shape: rows and columns of the photographs.
        scale: their pixels a millimetre.
        config: see there.
    """
    return cell_side(shape, scale / config.cells_per_mm)


def prepare_warnings(facts: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What a user should know of the views' facts, most cameras in one sentence.

    Args:
        facts: camera to what `prepare_view` returned.
    """
    out: dict[str, list[str]] = {}
    for camera, own in facts.items():
        sentences = [
            f"{a} looks like {b}: was another pattern lit?" for a, b in own["looks_like"].items()
        ]
        if own["aligned"]:
            sentences.append(
                "the subject moved between shots; " + ", ".join(own["aligned"]) + " aligned"
            )
        sentences += [
            f"{name} was {gain:.3g} times as bright" for name, gain in own["flicker"].items()
        ]
        apart, ambient = own["pairs_apart"], own["ambient"]
        if ambient is not None and max(map(abs, ambient)) > WARN_AMBIENT:
            share = 100 * float(np.mean(ambient))
            sentences.append(
                f"about {share:.1f} % of full is no lamp's light"
                if share >= 0
                else f"gradients and their complements together lack {-share:.1f} % of full"
            )
        if apart is not None and apart > WARN_APART:
            sentences.append("pairs do not sum to full alike: see the pictures of light and motion")
        for sentence in sentences:
            out.setdefault(sentence, []).append(camera)
    return [f"{', '.join(cameras)}: {sentence}" for sentence, cameras in out.items()]


class View:
    """One camera's photographs, to be changed in place, with small pictures of them.

    Attributes:
        images: (P, h, w, 3).
        usable: (h, w) bool.
        names: P patterns.
        cell_px: pixels a cell of the small pictures.
        px_per_mm: pixels a millimetre.
        small: pattern to (h', w', 3) float32, finite.
        free: (h', w') bool, cells all of whose pixels are usable.
        changed: names of photographs that were changed.
    """

    def __init__(
        self,
        images: np.ndarray,
        usable: np.ndarray,
        names: tuple[str, ...],
        cell_px: int,
        px_per_mm: float,
        small: dict[str, np.ndarray],
    ) -> None:
        self.images, self.usable, self.names = images, usable, names
        self.cell_px, self.px_per_mm, self.small = cell_px, px_per_mm, small
        self.free = free_cells(usable, cell_px)
        self.changed: set[str] = set()

    def look(self, names: Sequence[str]) -> None:
        """Make small pictures of some patterns anew."""
        self.free = free_cells(self.usable, self.cell_px)
        for name in names:
            self.small[name] = shrunk(self.images[self.names.index(name)], self.cell_px)


def _groups(
    session: Session, names: Sequence[str], recipes: Mapping[str, Recipe]
) -> dict[str, list[Pair]]:
    """Pairs by their whole; a rebuilt photograph has no evidence of its own."""
    groups: dict[str, list[Pair]] = {}
    for pair in pairs_of(session):
        three = {pair.first, pair.second, pair.whole}
        if three <= set(names) and not three & set(recipes):
            groups.setdefault(pair.whole, []).append(pair)
    return groups


def _align(view: View, pairs: Sequence[Pair], config: PrepareConfig, facts: dict[str, Any]) -> None:
    """Place the photographs that moved upon the whole."""
    flows: dict[int, Flow] = {}
    for pair in pairs:
        three = [mean_colour(view.small[n]) for n in (pair.first, pair.second, pair.whole)]
        motion = solve_pair(
            three[0],
            three[1],
            three[2],
            view.free,
            cell_px=view.cell_px,
            px_per_mm=view.px_per_mm,
            still_px=config.still_px,
        )
        if motion is None:
            continue
        believed = motion.after < (1 - config.least_explained) * motion.before
        sides = ((pair.first, motion.first), (pair.second, motion.second))
        for (name, flow), rms in zip(sides, motion.rms_px, strict=True):
            facts["displaced_px"][name] = round(rms, 3)
            if believed and rms > config.still_px:
                flows[view.names.index(name)] = flow
    if flows:
        warp(view.images, flows, view.usable)
        moved = [view.names[row] for row in sorted(flows)]
        facts["aligned"] += moved
        view.changed.update(moved)
        view.look(moved)


def _even_out(
    view: View,
    pairs: Sequence[Pair],
    config: PrepareConfig,
    facts: dict[str, Any],
    pictures: Diagnosis,
) -> None:
    """Take off flicker, and ambient light where all pairs show it alike."""
    fit = fit_sums(view.small, pairs, view.free, config.least_flicker)
    if fit is None:
        return
    changed = {name: gain for name, gain in fit.flicker.items() if gain != 1}
    for name, gain in changed.items():
        row = view.names.index(name)
        view.images[row] = np.asarray(view.images[row], np.float32) * np.float32(gain)
    view.changed.update(changed)
    facts["flicker"] |= {name: round(1 / gain, 4) for name, gain in changed.items()}
    facts["left"] |= {axis: round(left, 5) for axis, left in fit.left.items()}
    share = float(fit.ambient.mean())
    if facts["ambient"] is None or share > float(np.mean(facts["ambient"])):
        facts["ambient"] = [round(float(x), 5) for x in fit.ambient]
    facts["pairs_apart"] = round(max(fit.apart, facts["pairs_apart"] or 0.0), 5)
    sigma = config.ambient_sigma_mm * view.px_per_mm / view.cell_px
    ratio = ambient_ratio(view.small, pairs, view.free, fit.flicker, sigma)
    pictures.ambient = ratio
    if share > config.least_ambient and fit.apart < ALIKE * share:
        _take_off(view, pairs[0].whole, ratio)


def _take_off(view: View, whole: str, ratio: np.ndarray) -> None:
    """Subtract `ratio` times the whole from every photograph of its kind."""
    height, width = view.usable.shape
    ambient = cv2.resize(ratio, (width, height), interpolation=cv2.INTER_LINEAR)
    ambient *= np.asarray(view.images[view.names.index(whole)], np.float32)
    kind = whole.partition("@")[2]
    for row, name in enumerate(view.names):
        if name.partition("@")[2] == kind:
            view.images[row] = np.asarray(view.images[row], np.float32) - ambient
            view.changed.add(name)
