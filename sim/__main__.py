"""Commands of the simulated light stage."""

from __future__ import annotations

import time
from pathlib import Path

import typer

from lightstage.commands import JsonFlag, finish, make_app, progress_bar, run_app

app = make_app("A light stage without the hardware: sessions, data sets and the template.")


@app.callback()
def _group() -> None:
    """Keep the commands a group, however few there are."""


@app.command()
def session(
    subject: str = typer.Option(..., help="lps (the scanned head) or a parametric person's name."),
    out: Path = typer.Option(..., help="Session folder; truth goes to OUT.truth."),
    seed: int = typer.Option(0, help="Of the person, the noise and the landmark clicks."),
    expression: str = typer.Option("neutral", help="Expression of a parametric person."),
    sequence: str = typer.Option("binary", help="Named sequence or comma-separated patterns."),
    scale: float = typer.Option(0.1795, min=0.005, max=1.0, help="Pixels a side against the rig."),
    rig: Path | None = typer.Option(None, help="rig.json; the default rig where absent."),
    direct: bool = typer.Option(False, "--direct", help="Linear EXR frames without devices."),
    as_json: bool = JsonFlag,
) -> None:
    """Photograph a simulated person in the light stage."""
    from lightstage.patterns import pattern_levels, sequence_patterns
    from lightstage.rig import default_rig, load_rig
    from sim.session import SessionConfig, require_new, truth_path, write_direct
    from sim.subjects import load_subject
    from sim.truth import write_truth
    from sim.world import World

    begun = time.monotonic()
    require_new(out)
    config = SessionConfig(sequence=sequence)
    stage = (default_rig() if rig is None else load_rig(rig)).scaled(scale)
    for name in sequence_patterns(sequence):
        pattern_levels(name, stage)
    person = load_subject(subject, seed, expression, config.texture_rows)
    with progress_bar("shadow rays, cameras") as progress:
        world = World(person, stage, progress)
    with progress_bar("truth") as progress:
        truth = write_truth(world, truth_path(out), progress)
    with progress_bar("photographs") as progress:
        write_direct(world, out, config, seed, progress)
    count = len(sequence_patterns(sequence)) * len(stage.cameras)
    seconds = time.monotonic() - begun
    facts = {
        "session": str(out),
        "truth": str(truth),
        "photographs": count,
        "encoding": "linear" if direct else "raw",
        "seconds": round(seconds, 1),
    }
    finish(f"{out}: {count} photographs, truth in {truth}, {seconds:.1f} s", facts, as_json)


def main() -> None:
    """Entry point of `lightstage-sim`."""
    run_app(app)


if __name__ == "__main__":
    main()
