"""What the compiled loops of the coarse method take and fill, bundled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Window(NamedTuple):
    """A window of one view's frames.

    Attributes:
        half: (P, h, w, 3) uint16 bits of half floats.
        scale: what the readings are multiplied by.
        mask: (h, w) bool, which pixels to solve.
        valid: (h, w) bool, false where clipped.
        row_start: (h,) place in the maps of each row's first masked pixel.
        origin: (2,) row and column of the window's first pixel in the picture.
        rays: (gh, gw, 3) float32 unit directions from the camera, at every `step` pixels.
        step: see there.
        camera: (3,) float32 where the camera is, mm.
        block: pixels a side of the blocks that are pooled, counted from the window's corner.
    """

    half: np.ndarray
    scale: np.float32
    mask: np.ndarray
    valid: np.ndarray
    row_start: np.ndarray
    origin: np.ndarray
    rays: np.ndarray
    step: int
    camera: np.ndarray
    block: int


class Model(NamedTuple):
    """What pixels are solved against: one camera's far field, and what a reading requires.

    Attributes:
        diffuse, lobe, leaving: of `FarTables`, the first two flat.
        groups: of eight patterns.
        radius: of the lights, mm.
        white: (6,) float32 the lights' colour and its direction.
        part: (3,) float32 weights of R G B that normals are solved from, zeros for chroma.
        limits: (6,) float32 three times the dark level, grey saturation, solves at most, when to
            stop, noise squared, and the normal's deviation squared that halves the confidence.
    """

    diffuse: np.ndarray
    lobe: np.ndarray
    leaving: np.ndarray
    groups: int
    radius: np.float32
    white: np.ndarray
    part: np.ndarray
    limits: np.ndarray


class Maps(NamedTuple):
    """Maps of n pixels, float32: (n, 3) normal and albedo, (n,) the others.

    Until `finish_window` albedo holds what the pixel is lit with, roughness the power of its
    irradiance, specular its irradiance times its lobe.
    """

    normal: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    confidence: np.ndarray
