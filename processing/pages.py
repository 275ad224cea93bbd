"""OUT/report.html: a processed session's maps, and the facts of each stage."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.formats.half import float_from_half
from lightstage.formats.processed import ProcessedFolder
from processing.coarse_maps import has_coarse, read_coarse
from processing.decode.diagnosis_page import light_section
from processing.reconstruction.pictures import mesh_section
from processing.registration.residual import residual_section
from processing.report import (
    Link,
    Picture,
    Section,
    Table,
    display,
    display_normals,
    resize,
    side_by_side,
    write_report,
)
from processing.view_maps import MAP_NAMES

THUMBNAIL_PX = 240
ATLAS_PX = 360
SPECULAR_WHITE = 0.06
ROUGHNESS_WHITE = 0.5
REPORT, HEAD = "report.html", "head/page.html"
"""The page, and that of the head which `lightstage-learning export` makes, in a processed folder.
"""
CAPTIONS = {
    "diffuse_albedo": "Diffuse albedo, 1 is perfect white. No light or shadow should be left.",
    "specular_albedo": f"Specular albedo; {SPECULAR_WHITE} shows as white, skin is near 0.028.",
    "diffuse_normal": "Diffuse normals in world axes: red, green, blue are right, up, front.",
    "specular_normal": "Specular normals: the surface itself, with its finest relief; diffuse ones "
    "look softer. The table of stages names what they are taken from.",
    "roughness": f"Roughness of the mirror lobe (Beckmann's m); {ROUGHNESS_WHITE} shows as white "
    "and half of it as mid grey, skin has .2 to .35, less is shinier. It should change slowly.",
    "ambient_occlusion": "Ambient occlusion, 1 is open. Folds should be darker.",
    "confidence": "Confidence, 0 to 1: white is well seen. Black was not solved, or is seen too "
    "much from the side; an even grey has no mesh, and keeps the coarse maps. Dark dots all over "
    "the skin are single pixels whose readings agree less than others', by noise or at a hair, a "
    "mole or a pore; the atlas takes such places from other views. Bad would be dark patches on "
    "skin that the camera faces, or a view that is dark all over: wrong pattern, room light or "
    "motion.",
}
ATLAS_CAPTIONS = CAPTIONS | {
    "confidence": "Confidence of the view that counts most, 0 to 1. Black was seen by no camera: "
    "colours there are filled in from the other side of the face or from around. Dark dots are "
    "places that no view is sure of, such as pores and hairs. Bad would be black on forehead, "
    "cheeks, nose or chin.",
}


def write_processed_report(out: Path, report: Mapping[str, Any]) -> Path:
    """Write OUT/report.html from report.json's content and the maps that are there.

    Args:
        out: a processed folder.
        report: what report.json holds.

    Returns:
        The page's path.
    """
    folder = ProcessedFolder(out)
    sections = [Section("Stages", _stages(report))]
    head = _head(folder)
    if head:
        sections.append(Section("The head", head))
    stages = report.get("stages", {})
    light = light_section(out, stages.get("decode", {}))
    if light is not None:
        sections.append(light)
    views = _views(folder, refined="refine" in stages)
    if views:
        sections.append(Section("Views", views))
    mesh = mesh_section(out)
    if mesh is not None:
        sections.append(mesh)
    registered = residual_section(out, stages.get("register"))
    if registered is not None:
        sections.append(registered)
    atlas = _atlas(folder)
    if atlas:
        sections.append(Section("Atlas", atlas))
    title = f"Session of {report.get('subject', '?')}, {report.get('expression', '?')}"
    return write_report(out / REPORT, title, sections)


def lacks_head(out: Path) -> bool:
    """Whether a folder's page is older than that of its head, and so may not link to it."""
    try:
        return (out / REPORT).stat().st_mtime_ns < (out / HEAD).stat().st_mtime_ns
    except FileNotFoundError:
        return False


def show(name: str, image: np.ndarray) -> np.ndarray:
    """A (h, w[, 3]) map as an 8-bit picture to be inspected."""
    if name.endswith("_normal"):
        return display_normals(image)
    if name == "roughness":
        # A width is no light: without the screen's curve its differences show.
        grey = np.round(255 * np.clip(np.nan_to_num(image) / ROUGHNESS_WHITE, 0, 1))
        return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
    return display(image, 1 / SPECULAR_WHITE if name == "specular_albedo" else 1.0)


def _head(folder: ProcessedFolder) -> list[str | Link | Picture | Table]:
    """A link to the head's page, where there is one."""
    page, albedo = folder.root / HEAD, folder.atlas_path("diffuse_albedo")
    if not page.is_file():
        return []
    parts: list[str | Link | Picture | Table] = [
        Link(HEAD, "Turn the head and its light in the browser.")
    ]
    if albedo.is_file() and albedo.stat().st_mtime_ns > page.stat().st_mtime_ns:
        parts.append("It shows an earlier atlas than this one: export it again.")
    return parts


def _stages(report: Mapping[str, Any]) -> list[str | Picture | Table]:
    stages: Mapping[str, Mapping[str, Any]] = report.get("stages", {})
    rows = []
    for name, facts in stages.items():
        plain = {
            key: value
            for key, value in facts.items()
            if isinstance(value, (int, float, str)) and key not in ("seconds", "peak_rss_mb")
        }
        facts_in_words = ", ".join(f"{key} {_short(value)}" for key, value in plain.items())
        rows.append(
            (name, f"{facts['seconds']:.1f}", f"{facts['peak_rss_mb']:.0f}", facts_in_words)
        )
    table = Table(("stage", "seconds", "peak memory, MB", "facts, units in their names"), rows)
    versions = Table(("what", "version"), list(report.get("versions", {}).items()))
    return [
        *(f"Warning: {facts_in_words}" for facts_in_words in report.get("warnings", [])),
        table,
        versions,
    ]


def _short(value: float | int | str) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _views(folder: ProcessedFolder, refined: bool) -> list[str | Picture | Table]:
    parts: list[str | Picture | Table] = []
    for name, caption in CAPTIONS.items():
        small: dict[str, np.ndarray] = {}
        for camera in folder.view_ids():
            image = _view(folder, camera, name, refined)
            if image is not None:
                small[camera] = resize(show(name, image), THUMBNAIL_PX)
        if small:
            row = side_by_side(list(small.values()), THUMBNAIL_PX)
            parts.append(Picture(row, f"{caption} From left to right: {', '.join(small)}.", name))
    return parts


def _view(folder: ProcessedFolder, camera: str, name: str, refined: bool) -> np.ndarray | None:
    """A view's map, the coarse one until `refine` has made an exact one; None without any."""
    if not refined and has_coarse(folder.root, camera):
        if name not in MAP_NAMES.values():
            return None
        return float_from_half(read_coarse(folder.root, camera).picture(name))[0]
    return folder.read_view(camera, name) if folder.view_path(camera, name).is_file() else None


def _atlas(folder: ProcessedFolder) -> list[str | Picture | Table]:
    parts: list[str | Picture | Table] = []
    for name, caption in ATLAS_CAPTIONS.items():
        if folder.atlas_path(name).is_file():
            image = show(name, folder.read_atlas(name))
            parts.append(Picture(resize(image, min(ATLAS_PX, image.shape[0])), caption, name))
    return parts
