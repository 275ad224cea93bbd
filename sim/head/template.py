"""Our own template: the parametric head's mean, landmarks, regions, modes and skin maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightstage.formats.png import write_png
from lightstage.formats.template import Modes, Template, save_template
from sim.head.maps import region_share, to_tile
from sim.head.mesh import landmarks, neutral_mesh, regions
from sim.head.modes import EXPRESSIONS, expression_modes, identity_modes

MAP_ROWS, MAP_COLUMNS = 768, 512
DEPTH_RATIO = 0.85
"""Ratio of the depth of people's faces to that of ours, which is too deep: a scanned head (Lee
Perry-Smith's) has .88 of its depth, the mean of ICT's model .73."""

# Blinn-Phong exponent and translucency by region, smooth in between.
_SHININESS = {"skin": 24.0, "lips": 40.0, "eyes": 160.0, "ears": 20.0, "hair": 12.0}
_TRANSLUCENCY = {"skin": 0.6, "lips": 0.8, "eyes": 0.1, "ears": 1.0, "hair": 0.3}


def build_template() -> Template:
    """The template, made anew from the parametric head."""
    return Template(
        name="lightstage parametric head, layout 2",
        mesh=neutral_mesh(),
        landmarks=landmarks(),
        regions=regions(),
        licence="Apache-2.0",
        source="lightstage-sim template",
        modes=Modes(identity_modes(), expression_modes(), EXPRESSIONS),
        maps={"shininess": _blend(_SHININESS), "translucency": _blend(_TRANSLUCENCY)},
        depth_ratio=DEPTH_RATIO,
    )


def write_template(out: Path, template: Template | None = None) -> Path:
    """Write the template folder (docs/formats.md: template.json, mesh.obj, modes.npz, maps/).

    Args:
        out: folder, made where absent.
        template: of the same UV; that of `build_template` where None.

    Returns:
        `out`.
    """
    save_template(template or build_template(), out)
    skin = to_tile(region_share("skin") + region_share("lips"), MAP_ROWS, MAP_COLUMNS)
    write_png(out / "maps" / "skin.png", np.where(skin > 0.5, 255, 0).astype(np.uint8))
    return out


def _blend(values: dict[str, float]) -> np.ndarray:
    total = np.zeros((MAP_ROWS, MAP_COLUMNS))
    weight = np.full((MAP_ROWS, MAP_COLUMNS), 1e-6)
    for name, value in values.items():
        share = to_tile(region_share(name), MAP_ROWS, MAP_COLUMNS)
        total += share * value
        weight += share
    return (total / weight).astype(np.float32)
