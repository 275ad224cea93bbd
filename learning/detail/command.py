"""What `detail` does: read maps and mesh, find heights, write a map and an embossed mesh."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from learning.detail.config import MOST_TIMES, RELIEF_BOUNDS_MM
from learning.detail.emboss import embossed
from learning.detail.height import heights_mm
from learning.errors import NoReliefError
from learning.export.source import Source, read_source
from learning.vectors import unit
from lightstage.commands import ProgressCallback
from lightstage.errors import ConfigError
from lightstage.formats.exr import write_exr
from lightstage.formats.files import atomic_folder, require_replaceable, write_json
from lightstage.formats.mesh import write_obj

SCHEMA = "lightstage.detail/1"
DISPLACEMENT, EMBOSSED, ABOUT = "displacement.exr", "embossed.obj", "detail.json"
OWN = (DISPLACEMENT, EMBOSSED, ABOUT)
"""What a folder of heights holds."""
LEAST_MM = 1e-3
"""A map whose heights are less, in the mean, has the mesh's own normals: half floats make that."""


def detail_command(
    maps: Path,
    mesh: Path | None,
    out: Path,
    longest_mm: float,
    times: int,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Heights of pores and folds from specular normals; the facts.

    Args:
        maps: a processed folder, its atlas, maps of `infer`, or a fit's folder.
        mesh: of the maps; see `read_source` where None.
        out: folder to make; one of an earlier call is replaced, unless it has other files too.
        longest_mm: length of the waves of relief of which half is the mesh's.
        times: how often each triangle of the embossed mesh is split into four; 0 for no mesh.
        progress: of the three steps.

    Raises:
        NoReliefError: the normals are the mesh's own.
        LightstageError: bad input; nothing is written then.
    """
    began = time.monotonic()
    least, most = RELIEF_BOUNDS_MM
    if not least <= longest_mm <= most:
        raise ConfigError(
            "--longest-mm", found=f"{longest_mm:g}", expected=f"{least:g} to {most:g} mm"
        )
    if not 0 <= times <= MOST_TIMES:
        raise ConfigError("--subdivide", found=str(times), expected=f"0 to {MOST_TIMES}")
    require_replaceable(out, ABOUT, own=OWN)
    source = read_source(maps, mesh)
    rows, columns = source.size
    progress(1, 3)
    height, rounds = heights_mm(
        _at_texels(source, source.mesh.vertices),
        unit(_at_texels(source, source.normals)),
        source.maps["specular_normal"].astype(np.float32),
        source.covered,
        longest_mm,
    )
    progress(2, 3)
    here = height[source.covered]
    deviation_mm = float(np.sqrt((here**2).mean()))
    if not deviation_mm > LEAST_MM:
        raise NoReliefError(
            source.folder / "specular_normal.exr",
            found="the mesh's own normals",
            expected="finer ones",
            hint="`infer --mesostructure` finds pores and folds from 768 rows on.",
        )
    shown = source.spread(height.astype(np.float32))
    facts = {
        "rows": rows,
        "columns": columns,
        "longest_mm": longest_mm,
        "rounds": rounds,
        "height_rms_mm": deviation_mm,
        "height_1_percent_mm": float(np.percentile(here, 1)),
        "height_99_percent_mm": float(np.percentile(here, 99)),
        "triangles": 0,
    }
    finer = embossed(source.mesh, shown, times) if times else None
    if finer is not None:
        facts["triangles"] = len(finer.faces)
    with atomic_folder(out, ABOUT, own=OWN) as folder:
        write_exr(folder / DISPLACEMENT, shown)
        if finer is not None:
            write_obj(finer, folder / EMBOSSED)
        write_json(
            folder / ABOUT, {"schema": SCHEMA, "units": "mm along the mesh's normal", **facts}
        )
    progress(3, 3)
    return {**facts, "seconds": time.monotonic() - began}


def _at_texels(source: Source, values: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) values of the mesh's vertices; zero beside the surface."""
    rows, columns = source.size
    out = np.zeros((rows * columns, 3), np.float32)
    out[source.raster.texels()] = source.raster.at(values, source.mesh.triangles())
    return out.reshape(rows, columns, 3)
