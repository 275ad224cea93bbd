"""Commands of the learning package: train, infer, upscale, render, bake, export and others."""

from __future__ import annotations

if __name__ == "__main__":
    from lightstage.interrupts import end_without_traceback

    end_without_traceback()  # until the imports below are done

import contextlib
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from learning import domain_commands, experiment_commands, head_commands, photo_commands
from lightstage.commands import (
    ConsentsOption,
    JsonFlag,
    finish,
    make_app,
    output_file,
    output_folder,
    progress_bar,
    quiet,
    run_app,
)
from lightstage.counting import counted
from lightstage.formats.access import group_of, limited_access

app = make_app("Render skin, train the networks, infer reflectance.")
photo_commands.register(app)
head_commands.register(app)
experiment_commands.register(app)
domain_commands.register(app)

MapsOption = Annotated[Path, typer.Option(help="Folder of atlas maps.")]
MeshOption = Annotated[Path, typer.Option(help="Mesh with the maps' UV, in their axes.")]
LightsOption = Annotated[
    Path,
    typer.Option(
        help="Light set (lightstage.environment/1), or .exr or .hdr picture of light all round."
    ),
]
CountOption = Annotated[int, typer.Option(help="Number of lights that replace a picture of light.")]
RotateOption = Annotated[float, typer.Option(help="Turn the light about +y, degrees.")]
ShadowsOption = Annotated[
    str,
    typer.Option(
        help="Cast shadows: `baked` by rays; `table`, of our own template, in a hundredth of the "
        "time; `table:FILE`, made by `occlusion --out`; `network:FILE`, trained by `occlusion "
        "--network`; `none`."
    ),
]
RigOption = Annotated[Path | None, typer.Option(help="rig.json; the default rig without it.")]
CameraOption = Annotated[str, typer.Option(help="Camera of the rig.")]
DeviceOption = Annotated[
    str,
    typer.Option(
        help="Where the network runs: `cpu`, `cuda`, `cuda:N`, `mps`; `auto`: a GPU where there is "
        "one."
    ),
]
TemplateOption = Annotated[
    Path | None, typer.Option(help="Template whose shininess and translucency maps to use.")
]
ModeOption = Annotated[
    str,
    typer.Option(
        help="`dielectric`: facets with exact Fresnel over a diffuse layer; `physical`: "
        "Blinn-Phong; `paper`: the formulas as printed; `ggx`: facets with Schlick's Fresnel."
    ),
]


@app.command()
def render(
    maps: MapsOption,
    environment: LightsOption,
    out: Annotated[
        Path,
        output_file(
            "--out",
            help="Picture to write: .png (sRGB) or .exr (linear).",
            suffixes=[".png", ".exr"],
        ),
    ],
    mesh: Annotated[
        Path | None,
        typer.Option(help="Mesh with the maps' UV; else registered_mesh.obj beside the maps."),
    ] = None,
    rig: RigOption = None,
    camera: CameraOption = "cam0",
    template: TemplateOption = None,
    mode: ModeOption = "dielectric",
    background: Annotated[
        str, typer.Option(help="`white`, `black`, or `none`: a .png with alpha.")
    ] = "white",
    captured_only: Annotated[
        bool, typer.Option("--captured-only", help="Leave out texels of confidence 0.")
    ] = False,
    lights: CountOption = 64,
    rotate: RotateOption = 0.0,
    shadows: ShadowsOption = "baked",
    turntable: Annotated[
        int, typer.Option(help="Pictures from around the head, OUT_000 and on.")
    ] = 1,
    as_json: bool = JsonFlag,
) -> None:
    """Relight: show a head with maps under a light set, with cast shadows.

    Places that no camera saw are shown with what the atlas was filled with there.
    """
    from learning.commands import RenderRequest, render_command

    with limited_access(group_of([maps])), progress_bar("render") as progress:
        facts = render_command(
            RenderRequest(
                maps,
                mesh,
                environment,
                out,
                rig,
                camera,
                template,
                mode,
                lights,
                rotate,
                shadows,
            ),
            background,
            captured_only,
            turntable,
            progress,
        )
    many = f"{facts['pictures']} pictures of " if facts["pictures"] > 1 else ""
    finish(
        f"{out}: {many}{facts['width_px']} x {facts['height_px']} px, "
        f"{counted(facts['lights'], 'light')}, {facts['surface_percent']:.0f} % surface, "
        f"{facts['seconds']:.1f} s" + "".join(f"; {note}" for note in facts["notes"]),
        facts,
        as_json,
    )


