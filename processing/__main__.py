"""Commands of `lightstage-processing`: photographs to the registered atlas, and the dataset."""

from __future__ import annotations

if __name__ == "__main__":
    from lightstage.interrupts import end_without_traceback

    end_without_traceback()  # until the imports below are done

import sys
from pathlib import Path
from typing import Any

import typer

from lightstage.commands import (
    ConsentsOption,
    JsonFlag,
    finish,
    make_app,
    output_file,
    output_folder,
    progress_bar,
    run_app,
)
from lightstage.counting import counted
from lightstage.formats.access import group_of, limited_access
from lightstage.formats.consents import require_consents
from lightstage.formats.template import default_template_path
from processing import dataset_commands
from processing.atlas.config import AtlasConfig
from processing.batch import command as batch_command
from processing.batch.config import take_batch
from processing.calibration import command as calibration_command
from processing.calibration.cameras import command as cameras_command
from processing.calibration.lights import wiring_command
from processing.errors import ProcessingError
from processing.options import TemplatePath
from processing.template import command as template_command

app = make_app("Photographs of a light stage to reflectance maps, mesh, atlas and dataset.")
dataset_app = make_app("The lab's store of many processed sessions, and its published form.")
app.add_typer(dataset_app, name="dataset")
app.add_typer(template_command.app, name="template")
dataset_commands.register(dataset_app)
calibration_command.register(app)
cameras_command.register(app)
wiring_command.register(app)
batch_command.register(app)

SessionPath = typer.Argument(..., help="Session folder.", show_default=False)
OutPath = output_folder("--out", help="Processed folder, made or continued.")
Overwrite = typer.Option(False, "--overwrite", help="Replace what is there.")
Force = typer.Option(
    False, "--force", help="Continue where photographs contradict each other or their patterns."
)
ConfigPath = typer.Option(None, "--config", help="TOML file with one table for each stage.")
AtlasRows = typer.Option(
    None, "--atlas-rows", min=6, help=f"Atlas height in texels [{AtlasConfig.rows}]."
)


