"""Commands that make subject folders: from ICT Face Model Light, from any textured scan."""

from __future__ import annotations

import time
from pathlib import Path

import typer

from lightstage.commands import JsonFlag, finish, output_folder
from lightstage.counting import counted


def import_ict(
    path: Path = typer.Argument(..., help="A clone of ICT-FaceKit, or its FaceXModel folder."),
    out: Path = output_folder("--out", help="Subject folder, for `session --subject OUT`."),
    seed: int = typer.Option(0, min=0, help="Chooses the person."),
    expression: str = typer.Option("neutral", help="neutral, smile, jaw_open and so on."),
    rows: int = typer.Option(1536, min=96, max=6144, help="Rows of the maps, a multiple of 3."),
    name: str | None = typer.Option(None, help="Pseudonym; ict-SEED where absent."),
    as_json: bool = JsonFlag,
) -> None:
    """A person drawn from ICT Face Model Light's identity and expression modes, with our skin."""
    from lightstage.session import check_pseudonym
    from sim.scans.folder import require_free, save_subject
    from sim.scans.ict_subject import ict_subject

    begun = time.monotonic()
    called = f"ict-{seed}" if name is None else check_pseudonym(name, "name")
    require_free(out)
    person = ict_subject(called, path, seed, expression, rows)
    save_subject(person, out, {"from": "ICT Face Model Light", "seed": seed})
    seconds = time.monotonic() - begun
    facts = {
        "subject": str(out),
        "name": called,
        "expression": expression,
        "vertices": len(person.mesh.vertices),
        "rows": rows,
        "seconds": round(seconds, 1),
    }
    finish(
        f"{out}: {called}, {expression}, {len(person.mesh.vertices)} vertices, {rows} rows, "
        f"{seconds:.1f} s",
        facts,
        as_json,
    )


def import_scan(
    file: Path = typer.Argument(..., help="A textured scan: .glb, .gltf or .obj."),
    out: Path = output_folder("--out", help="Subject folder, for `session --subject OUT`."),
    landmarks: Path | None = typer.Option(
        None, help="JSON, ibug68: 68 points_mm, or points in the file's unit; null if unknown."
    ),
    units: str | None = typer.Option(
        None, help="mm, cm, m or the mm of one unit; glTF has m, OBJ is taken for mm."
    ),
    colour: Path | None = typer.Option(None, help="Colour texture, in place of the file's."),
    normals: Path | None = typer.Option(None, help="Tangent-space normals, in place of its own."),
    rows: int | None = typer.Option(None, min=16, max=8192, help="Of the maps; as the colour's."),
    flip_v: bool = typer.Option(False, "--flip-v", help="The file's v runs the other way."),
    flip_normals: bool = typer.Option(False, "--flip-normals", help="Its faces look inward."),
    largest_hole_mm: float = typer.Option(30.0, min=0.0, help="Larger holes are refused."),
    name: str | None = typer.Option(None, help="Pseudonym; the folder's name where absent."),
    source: str = typer.Option("", help="Who made the scan and its licence, named with pictures."),
    expression: str = typer.Option("neutral", help="What the face does."),
    as_json: bool = JsonFlag,
) -> None:
    """A textured scan as a subject: colour as albedo, gloss and what else it lacks made up."""
    from sim.scans.checks import CheckConfig
    from sim.scans.folder import require_free, save_subject
    from sim.scans.scan import ScanConfig
    from sim.scans.scan import import_scan as read

    begun = time.monotonic()
    require_free(out)
    config = ScanConfig(
        units=units,
        rows=rows,
        flip_v=flip_v,
        flip_normals=flip_normals,
        checks=CheckConfig(largest_hole_mm=largest_hole_mm),
    )
    called = out.name if name is None else name
    person, report = read(file, called, landmarks, colour, normals, source, expression, config)
    save_subject(person, out, {"from": file.name, **report.facts()})
    seconds = time.monotonic() - begun
    holes = report.mesh.holes_mm
    holes_in_words = counted(len(holes), "hole") + (f" (up to {holes[0]:.0f} mm)" if holes else "")
    finish(
        f"{out}: {called}, {counted(len(person.mesh.faces), 'triangle')}, "
        f"{report.mesh.zero_area} without area dropped, {holes_in_words}, "
        f"one unit = {report.mm_per_unit:g} mm, {counted(report.landmarks, 'landmark')}, "
        f"made up: {', '.join(report.made_up)}, {seconds:.1f} s",
        {
            "subject": str(out),
            "name": called,
            **report.facts(),
            "seconds": round(seconds, 1),
        },
        as_json,
    )


def add_import_commands(app: typer.Typer) -> None:
    """Register both commands."""
    app.command("import-ict")(import_ict)
    app.command("import-scan")(import_scan)
