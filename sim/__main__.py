"""Commands of the simulated light stage."""

from __future__ import annotations

if __name__ == "__main__":
    from lightstage.interrupts import end_without_traceback

    end_without_traceback()  # until the imports below are done

import time
from pathlib import Path

import typer

from lightstage.commands import (
    JsonFlag,
    finish,
    make_app,
    output_file,
    output_folder,
    progress_bar,
    run_app,
)
from lightstage.counting import counted
from sim.devices.icl_command import icl
from sim.devices.stage_command import add_stage_commands
from sim.errors import SimError
from sim.scans.commands import add_import_commands

SUBJECT_HELP = (
    "lps (the scanned head), ict (a head of ICT Face Model Light), a subject folder, or any other "
    "name: a parametric person."
)
MOST_STOPS = 64
"""Largest change of exposure, in stops: more would leave every picture black or white."""
app = make_app("A light stage without the hardware: people, light, sessions, targets, data sets.")
add_import_commands(app)
add_stage_commands(app)
app.command("icl")(icl)


@app.command()
def session(
    subject: str = typer.Option(..., help=SUBJECT_HELP),
    out: Path = output_folder("--out", help="Session folder; truth goes to OUT.truth."),
    seed: int = typer.Option(0, min=0, help="Of the person, the noise and the landmark clicks."),
    expression: str | None = typer.Option(None, help="Neutral, or what a folder's face does."),
    sequence: str = typer.Option("binary", help="Named sequence or comma-separated patterns."),
    scale: float = typer.Option(
        0.1795, min=0.005, max=1.0, help="Share of the rig's pixels a side."
    ),
    rig: Path | None = typer.Option(None, help="rig.json; the default rig where absent."),
    direct: bool = typer.Option(False, "--direct", help="Linear EXR photographs without devices."),
    light: str = typer.Option("fast", help="fast, or reference: bounces and subsurface, slow."),
    flaws: str = typer.Option(
        "ideal", help="What lens, lamps, room and subject do: ideal, lab, bad, or a TOML file."
    ),
    faults: Path | None = typer.Option(
        None, help="Story of what goes wrong with the devices (TOML, docs/faults.md)."
    ),
    rows: int = typer.Option(
        1536, min=96, max=6144, help="Rows of the person's maps, a multiple of 3; a folder's stay."
    ),
    consent: str | None = typer.Option(
        None, "--consent", help="Id of a consent record, as `lightstage capture` takes it."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Photograph a simulated person in the light stage."""
    import numpy as np

    from lightstage.formats.landmarks import LANDMARKS
    from lightstage.patterns import drive_levels, pattern_levels, sequence_patterns
    from lightstage.rig import default_rig, load_rig
    from lightstage.session import check_consent
    from sim.camera.flaws import load_flaws
    from sim.camera.optics import distorted
    from sim.camera.room import even_levels
    from sim.devices.capture import capture_session
    from sim.devices.faults import Story
    from sim.light.lamps import lamps_of
    from sim.light.polarised import is_polarised
    from sim.light.world import World
    from sim.people.person import require_rows
    from sim.people.subjects import check_subject, load_subject
    from sim.reference.world import ReferenceWorld
    from sim.session import (
        SessionConfig,
        require_new,
        truth_path,
        write_direct,
        write_landmarks,
    )
    from sim.truth import write_truth

    begun = time.monotonic()
    check_subject(subject)
    if consent is not None:
        check_consent(consent)
    require_rows(rows, "--rows")
    require_new(out)
    config = SessionConfig(sequence=sequence, texture_rows=rows)
    if light not in ("fast", "reference"):
        raise SimError("--light", found=light, expected="fast or reference")
    done_to_light = load_flaws(flaws)
    story = None if faults is None else Story.read(faults)
    if story is not None and direct:
        raise SimError("--faults", found="--direct too", expected="devices that can have faults")
    stage = (default_rig() if rig is None else load_rig(rig)).scaled(scale)
    stage = distorted(stage, done_to_light.lens)
    patterns = sequence_patterns(sequence, stage)
    if light == "reference" and any(is_polarised(name) for name in patterns):
        raise SimError(
            "--light reference", found="a polarised pattern", expected="patterns without @"
        )
    # Frames without devices are lit plainly; through the devices, as `lightstage capture` drives.
    states = [(pattern_levels if direct else drive_levels)(name, stage) for name in patterns]
    if story is not None:
        story.check_cameras([camera.id for camera in stage.cameras], "--faults")
    person = load_subject(subject, seed, expression, config.texture_rows)
    with progress_bar("shadow rays, cameras") as progress:
        lamps = lamps_of(stage, done_to_light.lamps, seed)
        world = World(person, stage, progress, lamps=lamps)
    with progress_bar("truth") as progress:
        truth = write_truth(world, truth_path(out), progress)
    lit: World | ReferenceWorld = world
    if light == "reference":
        lit = ReferenceWorld(person, stage, lamps)
        with progress_bar("path tracing, cameras") as progress:
            if done_to_light.room.ambient > 0:
                states.append(even_levels(lamps))
            lit.prepare(np.stack(states), progress)
    if direct:
        with progress_bar("photographs") as progress:
            write_direct(lit, out, config, seed, progress, done_to_light, consent)
    else:
        capture_session(lit, out, seed, sequence, done_to_light, story, consent=consent)
        write_landmarks(world, out / LANDMARKS, seed, config.click_noise_px)
    count = len(patterns) * len(stage.cameras)
    seconds = time.monotonic() - begun
    facts = {
        "session": str(out),
        "truth": str(truth),
        "photographs": count,
        "encoding": "linear" if direct else "raw",
        "seconds": round(seconds, 1),
    }
    finish(
        f"{out}: {counted(count, 'photograph')}, truth in {truth}, {seconds:.1f} s", facts, as_json
    )


@app.command()
def dataset(
    out: Path = output_folder("--out", help="Folder for all of them."),
    subjects: int | None = typer.Option(
        None, min=1, help="How many people; as many as the table has where absent."
    ),
    expressions: int = typer.Option(7, min=1, max=7, help="Of each; the first one is neutral."),
    seed: int = typer.Option(0, min=0, help="The same seed gives the same files to the byte."),
    people: str = typer.Option(
        "balanced", help="Shares by sex, age, tone and look: a table's name or a TOML file."
    ),
    maps_only: bool = typer.Option(False, "--maps-only", help="Maps and meshes, no photographs."),
    rows: int = typer.Option(1536, min=96, max=6144, help="Rows of the maps, a multiple of 3."),
    jobs: int = typer.Option(
        0, min=0, help="Processes for --maps-only; 0 for as many as cores and memory allow."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Make many parametric people, as maps or as sessions; continue where a run stopped."""
    from sim.people.dataset import make_plan, write_people, write_sessions
    from sim.people.table import load_table

    table = load_table(people)
    _require_own(out, "person-", ".person-", "people.")
    begun = time.monotonic()
    plan = make_plan(out, table, subjects or table.subjects, expressions, seed, rows)
    with progress_bar("scans") as progress:
        made = write_people(plan, jobs, progress) if maps_only else write_sessions(plan, progress)
    seconds = time.monotonic() - begun
    facts = {
        "out": str(out),
        "people": len(plan.persons),
        "scans": plan.scans,
        "made": made,
        "rows": rows,
        "seconds": round(seconds, 1),
    }
    finish(
        f"{out}: {counted(plan.scans, 'scan')} of "
        f"{counted(len(plan.persons), 'person', 'people')}, {made} made now, {seconds:.1f} s",
        facts,
        as_json,
    )


@app.command()
def render(
    subject: str = typer.Option(..., help=SUBJECT_HELP),
    light: str = typer.Option(
        ...,
        help="A pattern (full, x+, full@cross, olat-003 ..), street, noon, sunset, uniform, "
        "softbox, ring, rim, clamshell, or a file: latitude-longitude .exr or .hdr, lights .json.",
    ),
    out: Path = output_file(
        "--out", help="Picture, .png (exposed) or .exr (linear).", suffixes=[".png", ".exr"]
    ),
    seed: int = typer.Option(0, min=0, help="Of the person, and of the street's houses."),
    expression: str | None = typer.Option(None, help="Neutral, or what a folder's face does."),
    camera: str = typer.Option("cam0", help="View: a camera of the rig."),
    width: int = typer.Option(480, min=16, max=6016, help="Pixels across."),
    lights: int = typer.Option(256, help="Lights that stand for an environment, at most."),
    rotate: float = typer.Option(0.0, help="Degrees that an environment turns, +z toward +x."),
    exposure: float | None = typer.Option(None, help="Stops of a .png; automatic where absent."),
    reference: bool = typer.Option(
        False, "--reference", help="Path-traced, with bounces and light inside the skin."
    ),
    rig: Path | None = typer.Option(None, help="rig.json; the default rig where absent."),
    as_json: bool = JsonFlag,
) -> None:
    """Render a person under a pattern of the stage or under an environment."""
    from lightstage.rig import default_rig, load_rig
    from sim.light.portrait import portrait, require_light, write_portrait
    from sim.light.relight import RelightConfig, require_picture
    from sim.people.subjects import check_subject, load_subject

    begun = time.monotonic()
    check_subject(subject)
    require_picture(out)
    if exposure is not None and not abs(exposure) <= MOST_STOPS:
        expected = f"stops between -{MOST_STOPS} and {MOST_STOPS}"
        raise SimError("--exposure", found=str(exposure), expected=expected)
    config = RelightConfig(lights=lights, rotate_deg=rotate)
    stage = default_rig() if rig is None else load_rig(rig)
    stage = stage.scaled(width / stage.camera(camera).width_px)
    require_light(light, stage)  # an unknown one is refused before a person is made
    person = load_subject(subject, seed, expression)
    with progress_bar("lights") as progress:
        picture = portrait(
            person, stage, camera, light, config, seed, progress, reference=reference
        )
    factor = write_portrait(picture, out, exposure)
    seconds = time.monotonic() - begun
    facts = {
        "picture": str(out),
        "width_px": picture.shape[1],
        "height_px": picture.shape[0],
        "exposure": round(factor, 4),
        "seconds": round(seconds, 1),
    }
    size = f"{picture.shape[1]} x {picture.shape[0]} px"
    finish(f"{out}: {size}, exposure x {factor:.3g}, {seconds:.1f} s", facts, as_json)


@app.command()
def targets(
    out: Path = output_folder(
        "--out", help="Session folder; truth goes to OUT.truth.", shared=True
    ),
    rig: Path | None = typer.Option(None, help="rig.json; the default rig where absent."),
    seed: int = typer.Option(0, min=0, help="Of the board's poses, lenses, sensors and noise."),
    scale: float = typer.Option(
        0.1795, min=0.005, max=1.0, help="Share of the rig's pixels a side."
    ),
    flaws: str = typer.Option(
        "ideal", help="What lens, lamps, room and sensor do: ideal, lab, bad, or a TOML file."
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Photograph calibration targets: boards, chart, mirror and grey ball, flats and darks."""
    from lightstage.rig import default_rig, load_rig
    from sim.camera.flaws import load_flaws
    from sim.camera.optics import distorted
    from sim.session import require_new, truth_path
    from sim.targets.target_session import TargetsConfig, write_targets

    begun = time.monotonic()
    require_new(out)
    done_to_light = load_flaws(flaws)
    stage = (default_rig() if rig is None else load_rig(rig)).scaled(scale)
    stage = distorted(stage, done_to_light.lens)
    with progress_bar("photographs") as progress:
        write_targets(stage, out, TargetsConfig(), done_to_light, seed, progress)
    seconds = time.monotonic() - begun
    count = sum(1 for _ in out.glob("frames/*/*.dng"))
    truth = truth_path(out)
    facts = {
        "session": str(out),
        "truth": str(truth),
        "photographs": count,
        "seconds": round(seconds, 1),
    }
    finish(
        f"{out}: {counted(count, 'photograph')}, truth in {truth}, {seconds:.1f} s", facts, as_json
    )


@app.command()
def gallery(
    out: Path = output_file(
        "--out", help="Picture, .png (exposed) or .exr (linear).", suffixes=[".png", ".exr"]
    ),
    subjects: int = typer.Option(6, min=1, help="How many people, one a row."),
    expressions: str = typer.Option("neutral,smile,brow_raise", help="Columns of each light."),
    lights: str = typer.Option("full,x+,street", help="Patterns or environments, as in `render`."),
    people: str = typer.Option("balanced", help="Shares: a table's name or a TOML file."),
    seed: int = typer.Option(0, min=0, help="Of the people."),
    width: int = typer.Option(240, min=16, max=2048, help="Pixels across one picture."),
    rows: int = typer.Option(1536, min=96, max=6144, help="Rows of the textures."),
    as_json: bool = JsonFlag,
) -> None:
    """Make a contact sheet of people in several expressions under several lights."""
    from lightstage.rig import default_rig
    from sim.people.dataset import make_plan
    from sim.people.gallery import CAMERA, write_gallery
    from sim.people.table import load_table

    begun = time.monotonic()
    plan = make_plan(out.parent, load_table(people), subjects, 1, seed, rows)
    rig = default_rig()
    rig = rig.scaled(width / rig.camera(CAMERA).width_px)
    with progress_bar("pictures") as progress:
        write_gallery(
            plan.persons, expressions.split(","), lights.split(","), rig, rows, out, progress
        )
    seconds = time.monotonic() - begun
    facts = {"picture": str(out), "people": subjects, "seconds": round(seconds, 1)}
    finish(f"{out}: {counted(subjects, 'person', 'people')}, {seconds:.1f} s", facts, as_json)


@app.command()
def template(
    out: Path = output_folder("--out", help="Template folder.", shared=True),
    loops: bool = typer.Option(
        False,
        "--loops",
        help="In the topology with closed loops of quads around eyes and mouth, with the people "
        "and the detector's points of the template that is installed.",
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Write our own template: mesh, UV, landmarks, regions, modes, skin maps."""
    from sim.head.loops_template import build_loops_template
    from sim.head.template import write_template

    names = ["template.json", "mesh.obj", "modes.npz", "maps"]
    if loops:
        names += ["mediapipe468.json", "population.npz", "population_mediapipe468.json"]
    _require_own(out, *names)
    begun = time.monotonic()
    path = write_template(out, build_loops_template() if loops else None)
    seconds = time.monotonic() - begun
    finish(f"{path}: template, {seconds:.1f} s", {"template": str(path)}, as_json)


def _require_own(out: Path, *names: str) -> None:
    """Refuse to write into a folder that holds anything but what the same command made."""
    from lightstage.formats.files import others_in

    foreign = others_in(out, [f"{name}*" for name in names])
    if foreign:
        raise SimError(
            out,
            found=f"a folder with {foreign[0]}",
            expected="a new folder",
            hint="Name another, or remove what is there.",
        )


def main() -> None:
    """Entry point of `lightstage-sim`."""
    run_app(app)


if __name__ == "__main__":
    main()