@app.command()
def bake(
    maps: MapsOption,
    mesh: MeshOption,
    environment: LightsOption,
    out: Annotated[
        Path, output_file("--out", help="Texture to write, .exr, linear.", suffixes=[".exr"])
    ],
    rig: RigOption = None,
    camera: CameraOption = "cam0",
    template: TemplateOption = None,
    mode: ModeOption = "dielectric",
    lights: CountOption = 64,
    rotate: RotateOption = 0.0,
    shadows: ShadowsOption = "baked",
    as_json: bool = JsonFlag,
) -> None:
    """Bake light and shadow into a texture, as a photograph would give it."""
    from learning.commands import RenderRequest, bake_command

    with limited_access(group_of([maps])), progress_bar("bake") as progress:
        request = RenderRequest(
            maps, mesh, environment, out, rig, camera, template, mode, lights, rotate, shadows
        )
        facts = bake_command(request, progress)
    finish(
        f"{out}: {facts['rows']} x {facts['columns']} texels, {counted(facts['lights'], 'light')}, "
        f"{facts['seconds']:.1f} s" + "".join(f"; {note}" for note in facts["notes"]),
        facts,
        as_json,
    )


@app.command()
def occlusion(
    out: Annotated[
        Path, output_file("--out", help="Table to write, .npz.", suffixes=[".npz"], shared=True)
    ],
    template: Annotated[Path | None, typer.Option(help="Template; our own without it.")] = None,
    head: Annotated[
        list[Path] | None,
        typer.Option(
            help="Mesh of a head with UV instead, for shadows of its own; repeat it for several, "
            "such as one person's expressions."
        ),
    ] = None,
    rows: Annotated[int, typer.Option(help="Rows of the texture in which shadows are baked.")] = 96,
    directions: Annotated[
        int, typer.Option(help="Number of lights all round that are baked.")
    ] = 2048,
    network: Path | None = output_folder(
        "--network",
        help="Train the published network on the same pictures too, and score both: folder of its "
        "checkpoint, for --shadows network:FOLDER.",
        default=None,
        shared=True,
    ),
    config: Annotated[
        Path | None, typer.Option(help="TOML that overrides the network's training.")
    ] = None,
    as_json: bool = JsonFlag,
) -> None:
    """Bake a template's cast shadows into a table that needs no rays, or train a network of them.

    The last line gives the errors of table and network under lights that were not baked, beside
    rays, and how long each takes.
    """
    from learning.occlusion_command import occlusion_command

    heads = head or []
    # A head's shadows show whose they are; a template's are nobody's.
    access = (
        limited_access(group_of(p.parent for p in heads)) if heads else contextlib.nullcontext()
    )
    with access, progress_bar("occlusion") as progress:
        facts = occlusion_command(template, heads, out, rows, directions, network, config, progress)
    trained = f"; {facts['network']}: {facts['said']}" if "said" in facts else ""
    finish(
        f"{out}: {facts['directions']} directions at {facts['rows']} x {facts['columns']} texels, "
        f"{facts['bytes'] / 1000:.0f} kB{trained}; {facts['seconds']:.1f} s",
        facts,
        as_json,
    )


@app.command()
def train(
    data: Annotated[
        Path, typer.Option(help="Store made by `lightstage-processing dataset build`.")
    ],
    out: Annotated[Path, output_folder("--out", help="Folder of the run: checkpoint and metrics.")],
    preset: Annotated[
        str,
        typer.Option(
            help="`modern`: whole faces; `paper`: one network of patches; `avatarme`: four of "
            "them; `demo` and `avatarme-small`: these two, narrow, for minutes; `rcan`: "
            "super-resolution; `rcan-small`: the same, narrow; `mesostructure`: pores and folds."
        ),
    ] = "modern",
    config: Annotated[Path | None, typer.Option(help="TOML that overrides the preset.")] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            help="Time for the steps of this call, instead of the preset's number of them; reading "
            "the people, the first step, which compiles, and scoring come besides."
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the preset's.")] = None,
    resume: Annotated[bool, typer.Option(help="Continue from the run's checkpoint.")] = False,
    device: DeviceOption = "auto",
    consents: Path | None = ConsentsOption,
    environment: Annotated[
        Path | None,
        typer.Option(
            help="Light of the textures that the network is for, such as `domain-light` writes: "
            "all people are lit around it."
        ),
    ] = None,
    begin_with: Annotated[
        str | None,
        typer.Option(
            help="A run whose weights this one begins with, or `shipped`: the weights that come "
            "with the project; random ones else.",
            metavar="<path>",
        ),
    ] = None,
    as_json: bool = JsonFlag,
) -> None:
    """Train a network on a dataset; some people are held out and scored."""
    from learning.commands import train_command, trained_line
    from learning.processes import started_by_torchrun
    from learning.stopped import stopped_training

    processes = started_by_torchrun()
    bar = progress_bar("train") if processes.first else contextlib.nullcontext(quiet)
    try:
        with limited_access(group_of([data])), bar as progress:
            facts = train_command(
                data,
                out,
                preset,
                config,
                seconds,
                seed,
                resume,
                progress,
                device,
                processes,
                consents,
                environment,
                begin_with,
            )
    except KeyboardInterrupt:
        if not processes.first:
            raise
        given = {"--data": data, "--out": out, "--preset": preset, "--config": config}
        given |= {"--seconds": seconds, "--seed": seed, "--device": device}
        given |= {"--consents": consents, "--environment": environment}
        raise stopped_training(out, given, processes, begin_with) from None
    if not processes.first:
        return
    for warning in facts["warnings"]:
        print(f"warning: {warning}", file=sys.stderr)
    finish(f"{out}: {trained_line(facts)}", facts, as_json)


