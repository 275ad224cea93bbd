"""What `export` does: look through everything, write a new folder, return the facts."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from learning.errors import MapsError
from learning.export.gltf import write_glb
from learning.export.maps import write_maps
from learning.export.morphs import morph_targets
from learning.export.obj import write_obj_material, write_pictures
from learning.export.page import write_page
from learning.export.pictures import Pictures
from learning.export.recipe import readme
from learning.export.source import Source, read_source
from learning.export.usd import require_usd, write_usd
from lightstage.commands import ProgressCallback
from lightstage.errors import ConfigError
from lightstage.formats.files import atomic_folder, write_text
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import read_head_pose

FORMATS = ("gltf", "obj", "maps", "usd", "page")
PAGE = "page.html"
README = "README.txt"


def formats_of(words: str) -> list[str]:
    """The formats that a comma-separated list names, in `FORMATS`' order.

    Raises:
        ConfigError: none, or one that is unknown.
    """
    named = [word.strip() for word in words.split(",")]
    wrong = [word for word in named if word not in FORMATS]
    if wrong or not named:
        raise ConfigError(
            "--format", found=repr(words), expected=f"some of {', '.join(FORMATS)}, with commas"
        )
    return [word for word in FORMATS if word in named]


def export_command(
    maps: Path,
    mesh: Path | None,
    formats: str,
    out: Path,
    template: Path | None,
    compare: Path | None,
    progress: ProgressCallback,
    replace: bool = False,
) -> dict[str, Any]:
    """Export a head; returns the facts.

    Args:
        maps: a processed folder, its atlas, or maps of `infer`.
        mesh: of the maps; registered_mesh.obj beside them where None.
        formats: of `FORMATS`, with commas.
        out: folder to make.
        template: whose expressions become morph targets, and whose exponents replace a missing map
            of roughness.
        compare: other maps of the same mesh, such as inferred ones, for the page's slider.
        progress: of the formats.
        replace: an earlier export in `out`.

    Raises:
        LightstageError: bad input; nothing is written then.
    """
    began = time.monotonic()
    chosen = formats_of(formats)
    if "usd" in chosen:
        require_usd()
    if not replace and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise MapsError(
            out,
            field="--out",
            found="a folder that holds something" if out.is_dir() else "a file",
            expected="a new folder",
            hint="Choose another --out, or remove that one first.",
        )
    if compare is not None and "page" not in chosen:
        raise ConfigError("--compare", found="without page in --format", expected="page")
    source = read_source(maps, mesh, template)
    sides = {"captured" if compare else "head": (source, Pictures(source))}
    if compare is not None:
        place = ProcessedFolder(source.folder.parent).registered_mesh if mesh is None else mesh
        other = read_source(compare, place, template)
        sides = {"inferred": (other, Pictures(other)), **sides}
    morphs, notes = _morphs(source, template)
    notes = [*source.notes, *notes]
    pictures: Pictures = list(sides.values())[-1][1]
    written: list[tuple[str, str, str]] = []
    with atomic_folder(out, README) as folder:
        if "gltf" in chosen:
            write_glb(folder / "head.glb", source, pictures, morphs)
            progress(1 + chosen.index("gltf"), len(chosen))
        if "obj" in chosen or "usd" in chosen:
            paths = write_pictures(folder, pictures)
        if "obj" in chosen:
            write_obj_material(folder / "head.obj", source, paths)
            progress(1 + chosen.index("obj"), len(chosen))
        if "maps" in chosen:
            written = list(write_maps(folder, source))
            progress(1 + chosen.index("maps"), len(chosen))
        if "usd" in chosen:
            write_usd(folder / "head.usda", source, paths)
            progress(1 + chosen.index("usd"), len(chosen))
        if "page" in chosen:
            write_page(folder / PAGE, sides)
            progress(1 + chosen.index("page"), len(chosen))
        text = readme(chosen, source.size, written, notes, list(morphs), "roughness" in source.maps)
        write_text(folder / README, text)
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    rows, columns = source.size
    return {
        "formats": chosen,
        "rows": rows,
        "columns": columns,
        "morph_targets": list(morphs),
        "notes": notes,
        "bytes": size,
        "seconds": time.monotonic() - began,
    }


def _morphs(source: Source, template: Path | None) -> tuple[dict[str, np.ndarray], list[str]]:
    """Morph targets of a template, and notes for the user."""
    if template is None:
        return {}, []
    pose = ProcessedFolder(source.folder.parent).head_pose
    placed = read_head_pose(pose) if pose.exists() else np.eye(3, 4)
    targets, others = morph_targets(template, source.mesh, placed)
    if others:
        return targets, [f"expressions without ARKit's name, left out: {', '.join(others)}"]
    return targets, [] if targets else ["the template has no expressions: no morph targets"]
