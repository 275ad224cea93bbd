"""Which photographs are taken again where some of them contradict each other.

A contradiction shows that one of its photographs is wrong, and only guesses which one: what is too
bright against `full` may be right, and `full` an old picture. The guess is taken again first; where
that changes nothing, the others are.

That holds for a camera that contradicts itself alone. Where several cameras show the same, it is
the light: a lamp that has died would be in all photographs taken again, which then agree and are
all wrong. There the guess alone is taken again, and the capture stops.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from lightstage.findings import Finding

Contradiction = tuple[str | None, frozenset[str]]
"""The camera (None: all of them), and the patterns that take part."""


class Suspects:
    """Remembers what was taken again for each contradiction.

    Args:
        cameras: all ids.
        retakes: of one contradiction in total, whichever of its photographs are taken again: the
            first half of them for the photograph that a check names, the other half for the others.
    """

    def __init__(self, cameras: Collection[str], retakes: int) -> None:
        self._cameras = frozenset(cameras)
        self._retakes = retakes
        self._tries: dict[Contradiction, int] = {}
        self._taken: dict[Contradiction, set[str]] = {}

    def retakes_for(self, pattern: str, bad: Sequence[Finding]) -> dict[str, set[str]]:
        """Cameras that should retake each pattern, by pattern; it may be an earlier one.

        Args:
            pattern: of findings that name none.
            bad: findings.
        """
        again: dict[str, set[str]] = {}
        for finding, names in self._chosen(pattern, bad):
            wanted = self._cameras if finding.camera is None else {finding.camera}
            for name in names:
                again.setdefault(name, set()).update(wanted)
        return again

    def left(self, pattern: str, bad: Sequence[Finding]) -> int:
        """Retakes that are left for the contradiction of these findings that has the fewest."""
        keys = [_key(pattern, finding) for finding in bad if finding.suspects]
        return self._retakes - max((self._tries.get(key, 0) for key in keys), default=0)

    def count(self, pattern: str, bad: Sequence[Finding]) -> None:
        """Count the photographs that `retakes_for` names: they are retaken now."""
        found = {_key(pattern, each): names for each, names in self._chosen(pattern, bad)}
        for key, names in found.items():
            self._tries[key] = self._tries.get(key, 0) + 1
            self._taken.setdefault(key, set()).update(names)

    def _chosen(self, pattern: str, bad: Sequence[Finding]) -> list[tuple[Finding, set[str]]]:
        """The patterns that are to be taken again for each finding."""
        keys = {_key(pattern, each) for each in bad if each.suspects}
        chosen = []
        for finding in bad:
            key = _key(pattern, finding)
            alone = finding.camera is not None and sum(key[1] == other[1] for other in keys) == 1
            names = {finding.pattern or pattern}
            if alone and self._tries.get(key, 0) >= self._retakes // 2:
                names = set(key[1] - self._taken.get(key, set())) or set(key[1])
            chosen.append((finding, names))
        return chosen


def _key(pattern: str, finding: Finding) -> Contradiction:
    return finding.camera, frozenset((finding.pattern or pattern, *finding.suspects))
