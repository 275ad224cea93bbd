"""The renderer against energy, reciprocity, a path tracer that others keep, and the simulator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.render.environments import Environment
from learning.render.light_dome import even_directions
from learning.render.occlusion import bake_visibility
from learning.render.shading import shade
from learning.render.skin import ShadeOptions, SkinMaps
from learning.render.uv import rasterise
from lightstage.formats.template import default_template_path, load_template
from sim.light.facets import SKIN_F0
from sim.light.lamps import point_lamps
from sim.light.olat import shade as simulated
from sim.light.render import Lobe

RADIUS_MM = 80.0
CAMERA_MM = np.array([0.0, 0.0, 1100.0])
LIGHT_MM = np.array([300.0, 500.0, 1100.0])


def skin_of(
    position: np.ndarray, normal: np.ndarray, diffuse: float, specular: float, exponent: float
) -> SkinMaps:
    """n texels in a row, float64."""

    def row(values: np.ndarray) -> torch.Tensor:
        return torch.tensor(np.asarray(values, float).T[None, :, None])

    count = len(position)
    one = row(np.ones((count, 1)))
    return SkinMaps(
        diffuse * one.expand(-1, 3, -1, -1),
        specular * one,
        row(normal),
        row(normal),
        exponent * one,
        0 * one,
        row(position),
        one,
        1.0,
        one,
    )


def environment(toward: np.ndarray, rgb: float, camera: np.ndarray, distant: bool) -> Environment:
    count = len(toward)
    return Environment(
        torch.tensor(toward[None]),
        torch.full((1, count, 3), rgb, dtype=torch.float64),
        torch.zeros(1, 3, dtype=torch.float64),
        torch.full((1, count), distant),
        torch.tensor(np.asarray(camera, float)[None]),
    )


def seen(skin: SkinMaps, lights: Environment, mode: str = "physical") -> np.ndarray:
    """(n,) green."""
    options = ShadeOptions(mode=mode, subsurface_mm=0)
    return shade(skin, lights, options)[0, 1, 0].numpy()


@settings(max_examples=20, deadline=None)
@given(
    exponent=st.floats(1, 1000),
    specular=st.floats(0, 1),
    tilt=st.floats(0, 89),
    mode=st.sampled_from(["physical", "ggx"]),
)
def test_no_skin_sends_back_more_than_arrives(
    exponent: float, specular: float, tilt: float, mode: str
) -> None:
    up = even_directions(8000)
    up = up[up[:, 2] > 0]
    # A uniform field gives a white diffuser 1; the sum over lights is exact to 1e-3 at s = 1000.
    lights = environment(up, 1.0 / up[:, 2].sum(), 1e7 * direction(tilt), True)
    place, normal = np.zeros((1, 3)), np.array([[0, 0, 1.0]])
    skin = skin_of(place, normal, 1 - specular, specular, exponent)
    assert float(seen(skin, lights)[0]) <= 1.005
    mirror = skin_of(place, normal, 0, 1, exponent)
    assert float(seen(mirror, lights, mode)[0]) <= 1.005


def direction(tilt_deg: float, turn_deg: float = 0.0) -> np.ndarray:
    tilt, turn = np.deg2rad(tilt_deg), np.deg2rad(turn_deg)
    return np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


@settings(max_examples=40, deadline=None)
@given(
    one=st.tuples(st.floats(1, 80), st.floats(0, 360)),
    other=st.tuples(st.floats(1, 80), st.floats(0, 360)),
    exponent=st.floats(1, 300),
    mode=st.sampled_from(["physical", "ggx"]),
)
def test_light_and_camera_can_change_places(
    one: tuple[float, float], other: tuple[float, float], exponent: float, mode: str
) -> None:
    found = []
    for light, camera in (
        (direction(*one), direction(*other)),
        (direction(*other), direction(*one)),
    ):
        skin = skin_of(np.zeros((1, 3)), np.array([[0, 0, 1.0]]), 0.4, 0.3, exponent)
        lights = environment(light[None], 1.0, 1e9 * camera, True)
        found.append(float(seen(skin, lights, mode)[0]) / light[2])
    assert found[0] == pytest.approx(found[1], rel=1e-6)


def ball(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions from the camera to a ball, and its normals where they hit."""
    rng = np.random.default_rng(1)
    aim = rng.normal(size=(count, 3))
    aim *= RADIUS_MM / np.linalg.norm(aim, axis=1, keepdims=True)
    toward = aim - CAMERA_MM
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    along = toward @ CAMERA_MM
    distance = -along - np.sqrt(along**2 - CAMERA_MM @ CAMERA_MM + RADIUS_MM**2)
    return toward, (CAMERA_MM + distance[:, None] * toward) / RADIUS_MM


def blinn_phong(mi: Any) -> None:
    """Register the lobe as a Mitsuba BSDF, written from its definition."""

    class BlinnPhong(mi.BSDF):
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.exponent = props["exponent"]
            self.strength = props["strength"]
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags

        def sample(self, *_: Any) -> Any:
            return mi.BSDFSample3f(), mi.Color3f(0)

        def eval(self, _: Any, si: Any, wo: Any, active: Any = True) -> Any:
            del active
            wi = np.array(si.wi).ravel()
            out = np.array(wo).ravel()
            if wi[2] <= 0 or out[2] <= 0:
                return mi.Color3f(0)
            half = (wi + out) / np.linalg.norm(wi + out)
            return mi.Color3f(float(self.strength * half[2] ** self.exponent * out[2]))

        def pdf(self, *_: Any) -> float:
            return 0.0

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(context, si, wo, active), 0.0

    mi.register_bsdf("blinnphong", lambda props: BlinnPhong(props))


