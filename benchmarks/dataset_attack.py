"""An attack on published patches: find each patch's neighbour by what both show at their edges.

The attacker has the published arrays alone, and other people's patches with known places to learn
from. Of every patch all eight ways of turning and mirroring it are tried. What is compared are
colour, gloss, directions and shape along two edges and what both make of the gap between them; how
much each of these counts is learnt by a small network.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from processing.dataset.places import Layout, Place

BINS = 32
"""Samples along an edge."""
DEPTHS = 4
"""Bands of `BAND` texels of 128 that an edge's slope is taken from."""
BAND = 4
NEGATIVES = 60
"""Wrong neighbours that are learnt from beside each right one."""
STEPS = 600


@dataclasses.dataclass(frozen=True)
class Patches:
    """Published patches and, to judge by, where they were.

    Attributes:
        maps: by name (n, size, size, c) float32.
        places: of each.
        person: (n,) int.
        layout: distances that they were published with; published as well.
    """

    maps: dict[str, np.ndarray]
    places: list[Place]
    person: np.ndarray
    layout: Layout


def oriented(image: np.ndarray, turns: int, mirrored: bool) -> np.ndarray:
    """(n, s, s, c) patches turned counter-clockwise by quarter turns, then mirrored."""
    image = np.rot90(image, turns, axes=(1, 2))
    return image[:, :, ::-1] if mirrored else image


def left_edges(patches: Patches, turns: int, mirrored: bool) -> dict[str, np.ndarray]:
    """What is along the left edge from top to bottom, and what it becomes in the gap.

    Returns:
        Profiles (n, BINS, c): `colour` (log albedo and gloss), `normal`, `place`, the same with
        `_on` carried on to the middle of the gap, and `bend`, how the normal turns outward.
    """
    flip = np.array([-1.0 if mirrored else 1.0, 1, 1], np.float32)
    albedo = np.log(np.maximum(patches.maps["diffuse_albedo"], 0.01))
    gloss = 30 * patches.maps["specular_albedo"]
    colour = _bands(oriented(np.concatenate([albedo, gloss], axis=3), turns, mirrored))
    normal = _bands(oriented(patches.maps["specular_normal"] * flip, turns, mirrored))
    place = _bands(oriented(patches.maps["shape"] * flip, turns, mirrored))
    normal /= np.maximum(np.linalg.norm(normal, axis=3, keepdims=True), 1e-6)
    size, layout = patches.layout.size, patches.layout
    # In bands, from the middle of the first band to the middle of the gap.
    ahead = 0.5 + 0.5 * (layout.gap + layout.wander) / (BAND * size / 128)
    outward = _unit(place[:, 0] - place[:, -1])
    normal_on, place_on = _carried(normal, ahead), _carried(place, ahead)
    return {
        "colour": colour[:, 0],
        "colour_on": _carried(colour, ahead),
        "normal": normal[:, 0],
        "normal_on": normal_on,
        "place": place[:, 0],
        "place_on": place_on,
        "bend": ((normal_on - normal[:, 0]) * outward).sum(axis=2, keepdims=True),
    }


