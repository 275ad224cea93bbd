"""A mesh from three sides, shaded and in the colours of its distance to the truth.

`python -m benchmarks.geometry_pictures A.png B.png --out C.jpg` puts pictures of several meshes, as
`geometry_accuracy --pictures` writes them, beside each other.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from benchmarks.geometry_scores import Surface
from lightstage.formats.mesh import Mesh
from processing.sides import coloured_sides, lit_sides

SIDE_PX = 480
GAP_PX = 40
FULL_MM = 0.5
"""Distance at which the scale of colours ends."""


def write_pictures(mesh: Mesh, truth: Mesh, path: Path) -> None:
    """Write PATH.png: shaded above, distance below (dark blue 0, yellow FULL_MM and more)."""
    off = Surface(truth).nearest(mesh.vertices)[0]
    rows = [lit_sides(mesh, SIDE_PX), coloured_sides(mesh, off, FULL_MM, SIDE_PX)]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path.with_suffix(".png")), np.concatenate(rows)[..., ::-1])


def main() -> None:
    """Put pictures of meshes beside each other, for the docs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pictures", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rows", type=int, default=560)
    chosen = parser.parse_args()
    shown = []
    for path in chosen.pictures:
        picture = cv2.imread(str(path))
        if picture is None:
            parser.error(f"{path} is no picture")
        width = round(picture.shape[1] * chosen.rows / picture.shape[0])
        shown.append(cv2.resize(picture, (width, chosen.rows), interpolation=cv2.INTER_AREA))
        shown.append(np.full((chosen.rows, GAP_PX, 3), 255, np.uint8))
    whole = np.concatenate(shown[:-1], axis=1)
    cv2.imwrite(str(chosen.out), whole, [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
