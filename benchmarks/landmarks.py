"""How far are detected landmarks from the true ones, on people of three kinds, and how fast?"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.record import record
from lightstage.faces import Face, detect_faces
from lightstage.faces.of_template import landmark_weights, template_landmarks
from lightstage.faces.schemes import ibug68
from lightstage.formats.template import default_template_path, load_template
from lightstage.rig import Camera, Rig, default_rig, look_at
from processing.colour import srgb_from_linear
from processing.registration.config import RegisterConfig
from processing.registration.landmarks import triangulate
from processing.registration.providers import DetectedLandmarks
from sim.light.lamps import point_lamps
from sim.light.relight import auto_exposure
from sim.light.world import World
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.truth import landmarks_px

PICTURE_PX = 512
AWAY_MM = 900.0
SHOWN_MM = 330.0
YAWS_DEG = (-40.0, -20.0, 0.0, 20.0, 40.0)
WHO = {"ours": (101, 102, 103), "ict": (101, 102, 103), "lps": (0,)}
"""Seeds of each kind of person; none of them was looked at when the table of indices was chosen."""
TEXTURE_ROWS = 768
SOFT, HARD = 0.4, 0.02
"""Share of the light that comes from all round."""
LIGHTS: dict[str, tuple[float, float, float]] = {
    "all round": (0, 90, 1.0),
    "front": (0, 10, SOFT),
    "left": (-60, 20, SOFT),
    "right": (60, 20, SOFT),
    "above": (0, 70, SOFT),
    "below": (0, -50, SOFT),
    "back left": (-120, 20, SOFT),
    "hard left": (-75, 15, HARD),
    "hard right": (75, 15, HARD),
    "hard above": (20, 65, HARD),
}
"""Yaw to the person's left and pitch of the one lamp, degrees, and the share from all round."""
EYES = (36, 45)
INNER = slice(17, 68)
"""All but the jaw."""
HEADER = (
    "people",
    "landmarks",
    "pictures",
    "without a face",
    "all, %",
    "but the jaw, %",
    "yaw 0, %",
    "yaw 20, %",
    "yaw 40, %",
    "hard light, %",
    "ms",
)


class Shot(NamedTuple):
    """A picture with what is known about it.

    Attributes:
        picture: (h, w, 3) uint8.
        true_px: (68, 2), NaN where hidden.
        eyes_px: distance of the outer corners of the eyes if they were seen from the front.
        yaw_deg: of the camera.
        light: its name.
    """

    picture: np.ndarray
    true_px: np.ndarray
    eyes_px: float
    yaw_deg: float
    light: str


def main() -> None:
    template = load_template(default_template_path())
    assert template.face_points is not None
    vertices = template.mesh.vertices
    marks = vertices[template.landmarks]
    weights = landmark_weights(template.face_points.on(vertices), marks)
    rows: list[tuple[object, ...]] = []
    for kind, seeds in WHO.items():
        shots: list[Shot] = []
        faces: list[Face | None] = []
        views: list[tuple[Subject, list[Shot]]] = []
        seconds: list[float] = []
        for seed in seeds:
            name = "person" if kind == "ours" else kind
            subject = load_subject(name, seed, texture_rows=TEXTURE_ROWS)
            own = list(shots_of(subject, default_rig()))
            detect_faces(own[0].picture)
            for shot in own:
                begun = time.process_time()
                found = detect_faces(shot.picture)
                seconds.append(time.process_time() - begun)
                faces.append(found[0] if found else None)
            shots += own
            views.append((subject, [shot for shot in own if shot.light == "all round"]))
        there = [(s, f) for s, f in zip(shots, faces, strict=True) if f is not None]
        lost = len(shots) - len(there)
        for label, points in (
            ("by the table of indices", [ibug68(f.points_px) for _, f in there]),
            ("by the template's points", [template_landmarks(f, weights) for _, f in there]),
        ):
            rows.append((kind, label, len(shots), lost, *errors(there, points), ms(seconds)))
        rows.append(triangulated(kind, views, DetectedLandmarks(template)))
    record(
        "Landmarks",
        HEADER,
        rows,
        "iBUG's 68 against the true ones that the camera sees, mean distance over that between the "
        f"outer corners of the eyes seen from the front; pictures of {PICTURE_PX} px of people "
        "of seeds that nothing was chosen by, and of the scan, at which the table of indices was "
        "looked at, five yaws to 40 degrees, ten lights of which three hard. "
        "Whose landmarks are true: our people's are the template's, ICT's and the scan's (lps, "
        "eyes closed) their own makers'. Triangulated: from the five views in even light, against "
        "the true places, in space. ms: processor time of a picture, finding the face and seeing "
        "it three times; without a face five turns are tried.",
    )


