"""Non-rigid ICP: the template's vertices drawn onto the scan by a smooth displacement field.

Amberg's optimal step [Amberg2007], an exact solve for given closest points under a stiffness that
is annealed, with his per-vertex affine maps replaced by displacements under a thin-plate energy,
and his distance to points by the distance to tangent planes, along which the mesh slides freely.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from processing.registration.both_ways import BothWays
from processing.registration.coarse import coarsened
from processing.registration.config import NonrigidConfig
from processing.registration.flips import Faults, corners_of, grown, mend
from processing.registration.matches import Matches
from processing.registration.plate import Plate, Springs, contradicted
from processing.registration.sheet import Sheet
from processing.registration.target import Target


@dataclasses.dataclass(frozen=True)
class Fit:
    """What non-rigid ICP found.

    Attributes:
        vertices: (n, 3) mm.
        matched: (n,) bool, vertices that had a closest point within the gates at the end.
        distance_mm: (n,) of each vertex to the scan.
        contradicted: (m,) bool, landmarks left out because all others contradict them.
        faulty: (t,) bool, triangles that are still folded over or cross others.
        mended: how many were before mending.
        rounds: of closest points.
        residual: the worst relative residual of a linear solve.
        kept_share: of all closest points that were needed, those known from a round before.
    """

    vertices: np.ndarray
    matched: np.ndarray
    distance_mm: np.ndarray
    contradicted: np.ndarray
    faulty: np.ndarray
    mended: int
    rounds: int
    residual: float
    kept_share: float


def fit_nonrigid(
    rest: np.ndarray,
    triangles: np.ndarray,
    target: Target,
    landmark_vertices: np.ndarray,
    landmarks_mm: np.ndarray,
    config: NonrigidConfig,
    *,
    free: np.ndarray | None = None,
    hidden: np.ndarray | None = None,
    intricate: np.ndarray | None = None,
    both_ways: np.ndarray | None = None,
    in_place: np.ndarray | None = None,
    progress: ProgressCallback = quiet,
) -> Fit:
    """Draw a mesh onto a scan.

    Args:
        rest: (n, 3) mm, roughly aligned.
        triangles: (t, 3).
        target: the scan.
        landmark_vertices: (m,) indices into `rest`.
        landmarks_mm: (m, 3), finite.
        config: settings.
        free: (n,) bool, vertices that never follow the scan.
        hidden: (n,) bool, vertices that follow cavities of the scan only (inside of the mouth).
        intricate: (n,) bool, vertices that follow its coarse shape only (ears).
        both_ways: (n,) bool, vertices of thin and folded parts, roughly in their places: the
            scan's points draw them too.
        in_place: (n,) bool, those of them that are in their places to begin with. Stiffnesses that
            do not match both ways hold them there: landmarks nearby would carry them away.
        progress: called once a round.

    Returns:
        Fit.

    Raises:
        RegistrationError: a template without area.
    """
    none = np.zeros(len(rest), bool)
    thin = none if both_ways is None else both_ways
    placed = none if in_place is None else in_place
    fine = Sheet.of(
        rest,
        triangles,
        target,
        landmark_vertices,
        config.plate,
        config.gate,
        allowed=~none if free is None else ~free,
        hidden=none if hidden is None else hidden,
        stiff=none if intricate is None else intricate,
    )

    def drawn_both_ways(sheet: Sheet, faces: np.ndarray, chosen: np.ndarray) -> BothWays:
        areas = sheet.plate.areas
        return BothWays(sheet.rest, faces, chosen, areas, target, config.both_ways)

    sheet, coarse, sheets = fine, None, [fine]
    held = np.flatnonzero(placed)
    if config.coarse_cell_mm > 0:
        coarse = coarsened(rest, triangles, config.coarse_cell_mm, landmark_vertices)
        sheet = fine.coarsened(coarse)
        sheets.append(sheet)
        both = drawn_both_ways(sheet, coarse.triangles, thin[coarse.chosen])
        held = np.flatnonzero(placed[coarse.chosen])
    else:
        both = drawn_both_ways(fine, triangles, thin)
    faults = Faults(rest, triangles, target)
    offset = landmarks_mm - rest[landmark_vertices]
    wrong = np.zeros(len(offset), bool)
    moved = np.zeros_like(sheet.rest)
    yields = np.ones(len(rest))
    floor = config.noise_times * target.noise_mm()
    levels = [size for size in config.stiffness_mm if size >= floor] or [config.stiffness_mm[0]]
    total, rounds = len(levels) * config.iterations, 0

    def pulled(stiffness: float) -> tuple[Springs, Matches]:
        followed = sheet.allowed.copy()
        hold = stiffness > config.both_ways.from_mm
        followed[both.vertices] &= hold
        if stiffness < config.intricate_stiffness_mm:
            followed &= ~sheet.stiff
        if hold:
            followed[held] = False
        matches = sheet.matcher.match(sheet.rest + moved, stiffness)
        springs = _matched(sheet.plate, matches, followed, sheet.rest, moved, stiffness, config)
        both.draw(springs, sheet.rest, moved, stiffness)
        if hold:
            pull = _point_stiffness(config.landmark_pull, stiffness) * np.eye(3)
            springs.add(held, np.tile(pull, (len(held), 1, 1)), np.zeros((len(held), 3)))
        if sheet is fine:
            springs.scale(yields)
        return springs, matches

    for level, stiffness in enumerate(levels):
        if coarse is not None and stiffness < config.coarse_above_mm:
            moved = fine.carried(coarse, moved, config.coarse_cell_mm)
            sheet, coarse, held = fine, None, np.flatnonzero(placed)
            both = drawn_both_ways(fine, triangles, thin)
        for turn in range(config.iterations):
            springs, matches = pulled(stiffness)
            if turn == 0 and level == 1:
                sheet.plate.stiffen(stiffness, springs)
                wrong = _wrong_landmarks(
                    sheet.plate, springs, sheet.marks, offset, stiffness, config
                ) | hovering(landmarks_mm, target, config)
            kept = ~wrong
            _pull_landmarks(springs, matches, sheet.marks[kept], offset[kept], stiffness, config)
            if turn == 0:
                sheet.plate.stiffen(stiffness, springs)
            before, moved = moved, sheet.plate.solve(springs, moved)
            rounds += 1
            progress(min(level * config.iterations + turn + 1, total - 1), total)
            if sheet is fine:
                folded = corners_of(faults.folded(rest + moved), triangles, len(rest))
                yields[grown(folded, triangles, 1)] *= config.yield_times
            if np.abs(moved - before).max() < config.still_mm:
                break
    if coarse is not None:
        moved = fine.carried(coarse, moved, config.coarse_cell_mm)
        sheet, both = fine, drawn_both_ways(fine, triangles, thin)
    for turn in range(config.unfold_rounds):
        faulty = faults.all(rest + moved)
        if not faulty.any():
            break
        near = grown(corners_of(faulty, triangles, len(rest)), triangles, 1 + turn // 3)
        yields[near] *= config.yield_times
        springs, matches = pulled(levels[-1])
        _pull_landmarks(springs, matches, fine.marks[~wrong], offset[~wrong], levels[-1], config)
        fine.plate.stiffen(levels[-1], springs)
        moved = fine.plate.solve(springs, moved)
        rounds += 1
    progress(total, total)
    vertices, faulty, mended = mend(faults, rest + moved, triangles, rounds=config.mend_rounds)
    matches = fine.matcher.match(vertices, levels[-1])
    return Fit(
        vertices,
        fine.allowed & matches.follows,
        matches.closest.distance_mm,
        wrong,
        faulty,
        mended,
        rounds,
        max(one.plate.worst_residual for one in sheets),
        sum(one.matcher.kept for one in sheets) / sum(one.matcher.queried for one in sheets),
    )


def _matched(
    plate: Plate,
    matches: Matches,
    followed: np.ndarray,
    rest: np.ndarray,
    moved: np.ndarray,
    stiffness_mm: float,
    config: NonrigidConfig,
) -> Springs:
    """Springs onto the tangent planes of closest points, and to the scan's border."""
    springs = Springs.none(len(rest))
    chosen = np.flatnonzero(matches.follows & followed)
    normal = matches.closest.normal[chosen]
    gap = np.einsum(
        "nk,nk->n", matches.closest.point[chosen] - rest[chosen] - moved[chosen], normal
    )
    across = normal[:, :, None] * normal[:, None, :]
    matrix = (1 - config.hold) * across + config.hold * np.eye(3)
    springs.add(
        chosen,
        plate.areas[chosen, None, None] * matrix,
        moved[chosen] + gap[:, None] * normal,
    )
    if stiffness_mm < config.settled_below_mm:
        # Holes and what is beyond the scan's border are the plate's to bridge.
        loose = np.flatnonzero(~(matches.follows & followed) & ~matches.closest.border)
        held = config.hold * plate.areas[loose, None, None] * np.eye(3)
        springs.add(loose, held, moved[loose])
    here = followed[matches.border]
    border = matches.border[here]
    # A border counts as a strip as wide as the stiffness.
    area = plate.areas[border]
    strip = 2 * np.maximum(area, np.sqrt(area) * stiffness_mm)
    springs.add(
        border,
        strip[:, None, None] * np.eye(3),
        matches.border_mm[here] - rest[border],
    )
    return springs


