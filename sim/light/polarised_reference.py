"""Polarised light by Mitsuba: Stokes vectors of a picture, read through an analyser.

One lamp, a small square, shines through a plate that polarises it onto skin of one colour and one
roughness (`pplastic`, Baek's polarised reflectance [Baek2018]); the integrator carries Mueller
matrices along the paths and returns S0 S1 S2 S3 in each pixel, relative to the picture's rows.
What a lens's polariser passes follows by Mueller calculus.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.srgb import LUMINANCE
from lightstage.rig import Camera
from sim.light.polarised import PolariserConfig
from sim.reference.variant import mitsuba, working_llvm

SCALAR, LLVM = "scalar_spectral_polarized", "llvm_ad_mono_polarized"
LAMP_MM = 20.0
PLATE_MM = 5.0


@dataclasses.dataclass(frozen=True)
class PlainSkin:
    """Skin of one kind all over.

    Attributes:
        diffuse: reflectance of the layer beneath the interface.
        specular: factor of the mirror reflection; 1 is that of the index.
        roughness: Beckmann m.
        index: of refraction.
    """

    diffuse: float = 0.3
    specular: float = 1.0
    roughness: float = 0.3
    index: float = 1.4


@dataclasses.dataclass(frozen=True)
class StokesConfig:
    """How long to render.

    Attributes:
        samples: rays a pixel.
        bounces: 1 is direct light alone.
        seed: of the samples.
    """

    samples: int = 256
    bounces: int = 1
    seed: int = 0


def polarised_variant() -> str:
    """Mitsuba's fastest polarised variant that works here."""
    return SCALAR if working_llvm() is None else LLVM


def stokes_picture(
    mesh: Mesh,
    camera: Camera,
    lamp_mm: np.ndarray,
    lamp_axis: np.ndarray | None,
    skin: PlainSkin,
    config: StokesConfig,
) -> np.ndarray:
    """Stokes vectors that reach a camera from one polarised lamp.

    Args:
        mesh: the subject, mm, shaded by its smooth normals.
        camera: without distortion, its centre of projection in the picture's middle.
        lamp_mm: (3,) where the lamp is; it faces the origin.
        lamp_axis: (3,) the field that its polariser passes; None: no polariser.
        skin: of the whole subject.
        config: samples and bounces.

    Returns:
        (h, w, 4) float64, on the scale where a white diffuser at the origin facing the lamp reads
        1 of what has left the lamp's polariser. S1 is positive where the field lies along rows.

    Raises:
        SimError: Mitsuba is absent.
    """
    mi = mitsuba(polarised_variant())
    place = np.asarray(lamp_mm, float)
    distance = float(np.linalg.norm(place))
    ahead = -place / distance
    axis = np.array([ahead[2], 0.0, -ahead[0]]) if lamp_axis is None else np.asarray(lamp_axis)
    axis = axis - (axis @ ahead) * ahead
    axis /= np.linalg.norm(axis)
    radiance = np.pi * distance**2 / LAMP_MM**2
    scene = {
        "type": "scene",
        "integrator": {
            "type": "stokes",
            "light": {
                "type": "volpath",
                # The plate itself counts as one event of a path.
                "max_depth": config.bounces + 2,
                "hide_emitters": True,
                "rr_depth": 1000,
            },
        },
        "camera": _camera(mi, camera),
        "lamp": {
            "type": "rectangle",
            "to_world": _frame(mi, place, axis, ahead, LAMP_MM / 2),
            "emitter": {
                "type": "area",
                # A perfect polariser passes half.
                "radiance": _flat(radiance * (1 if lamp_axis is None else 2)),
            },
        },
    }
    if lamp_axis is not None:
        scene["plate"] = {
            "type": "rectangle",
            "to_world": _frame(mi, place + PLATE_MM * ahead, axis, ahead, 3 * LAMP_MM),
            "bsdf": {"type": "polarizer", "theta": _flat(0.0)},
        }
    with tempfile.TemporaryDirectory(prefix="lightstage-polarised-") as folder:
        shape = Path(folder) / "skin.ply"
        _write_ply(mi, mesh, shape)
        scene["skin"] = {
            "type": "ply",
            "filename": str(shape),
            "bsdf": {
                "type": "pplastic",
                "diffuse_reflectance": _flat(skin.diffuse),
                "specular_reflectance": _flat(skin.specular),
                "int_ior": skin.index,
                "ext_ior": 1.0,
                "alpha": skin.roughness,
            },
        }
        loaded = mi.load_dict(scene)
        found = np.array(mi.render(loaded, spp=config.samples, seed=config.seed), float)
    channels = found[..., -12:].reshape(*found.shape[:2], 4, 3)
    # The scalar variant is spectral and its film sRGB: a flat spectrum's luminance is its level.
    return channels @ LUMINANCE


def analysed(stokes: np.ndarray, config: PolariserConfig) -> np.ndarray:
    """(h, w) what a lens's polariser passes of Stokes vectors (h, w, 4), by its Mueller matrix."""
    turn = 2 * np.radians(config.lens_deg)
    along = stokes[..., 1] * np.cos(turn) + stokes[..., 2] * np.sin(turn)
    leak = 1.0 / config.lens_extinction
    return 0.5 * ((1 + leak) * stokes[..., 0] + (1 - leak) * along)


def _flat(value: float) -> dict[str, object]:
    return {"type": "spectrum", "value": float(value)}


def _frame(
    mi: Any, place: np.ndarray, axis: np.ndarray, ahead: np.ndarray, half_mm: float
) -> object:
    """A rectangle's transform: its x along `axis`, its front toward `ahead`."""
    matrix = np.eye(4)
    matrix[:3, 0] = half_mm * axis
    matrix[:3, 1] = half_mm * np.cross(ahead, axis)
    matrix[:3, 2] = ahead
    matrix[:3, 3] = place
    return mi.ScalarTransform4f(matrix.tolist())


def _camera(mi: Any, camera: Camera) -> dict[str, object]:
    centre = camera.centre_mm
    forward, down = camera.cam_from_world[2, :3], camera.cam_from_world[1, :3]
    fov = 2 * np.degrees(np.arctan(0.5 * camera.width_px / camera.fx_px))
    return {
        "type": "perspective",
        "fov": float(fov),
        "fov_axis": "x",
        "near_clip": 10.0,
        "far_clip": 10000.0,
        "to_world": mi.ScalarTransform4f().look_at(
            centre.tolist(), (centre + forward).tolist(), (-down).tolist()
        ),
        "film": {
            "type": "hdrfilm",
            "width": camera.width_px,
            "height": camera.height_px,
            "rfilter": {"type": "box"},
            "component_format": "float32",
        },
        "sampler": {"type": "independent"},
    }


def _write_ply(mi: Any, mesh: Mesh, path: Path) -> None:
    """A mesh with smooth normals as Mitsuba's own PLY."""
    triangles = mesh.triangles()
    normals = vertex_normals(np.asarray(mesh.vertices, float), triangles)
    made = mi.Mesh("skin", len(mesh.vertices), len(triangles), has_vertex_normals=True)
    values = mi.traverse(made)
    values["vertex_positions"] = np.asarray(mesh.vertices, np.float32).ravel()
    values["vertex_normals"] = np.asarray(normals, np.float32).ravel()
    values["faces"] = np.asarray(triangles, np.uint32).ravel()
    values.update()
    made.write_ply(str(path))
