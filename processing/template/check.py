"""All that is wrong with a template, as findings with a name, a sentence and the triangles."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.counting import counted
from lightstage.formats.mesh import connected, directed_edges
from lightstage.formats.template import REGIONS, Template
from lightstage.meshlab import reason_without, self_intersecting
from processing.errors import ProcessingError
from processing.registration.flips import folded_triangles, grown
from processing.registration.rigid import umeyama
from processing.registration.stage import open_to_sky
from processing.template.config import CheckConfig
from processing.template.frame import is_inside_out
from processing.template.mesh_faults import (
    Border,
    borders,
    crowded_edges,
    not_joined,
    slivers,
    turned_against,
)
from processing.template.own import own_template
from processing.template.regions import joined_to
from processing.template.uv_faults import islands, mirrored, overlapping, stretch_of

KEPT = 0.95
"""Share of the skin that is distorted less than the reported figure."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        name: short, the same for the same fault.
        text: a sentence for the user.
        triangles: (k,) indices of the triangles that have it; may be empty.
        unusable: whether the template cannot be used.
    """

    name: str
    text: str
    triangles: np.ndarray
    unusable: bool = False


NOWHERE = np.zeros(0, int)


def check_template(
    template: Template, config: CheckConfig | None = None
) -> tuple[list[Finding], dict[str, Any]]:
    """Check a template.

    Args:
        template: as `load_template` reads it, which refuses what is no template at all.
        config: settings.

    Returns:
        Findings, those first with which the template cannot be used; and facts, JSON-ready.
    """
    settings = config or CheckConfig()
    found: list[Finding] = []
    facts: dict[str, Any] = {
        "name": template.name,
        "vertices": len(template.mesh.vertices),
        "triangles": len(template.mesh.triangles()),
        "quads": int((template.mesh.faces[:, 3:] >= 0).sum()),
    }
    for part in (_surface, _texture, _landmarks, _regions_and_maps, _modes):
        part(template, settings, found, facts)
    facts["findings"] = {each.name: each.text for each in found}
    return sorted(found, key=lambda each: not each.unusable), facts


def _surface(
    template: Template, config: CheckConfig, found: list[Finding], facts: dict[str, Any]
) -> None:
    vertices, triangles = template.mesh.vertices, template.mesh.triangles()
    _add(found, "non-manifold edges", crowded_edges(triangles),
          "{} of edges that more than two triangles have")  # fmt: skip
    _add(found, "faces turned over", turned_against(triangles),
          "{} that face the other way than a neighbour")  # fmt: skip
    _add(found, "no area", slivers(vertices, triangles), "{} without area on the surface")
    reason = reason_without()
    if reason is None:
        crossing = self_intersecting(vertices, triangles)
        facts["self_intersecting_triangles"] = int(crossing.sum())
        _add(found, "self-intersections", crossing, "{} that cut through others")
    else:
        facts["not_checked"] = f"self-intersections: {reason}"
    loose = not_joined(vertices, triangles, config.joined_mm)
    _add(found, "not joined", loose[triangles].any(axis=1),
          "{} at borders that are on other borders and are not joined to them")  # fmt: skip
    unused = len(vertices) - len(np.unique(triangles))
    if unused:
        text = f"{counted(unused, 'vertex', 'vertices')} in no face"
        found.append(Finding("unused vertices", text, NOWHERE))
    with_marks = joined_to(template.landmarks, triangles, len(vertices))
    several = borders(vertices, triangles)
    facts["open_borders"] = len(several)
    facts["open_border_mm"] = float(sum(border.length_mm for border in several))
    places = [_place_of(border, template, with_marks, config) for border in several]
    facts["open_borders_at"] = {name: places.count(name) for name in sorted(set(places))}
    holes = [border for border, place in zip(several, places, strict=True) if place == "elsewhere"]
    if holes:
        inside = np.zeros(len(vertices), bool)
        for border in holes:
            inside[border.vertices] = True
        text = f"{counted(len(holes), 'open border')} beside neck, eyes and mouth"
        found.append(Finding("holes", text, np.flatnonzero(inside[triangles].any(axis=1))))
    part = connected(directed_edges(triangles), len(vertices))
    facts["parts"] = len(np.unique(part[triangles]))


def _texture(
    template: Template, config: CheckConfig, found: list[Finding], facts: dict[str, Any]
) -> None:
    mesh = template.mesh
    shared, share = overlapping(mesh, config.uv_rows)
    facts["uv_overlap_share"] = share
    _add(found, "UV overlap", shared, "{} that share texels with others")
    whole, over, flat = mirrored(mesh)
    island = islands(mesh)
    facts["uv_islands"] = int(island.max()) + 1
    facts["uv_islands_mirrored"] = len(np.unique(island[whole]))
    _add(found, "mirrored islands", whole, "{} in islands that the texture shows mirrored")
    _add(found, "UV turned over", over, "{} turned over within their island")
    if flat.all():
        found.append(Finding("no UV area", "no triangle has an area in the texture",
                             np.flatnonzero(flat), unusable=True))  # fmt: skip
        return
    _add(found, "no UV area", flat, "{} without area in the texture")
    stretch = stretch_of(mesh, config.texture_rows)
    skin = _skin(template)
    angle, area, texel = stretch.of(skin, KEPT)
    figures = {
        "skin_angle_p95_deg": angle,
        "skin_area_p95_times": area,
        "skin_angle_median_deg": stretch.of(skin, 0.5)[0],
        "skin_texel_mm": texel,
    }
    facts |= {name: value for name, value in figures.items() if np.isfinite(value)}
    if angle > config.stretch_angle_deg or area > config.stretch_area:
        bad = skin & ~(stretch.angle_deg <= config.stretch_angle_deg)
        with np.errstate(invalid="ignore"):
            times = (stretch.texel_mm / texel) ** 2
        bad |= skin & ~((times < config.stretch_area) & (times > 1 / config.stretch_area))
        text = f"5 % of the skin has angles distorted by more than {angle:.0f} deg, or more than "
        text += f"{area:.1f} times as many or as few texels as the median"
        found.append(Finding("stretch", text, np.flatnonzero(bad)))


def _landmarks(
    template: Template, config: CheckConfig, found: list[Finding], facts: dict[str, Any]
) -> None:
    vertices, triangles = template.mesh.vertices, template.mesh.triangles()
    marks = template.landmarks
    used = np.zeros(len(vertices), bool)
    used[triangles] = True
    around = np.zeros(len(vertices), bool)

    def add(name: str, some: np.ndarray, text: str, unusable: bool = False) -> None:
        around[:] = False
        around[marks[some]] = True
        numbers = ", ".join(str(each) for each in some[:10]) + (" .." if len(some) > 10 else "")
        where = np.flatnonzero(around[triangles].any(axis=1))
        found.append(Finding(name, f"landmarks {numbers}: {text}", where, unusable))

    loose = np.flatnonzero(~used[marks])
    if len(loose):
        add("landmarks off the surface", loose, "on vertices that no face uses", True)
    order = np.unique(marks, return_counts=True)
    twice = np.flatnonzero(np.isin(marks, order[0][order[1] > 1]))
    if len(twice):
        add("landmarks on one vertex", twice, "on a vertex that another one has, too")
    own = own_template()
    wanted, given = own.mesh.vertices[own.landmarks], vertices[marks]
    spread = np.linalg.svd(given - given.mean(axis=0), compute_uv=False)
    if spread[2] < 0.02 * spread[0]:
        add("landmarks in a plane", np.arange(68), "all in one plane, so that no pose can be "
             "found", True)  # fmt: skip
        return
    likeness = umeyama(given, wanted, scale=True, reflect=True)
    away = np.linalg.norm(likeness.apply(given) - wanted, axis=1)
    facts["landmarks_median_mm"] = float(np.median(away))
    if np.linalg.det(likeness.rotation) < 0 or np.median(away) > config.largest_misfit_mm:
        add("landmarks of no face", np.arange(68), "mirrored, or not in iBUG's order", True)
        return
    far = np.flatnonzero(away > config.landmark_mm)
    if len(far):
        add("landmarks elsewhere", far, f"more than {config.landmark_mm:g} mm from where our "
             "template has them")  # fmt: skip
    turned = np.rad2deg(np.arccos(np.clip((np.trace(likeness.rotation) - 1) / 2, -1, 1)))
    size = 1 / likeness.scale
    if turned > config.axes_deg:
        text = f"the face is turned by {turned:.0f} deg against the head frame (+y up, +z ahead)"
        found.append(Finding("axes", text, NOWHERE))
    if not config.smallest_size <= size <= config.largest_size:
        text = f"the face is {size:.3g} times as large as usual: is the mesh in mm?"
        found.append(Finding("size", text, NOWHERE, unusable=True))
    if is_inside_out(vertices, triangles, marks, own, likeness.rotation):
        text = "its triangles run clockwise seen from outside, so that it is inside out"
        found.append(Finding("inside out", text, NOWHERE, unusable=True))
        return
    hidden = ~open_to_sky(vertices, triangles, config.least_open_sky)
    # A fold, such as a mouth's corner, is narrow; what is under skin is so with its neighbours.
    hidden &= ~grown(~hidden, triangles, config.hidden_rings)
    under = np.flatnonzero(hidden[marks] & used[marks])
    if len(under):
        add("landmarks under skin", under, "inside of mouth or nose, or under another part")


def _regions_and_maps(
    template: Template, _config: CheckConfig, found: list[Finding], facts: dict[str, Any]
) -> None:
    facts["regions"] = {name: len(some) for name, some in template.regions.items()}
    missing = [name for name in REGIONS if not len(template.regions.get(name, ()))]
    if missing:
        found.append(Finding("regions missing", f"no {', '.join(missing)}", NOWHERE))
    unknown = sorted(set(template.regions) - set(REGIONS))
    if unknown:
        text = f"{', '.join(unknown)}: no stage reads such regions"
        found.append(Finding("regions unknown", text, NOWHERE))
    everywhere = np.concatenate(
        [np.unique(some) for some in template.regions.values()] or [NOWHERE]
    )
    numbers, times = np.unique(everywhere, return_counts=True)
    several = np.zeros(len(template.mesh.vertices), bool)
    several[numbers[times > 1].astype(int)] = True
    _add(found, "regions overlap", several[template.mesh.triangles()].all(axis=1),
          "{} in two regions at once")  # fmt: skip
    for name, image in template.maps.items():
        rows, columns = image.shape[:2]
        if image.ndim != 2 or abs(rows * 2 - columns * 3) > 3:
            text = f"{name} has {rows} x {columns} texels, not rows:columns = 3:2"
            found.append(Finding("maps", text, NOWHERE))
        low, high = {"translucency": (0.0, 1.0)}.get(name, (0.0, np.inf))
        if image.min() < low or image.max() > high:
            text = f"{name} goes from {image.min():.3g} to {image.max():.3g}, beyond its range"
            found.append(Finding("maps", text, NOWHERE))


def _modes(
    template: Template, config: CheckConfig, found: list[Finding], facts: dict[str, Any]
) -> None:
    modes = template.modes
    facts["identity_modes"] = 0 if modes is None else len(modes.identity)
    facts["expression_modes"] = 0 if modes is None else len(modes.expression)
    if modes is None:
        return
    for name, some in (("identity", modes.identity), ("expression", modes.expression)):
        if not np.isfinite(some).all():
            text = f"{name} modes have NaN or infinity"
            found.append(Finding("modes not finite", text, NOWHERE, unusable=True))
            return
        still = [str(k) for k, mode in enumerate(some) if not mode.any()]
        if still:
            text = f"{name} {', '.join(still[:10])} move nothing"
            found.append(Finding("modes without effect", text, NOWHERE))
    twice = len(modes.expression_names) - len(set(modes.expression_names))
    if twice:
        text = f"{counted(twice, 'name')} of expressions stand twice"
        found.append(Finding("names twice", text, NOWHERE))
    rest, triangles = template.mesh.vertices, template.mesh.triangles()
    moved = [
        (f"identity {k} at {sign * config.identity_deviations:+g}",
         sign * config.identity_deviations * mode)
        for k, mode in enumerate(modes.identity) for sign in (1, -1)
    ]  # fmt: skip
    moved += list(zip(modes.expression_names, modes.expression, strict=True))
    folded = np.zeros(len(triangles), bool)
    by_name = {}
    for name, offset in moved:
        fold = folded_triangles(rest, rest + offset, triangles)
        if fold.any():
            by_name[name] = int(fold.sum())
            folded |= fold
    facts["modes_that_fold"] = by_name
    if by_name:
        worst = sorted(by_name, key=lambda name: -by_name[name])[:5]
        text = ", ".join(f"{name} ({by_name[name]})" for name in worst)
        text = f"{counted(len(by_name), 'mode')} of {len(moved)} fold triangles: {text}"
        text += " .." if len(by_name) > len(worst) else ""
        found.append(Finding("modes that fold", text, np.flatnonzero(folded)))


def _add(found: list[Finding], name: str, chosen: np.ndarray, template: str) -> None:
    """Add a finding where there is any."""
    count = int(chosen.sum())
    if count:
        text = template.format(counted(count, "triangle"))
        found.append(Finding(name, text, np.flatnonzero(chosen)))


def _skin(template: Template) -> np.ndarray:
    """(t,) bool: triangles of skin and lips; all of a template without either."""
    inside = np.zeros(len(template.mesh.vertices), bool)
    for name in ("skin", "lips"):
        inside[template.regions.get(name, NOWHERE)] = True
    if not inside.any():
        inside[:] = True
    return np.asarray(inside[template.mesh.triangles()].all(axis=1))


def _place_of(
    border: Border, template: Template, with_marks: np.ndarray, config: CheckConfig
) -> str:
    """What an open border is: neck, eye, mouth, of a part of its own, or elsewhere."""
    marks = template.mesh.vertices[template.landmarks]
    if not with_marks[border.vertices].any():
        return "parts of their own"
    if border.middle[1] < marks[8, 1] and border.length_mm > config.neck_mm:
        return "neck"
    for eye in (slice(36, 42), slice(42, 48)):
        if np.linalg.norm(border.middle - marks[eye].mean(axis=0)) < config.eye_mm:
            return "eyes"
    if np.linalg.norm(border.middle - marks[48:].mean(axis=0)) < config.mouth_mm:
        return "mouth"
    return "elsewhere"


def require_usable(path: Path, found: list[Finding]) -> None:
    """ProcessingError where a template cannot be used."""
    bad = [each for each in found if each.unusable]
    if bad:
        raise ProcessingError(
            path,
            field=bad[0].name,
            found=bad[0].text,
            expected="a template that can be used",
            hint="docs/template.md explains each finding.",
        )