def reversed_edges(edges: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same edges from bottom to top."""
    return {name: values[:, ::-1] for name, values in edges.items()}


def described(edges: dict[str, np.ndarray], turned: bool) -> dict[str, np.ndarray]:
    """Edges as they are compared: places about their middle, in axes of their own where turned."""
    edges = dict(edges)
    for on in ("", "_on"):
        normal, place = f"normal{on}", f"place{on}"
        # Each patch's mean was taken away: an edge's height shows nothing, its form does.
        edges[place] = edges[place] - edges[place].mean(axis=1, keepdims=True)
        if turned:
            along = edges[place][:, -8:].mean(axis=1) - edges[place][:, :8].mean(axis=1)
            up = _unit(edges[normal].mean(axis=1))
            across = _unit(np.cross(along, up))
            axes = np.stack([_unit(np.cross(up, across)), up, across], axis=2)
            edges[normal] = edges[normal] @ axes
            edges[place] = edges[place] @ axes
    return edges


def features(ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray], shift: int) -> np.ndarray:
    """Differences of n edges to n others, each to each.

    Args:
        ours: described, (n, BINS, c).
        theirs: described, (n, BINS, c).
        shift: most bins by which two edges may be off each other.

    Returns:
        (n, n, f) float32: for each kind of profile the logarithm of the difference of the means,
        of that of the course along the edge at the best shift, and of that of its steps.
    """
    columns = []
    for name, first in ours.items():
        second = theirs[name]
        columns.append(_distances(first.mean(axis=1), second.mean(axis=1)))
        course = steps = np.full((len(first), len(second)), np.inf)
        for by in range(-shift, shift + 1):
            a = first[:, max(0, by) : BINS + min(0, by)]
            b = second[:, max(0, -by) : BINS + min(0, -by)]
            a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
            course = np.minimum(course, _distances(a, b))
            steps = np.minimum(steps, _distances(np.diff(a, axis=1), np.diff(b, axis=1)))
        columns += [course, steps]
    return np.log(np.stack(columns, axis=2) + 1e-4).astype(np.float32)


def _distances(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n, n) root mean square differences of (n, ..) each to each."""
    a, b = first.reshape(len(first), -1), second.reshape(len(second), -1)
    squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return np.asarray(np.sqrt(np.maximum(squares, 0) / a.shape[1]))


@dataclasses.dataclass(frozen=True)
class Joined:
    """How often the attacker was right about an edge's neighbour.

    Attributes:
        tried: edges that have one.
        right: the true neighbour was put first.
        early: it was among the first ten.
        person: the first was at least of the same person.
        chance: of a right answer, by drawing one of all others.
    """

    tried: int
    right: int
    early: int
    person: int
    chance: float


def join(halves: tuple[Patches, Patches]) -> Joined:
    """Each half of the people is attacked after the attacker learnt from the other."""
    right = early = person = tried = 0
    chance = 0.0
    for known, attacked in (halves, halves[::-1]):
        matcher = Matcher(known, np.random.default_rng(0))
        edges = Edges(attacked)
        scores = [matcher.scores(edges.compare(side)[0]).max(axis=0) for side in (0, 1)]
        for index, other, side in neighbours(attacked):
            row = scores[side][index].copy()
            row[index] = -np.inf
            order = np.argsort(-row)
            right += int(order[0] == other)
            early += int(other in order[:10])
            person += int(attacked.person[order[0]] == attacked.person[index])
            chance += 1 / (len(row) - 1)
            tried += 1
    return Joined(tried, right, early, person, chance / max(1, tried))


def neighbours(patches: Patches) -> list[tuple[int, int, int]]:
    """(patch, its neighbour, 0 for right, 1 for below) of all pairs in neighbouring cells."""
    layout = patches.layout
    rows = np.array([place.row for place in patches.places])
    columns = np.array([place.column for place in patches.places])
    least, most = layout.size + layout.gap, layout.size + layout.gap + 2 * layout.wander
    found = []
    for index in range(len(rows)):
        down, right = rows - rows[index], columns - columns[index]
        same = patches.person == patches.person[index]
        for side, (far, aside) in enumerate(((right, down), (down, right))):
            near = same & (far >= least) & (far <= most) & (abs(aside) <= layout.wander)
            found += [(index, int(other), side) for other in np.flatnonzero(near)]
    return found


class Matcher:
    """Learns from people with known places which of two edges belong together."""

    def __init__(self, patches: Patches, rng: np.random.Generator) -> None:
        """Train on all neighbours in `patches`."""
        edges = Edges(patches)
        right, wrong = [], []
        for side in (0, 1):
            rows, ways = edges.compare(side)
            for index, other, its_side in neighbours(patches):
                if its_side != side:
                    continue
                right.append(rows[ways.index(edges.upright(other, side)), index, other])
                some = rng.integers(0, len(patches.person), NEGATIVES)
                some = some[(some != index) & (some != other)]
                wrong.append(rows[rng.integers(0, len(ways), len(some)), index, some])
        x = np.concatenate([np.stack(right), *wrong])
        y = np.zeros(len(x), np.float32)
        y[: len(right)] = 1
        self._mean, self._scale = x.mean(axis=0), x.std(axis=0) + 1e-6
        torch.manual_seed(int(rng.integers(2**31)))
        width = x.shape[1]
        self._network = torch.nn.Sequential(
            torch.nn.Linear(width, 32), torch.nn.ReLU(), torch.nn.Linear(32, 1)
        )
        inputs = torch.from_numpy(self._scaled(x))
        wanted = torch.from_numpy(y)
        optimiser = torch.optim.AdamW(self._network.parameters(), 3e-3, weight_decay=1e-2)
        weight = torch.tensor(float((len(y) - y.sum()) / y.sum()))
        for _ in range(STEPS):
            drawn = torch.from_numpy(rng.integers(0, len(y), 1024))
            predicted = self._network(inputs[drawn])[:, 0]
            loss = torch.nn.functional.binary_cross_entropy_with_logits(
                predicted, wanted[drawn], pos_weight=weight
            )
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()

    def scores(self, rows: np.ndarray) -> np.ndarray:
        """(ways, n, n) of (ways, n, n, f) features: higher for neighbours."""
        with torch.inference_mode():
            flat = torch.from_numpy(self._scaled(rows.reshape(-1, rows.shape[-1])))
            return np.asarray(self._network(flat)[:, 0]).reshape(rows.shape[:-1])

    def _scaled(self, rows: np.ndarray) -> np.ndarray:
        return ((rows - self._mean) / self._scale).astype(np.float32)


class Edges:
    """All edges of a set of patches, in every way that they may be turned."""

    def __init__(self, patches: Patches) -> None:
        """Describe the left edges in all orientations."""
        self._places = patches.places
        layout = patches.layout
        self._turned = layout.turned
        self._shift = -(-layout.wander * BINS // layout.size)
        self._ways = [(k, m) for m in (False, True)[: 1 + layout.turned] for k in range(4)]
        raw = {way: left_edges(patches, *way) for way in self._ways}
        self._left = {way: described(raw[way], layout.turned) for way in raw}
        self._right = {way: described(reversed_edges(raw[way]), layout.turned) for way in raw}

    def compare(self, side: int) -> tuple[np.ndarray, list[tuple[int, bool]]]:
        """Features of all patches' true right (0) or lower (1) edges beside all edges there are.

        The attacker knows which of the four edges it is, which only helps.

        Returns:
            (ways, n, n, f), and the ways.
        """
        turns = [self.upright(index, 2 + side) for index in range(len(self._places))]
        ours = {
            name: np.stack([self._right[turn][name][i] for i, turn in enumerate(turns)])
            for name in next(iter(self._right.values()))
        }
        ways = self._ways if self._turned else [(side, False)]
        return np.stack([features(ours, self._left[way], self._shift) for way in ways]), ways

    def upright(self, index: int, turns: int) -> tuple[int, bool]:
        """How a published patch is turned back to the atlas, and then by so many quarter turns."""
        place = self._places[index]
        if place.mirrored:
            return (place.quarter_turns - turns) % 4, True
        return (turns - place.quarter_turns) % 4, False


def _bands(image: np.ndarray) -> np.ndarray:
    """(n, DEPTHS, BINS, c) means of squares along the left edge."""
    count, size, _, channels = image.shape
    depth = max(1, BAND * size // 128)
    strip = image[:, :, : DEPTHS * depth].reshape(
        count, BINS, size // BINS, DEPTHS, depth, channels
    )
    return np.asarray(strip.mean(axis=(2, 4)).transpose(0, 2, 1, 3), np.float32)


def _carried(bands: np.ndarray, ahead: float) -> np.ndarray:
    """(n, BINS, c) bands carried on by their slope to so many bands before the first."""
    depth = np.arange(DEPTHS, dtype=np.float32) - (DEPTHS - 1) / 2
    slope = np.einsum("d,ndbc->nbc", depth / (depth**2).sum(), bands)
    middle = bands.mean(axis=1)
    return np.asarray(middle - slope * ((DEPTHS - 1) / 2 + ahead))


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(length, 1e-6)
