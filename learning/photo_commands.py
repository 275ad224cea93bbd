"""Commands of photographs: `fit`, `avatar`, and the places of faces' points on a template."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from learning.photo.config import FitConfig
from lightstage.commands import (
    JsonFlag,
    finish,
    output_file,
    output_folder,
    progress_bar,
)
from lightstage.counting import counted
from lightstage.formats.access import group_of, limited_access
from lightstage.formats.template import default_template_path

PhotosArgument = Annotated[
    list[Path],
    typer.Argument(
        help="Photographs of one person: JPEG, PNG, TIFF or linear .exr. Shape and texture come "
        "from all, in the light of the first."
    ),
]
FaceTemplateOption = Annotated[
    Path,
    typer.Option(
        "--template",
        help="Template's folder, whose topology and UV the head has.",
        show_default="the project's own",
    ),
]
CheckpointOption = Annotated[
    Path | None,
    typer.Option(
        help="Run folder of a whole-face network, or its checkpoint.json; without it the shipped "
        "weights."
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
FaceOption = Annotated[int, typer.Option("--face", help="Number of the face; 1 is the largest.")]
FilmOption = Annotated[
    float | None,
    typer.Option(
        "--focal-35mm",
        help="35 mm equivalent of the focal length, by the diagonal, mm, in place of what the "
        "files state.",
    ),
]
FitRowsOption = Annotated[
    int | None,
    typer.Option(
        "--rows",
        help=f"Rows of the texture, a multiple of 3; {FitConfig.rows} where not given.",
    ),
]
FitRefineOption = Annotated[
    float | None,
    typer.Option(
        "--refine",
        help="Seconds, at most, for the last search of the light, by which skin is refined; "
        f"{FitConfig.refine_seconds:g} where not given, 0 for none.",
    ),
]
FitConfigOption = Annotated[
    Path | None, typer.Option("--config", help="TOML that overrides the defaults of the fit.")
]


def register(app: typer.Typer) -> None:
    """Add the commands `fit`, `avatar`, `template-points` and `train-points` to an application."""
    app.command("fit")(fit)
    app.command("avatar")(avatar)
    app.command("template-points")(template_points)
    app.command("train-points")(train_points)


def fit(
    photo: PhotosArgument,
    out: Annotated[
        Path, output_folder("--out", help="Folder to make; one of an earlier fit is replaced.")
    ],
    template: FaceTemplateOption = default_template_path(),
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
        f"{counted(len(facts['photographs']), 'photograph')}, "
        f"landmarks {first['landmark_px']:.1f} px, "
        + ("no light found, " if facts["lamps"] is None else f"{counted(facts['lamps'], 'lamp')}, ")
        + f"{facts['seconds']:.1f} s"
        + "".join(f"; {note}" for note in facts["notes"]),
        facts,
        as_json,
    )


def avatar(
    out: Annotated[
        Path, output_folder("--out", help="Folder of the avatar; what is up to date stays.")
    ],
    template: FaceTemplateOption = default_template_path(),
    photo: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Photographs of one person: JPEG, PNG, TIFF or linear .exr. Shape and texture "
            "come from all, in the light of the first."
        ),
    ] = None,
    maps: Annotated[
        Path | None,
        typer.Option(
            help="Captured head in place of photographs: a processed folder, or its atlas. There "
            "is no fit then."
        ),
    ] = None,
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
    expression: Annotated[
        str,
        typer.Option(
            help="With which the exported head opens: `neutral`, or `photo` for the first "
            "photograph's."
        ),
    ] = "neutral",
    until: Annotated[str, typer.Option(help="Last stage: `fit`, `detail` or `export`.")] = "export",
    as_json: bool = JsonFlag,
) -> None:
    """Make a head for other programs from photographs of one person: fit, detail, export."""
    from learning.avatar import avatar_command
    from learning.photo.command import FitRequest

    photos = tuple(photo or ())
    request = FitRequest(
        photos, template, out, landmarks, face, film_mm, checkpoint, rows, refine, config
    )
    given = [path.parent for path in photos] + ([] if maps is None else [maps])
    with limited_access(group_of(given)):
        facts = avatar_command(request, until, formats, progress_bar, maps, expression)
    skipped = f"{', '.join(facts['skipped'])} up to date, " if facts["skipped"] else ""
    finish(
        f"{out}: {', '.join(facts['parts'])}; {facts['rows']} x {facts['columns']} texels, "
        f"{skipped}{facts['seconds']:.1f} s" + "".join(f"; {note}" for note in facts["notes"]),
        facts,
        as_json,
    )


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
    """Find the places of the face detector's 468 points on a template, by pictures all round."""
    from learning.points.command import template_points as find_template_points

    with progress_bar("template-points") as progress:
        facts = find_template_points(template, out, picture, progress)
    people = facts["found_on_people"]
    beside = "" if people is None else f" ({people} on the population's mean head)"
    finish(
        f"{facts['points']}: {facts['found']} points{beside}, "
        f"{facts['absent']} without a place, lines of sight {facts['spread_median_mm']} mm apart "
        f"(median), a face in {facts['faces']} of {facts['pictures']} pictures, "
        f"{facts['seconds']:.0f} s",
        facts,
        as_json,
    )


def train_points(
    data: Annotated[
        Path, typer.Option(help="Store of maps in the template's texture, whose skins are shown.")
    ],
    out: Annotated[Path, output_folder("--out", help="Run to make; one that is there is refused.")],
    template: Annotated[
        Path,
        typer.Option(
            help="Template whose people are drawn: mean head, modes, population.",
            show_default="the project's own",
        ),
    ] = default_template_path(),
    config: Annotated[
        Path | None, typer.Option("--config", help="TOML that overrides the training's defaults.")
    ] = None,
    as_json: bool = JsonFlag,
) -> None:
    """Train the network that finds template points in photographs, on faces that it draws."""
    from learning.points.train import train_points as train

    with limited_access(group_of([data])), progress_bar("train-points") as progress:
        facts = train(data, template, out, config, progress)
    finish(
        f"{out}: {counted(facts['faces'], 'face')}; on faces held out points are "
        f"{facts['points_mm']:.1f} mm off (the detector's {facts['detector_mm']:.1f}, without "
        f"their mean error {facts['detector_mean_off_mm']:.1f}), {facts['seconds']:.0f} s",
        facts,
        as_json,
    )
