"""Commands of finished heads: `export`, `detail`, `evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from learning.detail.config import RELIEF_MM, TIMES
from lightstage.commands import (
    JsonFlag,
    finish,
    output_file,
    output_folder,
    progress_bar,
)
from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.formats.access import group_of, limited_access


def register(app: typer.Typer) -> None:
    """Add the commands `export`, `detail` and `evaluate` to an application."""
    app.command("export")(export)
    app.command("detail")(detail)
    app.command("evaluate")(evaluate)


def export(
    maps: Annotated[
        Path,
        typer.Argument(
            help="Processed folder, whose atlas and registered mesh are taken; or a folder of "
            "maps, such as `infer` writes."
        ),
    ],
    out: Annotated[Path, output_folder("--out", help="Folder to make.")],
    mesh: Annotated[
        Path | None,
        typer.Option(
            help="Mesh with the maps' UV; else registered_mesh.obj beside the maps, of a fit "
            "its neutral one."
        ),
    ] = None,
    formats: Annotated[
        str,
        typer.Option(
            "--format",
            help="Some of, with commas: `gltf` (head.glb), `obj` (with head.mtl), `maps` (16-bit "
            "PNG and OpenEXR, with a recipe for Blender and Unreal), `usd` (needs the extra usd), "
            "`page` (page.html, which opens in a browser from the disk).",
        ),
    ] = "gltf,obj,maps",
    template: Annotated[
        Path | None,
        typer.Option(
            help="Template whose expressions become morph targets under ARKit's names, and whose "
            "shininess replaces a missing map of roughness."
        ),
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option(
            help="Inferred maps of the same mesh: the page has a slider between them and MAPS."
        ),
    ] = None,
    lods: Annotated[
        int,
        typer.Option(
            help="Levels of detail beside the head, each with a quarter of the triangles of the "
            "one before and pictures of half the rows (needs the extra meshlab)."
        ),
    ] = 0,
    as_json: bool = JsonFlag,
) -> None:
    """Write a head for artists, engines and researchers: glTF, OBJ, maps, USD, a web page."""
    from learning.export.command import export_command

    with limited_access(group_of([maps])), progress_bar("export") as progress:
        facts = export_command(maps, mesh, formats, out, template, compare, progress, levels=lods)
    finish(
        f"{out}: {', '.join(facts['formats'])}; {facts['rows']} x {facts['columns']} texels, "
        f"{facts['bytes'] / 1e6:.1f} MB, {facts['seconds']:.1f} s"
        + "".join(f"; level of {count} triangles" for count in facts["lod_triangles"])
        + "".join(f"; {note}" for note in facts["notes"]),
        facts,
        as_json,
    )


def detail(
    maps: Annotated[
        Path,
        typer.Argument(
            help="Processed folder, folder of maps such as `infer` writes, or a fit's folder."
        ),
    ],
    out: Annotated[
        Path, output_folder("--out", help="Folder to make; one of an earlier call is replaced.")
    ],
    mesh: Annotated[
        Path | None,
        typer.Option(
            help="Mesh with the maps' UV; else registered_mesh.obj beside the maps, of a fit "
            "its neutral one."
        ),
    ] = None,
    longest_mm: Annotated[
        float,
        typer.Option(
            help="Length in mm of the waves of relief that keep half of their height; longer ones "
            "are the mesh's."
        ),
    ] = RELIEF_MM,
    subdivide: Annotated[
        int, typer.Option(help="How often triangles are split into four; 0 for no mesh.")
    ] = TIMES,
    as_json: bool = JsonFlag,
) -> None:
    """Find the heights of pores and folds: a displacement map in mm, and an embossed mesh."""
    from learning.detail.command import detail_command

    with limited_access(group_of([maps])), progress_bar("detail") as progress:
        facts = detail_command(maps, mesh, out, longest_mm, subdivide, progress)
    finish(
        f"{out}: heights of {facts['height_rms_mm']:.3f} mm (root mean square), "
        f"{counted(facts['triangles'], 'triangle')}, {facts['seconds']:.1f} s",
        facts,
        as_json,
    )


def evaluate(
    inferred: Annotated[
        list[Path],
        typer.Argument(help="Folders of maps, such as `infer`, `fit` and `avatar` write."),
    ],
    truth: Annotated[
        list[Path],
        typer.Option(
            help="Processed folder with the captured maps; once for each inferred one, in order, "
            "or once for all. Those with the same truth are of one person, who counts once, and "
            "how far they agree is measured."
        ),
    ],
    data: Annotated[
        str, typer.Option(help="Whose truth: `captured` or `simulated` people.")
    ] = "captured",
    recogniser: Annotated[
        Path | None,
        typer.Option(
            help="Face recogniser of your own, .onnx, by which identity is measured; dlib's where "
            "none is given and the extra `likeness` is installed."
        ),
    ] = None,
    recogniser_size: Annotated[
        int | None,
        typer.Option(help="Side of its pictures, px, where the file does not state it."),
    ] = None,
    recogniser_range: Annotated[
        str,
        typer.Option(help="Black and white to it: `signed` -1, 1; `unit` 0, 1; `bytes` 0, 255."),
    ] = "signed",
    out: Path | None = output_file(
        "--out",
        help="Figures to write, .json; a table with .md is written beside it.",
        suffixes=[".json"],
        default=None,
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Measure inferred maps against captured ones, with intervals over people.

    With one person of several photographs intervals are over photographs.
    """
    from learning.evaluation.command import evaluate_command
    from learning.evaluation.recogniser import RecogniserRequest

    if recogniser is None and (recogniser_size is not None or recogniser_range != "signed"):
        raise ConfigError(
            "--recogniser-size, --recogniser-range",
            found="one of them without --recogniser",
            expected="--recogniser FILE.onnx",
        )
    recognise = (
        None
        if recogniser is None
        else RecogniserRequest(recogniser, recogniser_size, recogniser_range)
    )
    with (
        limited_access(group_of([*inferred, *truth])),
        progress_bar("evaluate") as progress,
    ):
        facts = evaluate_command(tuple(inferred), tuple(truth), data, out, progress, recognise)
    figures = facts["figures"]
    more = facts["photographs"] > facts["people"]
    photographs = f", {counted(facts['photographs'], 'photograph')}" if more else ""
    over = f" (intervals {facts['intervals']})" if more and facts["people"] == 1 else ""
    finish(
        f"{counted(facts['people'], 'person', 'people')}{photographs}{over}, {facts['data']}: "
        "albedo "
        f"{figures['albedo_psnr_db']['mean']:.1f} dB "
        f"({figures['albedo_relative_psnr_db']['mean']:.1f} relative), "
        + (
            f"diffuse normals {figures['diffuse_normal_mean_deg']['mean']:.1f} deg, "
            if "diffuse_normal_mean_deg" in figures
            else ""
        )
        + f"skin colour {figures['ita_error_deg']['mean']:.1f} deg of ITA, identity "
        + "".join(
            f"{name} {figures[f'identity_{name}']['mean']:.3f} "
            for name in ("cosine", "distance")
            if f"identity_{name}" in figures
        )
        + facts["identity"]
        + f", {facts['seconds']:.1f} s",
        facts,
        as_json,
    )