def path_traced(bsdf: dict[str, Any], toward: np.ndarray) -> np.ndarray:
    """(n,) radiance of the ball by Mitsuba, on our scale for a light of 1."""
    mi = pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    mi.set_variant("scalar_rgb")
    blinn_phong(mi)
    lamp = {
        "type": "point",
        "position": LIGHT_MM.tolist(),
        "intensity": {"type": "rgb", "value": float(np.pi * LIGHT_MM @ LIGHT_MM)},
    }
    shape = {"type": "sphere", "radius": RADIUS_MM, "bsdf": bsdf}
    scene = mi.load_dict(
        {"type": "scene", "integrator": {"type": "direct"}, "ball": shape, "lamp": lamp}
    )
    sampler, integrator = mi.load_dict({"type": "independent"}), scene.integrator()
    rays = [mi.RayDifferential3f(mi.Point3f(*CAMERA_MM), mi.Vector3f(*way)) for way in toward]
    return np.array([integrator.sample(scene, sampler, ray)[0][1] for ray in rays], float)


@pytest.mark.parametrize("exponent", [6.0, 60.0])
def test_blinn_phong_is_that_of_mitsuba(exponent: float) -> None:
    toward, normal = ball(120)
    norm = (exponent + 2) * (exponent + 4) / (8 * (2 ** (-exponent / 2) + exponent))
    bsdf = {"type": "blinnphong", "exponent": exponent, "strength": 0.3 * norm / np.pi}
    truth = path_traced(bsdf, toward)
    skin = skin_of(RADIUS_MM * normal, normal, 0.0, 0.3, exponent)
    found = seen(skin, environment(LIGHT_MM[None], 1.0, CAMERA_MM, False))
    assert truth.max() > 0.1
    np.testing.assert_allclose(found, truth, atol=1e-4 * truth.max(), rtol=1e-4)


def test_lambert_and_facets_are_those_of_mitsuba() -> None:
    toward, normal = ball(300)
    lights = environment(LIGHT_MM[None], 1.0, CAMERA_MM, False)
    matte = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    found = seen(skin_of(RADIUS_MM * normal, normal, 0.5, 0.0, 10), lights)
    np.testing.assert_allclose(found, path_traced(matte, toward), atol=1e-5, rtol=1e-4)
    alpha = 0.3
    mirror = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": alpha}
    truth = path_traced(mirror, toward)
    skin = skin_of(RADIUS_MM * normal, normal, 0.0, 1.0, 2 / alpha**2 - 2)
    found = seen(skin, lights, "ggx")
    np.testing.assert_allclose(found, truth, atol=1e-4 * truth.max(), rtol=1e-3)


def test_cast_shadows_are_those_of_mitsuba() -> None:
    mi = pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    mi.set_variant("scalar_rgb")
    mesh = load_template(default_template_path()).mesh
    raster = rasterise(mesh, 48, 32)
    toward = np.array([[0.6, 0.5, 0.62], [-0.9, 0.1, 0.3], [0.0, 0.95, 0.3]])
    ours = bake_visibility(mesh, raster, toward, np.ones(3, bool))[:, raster.covered]
    points, normals = raster.interpolate(mesh.vertices), raster.normals(mesh)
    points, normals = points[raster.covered], normals[raster.covered]
    triangles = mesh.triangles()
    made = mi.Mesh("head", len(mesh.vertices), len(triangles))
    params = mi.traverse(made)
    params["vertex_positions"] = np.asarray(mesh.vertices, np.float32).ravel()
    params["faces"] = np.asarray(triangles, np.uint32).ravel()
    params.update()
    scene = mi.load_dict({"type": "scene", "head": made})
    wrong = total = 0
    for light, picture in zip(toward, ours, strict=True):
        way = light / np.linalg.norm(light)
        above = np.flatnonzero(normals @ way > 0.02)[::5]
        for index in above:
            start = points[index] + 0.3 * normals[index]
            ray = mi.Ray3f(mi.Point3f(*start), mi.Vector3f(*way))
            wrong += bool(scene.ray_test(ray)) != (picture[index] == 0)
            total += 1
    assert total > 200
    assert wrong <= 0.005 * total


def test_facets_are_near_the_simulators_written_apart() -> None:
    toward, normal = ball(400)
    alpha = 0.3
    count = len(normal)
    specular = simulated(
        RADIUS_MM * normal,
        normal,
        normal,
        -toward,
        np.full((count, 3), 0.5),
        np.full(count, SKIN_F0),
        np.full(count, alpha),
        np.ones((count, 1), np.uint8),
        point_lamps(LIGHT_MM[None]),
        np.ones((1, 1, 3)),
        Lobe("ggx"),
    )[1][0, :, 1]
    skin = skin_of(RADIUS_MM * normal, normal, 0.0, SKIN_F0, 2 / alpha**2 - 2)
    found = seen(skin, environment(LIGHT_MM[None], 1.0, CAMERA_MM, False), "ggx")
    bright = specular > 0.1 * specular.max()
    assert bright.sum() > 20
    # Schlick's Fresnel against the exact one, and another form of shadowing.
    assert np.median(np.abs(found[bright] / specular[bright] - 1)) < 0.05
