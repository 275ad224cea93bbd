"""Skin's relief: pores, the fine net, creases of age and of expression, as height in mm.

Height is measured along the mesh's smooth normals. Normals follow from it and from the posed mesh
alone, so a crease shades as the displaced surface would.
"""

from __future__ import annotations

import numpy as np

from sim.skin.noise import cell_edges
from sim.skin.parts import Patch

NET_CELL_MM = 1.05


def skin_relief(patch: Patch, strength: float, age: float) -> np.ndarray:
    """Pores, net and unevenness of resting skin without its creases.

    Args:
        patch: where.
        strength: of pores and net, about 1.
        age: 0 smooth to 1 lined; old skin has a coarser net.

    Returns:
        (h, columns) float32 mm, about -.1 to .05.
    """
    nose, cheeks = patch.mask("nose"), patch.mask("cheeks")
    lips = patch.mask("lips")
    depth = 0.020 + 0.042 * np.maximum(nose, patch.mask("wings")) + 0.022 * cheeks
    depth += 0.012 * patch.mask("forehead") + 0.012 * patch.mask("chin")

    def pore(distance: np.ndarray, label: np.ndarray) -> np.ndarray:
        width = 0.15 + 0.13 * label**2
        return np.asarray(-np.exp(-0.5 * (distance / width) ** 2) * (0.25 + 0.75 * label))

    pits = depth * patch.pits(1.15, 20, pore)
    fine = patch.pits(0.62, 28, lambda d, label: -np.exp(-0.5 * (d / 0.11) ** 2) * label)
    net = -(0.011 + 0.006 * age) * net_lines(patch, 21)
    grain = 0.0045 * patch.noise(0.8, 2, 22) + 0.008 * patch.noise(2.4, 2, 29)
    skin = pits + 0.016 * fine + net + grain
    waves = 0.016 * (1 + 0.6 * age) * patch.noise(6.0, 2, 27)
    grooves = patch.noise_of(lambda p: p * np.array([1.0, 0.16, 0.16], np.float32), 1.5, 2, 26)
    lip = -0.030 * np.maximum(grooves, -0.4) + 0.008 * patch.noise(0.7, 2, 25)
    out = (1 - lips) * (strength * skin + waves) + lips * lip
    return np.asarray(out * (1 - patch.mask("eyes")), np.float32)


def net_lines(patch: Patch, salt: int) -> np.ndarray:
    """(h, columns) 0..1, furrows between the polygons of the skin's net, finer on the face."""

    def lines(place: np.ndarray) -> np.ndarray:
        flat = np.ascontiguousarray(place.reshape(-1, 3))
        edge = cell_edges(flat, NET_CELL_MM, patch.face.seed + 1009 * salt)
        return np.exp(-((edge.reshape(place.shape[:2]) / 0.13) ** 2)).astype(np.float32)

    return patch.on_fewer(lines, NET_CELL_MM / 8)