def _point_stiffness(times: float, stiffness_mm: float) -> float:
    """mm^2 of a spring that pulls a point so many times as hard as the plate resists."""
    return times * 8 * stiffness_mm**2


def _pull_landmarks(
    springs: Springs,
    matches: Matches,
    vertices: np.ndarray,
    offset: np.ndarray,
    stiffness_mm: float,
    config: NonrigidConfig,
) -> None:
    fine = stiffness_mm < config.fine_mm
    pull = _point_stiffness(config.fine_pull if fine else config.landmark_pull, stiffness_mm)
    matrix = np.tile(pull * np.eye(3), (len(vertices), 1, 1))
    if fine:
        normal = matches.closest.normal[vertices] * matches.follows[vertices, None]
        matrix -= pull * normal[:, :, None] * normal[:, None, :]
    for k in range(len(vertices)):  # one at a time: two landmarks may share a vertex
        springs.add(vertices[k : k + 1], matrix[k : k + 1], offset[k : k + 1])


def _wrong_landmarks(
    plate: Plate,
    springs: Springs,
    vertices: np.ndarray,
    offset: np.ndarray,
    stiffness_mm: float,
    config: NonrigidConfig,
) -> np.ndarray:
    """(m,) bool: landmarks that the scan and all other landmarks contradict."""
    count = len(vertices)
    unit = np.zeros((len(springs.pull), count))
    unit[vertices, np.arange(count)] = 1
    answers = plate.smooth(np.concatenate([springs.pull, unit], axis=1))[vertices]
    reach = answers[:, 3:] + np.eye(count) / (config.landmark_pull * 8 * stiffness_mm**2)
    return contradicted(
        offset - answers[:, :3], reach, config.contradicted_mm, config.contradicted_times
    )


def hovering(landmarks_mm: np.ndarray, target: Target, config: NonrigidConfig) -> np.ndarray:
    """(m,) bool: landmarks off the scan, where it has no hole; they name a place of its surface."""
    closest = target.closest(landmarks_mm)
    typical = float(np.median(closest.distance_mm)) if len(landmarks_mm) else 0.0
    limit = max(config.off_surface_mm, config.off_surface_times * typical)
    far: np.ndarray = (closest.distance_mm > limit) & ~closest.border
    return far
