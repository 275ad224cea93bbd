"""Studios of area lights at finite distance: soft boxes, a ring, rim lights.

A light is a flat panel that shines alike in all directions on its front (Lambertian). It is cut
into a grid of points, each of which gives at the origin what its part of the panel does; away from
there it falls off with the square of the distance, the panel's own cosine being that at the origin:
over a head, 1.5 m away, a few per cent.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.environment import LightSet
from sim.errors import SimError


@dataclasses.dataclass(frozen=True)
class Panel:
    """A flat area light that faces the origin.

    Attributes:
        centre_mm: of the panel.
        size_mm: width and height.
        rgb: what a perfect white diffuser at the origin that faces it reads.
        inner: 0 is a rectangle; above 0 an ellipse whose middle is dark to this share of its size.
    """

    centre_mm: tuple[float, float, float]
    size_mm: tuple[float, float]
    rgb: tuple[float, float, float]
    inner: float = 0.0

    def __post_init__(self) -> None:
        """SimError for a panel without size, at the origin or of negative light."""
        bad = min(self.size_mm) <= 0 or np.linalg.norm(self.centre_mm) < 1 or min(self.rgb) < 0
        if bad or not 0 <= self.inner < 1:
            raise SimError(
                "panel",
                found=f"{self}",
                expected="a size, a place away from the origin, light of at least 0, inner below 1",
            )


STUDIOS: dict[str, tuple[Panel, ...]] = {
    # A large soft box from the upper left, a dim one low on the right: the plain portrait.
    "softbox": (
        Panel((-900.0, 800.0, 1100.0), (900.0, 900.0), (0.85, 0.83, 0.80)),
        Panel((1300.0, 0.0, 1000.0), (1200.0, 1600.0), (0.16, 0.17, 0.19)),
    ),
    # Around the frontal camera's axis.
    "ring": (Panel((0.0, 0.0, 1150.0), (480.0, 480.0), (0.9, 0.9, 0.9), 0.75),),
    # Two strips from behind and a weak fill from in front.
    "rim": (
        Panel((-1300.0, 200.0, -700.0), (300.0, 1400.0), (1.3, 1.2, 1.05)),
        Panel((1300.0, 200.0, -700.0), (300.0, 1400.0), (1.0, 1.1, 1.3)),
        Panel((0.0, 500.0, 1500.0), (1000.0, 700.0), (0.14, 0.14, 0.14)),
    ),
    # From above and below, nearly on the axis.
    "clamshell": (
        Panel((0.0, 850.0, 1050.0), (1000.0, 600.0), (0.65, 0.65, 0.65)),
        Panel((0.0, -750.0, 1000.0), (1000.0, 500.0), (0.32, 0.32, 0.32)),
    ),
}


def studio(name: str, count: int = 256) -> LightSet:
    """A named studio as points.

    Args:
        name: one of `STUDIOS`.
        count: of all points, about: panels share them by their area.

    Raises:
        SimError: another name, or a count below 1.
    """
    if name not in STUDIOS:
        raise SimError("studio", found=repr(name), expected=", ".join(STUDIOS))
    if count < 1:
        raise SimError(f"studio {name}", field="lights", found=str(count), expected="at least 1")
    panels = STUDIOS[name]
    areas = np.array([p.size_mm[0] * p.size_mm[1] for p in panels])
    places, colours = [], []
    for panel, share in zip(panels, areas / areas.sum(), strict=True):
        place, part = panel_points(panel, max(1, round(count * share)))
        places.append(place)
        colours.append(part[:, None] * np.array(panel.rgb))
    return LightSet(name, np.concatenate(places), np.concatenate(colours), np.zeros(3))


def panel_points(panel: Panel, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) in mm that stand for a panel, n about `count`, and their shares (n,).

    Together they give a diffuser at the origin that faces the panel's centre what the panel does.
    """
    centre = np.asarray(panel.centre_mm, float)
    normal = -centre / np.linalg.norm(centre)
    up = np.array([0.0, 1.0, 0.0]) if abs(normal[1]) < 0.99 else np.array([0.0, 0.0, 1.0])
    side = np.cross(up, normal)
    side /= np.linalg.norm(side)
    high = np.cross(normal, side)
    u, v = _ring(panel.inner, count) if panel.inner > 0 else _grid(panel.size_mm, count)
    width, height = panel.size_mm
    places = centre + np.outer(u * width, side) + np.outer(v * height, high)
    distance = np.linalg.norm(places, axis=1)
    leaving = (-places / distance[:, None]) @ normal
    share = leaving / distance**2
    arriving = share * (places @ -normal) / distance
    return places, share / arriving.sum()


def _grid(size_mm: tuple[float, float], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places -1/2..1/2 across and up a rectangle, on an even grid of about `count`."""
    columns = max(1, round(np.sqrt(count * size_mm[0] / size_mm[1])))
    rows = max(1, round(count / columns))
    u = (np.arange(columns) + 0.5) / columns - 0.5
    v = (np.arange(rows) + 0.5) / rows - 0.5
    across, up = np.meshgrid(u, v)
    return across.ravel(), up.ravel()


def _ring(inner: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places -1/2..1/2 across and up a ring, evenly by area along a golden spiral."""
    k = np.arange(count) + 0.5
    radius = 0.5 * np.sqrt(inner**2 + (1 - inner**2) * k / count)
    turn = np.pi * (3 - np.sqrt(5)) * k
    return radius * np.cos(turn), radius * np.sin(turn)
