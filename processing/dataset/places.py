"""Where the patches of a scan are that may be published: apart, off any common grid, small.

Neighbouring patches are a gap apart, each drawn somewhere in its own cell, and each is turned and
mirrored at random with its own axes for directions, so that no edge shows which edge it was beside.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from processing.dataset.store import Store

STRIP_ROWS = 512
"""Rows that are measured at a time."""
LARGEST_TEXEL = 16.0
"""A texel that spans more than this many times the median crosses the texture's border or a seam:
it counts so much."""
REACH = 0.75
"""Share of texels that a proposed size is chosen for; the others are stretched more."""
CLEAR = 1 / 8
"""Side of a square of skin without a gap, as a share of a patch's side: 3 to 5 mm of a face."""


@dataclasses.dataclass(frozen=True)
class Place:
    """One patch: where it is, and how it is turned before it is published.

    Attributes:
        scan: index in the store.
        row: of the top-left texel.
        column: of the top-left texel.
        face_share: what its clear skin is of the scan's measured skin, by area on the surface.
        quarter_turns: counter-clockwise, 0 to 3.
        mirrored: flipped left to right, after the turns.
        axes: (3, 3) that takes directions of the head frame to the patch's own; orthogonal, with
            determinant -1 where the patch is mirrored.
    """

    scan: int
    row: int
    column: int
    face_share: float
    quarter_turns: int
    mirrored: bool
    axes: np.ndarray


@dataclasses.dataclass(frozen=True)
class Layout:
    """Distances between patches.

    Attributes:
        size: side of a patch in texels.
        gap: fewest texels between two patches.
        wander: most texels by which a patch is off its cell's corner, each way.
        min_coverage: smallest share of a patch's texels that are clear skin.
        turned: whether patches are turned and mirrored at random, and their directions with them.
    """

    size: int
    gap: int
    wander: int
    min_coverage: float
    turned: bool = True


def texel_areas_mm2(store: Store, scan: int) -> np.ndarray:
    """Area of each texel on the surface, from the positions of its neighbours.

    Returns:
        (rows, columns) float32 mm2; 0 where no skin was measured.
    """
    info = store.scans[scan]
    area = np.zeros((info.rows, info.columns), np.float32)
    for first in range(0, info.rows, STRIP_ROWS):
        # One row more than is written: a texel reaches to the next.
        rows = slice(first, min(info.rows, first + STRIP_ROWS + 1))
        seen = store.read(scan, "confidence", rows, slice(None))[:, :, 0] > 0
        position = store.read(scan, "position", rows, slice(None))
        whole = seen[:-1, :-1] & seen[1:, 1:] & seen[:-1, 1:] & seen[1:, :-1]
        down = position[1:, 1:] - position[:-1, :-1]
        up = position[:-1, 1:] - position[1:, :-1]
        size = 0.5 * np.linalg.norm(np.cross(down, up), axis=2)
        area[first : first + len(size), :-1] = np.where(whole, size, 0)
    there = area > 0
    if there.any():
        middle = float(np.median(area[there]))
        np.minimum(area, LARGEST_TEXEL * middle, out=area)
        # A texel at the border of what was measured counts as most others do.
        seen = store.read(scan, "confidence", slice(None), slice(None))[:, :, 0] > 0
        area[seen & ~there] = middle
    return area


def places_of(store: Store, scan: int, layout: Layout) -> list[Place]:
    """Every place of a scan that shows enough clear skin, whatever the share of the face.

    All scans of a person have the same places, in every release: patches of two expressions or of
    two releases that overlapped would stitch together what the gap keeps apart. What is drawn
    follows from the SHA-256 of the maps of the person's neutral scan, which nobody knows who does
    not have the maps.

    Args:
        store: the lab's store.
        scan: index in it.
        layout: distances.

    Returns:
        Places in row order; empty where the maps are smaller than a patch.
    """
    info, size = store.scans[scan], layout.size
    rng = np.random.default_rng(_secret_of(store, info.subject))
    seen = store.read(scan, "confidence", slice(None), slice(None))[:, :, 0] > 0
    area = texel_areas_mm2(store, scan)
    face = max(float(area.sum(dtype=float)), 1e-9)
    # At least one texel must be measured, or a patch would have no mean to remove.
    fewest = max(layout.min_coverage * size**2, 0.5)
    pitch = size + layout.gap + layout.wander
    start = rng.integers(-pitch, 1, 2)
    found = []
    for corner_row in range(int(start[0]), info.rows, pitch):
        for corner_column in range(int(start[1]), info.columns, pitch):
            # Drawn for every cell, so that what one shows does not move the others.
            off = rng.integers(0, layout.wander + 1, 2)
            row, column = corner_row + int(off[0]), corner_column + int(off[1])
            turns, mirrored = int(rng.integers(4)), bool(rng.integers(2))
            axes = _random_axes(rng, mirrored)
            inside = 0 <= row <= info.rows - size and 0 <= column <= info.columns - size
            if not inside:
                continue
            here = slice(row, row + size), slice(column, column + size)
            clear = clear_skin(seen[here])
            if clear.sum() < fewest:
                continue
            share = float(area[here][clear].sum(dtype=float)) / face
            if not layout.turned:
                turns, mirrored, axes = 0, False, np.eye(3)
            found.append(Place(scan, row, column, share, turns, mirrored, axes))
    return found


def size_that_shows(store: Store, most: float) -> int:
    """Side of a patch, in texels, that shows at most a share of the face at most places.

    Args:
        store: the lab's store; the scan that requires the smallest patch decides.
        most: share of a scan's measured skin.

    Returns:
        Texels, at least 1; a multiple of 8 where it is more than that.
    """
    sizes = []
    for scan in store.scans:
        area = texel_areas_mm2(store, scan.index)
        there = area[area > 0]
        if len(there):
            sizes.append(np.sqrt(most * there.sum() / np.quantile(there, REACH)))
    size = int(min(sizes, default=1))
    return max(1, size // 8 * 8 if size >= 8 else size)


def clear_skin(measured: np.ndarray) -> np.ndarray:
    """Texels of a patch that are in a square of measured skin without a gap.

    Between the hairs of a beard single texels are skin. They are too small for a texture, and
    their outline draws the hair.

    Args:
        measured: (size, size) bool, where skin was measured.

    Returns:
        (size, size) bool.
    """
    # Odd, so that the square has a middle and a turned patch has the same texels.
    side = int(CLEAR * len(measured)) | 1
    square = np.ones((side, side), np.uint8)
    # What is beyond the patch is not published and makes no square whole.
    middles = cv2.erode(
        measured.astype(np.uint8), square, borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    return np.asarray(cv2.dilate(middles, square) > 0)


def turned(patch: np.ndarray, place: Place) -> np.ndarray:
    """A patch's picture as it is published: (size, size, c), turned and mirrored."""
    picture = np.rot90(patch, place.quarter_turns)
    return picture[:, ::-1] if place.mirrored else picture


def _secret_of(store: Store, subject: str) -> int:
    """What a person's places are drawn with: of the neutral scan, of the first where none is."""
    own = [scan for scan in store.scans if scan.subject == subject]
    chosen = next((scan for scan in own if scan.expression == "neutral"), own[0])
    return int(chosen.sha256, 16)


def _random_axes(rng: np.random.Generator, mirrored: bool) -> np.ndarray:
    """(3, 3) uniform rotation from a random quaternion, after x is mirrored where wanted."""
    w, x, y, z = (lambda q: q / np.linalg.norm(q))(rng.normal(size=4))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rotation @ np.diag([-1.0 if mirrored else 1.0, 1, 1])
