"""The command `experiment`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from lightstage.commands import ConsentsOption, JsonFlag, finish, output_folder, progress_bar
from lightstage.counting import counted
from lightstage.formats.access import group_of, limited_access


def register(app: typer.Typer) -> None:
    """Add the command `experiment` to an application."""
    app.command("experiment")(experiment)


def experiment(
    name: Annotated[
        str,
        typer.Argument(
            help="`ladder`, `lambda`, `n_L`, `scene`, `encoding`, `norm`, `seeds` or `people`."
        ),
    ],
    out: Annotated[
        Path, output_folder("--out", help="Folder of the experiment; the same call resumes it.")
    ],
    data: Annotated[
        Path | None,
        typer.Option(help="Store made by `lightstage-processing dataset build`."),
    ] = None,
    size: Annotated[
        str, typer.Option(help="`tiny`, `demo`, `small`, or `full`: as published.")
    ] = "small",
    config: Annotated[Path | None, typer.Option(help="TOML that overrides the size.")] = None,
    seeds: Annotated[int | None, typer.Option(help="Seeds, instead of the size's.")] = None,
    only: Annotated[
        str | None, typer.Option(help="Some of the settings, by name, with commas.")
    ] = None,
    jobs: Annotated[int, typer.Option(help="Runs at once on this machine.")] = 1,
    device: Annotated[
        str,
        typer.Option(
            help="Where networks run: `cpu`, `cuda`, `cuda:N`, `mps`; `auto`: a GPU where there is "
            "one."
        ),
    ] = "auto",
    stop_after: Annotated[
        float | None,
        typer.Option(help="Seconds after which runs save and stop; the same call resumes them."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Address of a Dask scheduler, whose workers do the runs."),
    ] = None,
    keep_weights: Annotated[
        bool, typer.Option("--keep-weights", help="Keep the network of each run.")
    ] = False,
    prepare: Annotated[
        bool,
        typer.Option("--prepare", help="Only bake the shadows that the runs share."),
    ] = False,
    report: Annotated[
        bool, typer.Option("--report", help="Only write the report of the finished runs.")
    ] = False,
    consents: Path | None = ConsentsOption,
    as_json: bool = JsonFlag,
) -> None:
    """Compare settings of the trainings over people and seeds, as published and beyond."""
    from learning.experiments.command import ExperimentRequest, experiment_command

    request = ExperimentRequest(
        name,
        out,
        data,
        size,
        config,
        seeds,
        only,
        jobs,
        device,
        stop_after,
        scheduler,
        keep_weights,
        report,
        prepare,
        consents,
    )

    def print_line(line: str) -> None:
        print(f"{name}: {line}", file=sys.stderr, flush=True)

    with limited_access(group_of([data or out])), progress_bar("experiment") as progress:
        facts = experiment_command(request, progress, print_line)
    if "prepared" in facts:
        line = f"shadows of {facts['prepared']} of {counted(facts['to_prepare'], 'run')} are baked"
    elif "runs" not in facts:
        line = f"{counted(facts['finished'], 'run')} finished; {facts['report']}"
    else:
        line = (
            f"{facts['finished']} of {counted(facts['runs'], 'run')} finished, {facts['now']} now, "
            f"{facts['diverged']} diverged, {facts['left']} left; {facts['report']}"
        )
    finish(f"{out}: {line}", facts, as_json)
