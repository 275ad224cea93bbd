"""Fine detail of the specular albedo, after that of the diffuse one.

Pores, folds and hairs are darker than the skin around them in either: light that enters a pore
leaves it less often, whether it was mirrored or went through the skin. The network's specular
albedo is much coarser than they are.
"""

from __future__ import annotations

import numpy as np

from learning.networks.whole_face import DARKEST
from learning.whole.detail import blurred

SLOPE = 1.2
"""Change of the specular albedo's logarithm for one of the diffuse albedo's. Least squares over
twelve simulated people and twelve of ICT's, none of whom a benchmark has, gave 1.2 to 1.9; more
would take more of what is darker by its pigment alone."""
WIDTH = 1 / 128
"""Standard deviation of what is coarser than detail, of a texture's rows."""
MOST = 0.5
"""Of the logarithm: a mole is no hole."""


def specular_detail(diffuse_albedo: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Factor of a specular albedo that has no detail of its own.

    Args:
        diffuse_albedo: (rows, columns, 3) linear, without light.
        covered: (rows, columns) bool, where a surface is.

    Returns:
        (rows, columns) float32, about 1.
    """
    weight = covered.astype(np.float32)
    level = np.log(np.maximum(diffuse_albedo, DARKEST)).mean(axis=2).astype(np.float32) * weight
    sigma = WIDTH * len(covered)
    around = blurred(level, sigma) / np.maximum(blurred(weight, sigma), 1e-6)
    factor: np.ndarray = np.exp(np.clip(SLOPE * (level - around), -MOST, MOST))
    return np.where(covered, factor, 1.0).astype(np.float32)
