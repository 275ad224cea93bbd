"""Mirror and grey ball: highlights where optics puts them, light as Lambert says."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
import scipy.optimize

from lightstage.rig import default_rig
from sim.errors import SimError
from sim.light.lamps import LampConfig, lamps_of
from sim.targets.ball import Ball, highlights_mm, photograph_grey, photograph_mirror

NO_ROOM = np.zeros(3)


@pytest.fixture(scope="module")
def rig():
    whole = default_rig().scaled(0.1795)
    bent = dataclasses.replace(whole.cameras[0], dist=(-0.2, 0.1, 0.002, -0.001, 0.0))
    return dataclasses.replace(whole, cameras=(bent, whole.cameras[1]))


@pytest.fixture(scope="module")
def full(rig):
    return np.ones(len(rig.lights))


def test_a_highlight_lies_where_the_way_over_the_mirror_is_shortest(rig):
    """Fermat instead of the mirror's law: an independent solution of the same places."""
    ball, camera = Ball(np.array([20.0, -10.0, 5.0]), 38.1, 0.6), rig.cameras[1]
    some = rig.positions_mm[::17]
    found = highlights_mm(ball, camera, some)
    assert np.isfinite(found).all()
    for place, lamp in zip(found, some, strict=True):
        normal = (place - ball.centre_mm) / ball.radius_mm

        def length(angles, normal=normal, lamp=lamp):
            first = np.cross(normal, [0.3, 0.5, 0.8])
            first /= np.linalg.norm(first)
            off = normal + angles[0] * first + angles[1] * np.cross(normal, first)
            point = ball.centre_mm + ball.radius_mm * off / np.linalg.norm(off)
            return np.linalg.norm(point - camera.centre_mm) + np.linalg.norm(point - lamp)

        best = scipy.optimize.minimize(length, [0.05, -0.05], method="BFGS").x
        assert np.abs(best).max() < 1e-4
        into = place - camera.centre_mm
        into /= np.linalg.norm(into)
        out = (lamp - place) / np.linalg.norm(lamp - place)
        np.testing.assert_allclose(out, into - 2 * (into @ normal) * normal, atol=1e-9)


def test_the_mirror_balls_picture_shows_each_lamp_at_its_highlight(rig, full):
    ball = Ball(np.array([10.0, 5.0, 0.0]), 38.1, 0.6)
    # Pixels finer than the lamps' pictures: the middle of less than a pixel is not seen.
    bent = dataclasses.replace(default_rig().scaled(0.4).cameras[0], dist=rig.cameras[0].dist)
    camera = dataclasses.replace(bent, width_px=600, height_px=600, cx_px=300.0, cy_px=300.0)
    lamps = lamps_of(rig)
    known, _ = camera.project(highlights_mm(ball, camera, rig.positions_mm))
    middle, _ = camera.project(ball.centre_mm[None])
    inner = np.linalg.norm(known - middle, axis=1) < 160  # of 245: not yet smeared
    rng = np.random.default_rng(1)
    for lamp in rng.choice(np.flatnonzero(inner), 4, replace=False):
        level = np.zeros(len(full))
        level[lamp] = 1.0
        light, depth = photograph_mirror(ball, camera, lamps, level, NO_ROOM)
        weight = light[..., 1].astype(float)
        rows, columns = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
        found = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
        np.testing.assert_allclose(found, known[lamp], atol=0.05)
        assert depth[weight > 0].min() > 1000
    together, _ = photograph_mirror(ball, camera, lamps, full, NO_ROOM)
    for place in known[inner]:
        column, row = place.astype(int)
        assert together[row - 1 : row + 2, column - 1 : column + 2].max() > 20


def test_a_highlight_holds_the_light_that_a_convex_mirror_sends_on(rig):
    """A lamp nearly behind the camera: the paraxial image, half a radius' focal length."""
    radius = 38.1
    ball, camera = Ball(np.zeros(3), radius, 0.6), rig.cameras[1]
    lamps = dataclasses.replace(lamps_of(rig), exponent=0.0)
    away = np.linalg.norm(camera.centre_mm)
    lamp = int(np.argmax(rig.positions_mm @ camera.centre_mm))
    level = np.zeros(len(rig.lights))
    level[lamp] = 1.0
    light, _ = photograph_mirror(ball, camera, lamps, level, NO_ROOM)
    received = light[..., 1].sum(dtype=float) / camera.fx_px**2
    distance = np.linalg.norm(rig.positions_mm[lamp])
    # A diffuser that reads w has lamp radiance times lamp area over pi distance^2 fall on it.
    radiance_area = np.pi * lamps.weights[lamp, 1] * distance**2
    shrink = (radius / 2) / (distance - radius + radius / 2)
    behind = shrink * (distance - radius)
    known = 0.6 * radiance_area * shrink**2 / (away - radius + behind) ** 2
    assert received == pytest.approx(known, rel=0.04)


def test_a_lamp_without_size_has_no_picture_in_a_mirror(rig, full):
    points = lamps_of(rig, LampConfig(radius_mm=0.0))
    with pytest.raises(SimError, match="radius_mm"):
        photograph_mirror(Ball(np.zeros(3), 38.1, 0.6), rig.cameras[0], points, full, NO_ROOM)


def test_the_grey_ball_is_lamberts_law_at_every_pixel(rig):
    """The plain twin sums lamps for a few pixels, one by one."""
    ball, camera = Ball(np.array([5.0, 0.0, -10.0]), 38.1, 0.18), rig.cameras[1]
    lamps = lamps_of(rig)
    levels = np.random.default_rng(2).random(len(rig.lights))
    light, depth = photograph_grey(ball, camera, lamps, levels, np.full(3, 0.03))
    origin, rays = camera.pixel_rays()
    inside = np.argwhere(cv2.erode((light[..., 1] > 0).astype(np.uint8), np.ones((5, 5))))
    for row, column in inside[:: len(inside) // 12]:
        ray = rays[row, column]
        along = ray @ (ball.centre_mm - origin)
        aside2 = np.sum((ball.centre_mm - origin) ** 2) - along**2
        point = origin + (along - np.sqrt(ball.radius_mm**2 - aside2)) * ray
        normal = (point - ball.centre_mm) / ball.radius_mm
        total = 0.03
        for place, axis, weight, level in zip(
            lamps.positions_mm, lamps.axes, lamps.weights[:, 1], levels, strict=True
        ):
            way = place - point
            far = np.linalg.norm(way)
            cosine = max(normal @ way / far, 0.0)
            fall = (-(way @ axis) / far) ** lamps.exponent
            total += level * weight * cosine * fall * (np.linalg.norm(place) / far) ** 2
        assert light[row, column, 1] == pytest.approx(0.18 * total, rel=1e-5)
        assert depth[row, column] == pytest.approx((point - origin) @ rays[540, 360], rel=1e-3)
