"""The command `domain-light`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lightstage.commands import JsonFlag, finish, output_file, progress_bar
from lightstage.counting import counted
from lightstage.formats.access import group_of, limited_access


def register(app: typer.Typer) -> None:
    """Add the command `domain-light` to an application."""
    app.command("domain-light")(domain_light)


def domain_light(
    textures: Annotated[
        list[Path],
        typer.Argument(
            help="Textures of one source: folders that `fit` made, linear .exr files, or folders "
            "of either."
        ),
    ],
    out: Path = output_file(
        "--out", help="Light to write, .json.", suffixes=[".json"], shared=True
    ),
    mesh: Annotated[
        Path | None,
        typer.Option(help="Mesh of all textures; else each has its registered_mesh.obj beside it."),
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(help="Run folder of a whole-face network; the weights that are shipped else."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="TOML that overrides the defaults.")
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(help="For the search of the lamps, at most; 120 where not given."),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(help="Of the descent through the renderer; 200 where not given, 0 for none."),
    ] = None,
    as_json: bool = JsonFlag,
) -> None:
    """Find the light that textures of one source have in common, to train a network in it."""
    from learning.domain.command import domain_light as find_domain_light

    given = group_of([path.parent for path in textures])
    with limited_access(given), progress_bar("domain-light") as progress:
        facts = find_domain_light(textures, out, mesh, checkpoint, config, seconds, steps, progress)
    finish(
        f"{out}: {counted(facts['lamps'], 'lamp')} in {counted(facts['textures'], 'texture')}, "
        f"difference from them {facts['difference_before']:.4f} to "
        f"{facts['difference_after']:.4f}, {facts['seconds']:.1f} s"
        + "".join(f"; {note}" for note in facts["notes"]),
        facts,
        as_json,
    )
