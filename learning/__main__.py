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

MapsOption = Annotated[Path, typer.Option(help="Folder of atlas maps.")]
MeshOption = Annotated[Path, typer.Option(help="Mesh with the maps' UV, in their axes.")]
LightsOption = Annotated[
    Path,
    typer.Option(
        help="Light set (lightstage.environment/1), or .exr or .hdr picture of light all round."
    ),
]
CountOption = Annotated[int, typer.Option(help="Lights that stand for a picture of light.")]
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
    background: Annotated[str, typer.Option(help="`white` or `black`.")] = "white",
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
def export(
    maps: Annotated[
        Path,
        typer.Argument(
            help="Processed folder, whose atlas and registered mesh are taken; or a folder of "
            "maps, such as `infer` writes."
        ),
    ],
    out: Annotated[Path, output_folder("--out", help="Folder to make.")],
    mesh: Annotated[
        Path | None,
        typer.Option(help="Mesh with the maps' UV; else registered_mesh.obj beside the maps."),
    ] = None,
    formats: Annotated[
        str,
        typer.Option(
            "--format",
            help="Some of, with commas: `gltf` (head.glb), `obj` (with head.mtl), `maps` (16-bit "
            "PNG and OpenEXR, with a recipe for Blender and Unreal), `usd` (needs the extra usd), "
            "`page` (page.html, which opens in a browser from the disk).",
        ),
    ] = "gltf,obj,maps",
    template: Annotated[
        Path | None,
        typer.Option(
            help="Template whose expressions become morph targets under ARKit's names, and whose "
            "shininess stands for a map of roughness that is missing."
        ),
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option(
            help="Inferred maps of the same mesh: the page has a slider between them and MAPS."
        ),
    ] = None,
    as_json: bool = JsonFlag,
) -> None:
    """Write a head for artists, engines and researchers: glTF, OBJ, maps, USD, a web page."""
    from learning.export.command import export_command

    with limited_access(group_of([maps])), progress_bar("export") as progress:
        facts = export_command(maps, mesh, formats, out, template, compare, progress)
    finish(
        f"{out}: {', '.join(facts['formats'])}; {facts['rows']} x {facts['columns']} texels, "
        f"{facts['bytes'] / 1e6:.1f} MB, {facts['seconds']:.1f} s"
        + "".join(f"; {note}" for note in facts["notes"]),
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
    rows: Annotated[int, typer.Option(help="Rows of the texture shadows are baked in.")] = 96,
    directions: Annotated[int, typer.Option(help="Lights all round that are baked.")] = 2048,
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

    The last line says how wrong table and network are under lights that were not baked, beside
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


PhotosArgument = Annotated[
    list[Path],
    typer.Argument(
        help="Photographs of one person: JPEG, PNG, TIFF or linear .exr. Shape comes from all, the "
        "texture from the first."
    ),
]
FaceTemplateOption = Annotated[
    Path,
    typer.Option("--template", help="Template's folder, whose topology and UV the head has."),
]
CheckpointOption = Annotated[
    Path | None,
    typer.Option(
        help="Run folder of a whole-face network, or its checkpoint.json; the weights that are "
        "shipped else."
    ),
]
MarksOption = Annotated[
    Path | None,
    typer.Option(
        "--landmarks",
        help="Points of each photograph by its file's name (lightstage.landmarks/1, of iBUG's 68 "
        "or MediaPipe's 468); detected without it.",
    ),
]
FaceOption = Annotated[int, typer.Option("--face", help="Which face, 1 is the largest.")]
FilmOption = Annotated[
    float | None,
    typer.Option(
        "--focal-35mm",
        help="Focal length of the lens as on 35 mm film, mm, in place of what the files tell.",
    ),
]
FitRowsOption = Annotated[
    int | None,
    typer.Option("--rows", help="Rows of the texture, a multiple of 3; 1536 where not given."),
]
FitRefineOption = Annotated[
    float | None,
    typer.Option(
        "--refine",
        help="Seconds, at most, for the search of the light; 20 where not given, 0 for none.",
    ),
]
FitConfigOption = Annotated[
    Path | None, typer.Option("--config", help="TOML that overrides the defaults of the fit.")
]


@app.command()
def fit(
    photo: PhotosArgument,
    template: FaceTemplateOption,
    out: Annotated[
        Path, output_folder("--out", help="Folder to make; one of an earlier fit is replaced.")
    ],
    landmarks: MarksOption = None,
    face: FaceOption = 1,
    film_mm: FilmOption = None,
    checkpoint: CheckpointOption = None,
    rows: FitRowsOption = None,
    refine: FitRefineOption = None,
    config: FitConfigOption = None,
    as_json: bool = JsonFlag,
) -> None:
    """Find a head's shape, texture, skin and light from photographs of one person."""
    from learning.photo.command import FitRequest, fit_command

    request = FitRequest(
        tuple(photo), template, out, landmarks, face, film_mm, checkpoint, rows, refine, config
    )
    with limited_access(group_of([path.parent for path in photo])), progress_bar("fit") as progress:
        facts = fit_command(request, progress)
    first = facts["photographs"][0]
    finish(
        f"{out}: {facts['rows']} x {facts['columns']} texels, {facts['seen_percent']:.0f} % from "
        f"the photograph, landmarks {first['landmark_px']:.1f} px, "
        + ("no light found, " if facts["lamps"] is None else f"{counted(facts['lamps'], 'lamp')}, ")
        + f"{facts['seconds']:.1f} s"
        + "".join(f"; {note}" for note in facts["notes"]),
        facts,
        as_json,
    )


@app.command()
def avatar(
    photo: PhotosArgument,
    template: FaceTemplateOption,
    out: Annotated[
        Path, output_folder("--out", help="Folder of the avatar; what is up to date stays.")
    ],
    landmarks: MarksOption = None,
    face: FaceOption = 1,
    film_mm: FilmOption = None,
    checkpoint: CheckpointOption = None,
    rows: FitRowsOption = None,
    refine: FitRefineOption = None,
    config: FitConfigOption = None,
    formats: Annotated[
        str, typer.Option("--format", help="As `export --format`, with commas.")
    ] = "gltf,page",
    until: Annotated[str, typer.Option(help="Last stage: `fit` or `export`.")] = "export",
    as_json: bool = JsonFlag,
) -> None:
    """Make a head that leaves the program from photographs of one person: fit, then export."""
    from learning.avatar import avatar_command
    from learning.photo.command import FitRequest

    request = FitRequest(
        tuple(photo), template, out, landmarks, face, film_mm, checkpoint, rows, refine, config
    )
    with (
        limited_access(group_of([path.parent for path in photo])),
        progress_bar("avatar") as progress,
    ):
        facts = avatar_command(request, until, formats, progress)
    skipped = f"{' and '.join(facts['skipped'])} up to date, " if facts["skipped"] else ""
    finish(
        f"{out}: {facts['rows']} x {facts['columns']} texels, {skipped}{facts['seconds']:.1f} s"
        + "".join(f"; {note}" for note in facts["notes"]),
        facts,
        as_json,
    )


@app.command()
def detail(
    maps: Annotated[
        Path,
        typer.Argument(
            help="Processed folder, folder of maps such as `infer` writes, or a fit's folder."
        ),
    ],
    out: Annotated[
        Path, output_folder("--out", help="Folder to make; one of an earlier call is replaced.")
    ],
    mesh: Annotated[
        Path | None,
        typer.Option(help="Mesh with the maps' UV; else registered_mesh.obj beside the maps."),
    ] = None,
    longest_mm: Annotated[
        float, typer.Option(help="Size in mm above which relief is the mesh's, not the normals'.")
    ] = 10.0,
    subdivide: Annotated[
        int, typer.Option(help="How often triangles are split into four; 0 for no mesh.")
    ] = 2,
    as_json: bool = JsonFlag,
) -> None:
    """Find the heights of pores and folds: a displacement map in mm, and an embossed mesh."""
    from learning.detail.command import detail_command

    with limited_access(group_of([maps])), progress_bar("detail") as progress:
        facts = detail_command(maps, mesh, out, longest_mm, subdivide, progress)
    finish(
        f"{out}: heights of {facts['height_rms_mm']:.3f} mm (root mean square), "
        f"{counted(facts['triangles'], 'triangle')}, {facts['seconds']:.1f} s",
        facts,
        as_json,
    )


@app.command()
def evaluate(
    inferred: Annotated[
        list[Path],
        typer.Argument(help="Folders of maps, such as `infer`, `fit` and `avatar` write."),
    ],
    truth: Annotated[
        list[Path],
        typer.Option(
            help="Processed folder with the captured maps; once for each inferred one, in order, "
            "or once for all: these are then of one person, and how far they agree is measured."
        ),
    ],
    data: Annotated[
        str, typer.Option(help="Whose truth: `captured` or `simulated` people.")
    ] = "captured",
    out: Path | None = output_file(
        "--out",
        help="Figures to write, .json; a table with .md stands beside it.",
        suffixes=[".json"],
        default=None,
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Measure inferred maps against captured ones, with intervals over people."""
    from learning.evaluation.command import evaluate_command

    with (
        limited_access(group_of([*inferred, *truth])),
        progress_bar("evaluate") as progress,
    ):
        facts = evaluate_command(tuple(inferred), tuple(truth), data, out, progress)
    figures = facts["figures"]
    finish(
        f"{counted(facts['people'], 'person', 'people')}, {facts['data']}: albedo "
        f"{figures['albedo_psnr_db']['mean']:.1f} dB "
        f"({figures['albedo_relative_psnr_db']['mean']:.1f} relative), "
        + (
            f"diffuse normals {figures['diffuse_normal_mean_deg']['mean']:.1f} deg, "
            if "diffuse_normal_mean_deg" in figures
            else ""
        )
        + f"skin colour {figures['ita_error_deg']['mean']:.1f} deg of ITA, "
        f"{facts['seconds']:.1f} s",
        facts,
        as_json,
    )


@app.command("template-points")
def template_points(
    template: Annotated[Path, typer.Option(help="Template's folder: mesh, landmarks, regions.")],
    out: Path | None = output_file(
        "--out",
        help="Points to write, .json; mediapipe468.json in the template's folder without it.",
        suffixes=[".json"],
        default=None,
        shared=True,
    ),
    picture: Path | None = output_file(
        "--picture",
        help="Picture of the head with its points, .png.",
        suffixes=[".png"],
        default=None,
        shared=True,
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Find where the face detector's 468 points lie on a template, from pictures all round."""
    from learning.points.command import template_points as find_template_points

    with progress_bar("template-points") as progress:
        facts = find_template_points(template, out, picture, progress)
    finish(
        f"{facts['points']}: {facts['found']} points, {facts['absent']} without a place, lines of "
        f"sight {facts['spread_median_mm']} mm apart (median), a face in {facts['faces']} of "
        f"{facts['pictures']} pictures, {facts['seconds']:.0f} s",
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
    resume: Annotated[bool, typer.Option(help="Go on from the run's checkpoint.")] = False,
    device: DeviceOption = "auto",
    consents: Path | None = ConsentsOption,
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
            )
    except KeyboardInterrupt:
        if not processes.first:
            raise
        given = {"--data": data, "--out": out, "--preset": preset, "--config": config}
        given |= {"--seconds": seconds, "--seed": seed, "--device": device}
        given |= {"--consents": consents}
        raise stopped_training(out, given, processes) from None
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
        typer.Option(help="Run folder or its checkpoint.json; the weights that are shipped else."),
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
            "or `none`: normals are the mesh's then. The weights that are shipped else."
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
            help="Run folder of a `rcan` or `rcan-small` training, or its checkpoint.json; the "
            "weights that are shipped else."
        ),
    ] = None,
    times: Annotated[
        int | None,
        typer.Option(help="The enlargement to make sure of; the network has one, mostly 8."),
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