@app.command()
def infer(
    texture: Annotated[Path, typer.Option(help="Texture with light in it, .exr, linear.")],
    mesh: MeshOption,
    out: Annotated[Path, output_folder("--out", help="Folder for the maps.")],
    checkpoint: Annotated[
        Path | None,
        typer.Option(help="Run folder or its checkpoint.json; without it the shipped weights."),
    ] = None,
    head_pose: Annotated[
        Path | None,
        typer.Option(
            help="head_from_world.json of a mesh in world axes. Without it a whole-face network "
            "aligns the mesh with the people that it was trained on, and a network of patches "
            "takes it as in the head frame. Normals come out in the mesh's axes."
        ),
    ] = None,
    refine: Annotated[
        float | None,
        typer.Option(
            help="Seconds, at most, to find the texture's light and refine the albedo by it; 0 for "
            "the network's own answer. 60 where not given, for whole-face networks alone; most "
            "textures take 5 to 20."
        ),
    ] = None,
    mesostructure: Annotated[
        str | None,
        typer.Option(
            help="Pores and folds of refined textures: run folder of a `mesostructure` training, "
            "or `none`, which keeps the mesh's normals. Without it the shipped weights."
        ),
    ] = None,
    device: DeviceOption = "auto",
    as_json: bool = JsonFlag,
) -> None:
    """Infer albedo, normals and the light from a texture with light in it."""
    from learning.commands import infer_command

    with limited_access(group_of([texture.parent])), progress_bar("infer") as progress:
        facts = infer_command(
            texture, mesh, checkpoint, out, head_pose, refine, progress, device, mesostructure
        )
    finish(
        f"{out}: {facts['rows']} x {facts['columns']} texels, "
        + (f"{facts['tiles']} tiles, " if facts["tiles"] > 1 else "")
        + ("" if facts["lamps"] is None else f"{counted(facts['lamps'], 'lamp')} found, ")
        + f"{facts['seconds']:.1f} s"
        + "".join(f"; {note}" for note in facts["notes"]),
        facts,
        as_json,
    )


@app.command()
def upscale(
    picture: Annotated[Path, typer.Argument(help="Texture to enlarge, .exr, linear.")],
    out: Annotated[
        Path, output_file("--out", help="Texture to write, .exr, linear.", suffixes=[".exr"])
    ],
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            help="Run folder of a `rcan` or `rcan-small` training, or its checkpoint.json; "
            "without it the shipped weights."
        ),
    ] = None,
    times: Annotated[
        int | None,
        typer.Option(help="Refuse a network of another enlargement than this; most have 8."),
    ] = None,
    device: DeviceOption = "auto",
    as_json: bool = JsonFlag,
) -> None:
    """Enlarge a texture by super-resolution, without tiles that show."""
    from learning.commands import upscale_command

    with limited_access(group_of([picture.parent])), progress_bar("upscale") as progress:
        facts = upscale_command(picture, checkpoint, out, times, progress, device)
    finish(
        f"{out}: {facts['rows']} x {facts['columns']} texels, {facts['times']} times as large; "
        f"trained on textures of {facts['trained_rows']} rows; {facts['seconds']:.1f} s",
        facts,
        as_json,
    )


def main() -> None:
    """Run the commands."""
    # Threads that wait for each other give their core away; beside other work, spinning makes a
    # training step twenty times slower. Read when torch is imported, which the commands do late.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    run_app(app)


if __name__ == "__main__":
    main()
