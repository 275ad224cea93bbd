"""The main job on the simulated stage, by the commands that a user types, each timed.

`python -m demo.run --out build/demo` captures a simulated person, processes the photographs,
trains a small network, relights the captured head and ends with build/demo/report.html.
"""

from __future__ import annotations

import dataclasses
import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from demo.measure import run_measured
from demo.steps import DemoConfig, Layout, steps
from demo.tiny import tiny_config, tiny_rig
from lightstage.commands import output_folder, run_app
from lightstage.counting import counted
from lightstage.errors import LightstageError
from lightstage.formats.files import read_json, write_json
from lightstage.rig import save_rig

STEPS_SCHEMA = "lightstage.demo/1"


def run(config: DemoConfig, out: Path) -> int:
    """Run all steps and write the report; returns the exit status of the first step that failed.

    Args:
        config: what to show.
        out: the demo's folder; what an earlier demo left there is removed.

    Raises:
        LightstageError: `out` holds something that no demo made.
    """
    at = Layout(out)
    _clear(at)
    done: list[dict[str, Any]] = []
    write_steps(at, config, done)
    if config.tiny_rig:
        save_rig(tiny_rig(), at.rig)
    plan = steps(config, at)
    for number, step in enumerate(plan, 1):
        command = shlex.join(["python", "-m", *step.arguments])
        print(f"\n[{number}] {step.title}\n    {command}", flush=True)
        measured = run_measured([sys.executable, "-m", *step.arguments])
        print(f"    {measured.seconds:.1f} s, {measured.peak_mb:.0f} MB", flush=True)
        if measured.code:
            print(
                f"demo: step {step.name} ended with status {measured.code}; its message is above",
                file=sys.stderr,
            )
            return measured.code
        cost = {"seconds": round(measured.seconds, 2), "peak_mb": round(measured.peak_mb, 1)}
        done.append({"name": step.name, "title": step.title, "command": command, **cost})
        write_steps(at, config, done)
    print("\n[report] pictures and errors of every stage", flush=True)
    return run_measured([sys.executable, "-m", "demo.report", str(out)]).code


def write_steps(at: Layout, config: DemoConfig, done: Sequence[dict[str, Any]]) -> Path:
    """Write steps.json: the configuration and what each finished step cost."""
    values = {
        key: str(value) if isinstance(value, Path) else value
        for key, value in dataclasses.asdict(config).items()
    }
    return write_json(at.steps, {"schema": STEPS_SCHEMA, "config": values, "steps": list(done)})


def _clear(at: Layout) -> None:
    """Remove what an earlier demo left, and nothing else."""
    if at.root.exists() and any(at.root.iterdir()) and not at.steps.exists():
        raise LightstageError(
            at.root,
            found="a folder that no demo made",
            expected="a new folder or an earlier demo's",
            hint="Choose another with --out.",
        )
    if at.root.exists():
        shutil.rmtree(at.root)
    at.root.mkdir(parents=True)


def scan_is_there() -> bool:
    """Whether the scanned head is where the simulator searches for it."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("LIGHTSTAGE_DATA", beside))
    return (folder / "lps_head" / "LeePerrySmith.glb").is_file()


def main(
    out: Path = output_folder(
        "--out", help="The demo's folder, made anew.", default=Path("build/demo")
    ),
    subject: str | None = typer.Option(
        None, "--subject", help="lps or parametric [lps where the scan is at hand]."
    ),
    quick: bool = typer.Option(False, "--quick", help="Half the pixels, a short training."),
    tiny: bool = typer.Option(
        False, "--tiny", help="A parametric person in few pixels: tries the installation."
    ),
) -> None:
    """Run the demo."""
    chosen = subject or ("lps" if scan_is_there() else "parametric")
    config = DemoConfig(chosen)
    if tiny:
        if subject is not None or quick:
            raise LightstageError(
                "--tiny",
                found="--quick beside it" if quick else "--subject beside it",
                expected="--tiny alone, which is a parametric person in few pixels",
            )
        config = tiny_config()
    elif quick:
        config = dataclasses.replace(
            config, scale=config.scale / 2, atlas_rows=768, train_seconds=30
        )
    code = run(config, out)
    if code == 0:
        steps_done = read_json(Layout(out).steps)["steps"]
        seconds = sum(step["seconds"] for step in steps_done)
        print(f"\n{out / 'report.html'}: {counted(len(steps_done), 'step')}, {seconds:.0f} s")
    raise typer.Exit(code)


if __name__ == "__main__":
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command()(main)
    run_app(app)
