"""Heads from photographs: shape, light and texture against the truth, beside the mean shape.

`python -m benchmarks.photo` photographs heads that the fit knows nothing of (simulated people,
people of ICT's model, the scanned head) under lights of the simulator, finds their faces and fits
them, by their landmarks alone and by their pixels too. The error of a shape is the mean distance of
corresponding vertices of the face after the best similarity; ICT's people and the scan correspond
as far as their registration does. Along the normal no correspondence is needed.
``--expression smile`` has people of models smile.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

import numpy as np

from benchmarks.networks_lights import light_of
from benchmarks.networks_people import KINDS, Head, chosen, make
from benchmarks.photo_studio import (
    DISTANCE_MM,
    FOCAL_PX,
    HEIGHT_PX,
    WIDTH_PX,
    Sitter,
    marks_of,
    photograph,
)
from benchmarks.record import record, table
from learning.checkpoint import load_whole_face, shipped_weights
from learning.photo.config import FitConfig
from learning.photo.fit import FittedHead, fit_head
from learning.photo.model import NOSE_TIP, shape_model
from learning.photo.shape_fit import Photograph, fit_shape
from learning.render.view import render_view
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import vertex_normals
from lightstage.formats.template import Template, default_template_path, load_template
from processing.colour import srgb_from_linear
from sim.head.modes import EXPRESSIONS

LIGHTS = ("front", "warm-cool", "hard-oblique", "hard-side")
YAWS_DEG = (0, 30)
THREE_DEG = (0, 30, -30)
FACE_MM, FACING = 80.0, 0.3
"""The face that is scored: within this of the nose's tip, and its normals forward by so much."""
NUMBER = 3
"""Of the lights' draw."""
NEUTRAL = "neutral"


def apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n, 3) what is left of their difference after the best similarity [Umeyama1991]."""
    first, second = one - one.mean(axis=0), other - other.mean(axis=0)
    left, size, right = np.linalg.svd(second.T @ first)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = (size * sign).sum() / (first**2).sum()
    found: np.ndarray = scale * first @ (left * sign @ right).T - second
    return found


def scored(template: Template) -> np.ndarray:
    """(n,) bool, vertices of the face that is scored."""
    mean = template.mesh.vertices
    forward = vertex_normals(mean, template.mesh.triangles())[:, 2] > FACING
    near = np.linalg.norm(mean - mean[template.landmarks[NOSE_TIP]], axis=1) < FACE_MM
    return np.asarray(forward & near)


def in_head(head: Head, points: np.ndarray) -> np.ndarray:
    """(n, 3) world to head frame."""
    found: np.ndarray = points @ head.head_from_world[:, :3].T + head.head_from_world[:, 3]
    return found


def light_off_deg(found: LightSet | None, true: LightSet, head: Head) -> float:
    """Degrees between the strongest lamps."""
    if found is None or not len(found.rgb) or not len(true.rgb):
        return float("nan")
    one = found.position_mm[found.rgb.sum(axis=1).argmax()]
    other = in_head(head, true.position_mm)[true.rgb.sum(axis=1).argmax()]
    cosine = one @ other / (np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def over_photograph(taken: Photograph, fitted: FittedHead) -> float:
    """PSNR in dB of the head drawn over its photograph, sRGB, where texels were taken from it."""
    camera = fitted.shape.cameras[0]
    head, alpha = render_view(fitted.texture, fitted.seen, fitted.shape.meshes[0], camera, 0.0)
    here = alpha > 0.99
    off = srgb_from_linear(head[here]) - srgb_from_linear(taken.rgb_linear[here])
    return float(-10 * np.log10(max(float((off**2).mean()), 1e-12)))


Off = tuple[float, float]
"""Mean distance of corresponding vertices, and of that its part along the true normals, mm."""


@dataclasses.dataclass
class Scores:
    """Errors of one kind of heads."""

    mesh: list[Off] = dataclasses.field(default_factory=list)
    mean: list[Off] = dataclasses.field(default_factory=list)
    one_alone: list[Off] = dataclasses.field(default_factory=list)
    one_pixels: list[Off] = dataclasses.field(default_factory=list)
    three_alone: list[Off] = dataclasses.field(default_factory=list)
    three_pixels: list[Off] = dataclasses.field(default_factory=list)
    between: list[float] = dataclasses.field(default_factory=list)
    light: list[float] = dataclasses.field(default_factory=list)
    psnr: list[float] = dataclasses.field(default_factory=list)
    pixels_s: list[float] = dataclasses.field(default_factory=list)
    whole_s: list[float] = dataclasses.field(default_factory=list)
    lost: int = 0


def measure(
    head: Head, template: Template, rows: int, whole: bool, scale: float, scores: Scores
) -> None:
    """Fit one head under each light, and add up its errors."""
    config = dataclasses.replace(FitConfig(), rows=rows)
    model = shape_model(template, config)
    marks = marks_of(template)
    places = marks.places
    face = scored(template)
    truth = in_head(head, head.mesh.vertices)
    normals = vertex_normals(truth, template.mesh.triangles())[face]
    network, _ = load_whole_face(shipped_weights())
    alone = dataclasses.replace(config, pixel_rounds=0)

    def off(vertices: np.ndarray) -> Off:
        beside = apart(vertices[face], truth[face])
        return _mean(beside), float(np.abs((beside * normals).sum(axis=1)).mean())

    scores.mesh.append(off(template.mesh.vertices))
    scores.mean.append(off(model.mean))
    shapes = []
    sitters = {yaw: Sitter(head, yaw, scale) for yaw in THREE_DEG}
    for name in LIGHTS:
        light = light_of(name, NUMBER)
        shots = {yaw: photograph(each, light, marks, f"{yaw}") for yaw, each in sitters.items()}
        lost = [yaw for yaw, shot in shots.items() if not np.isfinite(shot.landmarks_px).any()]
        scores.lost += len(lost)
        for yaw in YAWS_DEG:
            if yaw in lost:
                continue
            shape = fit_shape([shots[yaw]], template, places, alone, model)
            scores.one_alone.append(off(shape.meshes[0].vertices))
            if yaw == 0:
                shapes.append(shape.neutral.vertices[face])
            began = time.perf_counter()
            shape = fit_shape([shots[yaw]], template, places, config, model, network)
            scores.pixels_s.append(time.perf_counter() - began)
            scores.one_pixels.append(off(shape.meshes[0].vertices))
        if not lost:
            photographs = list(shots.values())
            shape = fit_shape(photographs, template, places, alone, model)
            scores.three_alone.append(off(shape.meshes[0].vertices))
            shape = fit_shape(photographs, template, places, config, model, network)
            scores.three_pixels.append(off(shape.meshes[0].vertices))
        if whole and THREE_DEG[1] not in lost:
            began = time.perf_counter()
            fitted = fit_head([shots[THREE_DEG[1]]], template, places, network, config)
            scores.whole_s.append(time.perf_counter() - began)
            scores.light.append(light_off_deg(fitted.light, light, head))
            scores.psnr.append(over_photograph(shots[THREE_DEG[1]], fitted))
    for index, one in enumerate(shapes):
        scores.between += [_mean(apart(one, other)) for other in shapes[:index]]


def _mean(off: np.ndarray) -> float:
    return float(np.linalg.norm(off, axis=1).mean())


def main() -> None:
    """Measure, print, record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", default=",".join(KINDS), help="kinds of heads, with commas")
    parser.add_argument("--count", type=int, default=2, help="simulated people, and ICT's")
    parser.add_argument("--rows", type=int, default=384, help="of the texture")
    parser.add_argument("--scale", type=float, default=1.0, help="of the photographs' size")
    parser.add_argument("--unseen", action="store_true", help="the half of ICT's people kept apart")
    parser.add_argument(
        "--expression", default=NEUTRAL, choices=(NEUTRAL, *EXPRESSIONS), help="of all but the scan"
    )
    parser.add_argument("--shape-alone", action="store_true", help="without light and texture")
    arguments = parser.parse_args()
    template = load_template(default_template_path())
    rows = []
    kinds = [
        k for k in arguments.people.split(",") if arguments.expression == NEUTRAL or k != "scan"
    ]
    for kind in kinds:
        scores = Scores()
        for who in chosen([kind], arguments.count, arguments.unseen):
            head = make(dataclasses.replace(who, expression=arguments.expression), arguments.rows)
            measure(
                head, template, arguments.rows, not arguments.shape_alone, arguments.scale, scores
            )
        name = f"{kind}, unseen half" if arguments.unseen and kind == "ict" else kind
        rows.append(_row(name, scores))
    header = [
        "heads",
        "template's mesh mm (along the normal)",
        "mean shape of the fit",
        "one photo, landmarks alone",
        "one photo, pixels too",
        "three photos, landmarks alone",
        "three photos, pixels too",
        "under other lights mm",
        "strongest lamp deg, median",
        "over the photo dB",
        "shape by pixels s",
        "whole s",
        "faces not found",
    ]
    if arguments.scale != 1.0 or (arguments.people != ",".join(KINDS) and not arguments.unseen):
        print(table(header, rows))
        return
    title = "Heads from photographs" + (", the unseen half" if arguments.unseen else "")
    if arguments.expression != NEUTRAL:
        title += f", {arguments.expression}"
    note = (
        f"`python -m benchmarks.photo`: photographs of {WIDTH_PX} x {HEIGHT_PX} px, a face about "
        f"{round(200 * FOCAL_PX / DISTANCE_MM)} px high, yaw 0 and 30 degrees, focal length known, "
        f"lights {', '.join(LIGHTS)}; {arguments.count} people of a kind, textures of "
        f"{arguments.rows} rows. Shape: mean distance of the face's vertices after the best "
        "similarity, mm, and its part along the normal."
    )
    record(title, header, rows, note)


def _row(name: str, scores: Scores) -> list[str]:
    def both(values: list[Off]) -> str:
        if not values:
            return "-"
        distance, along = np.mean(values, axis=0)
        return f"{distance:.2f} ({along:.2f})"

    def plain(values: list[float], digits: int = 1) -> str:
        return f"{np.mean(values):.{digits}f}" if values else "-"

    return [
        name,
        both(scores.mesh),
        both(scores.mean),
        both(scores.one_alone),
        both(scores.one_pixels),
        both(scores.three_alone),
        both(scores.three_pixels),
        plain(scores.between, 2),
        f"{np.nanmedian(scores.light):.0f}" if scores.light else "-",
        plain(scores.psnr),
        plain(scores.pixels_s),
        plain(scores.whole_s),
        str(scores.lost),
    ]


if __name__ == "__main__":
    main()