@app.command()
def run(
    session: Path = SessionPath,
    out: Path = OutPath,
    template: Path = TemplatePath,
    config: Path | None = ConfigPath,
    until: str = typer.Option("atlas", "--until", help="The last stage to run."),
    atlas_rows: int | None = AtlasRows,
    mesh: Path | None = typer.Option(
        None,
        "--mesh",
        help="Your own mesh of this head as it sat, .ply or .obj, mm, in the rig's axes, in place "
        "of a reconstructed one.",
    ),
    occluders: Path | None = typer.Option(
        None,
        "--occluders",
        help="Mesh of what else casts shadows or hides skin: clothes, hair, glasses.",
    ),
    force: bool = Force,
    why: bool = typer.Option(
        False, "--why", help="Print which stages would run and why; run none."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Everything from photographs to the atlas; what is up to date is skipped."""
    if why:
        _why(session, out, template, config, atlas_rows, as_json, until, force, (mesh, occluders))
        return
    _process(
        session,
        out,
        template,
        config,
        atlas_rows,
        as_json,
        until=until,
        force=force,
        meshes=(mesh, occluders),
    )


@app.command()
def separate(
    session: Path = SessionPath,
    out: Path = OutPath,
    config: Path | None = ConfigPath,
    force: bool = Force,
    as_json: bool = JsonFlag,
) -> None:
    """Coarse far-field maps of every view (decodes first where needed)."""
    _process(session, out, None, config, None, as_json, only="separate", force=force)


def _add_stage(stage: str, help_text: str) -> None:
    """Add the command that runs one stage, which reads no template, on what is in OUT."""

    @app.command(stage, help=help_text)
    def command(
        session: Path = SessionPath,
        out: Path = OutPath,
        config: Path | None = ConfigPath,
        as_json: bool = JsonFlag,
    ) -> None:
        _process(session, out, None, config, None, as_json, only=stage)


_add_stage("reconstruct", "The base mesh from the decoded views.")
_add_stage("refine", "Exact maps of every view, with the mesh's positions and shadows.")


@app.command()
def register(
    session: Path = SessionPath,
    out: Path = OutPath,
    template: Path = TemplatePath,
    config: Path | None = ConfigPath,
    as_json: bool = JsonFlag,
) -> None:
    """The template brought onto the base mesh."""
    _process(session, out, template, config, None, as_json, only="register")


@app.command()
def atlas(
    session: Path = SessionPath,
    out: Path = OutPath,
    template: Path = TemplatePath,
    config: Path | None = ConfigPath,
    atlas_rows: int | None = AtlasRows,
    as_json: bool = JsonFlag,
) -> None:
    """The views' maps blended into the template's texture."""
    _process(session, out, template, config, atlas_rows, as_json, only="atlas")


def _process(
    session: Path,
    out: Path,
    template: Path | None,
    config: Path | None,
    atlas_rows: int | None,
    as_json: bool,
    *,
    until: str = "atlas",
    only: str | None = None,
    force: bool = False,
    meshes: tuple[Path | None, Path | None] = (None, None),
) -> None:
    from processing import pipeline, pipeline_config

    settings = pipeline_config.read_config(
        config, atlas_rows, *meshes, force=force, take=take_batch
    )
    with limited_access(group_of([session])):
        report = pipeline.run(
            session,
            out,
            template or default_template_path(),
            settings,
            until=until,
            only=only,
            bar=progress_bar,
        )
    ran = report["ran"]
    for warning in report["warnings"]:
        if warning.partition(":")[0] in ran:
            print(f"warning: {warning}", file=sys.stderr)
    seconds = sum(report["stages"][stage]["seconds"] for stage in ran)
    peak = max((report["stages"][stage]["peak_rss_mb"] for stage in ran), default=0.0)
    summary = f"ran {' '.join(ran)} in {seconds:.1f} s, peak {peak:.0f} MB" if ran else "up to date"
    warned = f", {counted(len(report['warnings']), 'warning')}" if report["warnings"] else ""
    facts = {"out": str(out), "ran": ran, "stages": report["stages"]}
    finish(f"{out}: {summary}{warned}", {**facts, "warnings": report["warnings"]}, as_json)


def _why(
    session: Path,
    out: Path,
    template: Path,
    config: Path | None,
    atlas_rows: int | None,
    as_json: bool,
    until: str,
    force: bool,
    meshes: tuple[Path | None, Path | None],
) -> None:
    """Print which stages would run, and why."""
    from processing import pipeline, pipeline_config

    settings = pipeline_config.read_config(
        config, atlas_rows, *meshes, force=force, take=take_batch
    )
    reasons = pipeline.why(pipeline.read_job(session, out, template, settings, until), until)
    lines = [f"{stage}: {reason or 'up to date'}" for stage, reason in reasons.items()]
    finish("\n".join(lines), {"out": str(out), "stages": reasons}, as_json)


@app.command("register-mesh")
def register_mesh(
    mesh: Path = typer.Argument(..., help="Scan, .obj or .ply, in mm.", show_default=False),
    landmarks: Path | None = typer.Option(
        None, "--landmarks", help="JSON with points_mm, 68 iBUG."
    ),
    landmark_command: str | None = typer.Option(
        None,
        "--landmark-command",
        help="Or a program that finds them in pictures of the mesh; our own detector without both.",
    ),
    out: Path = output_file(
        "--out", help="Registered mesh, .obj, in the template's UV.", suffixes=[".obj"]
    ),
    template: Path = TemplatePath,
    config: Path | None = ConfigPath,
    as_json: bool = JsonFlag,
) -> None:
    """Register the template to any scan."""
    import numpy as np

    from lightstage.formats.landmarks import read_points_mm
    from lightstage.formats.mesh import read_mesh, write_obj
    from lightstage.formats.template import load_template
    from lightstage.meshlab import cleaned
    from processing import pipeline_config
    from processing.registration.providers import (
        CommandLandmarks,
        DetectedLandmarks,
        landmarks_of_mesh,
    )
    from processing.registration.stage import register_mesh as register_scan
    from processing.registration.start import landmarks_unit, named, require_surface
    from processing.units import MM, axis_name, largest_side, likely_unit

    if landmarks is not None and landmark_command is not None:
        raise ProcessingError(
            "--landmark-command", found="it beside --landmarks", expected="one of the two"
        )
    if out.exists() and mesh.exists() and out.samefile(mesh):
        raise ProcessingError(
            out,
            field="--out",
            found="the scan itself",
            expected="another file",
            hint="The registered mesh would take the scan's place.",
        )
    shape, scan = load_template(template), read_mesh(mesh)
    settings = pipeline_config.read_config(config).register
    command = landmark_command or settings.landmark_command
    notes: list[str] = []
    with named(mesh):
        require_surface(scan)
    if landmarks is not None:
        points_mm = read_points_mm(landmarks)
        unit = landmarks_unit(scan, points_mm, shape)
        points_mm = unit.mm * points_mm
    else:
        provider = CommandLandmarks(command) if command else DetectedLandmarks(shape)
        unit = likely_unit(scan.vertices)
        scaled = scan.with_vertices(unit.mm * scan.vertices)
        marks_mm = shape.mesh.vertices[shape.landmarks]
        agree_mm = settings.click_agree_mm if command else settings.detected_agree_mm
        with named(mesh):
            found = landmarks_of_mesh(scaled, provider, agree_mm, marks_mm)
        points_mm = found.landmarks.points_mm
        if not np.array_equal(found.turn, np.eye(3)):
            ahead, up = (axis_name(found.turn[row]) for row in (2, 1))
            notes.append(f"the face was found looking along {ahead} with {up} up")
    if unit is not MM:
        side = largest_side(scan.vertices)
        notes.append(
            f"largest side {side:.3g}: taken for {unit.name} and multiplied by {unit.mm:g}"
        )
        scan = scan.with_vertices(unit.mm * scan.vertices)
    scan, removed, note = cleaned(scan, mesh.name)
    notes += [note] if note else []
    with limited_access(group_of([mesh.parent])), progress_bar("register-mesh") as progress:
        with named(mesh, landmarks):
            vertices, facts = register_scan(scan, points_mm, shape, settings, progress)
        write_obj(shape.mesh.with_vertices(vertices), out)
    facts = {"scan_unit": unit.name, "notes": notes, "scan_cleaned": removed, **facts}
    summary = "; ".join([*notes, _facts_in_words(facts)])
    finish(f"{out}: {summary}", {"out": str(out), **facts}, as_json)


@app.command()
def evaluate(
    out: Path = typer.Argument(..., help="Processed folder.", show_default=False),
    truth: Path = typer.Argument(..., help="Truth in the same form.", show_default=False),
    template: Path = TemplatePath,
    albedo: str = typer.Option(
        "entered",
        help="What the truth's diffuse albedo is a share of: the light that `entered` the skin, or "
        "`incident` light, as in renderers without an interface.",
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Every error there is against a simulated session's truth."""
    from processing.evaluation.config import AlbedoOf, EvaluateConfig
    from processing.evaluation.folder import evaluate as evaluate_folder
    from processing.evaluation.folder import headline

    if albedo not in list(AlbedoOf):
        raise ProcessingError(
            "--albedo", found=repr(albedo), expected=" or ".join(AlbedoOf), hint="See --help."
        )
    with limited_access(group_of([out])), progress_bar("evaluate") as progress:
        facts = evaluate_folder(
            out, truth, template, EvaluateConfig(albedo=AlbedoOf(albedo)), progress
        )
    finish(f"{out / 'evaluation.json'}: {_facts_in_words(headline(facts))}", facts, as_json)


@dataset_app.command()
def build(
    processed: list[Path] = typer.Argument(..., help="Processed folders.", show_default=False),
    out: Path = output_folder("--out", help="Store to make."),
    overwrite: bool = Overwrite,
    consents: Path | None = ConsentsOption,
    as_json: bool = JsonFlag,
) -> None:
    """The lab's store: whole maps of every scan."""
    from lightstage.formats.files import require_new
    from processing.dataset import (
        DATASET,
        STORE,
        STORE_FILES,
        build_store,
        open_store,
        without_people_files,
    )

    require_new(out, overwrite, DATASET, STORE, STORE_FILES)
    folders, passed = without_people_files(processed)
    with limited_access(group_of(folders)), progress_bar("dataset build") as progress:
        build_store(folders, out, progress, consents)
    scans = open_store(out).scans
    subjects = len({scan.subject for scan in scans})
    unasked = len({s.subject for s in scans if not (s.consent or s.synthetic)})
    facts = {
        "out": str(out),
        "scans": len(scans),
        "subjects": subjects,
        "subjects_without_consent": unasked,
        "passed_over": [str(path) for path in passed],
    }
    summary = f"{counted(len(scans), 'scan')} of {counted(subjects, 'subject')}"
    if unasked:
        summary += f", {unasked} without a consent record"
    if passed:
        names = ", ".join(path.name for path in passed)
        summary += f"; skipped {names} of lightstage-sim dataset"
    finish(f"{out}: {summary}", facts, as_json)


@dataset_app.command()
def publish(
    store: Path = typer.Argument(..., help="The lab's store.", show_default=False),
    out: Path = output_folder("--out", help="Published folder to make.", shared=True),
    overwrite: bool = Overwrite,
    form: str = typer.Option(
        "zarr", "--format", help="zarr: one group; webdataset: tars that this package reads."
    ),
    patch: int | None = typer.Option(
        None,
        "--patch",
        min=8,
        help="Side of a patch in texels; by default 512 for each 6144 rows of the atlas. A patch "
        "shows at most 1/40 of the face.",
    ),
    gap: float | None = typer.Option(
        None, "--gap", help="Least distance of patches, as a share of their side [0.5]."
    ),
    drop: float | None = typer.Option(
        None, "--drop", help="Share of everybody's patches that is left out [0.25]."
    ),
    without_consent: bool = typer.Option(
        False,
        "--without-consent",
        help="Publish people without a consent record, too; the published set states it.",
    ),
    about: Path | None = typer.Option(
        None,
        "--about",
        help="TOML file with name, license, terms, creators, contact and url of the release; "
        "nothing is published without it.",
    ),
    consents: Path | None = ConsentsOption,
    seed: int | None = typer.Option(
        None,
        "--seed",
        min=0,
        help="Of what is left out and of the order, kept out of the result; by default a secret.",
    ),
    as_json: bool = JsonFlag,
) -> None:
    """The anonymous form: small patches apart from each other, turned, shuffled, some left out."""
    from lightstage.formats.files import read_json, require_new
    from processing.dataset import (
        DATASET,
        PUBLISHED,
        RELEASE_FILES,
        PublishConfig,
        narrow_gap,
        open_store,
        read_about,
        same_version,
    )
    from processing.dataset import publish as publish_store

    require_new(out, overwrite, DATASET, PUBLISHED, RELEASE_FILES)
    given: dict[str, Any] = {
        "form": form,
        "patch_px": patch,
        "gap": gap,
        "drop": drop,
        "without_consent": without_consent,
    }
    config = PublishConfig(**{k: v for k, v in given.items() if v is not None})
    if consents is not None and without_consent:
        raise ProcessingError(
            "--without-consent",
            found="it beside a registry of consents",
            expected="one of the two",
            hint="What the registry refuses is not published.",
        )
    opened = open_store(store, "These patches are published already.")
    require_consents(consents, "publication", opened.consents)
    about_file = read_about(about)
    warnings = [*filter(None, [narrow_gap(config.gap), same_version(opened, out, about_file)])]
    with progress_bar("dataset publish") as progress:
        publish_store(opened, out, seed, config, progress, about=about_file)
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    written = read_json(out / DATASET)
    counts, unasked = written["counts"], written["consent"]["subjects_without"]
    summary = counted(counts["patches"], "patch", "patches")
    summary += f" of {counted(counts['subjects'], 'subject')}"
    if unasked:
        summary += f", {unasked} of them without a consent record"
    if about_file.unanswered:
        open_ones = counted(len(about_file.unanswered), "question")
        summary += f"; {open_ones} of its DATASHEET.md not answered: "
        summary += ", ".join(about_file.unanswered)
    facts = {
        "out": str(out),
        **counts,
        "unanswered": about_file.unanswered,
        "patch": written["patch"],
        "gap": written["gap"],
    }
    facts |= {"subjects_without_consent": unasked, "warnings": warnings}
    finish(f"{out}: {summary}", facts, as_json)


def _facts_in_words(facts: dict[str, Any]) -> str:
    """The plain numbers among facts, on one line."""
    plain = {k: v for k, v in facts.items() if isinstance(v, (int, float, str))}
    return ", ".join(
        f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
        for key, value in plain.items()
    )


def main() -> None:
    """Entry point."""
    run_app(app)


if __name__ == "__main__":
    main()