def errors(there: list[tuple[Shot, Face]], points: list[np.ndarray]) -> list[str]:
    """Mean errors in percent: all, but the jaw, at three yaws, in hard light."""
    away = np.array(
        [
            100 * np.linalg.norm(p - shot.true_px, axis=1) / shot.eyes_px
            for p, (shot, _) in zip(points, there, strict=True)
        ]
    )
    yaw = np.abs([shot.yaw_deg for shot, _ in there])
    hard = np.array([shot.light.startswith("hard") for shot, _ in there])
    parts = [away[:, INNER][yaw == y] for y in (0, 20, 40)]
    means = [away, away[:, INNER], *parts, away[:, INNER][hard]]
    return [f"{np.nanmean(part):.2f}" for part in means]


def triangulated(
    kind: str, views: list[tuple[Subject, list[Shot]]], provider: DetectedLandmarks
) -> tuple[object, ...]:
    """A row: landmarks in space from the views of each person, as `register` takes them."""
    every, inner = [], []
    for subject, shots in views:
        middle = np.nanmean(subject.landmarks_mm[17:], axis=0)
        cameras = {f"{s.yaw_deg:+.0f}": portrait_camera(middle, s.yaw_deg) for s in shots}
        found = provider.find({f"{s.yaw_deg:+.0f}": s.picture for s in shots})
        placed = triangulate(found, cameras, agree_mm=RegisterConfig().detected_agree_mm)
        eyes_mm = np.linalg.norm(np.subtract(*subject.landmarks_mm[list(EYES)]))
        away = 100 * np.linalg.norm(placed.points_mm - subject.landmarks_mm, axis=1) / eyes_mm
        every.append(np.nanmean(away))
        inner.append(np.nanmean(away[INNER]))
    shown = [f"{np.mean(every):.2f}", f"{np.mean(inner):.2f}"]
    return (kind, "triangulated", len(views) * len(YAWS_DEG), "", *shown, "", "", "", "", "")


def ms(seconds: list[float]) -> str:
    return f"{1000 * np.median(seconds):.0f}"


def toward(yaw_deg: float, pitch_deg: float) -> np.ndarray:
    """(3,) unit."""
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    return np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])


def portrait_camera(middle_mm: np.ndarray, yaw_deg: float) -> Camera:
    place = middle_mm + AWAY_MM * toward(yaw_deg, 5.0)
    focal, half = PICTURE_PX * AWAY_MM / SHOWN_MM, PICTURE_PX / 2
    pose = np.array(look_at(place, middle_mm))
    dist = (0.0, 0.0, 0.0, 0.0, 0.0)
    size = (PICTURE_PX, PICTURE_PX)
    return Camera(f"yaw{yaw_deg:+.0f}", "", "", *size, focal, focal, half, half, dist, pose)


def lamp_places() -> np.ndarray:
    """(m, 3) the single lamps, then as many all round, mm."""
    single = [toward(yaw, pitch) for yaw, pitch, _ in LIGHTS.values()]
    rows = [(0, 8), (45, 5), (-35, 5)]
    around = [toward(360 * i / n, pitch) for pitch, n in rows for i in range(n)]
    return 1500.0 * np.array([*single, *around])


def shots_of(subject: Subject, rig: Rig) -> Iterator[Shot]:
    """Pictures of a person from all sides under all lights."""
    middle = np.nanmean(subject.landmarks_mm[17:], axis=0)
    cameras = tuple(portrait_camera(middle, yaw) for yaw in YAWS_DEG)
    places = lamp_places()
    one = rig.lights[0]
    lights = tuple(
        dataclasses.replace(one, id=i, name=str(i), position_mm=tuple(p), rgb_gain=(1.0, 1.0, 1.0))
        for i, p in enumerate(places)
    )
    stage = dataclasses.replace(rig, cameras=cameras, lights=lights)
    world = World(subject, stage, lamps=point_lamps(places))
    states = np.zeros((len(LIGHTS), len(places)))
    for index, (_, _, around) in enumerate(LIGHTS.values()):
        states[index, index] = 1 - around
        states[index, len(LIGHTS) :] = around / (len(places) - len(LIGHTS))
    eyes_mm = np.linalg.norm(np.subtract(*subject.landmarks_mm[list(EYES)]))
    for camera, yaw in zip(cameras, YAWS_DEG, strict=True):
        true = landmarks_px(world, camera, np.random.default_rng(0), 0.0)
        pictures = world.photograph(camera.id, states)
        for name, linear in zip(LIGHTS, pictures, strict=True):
            exposed = np.clip(linear * auto_exposure(linear), 0, 1)
            yield Shot(
                (255 * srgb_from_linear(exposed) + 0.5).astype(np.uint8),
                true,
                float(eyes_mm * camera.fx_px / AWAY_MM),
                yaw,
                name,
            )


if __name__ == "__main__":
    main()
