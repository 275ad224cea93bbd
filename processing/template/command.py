"""`lightstage-processing template ...`: somebody's head model as a template, and back."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import typer

from lightstage.commands import (
    JsonFlag,
    finish,
    make_app,
    output_file,
    output_folder,
    progress_bar,
)
from processing.errors import ProcessingError

app = make_app("Templates people already have: import them, look for faults, carry maps over.")

Overwrite = typer.Option(False, "--overwrite", help="Replace a template that is there.")
UnitOption = typer.Option(
    None,
    "--unit",
    help="Of the mesh: mm, cm or m.",
    show_default="found by the mesh's size",
)


@app.command("import-ict")
def import_ict_command(
    clone: Path = typer.Argument(
        ..., metavar="PATH", help="Clone of ICT-FaceKit.", show_default=False
    ),
    out: Path = output_folder("--out", help="Template folder to make.", shared=True),
    mouth: bool = typer.Option(False, "--mouth", help="Keep gums, tongue and teeth as well."),
    unit: str | None = UnitOption,
    overwrite: bool = Overwrite,
    as_json: bool = JsonFlag,
) -> None:
    """A template of ICT Face Model Light, as its users clone it."""
    from processing.template.build import write_template
    from processing.template.config import ImportConfig
    from processing.template.import_ict import import_ict

    _require_new(out, overwrite)
    config = ImportConfig()
    with progress_bar("template import-ict") as progress:
        template, facts = import_ict(clone, config, _unit(unit), mouth, progress)
        write_template(template, out, config)
    _finish_import(out, template.regions, facts, as_json)


@app.command("import-obj")
def import_obj_command(
    mesh: Path = typer.Argument(..., help="Head mesh with UV, .obj.", show_default=False),
    landmarks: Path = typer.Option(
        ..., "--landmarks", help="JSON with points_mm or vertices, 68 iBUG.", show_default=False
    ),
    out: Path = output_folder("--out", help="Template folder to make.", shared=True),
    regions: Path | None = typer.Option(
        None,
        "--regions",
        help="JSON with vertices of skin, lips, eyes, ears, hair.",
        show_default="by our own template",
    ),
    unit: str | None = UnitOption,
    licence: str = typer.Option("", "--licence", help="Of the mesh, as the template says it."),
    overwrite: bool = Overwrite,
    as_json: bool = JsonFlag,
) -> None:
    """A template of any head mesh, with its own topology and UV."""
    from processing.template.build import write_template
    from processing.template.config import ImportConfig
    from processing.template.import_obj import import_obj

    _require_new(out, overwrite)
    config = ImportConfig()
    with progress_bar("template import-obj") as progress:
        template, facts = import_obj(
            mesh, landmarks, config, _unit(unit), regions, licence, progress
        )
        write_template(template, out, config)
    _finish_import(out, template.regions, facts, as_json)


@app.command("check")
def check_command(
    template: Path = typer.Argument(..., metavar="T", help="Template folder.", show_default=False),
    picture: Path | None = output_file(
        "--picture",
        help="Texture and mesh with the faults in colours, .png.",
        suffixes=[".png"],
        default=None,
        shared=True,
    ),
    as_json: bool = JsonFlag,
) -> None:
    """What is wrong with a template; exit 2 only where it cannot be used."""
    from lightstage.formats.png import write_png
    from lightstage.formats.template import load_template
    from processing.template.check import check_template, require_usable
    from processing.template.picture import draw

    shape = load_template(template)
    found, facts = check_template(shape)
    for each in found:
        print(f"warning: {each.name}: {each.said}", file=sys.stderr)
    if picture is not None:
        write_png(picture, draw(shape, found))
    require_usable(template, found)
    said = f"{len(found)} findings" if found else "nothing found"
    told = ("skin_angle_p95_deg", "skin_area_p95_times", "skin_texel_mm", "uv_overlap_share",
            "open_borders")  # fmt: skip
    said += "".join(f", {name} {facts[name]:.3g}" for name in told if name in facts)
    finish(f"{template}: {said}", {"template": str(template), **facts}, as_json)


def _finish_import(
    out: Path, regions: dict[str, Any], facts: dict[str, Any], as_json: bool
) -> None:
    sizes = {name: len(vertices) for name, vertices in regions.items()}
    passed = facts.get("passed_over", [])
    if passed:
        named = ", ".join(passed[:5]) + (" .." if len(passed) > 5 else "")
        print(f"warning: passed over {named}: neither identity nor expression", file=sys.stderr)
    said = f"{facts['vertices']} vertices, unit {facts['unit']}"
    if "identity_modes" in facts:
        said += f", {facts['identity_modes']} identity and {facts['expression_modes']} expression "
        said += "modes"
    said += "; " + ", ".join(f"{name} {count}" for name, count in sizes.items())
    finish(f"{out}: {said}", {"out": str(out), **facts, "region_vertices": sizes}, as_json)


def _unit(name: str | None) -> Any:
    """The unit that an option names, None where it is absent."""
    from processing.units import CM, METRES, MM

    units = {"mm": MM, "cm": CM, "m": METRES}
    if name is not None and name not in units:
        raise ProcessingError("--unit", found=repr(name), expected=" or ".join(units))
    return None if name is None else units[name]


def _require_new(out: Path, overwrite: bool) -> None:
    """Refuse to replace what is there, unless told to and a template."""
    from lightstage.formats.files import require_replaceable
    from processing.template.build import MARKER

    require_replaceable(out, MARKER)
    if not overwrite and out.is_dir() and any(out.iterdir()):
        raise ProcessingError(
            out,
            found="a folder that holds something",
            expected="a new one",
            hint="Name another, or pass --overwrite.",
        )
