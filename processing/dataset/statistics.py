"""Mean and deviation of maps over all that was added, so that no single scan can be read out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


class Statistics:
    """Running sums over measured texels."""

    def __init__(self, channels: Mapping[str, int]) -> None:
        """Names of the maps that are summed and their channels."""
        self._texels = 0
        self._measured = 0
        self._sum = {name: np.zeros(count) for name, count in channels.items()}
        self._squares = {name: np.zeros(count) for name, count in channels.items()}

    def add(self, maps: Mapping[str, np.ndarray], measured: np.ndarray) -> None:
        """Add (h, w, c) maps at the places where (h, w) `measured` is true."""
        self._texels += measured.size
        self._measured += int(measured.sum())
        for name in self._sum:
            values = maps[name][measured].astype(float)
            self._sum[name] += values.sum(axis=0)
            self._squares[name] += (values**2).sum(axis=0)

    def facts(self) -> dict[str, float | list[float]]:
        """Coverage (share of texels measured), NAME_mean and NAME_deviation a channel."""
        count = max(1, self._measured)
        facts: dict[str, float | list[float]] = {"coverage": self._measured / max(1, self._texels)}
        for name, total in self._sum.items():
            mean = total / count
            variance = np.maximum(self._squares[name] / count - mean**2, 0)
            facts[f"{name}_mean"] = mean.tolist()
            facts[f"{name}_deviation"] = np.sqrt(variance).tolist()
        return facts

    def sums(self) -> dict[str, Any]:
        """What was summed, JSON-ready: `add_sums` adds it to others'."""
        return {
            "texels": self._texels,
            "measured": self._measured,
            "sum": {name: total.tolist() for name, total in self._sum.items()},
            "squares": {name: total.tolist() for name, total in self._squares.items()},
        }

    def add_sums(self, sums: Mapping[str, Any]) -> None:
        """Add what another one summed.

        Raises:
            KeyError, TypeError, ValueError: no such sums.
        """
        self._texels += int(sums["texels"])
        self._measured += int(sums["measured"])
        for name, total in self._sum.items():
            for own, other in ((total, sums["sum"]), (self._squares[name], sums["squares"])):
                values = np.array(other[name], float)
                if values.shape != own.shape or not np.isfinite(values).all():
                    raise ValueError(f"{name}: {values.shape} of {own.shape}")
                own += values
