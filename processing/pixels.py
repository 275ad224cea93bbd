"""Maps of one view's pixels, as every method of separation and `refine` returns them."""

from __future__ import annotations

import dataclasses

import numpy as np

from lightstage.formats.processed import ProcessedFolder


@dataclasses.dataclass(frozen=True)
class PixelMaps:
    """Maps of the n pixels of a mask, in row order; 0 where unsolved.

    Attributes:
        diffuse_normal: (n, 3) unit, the direction that explains the diffuse shading.
        specular_normal: (n, 3) unit, the surface's own with its finest relief.
        albedo: (n, 3) diffuse.
        specular: (n,) reflectance at normal incidence.
        roughness: (n,) Beckmann's m that the specular albedo was found with.
        confidence: (n,) 0..1.
    """

    diffuse_normal: np.ndarray
    specular_normal: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    confidence: np.ndarray


MAP_NAMES = {
    "diffuse_normal": "diffuse_normal",
    "specular_normal": "specular_normal",
    "albedo": "diffuse_albedo",
    "specular": "specular_albedo",
    "roughness": "roughness",
    "confidence": "confidence",
}
"""Fields of `PixelMaps`, and the maps that they are written to."""


def pasted(mask: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(h, w, ..) float16 picture of n pixels' (n, ..) values, zero outside the (h, w) mask.

    What half floats cannot hold becomes infinite, and is refused when it is written.
    """
    image = np.zeros((*mask.shape, *values.shape[1:]), np.float16)
    with np.errstate(over="ignore"):
        image[mask] = values.astype(np.float16)
    return image


def write_maps(folder: ProcessedFolder, camera_id: str, mask: np.ndarray, maps: PixelMaps) -> None:
    """Write one view's maps, zero outside the (h, w) mask."""
    for field, name in MAP_NAMES.items():
        folder.write_view(camera_id, name, pasted(mask, getattr(maps, field)))
