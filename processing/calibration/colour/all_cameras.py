"""Every camera's colours from photographs of the chart, and its absolute albedo by a grey ball."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.errors import FormatError, LightstageError, one_error
from lightstage.formats.environment import LightSet
from lightstage.formats.flats import FlatField
from lightstage.rig import Camera
from processing.calibration.ball import Picture, half
from processing.calibration.colour.chart import ChartView, chart_places_mm, find_chart
from processing.calibration.colour.config import ChartConfig, ColourFitConfig, GreyAlbedoConfig
from processing.calibration.colour.fit import ChartSample, ColourFit, fit_colour
from processing.calibration.colour.grey import ball_albedo
from processing.calibration.colour.white import white_at
from processing.calibration.folder import Pose
from processing.calibration.picture import Mosaic, flattened, read_mosaic
from processing.colour import ColourCorrection
from processing.errors import ProcessingError


@dataclasses.dataclass(frozen=True)
class Seen:
    """A chart as one camera saw it.

    Attributes:
        pose: of the chart.
        view: where its patches are, and what they read with vignetting undone.
        places_mm: (24, 3) of the patches' middles in the world.
        normal: (3,) unit, of the chart's face.
        exposure: of the photograph; None where its file has none.
        tilt_deg: between the chart's normal and the way to the camera.
    """

    pose: Pose
    view: ChartView
    places_mm: np.ndarray
    normal: np.ndarray
    exposure: float | None
    tilt_deg: float


def see_charts(
    poses: list[Pose],
    flats: dict[str, FlatField],
    chart: ChartConfig,
    progress: ProgressCallback = quiet,
) -> dict[str, Seen]:
    """Find the chart that each camera's colours are fitted to.

    Args:
        poses: of the chart. One that was made for a camera is read by that camera; where nothing
            names none, each camera takes the pose that it sees least tilted.
        flats: fields of cameras that have one.
        chart: see there.
        progress: of photographs.

    Returns:
        Camera id to its chart.

    Raises:
        ProcessingError: every camera without one, in one message.
        FormatError: a photograph that cannot be read.
    """
    wanted = [
        (pose, camera)
        for pose in poses
        for camera in pose.session.camera_ids()
        if pose.faces in (None, camera)
    ]
    best: dict[str, Seen] = {}
    for done, (pose, name) in enumerate(wanted, 1):
        seen = _look(pose, pose.session.rig.camera(name), flats.get(name), chart)
        if seen is not None and (name not in best or seen.tilt_deg < best[name].tilt_deg):
            best[name] = seen
        progress(done, len(wanted))
    problems: list[LightstageError] = [
        ProcessingError(
            f"chart, {name}",
            found="no colour chart",
            expected=f"its 24 patches, turned to the camera within {chart.max_tilt_deg:g} degrees",
            hint="Photograph the chart again, toward this camera, without glare.",
        )
        for name in dict.fromkeys(camera for _, camera in wanted)
        if name not in best
    ]
    if problems:
        raise one_error(problems)
    return best


def fit_colours(
    seen: dict[str, Seen], lights: dict[str, LightSet], known: np.ndarray, config: ColourFitConfig
) -> dict[str, ColourFit]:
    """Fit the colours of every camera to its chart.

    Args:
        seen: camera id to its chart.
        lights: by `Pose.where`: what shone, on the scale on which white is to read 1.
        known: (24, 3) reflectances of the patches.
        config: of the fit.

    Raises:
        ProcessingError: every camera whose chart has too few usable patches, in one message.
    """
    fits: dict[str, ColourFit] = {}
    problems: list[LightstageError] = []
    for name, each in seen.items():
        white = white_at(each.places_mm, each.normal, lights[each.pose.where])
        sample = ChartSample(each.view.rgb, white, each.view.clipped)
        where = f"{each.pose.where}, {name}"
        try:
            fits[name] = fit_colour([sample], known, config, each.exposure, where)
        except ProcessingError as error:
            problems.append(error)
    if problems:
        raise one_error(problems)
    return fits


def check_grey(
    pose: Pose,
    corrections: dict[str, ColourCorrection],
    flats: dict[str, FlatField],
    lights: LightSet,
    config: GreyAlbedoConfig,
) -> tuple[dict[str, ColourCorrection], dict[str, Any]]:
    """Compare what a grey ball reads with what it is; scale colours to it where that is wanted.

    Returns:
        The corrections, scaled where `config.sets_the_scale`, and facts: albedo by camera, its
        largest departure as a share.

    Raises:
        FormatError: a photograph that cannot be read, or of another size than its camera's.
        ProcessingError: see `grey.ball_albedo`.
    """
    pictures = []
    for name in pose.session.camera_ids():
        if name not in corrections:
            continue
        path = pose.photograph(name)
        mosaic = read_mosaic(path)
        _require_size(path, mosaic, pose.session.rig.camera(name))
        mosaic = flattened(mosaic, flats.get(name))
        rgb = corrections[name].apply(mosaic.cells())
        made = corrections[name].exposure
        if made is not None and mosaic.exposure is not None:
            rgb = rgb * np.float32(made / mosaic.exposure)
        camera = half(pose.session.rig.camera(name))
        pictures.append(Picture(rgb, ~mosaic.clipped_cells(), camera))
    albedo, cameras = ball_albedo(pictures, lights, config, pose.session.root)
    ratio = {name: float(value.mean()) / config.reflectance for name, value in albedo.items()}
    # Of the channels the worst: a mean would hide colours that are off to opposite sides.
    worst = max(float(np.abs(value / config.reflectance - 1).max()) for value in albedo.values())
    facts = {
        "reflectance": config.reflectance,
        "largest_error": round(worst, 5),
        "sets_the_scale": config.sets_the_scale,
        "cameras": cameras,
    }
    if config.sets_the_scale:
        corrections = {
            name: each.scaled(1 / ratio[name]) if name in ratio else each
            for name, each in corrections.items()
        }
    return corrections, facts


def _require_size(path: Path, mosaic: Mosaic, camera: Camera) -> None:
    """FormatError where a photograph is not of its camera's size."""
    height, width = mosaic.level.shape
    if (height, width) != (camera.height_px // 2 * 2, camera.width_px // 2 * 2):
        raise FormatError(
            path,
            found=f"{width} x {height} pixels",
            expected=f"{camera.width_px} x {camera.height_px}, as {camera.id} has in rig.json",
        )


def _look(pose: Pose, camera: Camera, field: FlatField | None, chart: ChartConfig) -> Seen | None:
    """The chart in one photograph; None where it is not seen, or too tilted."""
    path = pose.photograph(camera.id)
    mosaic = read_mosaic(path, chart.clip_share)
    _require_size(path, mosaic, camera)
    mosaic = flattened(mosaic, field)
    view = find_chart(mosaic.cells(), mosaic.clipped_cells())
    if view is None:
        return None
    places, normal = chart_places_mm(view, camera, chart.pitch_mm)
    toward = camera.centre_mm - places.mean(axis=0)
    cosine = float(normal @ toward / np.linalg.norm(toward))
    tilt_deg = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    if tilt_deg > chart.max_tilt_deg:
        return None
    return Seen(pose, view, places, normal, mosaic.exposure, tilt_deg)
