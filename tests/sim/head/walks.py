"""Closed loops of a mesh of quads, found by walking over it, whatever made it."""

from __future__ import annotations

import numpy as np

from lightstage.formats.mesh import Mesh


def closed_strips(mesh: Mesh) -> list[np.ndarray]:
    """Closed rows of quads: through each quad from one edge to the opposite one.

    Returns:
        For each row the (k, 3) middles of its quads, in order.
    """
    beside: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for quad, corners in enumerate(mesh.faces.tolist()):
        for side in range(4):
            ends = corners[side], corners[(side + 1) % 4]
            beside.setdefault((min(ends), max(ends)), []).append((quad, side))
    edge_of = {place: edge for edge, places in beside.items() for place in places}
    done: set[tuple[int, int]] = set()
    found = []
    for first in sorted(edge_of):
        if first[1] > 1 or first in done:
            continue
        quad, side = first
        strip = []
        while True:
            strip.append(quad)
            done.add((quad, side % 2))
            beyond = edge_of[quad, (side + 2) % 4]
            others = [place for place in beside[beyond] if place[0] != quad]
            if not others:
                strip = []
                break
            quad, side = others[0]
            if (quad, side % 2) == (first[0], first[1] % 2) and quad == first[0]:
                break
            if (quad, side % 2) in done:
                strip = []
                break
        if strip:
            found.append(mesh.vertices[mesh.faces[strip]].mean(axis=1))
    return found


def closed_lines(mesh: Mesh) -> list[np.ndarray]:
    """Closed lines of edges: straight on through vertices of four edges.

    Returns:
        For each line its (k,) vertices, in order.
    """
    around: dict[int, set[int]] = {}
    with_both: dict[tuple[int, int], set[int]] = {}
    for corners in mesh.faces.tolist():
        for side in range(4):
            one, two = corners[side], corners[(side + 1) % 4]
            around.setdefault(one, set()).add(two)
            around.setdefault(two, set()).add(one)
            for at, other in ((one, corners[side - 1]), (two, corners[(side + 2) % 4])):
                far = two if at == one else one
                with_both.setdefault((at, far), set()).add(other)
    done: set[tuple[int, int]] = set()
    found = []
    for first in sorted((a, b) for a, others in around.items() for b in others if a < b):
        if first in done:
            continue
        before, here = first
        line = [before]
        while True:
            done.add((min(before, here), max(before, here)))
            if len(around[here]) != 4 or len(with_both[here, before]) != 2:
                line = []
                break
            (after,) = around[here] - {before} - with_both[here, before]
            line.append(here)
            before, here = here, after
            if (before, here) == first:
                break
        if line:
            found.append(np.array(line[:-1]))
    return found


def surrounding(loops: list[np.ndarray], centre: np.ndarray, within_mm: float) -> list[int]:
    """Those of closed loops (k, 3) mm that surround a place, seen from the front, and are near."""
    chosen = []
    for number, loop in enumerate(loops):
        beside = loop - centre
        if np.linalg.norm(beside, axis=1).max() > within_mm:
            continue
        angle = np.unwrap(np.arctan2(*beside[[*range(len(beside)), 0], :2].T[::-1]))
        if round(abs(angle[-1] - angle[0]) / (2 * np.pi)) == 1:
            chosen.append(number)
    return chosen
