"""What `export` does: look through everything, write a new folder, return the facts."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from learning.errors import MapsError
from learning.export.gltf import write_glb
from learning.export.levels import coarser, on_level, require_levels, require_triangles
from learning.export.maps import MAPS, write_maps
from learning.export.morphs import PHOTO, morph_targets
from learning.export.obj import PICTURES, write_obj_material, write_pictures
from learning.export.page import write_page
from learning.export.parts.furnish import Furnished, furnished
from learning.export.pictures import Pictures
from learning.export.recipe import readme
from learning.export.source import Source, posed, read_source
from learning.export.usd import require_usd, write_usd
from lightstage.commands import ProgressCallback
from lightstage.errors import ConfigError
from lightstage.formats.files import atomic_folder, require_replaceable, write_text
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import read_head_pose

FORMATS = ("gltf", "obj", "maps", "usd", "page")
PROGRAMS = ("gltf", "obj", "usd")
"""Formats that levels of detail are written in, too."""
PAGE = "page.html"
README = "README.txt"
OWN = (README, PAGE, "head.*", f"{MAPS}/*", f"{PICTURES}/*.png")
"""What an export without levels of detail holds."""


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
    levels: int = 0,
    opens_with: str | None = None,
) -> dict[str, Any]:
    """Export a head; returns the facts.

    Args:
        maps: a processed folder, its atlas, or maps of `infer`.
        mesh: of the maps; see `read_source` where None.
        formats: of `FORMATS`, with commas.
        out: folder to make.
        template: whose expressions become morph targets, and whose exponents replace a missing map
            of roughness.
        compare: other maps of the same mesh, such as inferred ones, for the page's slider.
        progress: of the formats.
        replace: an earlier export in `out`, unless it has other files too.
        levels: of less detail, each in a folder of its own.
        opens_with: `PHOTO` for the expression of a fit's photograph; a neutral face where None.

    Raises:
        LightstageError: bad input; nothing is written then.
    """
    began = time.monotonic()
    chosen = formats_of(formats)
    if "usd" in chosen:
        require_usd()
    require_levels(levels, PROGRAMS, chosen)
    if not replace and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise MapsError(
            out,
            field="--out",
            found="a folder that holds something" if out.is_dir() else "a file",
            expected="a new folder",
            hint="Choose another --out, or remove that one first.",
        )
    require_replaceable(out, README, own=OWN)
    if compare is not None and "page" not in chosen:
        raise ConfigError("--compare", found="without page in --format", expected="page")
    source = read_source(maps, mesh, template)
    require_triangles(levels, len(source.mesh.triangles()))
    sides = {"captured" if compare else "head": (source, Pictures(source))}
    if compare is not None:
        place = ProcessedFolder(source.folder.parent).registered_mesh if mesh is None else mesh
        other = read_source(compare, place, template)
        if source.photo_mm is not None:
            other = posed(other, -source.photo_mm)
        sides = {"inferred": (other, Pictures(other)), **sides}
    with_morphs = bool({"gltf", "page"} & set(chosen))
    morphs, notes = _morphs(source, template, mesh, with_morphs)
    if source.photo_mm is not None:
        morphs[PHOTO] = source.photo_mm
    head = furnished(source, morphs) if with_morphs else Furnished(source, morphs)
    notes = [*source.notes, *notes]
    pictures: Pictures = list(sides.values())[-1][1]
    written: list[tuple[str, str, str]] = []
    programs = [name for name in chosen if name in PROGRAMS]
    steps = iter(range(1, 1 + len(chosen) + levels * len(programs)))

    def step() -> None:
        progress(next(steps), len(chosen) + levels * len(programs))

    finer, counts = source, []
    with atomic_folder(out, README, own=OWN) as folder:
        _write_programs(folder, programs, source, pictures, morphs, head, opens_with, step)
        if "maps" in chosen:
            written = list(write_maps(folder, source))
            step()
        if "page" in chosen:
            write_page(folder / PAGE, sides, head, opens_with)
            step()
        for number in range(1, levels + 1):
            finer = coarser(finer)
            counts.append(len(finer.mesh.triangles()))
            moved = {name: on_level(source, finer, offset) for name, offset in morphs.items()}
            level = folder / f"lod{number}"
            level.mkdir()
            plain, drawn = Furnished(finer, moved), Pictures(finer)
            _write_programs(level, programs, finer, drawn, moved, plain, opens_with, step)
        rough = "roughness" in source.maps
        text = readme(
            chosen, source.size, written, notes, list(head.morphs), rough, counts, opens_with
        )
        write_text(folder / README, text)
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    rows, columns = source.size
    return {
        "formats": chosen,
        "rows": rows,
        "columns": columns,
        "morph_targets": list(head.morphs),
        "lod_triangles": counts,
        "notes": notes,
        "bytes": size,
        "seconds": time.monotonic() - began,
    }


def _write_programs(
    folder: Path,
    programs: list[str],
    source: Source,
    pictures: Pictures,
    morphs: dict[str, np.ndarray],
    head: Furnished,
    opens_with: str | None,
    step: Callable[[], None],
) -> None:
    """Write a head, or a level of it, for other programs: some of `PROGRAMS`; a step after each.

    Args:
        folder: of the files.
        programs: their formats.
        source: the closed skin.
        pictures: of it.
        morphs: of it.
        head: the skin as it may be opened, for formats with morph targets.
        opens_with: the morph that is shown; None for none.
        step: called after each format.
    """
    if "gltf" in programs:
        write_glb(folder / "head.glb", head, pictures, opens_with)
        step()
    if opens_with in morphs:
        # Formats without morph targets have the expression in the mesh.
        source = posed(source, morphs[opens_with])
    if "obj" in programs or "usd" in programs:
        paths = write_pictures(folder, pictures)
    if "obj" in programs:
        write_obj_material(folder / "head.obj", source, paths)
        step()
    if "usd" in programs:
        write_usd(folder / "head.usda", source, paths)
        step()


def _morphs(
    source: Source, template: Path | None, mesh: Path | None, wanted: bool
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Morph targets of a template, and notes for the user; the mesh's own file may be elsewhere."""
    if template is None:
        return {}, []
    if not wanted:
        return {}, ["expressions (--template) are written to glTF and page alone: no morph targets"]
    places = [source.folder.parent, *([] if mesh is None else [mesh.parent])]
    poses = [
        pose for pose in (ProcessedFolder(place).head_pose for place in places) if pose.exists()
    ]
    placed = read_head_pose(poses[0]) if poses else None
    targets, others = morph_targets(template, source.mesh, placed)
    if others:
        return targets, [f"numbered modes, which are no movements, left out: {', '.join(others)}"]
    return targets, [] if targets else ["the template has no expressions: no morph targets"]
