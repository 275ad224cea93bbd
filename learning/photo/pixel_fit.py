"""A shape from the pixels of photographs, after their landmarks: shading, pattern and outlines.

At places spread over the face the logarithm of a photograph's light is compared with that of the
model: the skin's albedo times the irradiance on the model's normal, and what it mirrors. The
outline of the head is compared with the strongest edge of the photograph nearby. A Gauss-Newton
step moves identity, pose, expression, albedo and the strengths of the light at once, with the
landmarks and all that is known before beside them. Lamps are searched once; shadows, which places
are seen, and which of them are skin, are found anew in each round.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from learning.gauss_newton import descended
from learning.networks.whole_face import WholeFaceNetwork
from learning.photo.config import FitConfig
from learning.photo.face_light import HARMONICS, Lit, irradiance
from learning.photo.face_places import (
    FacePlaces,
    face_places,
    normals_with_slopes,
    sampled_texels,
)
from learning.photo.landmark_fit import Problem, Unknowns, camera_of, projected
from learning.photo.model import ShapeModel
from learning.photo.outline import Rims, find_rims
from learning.photo.sampling import sampled
from learning.photo.unwrap import unwrap
from learning.render.occlusion import ShadowCaster
from learning.render.uv import rasterise, spread_outside
from learning.render.view import cast_from, sample_bilinear, scene_of
from learning.whole.light import Light, LightFit, LitSurface
from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.srgb import LUMINANCE
from lightstage.formats.template import Template
from lightstage.rig import Camera

BLUR_MM = (3.0, 2.0)
"""Standard deviation of the photographs' blur in the first round, and in the others."""
STEPS = 6
"""Gauss-Newton steps of a round, at most."""
SETTLED = 1e-4
"""A step that lowers the cost by less than this share is the round's last."""
DARK = 0.02
"""Light at which a pixel counts a quarter."""
DARKEST = 0.002
"""Added to all light before logarithms are taken."""
CLIPPED = 0.99
"""Share of a photograph's largest value from which a channel may be clipped: it does not show how
much light there was. A photograph that is not clipped loses its brightest highlight by it."""
MOST_CLIPPED = 0.5
"""Share of such pixels around a place, from which it does not count."""
GRAZING, FULL = 0.3, 0.5
"""Cosines to the camera from which a place counts, and from which it counts whole."""
SAME_MM = 1.5
"""A place is seen where a ray meets the surface no farther from it than that."""
CUT_OFF = 3.0
"""Standard deviations at which a residual loses its weight [GemanMcClure1985]."""
NOT_SKIN = 2.5
"""A neighbourhood that is so many times as far off as the median one counts half."""
STRENGTH = 1.0
"""Standard deviation of a lamp's strength, of all light."""
CORRECTION = 0.1
"""The same of each harmonic that corrects the light from everywhere."""
OUTLINE_ALIKE_MM = 10.0
"""So much of an outline errs as one."""
LARGEST_OFF = 10.0


class Picture:
    """A photograph as the fit compares it: the logarithm of its light, blurred, and its slopes.

    Attributes:
        light: (h, w) linear luminance.
        clipped_from: value of a channel from which it may be clipped.
        clipped: (h, w) 0..1, share of such pixels, blurred likewise.
    """

    def __init__(self, rgb_linear: np.ndarray, sigma_px: float) -> None:
        """(h, w, 3) and the standard deviation of the blur."""
        rgb = np.maximum(np.nan_to_num(rgb_linear), 0).astype(np.float32)
        sigma_px = max(sigma_px, 0.5)
        self.light = np.ascontiguousarray(rgb @ LUMINANCE.astype(np.float32))
        soft = cv2.GaussianBlur(self.light, (0, 0), sigma_px)
        most = rgb.max(axis=2)
        self.clipped_from = CLIPPED * float(most.max())
        clipped = (most >= self.clipped_from).astype(np.float32)
        self.clipped = cv2.GaussianBlur(clipped, (0, 0), sigma_px)
        self._value = np.log(soft + DARKEST)
        self._across = cv2.Sobel(self._value, cv2.CV_32F, 1, 0, scale=1 / 8)
        self._down = cv2.Sobel(self._value, cv2.CV_32F, 0, 1, scale=1 / 8)

    def at(self, places_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(s,) values and (s, 2) slopes at (s, 2) places."""
        images = (self._value, self._across, self._down)
        value, across, down = (sampled(image, places_px).astype(float) for image in images)
        return value, np.stack([across, down], axis=1)


@dataclasses.dataclass(frozen=True)
class State:
    """Where the search is.

    Attributes:
        at: shape and cameras.
        albedo: (a,) coefficients of the places' albedo.
        light: of each photograph the (l + 1 + 8,) strengths of `irradiance`.
    """

    at: Unknowns
    albedo: np.ndarray
    light: tuple[np.ndarray, ...]

    def moved(self, step: np.ndarray, shape: int) -> State:
        """After a (u,) step in the order: `shape` unknowns of shape and cameras, albedo, lights."""
        ends = np.cumsum([shape, len(self.albedo), *(len(x) for x in self.light)])
        own, albedo, *lights = np.split(step, ends[:-1])
        light = tuple(x + part for x, part in zip(self.light, lights, strict=True))
        return State(self.at.moved(own), self.albedo + albedo, light)


@dataclasses.dataclass(frozen=True)
class View:
    """What a round knows of one photograph.

    Attributes:
        picture: blurred.
        places: those that count.
        lit: these places' light.
        rims: the outline.
    """

    picture: Picture
    places: FacePlaces
    lit: Lit
    rims: Rims


Term = tuple[np.ndarray, np.ndarray, np.ndarray]
"""(s,) residuals over their deviation, (s, u) slopes, (s,) weights."""


class PixelFit:
    """Photographs of one person, and the search for the shape that gives their pixels."""

    def __init__(
        self,
        problem: Problem,
        model: ShapeModel,
        template: Template,
        network: WholeFaceNetwork,
        pictures: list[np.ndarray],
        config: FitConfig,
    ) -> None:
        """The landmarks' problem, the model of all vertices, and (h, w, 3) linear pictures."""
        self.problem, self.model, self.template, self.config = problem, model, template, config
        self.places = face_places(template, model, network, config)
        self.rgb = [np.nan_to_num(p, nan=0.0, posinf=0.0, neginf=0.0) for p in pictures]
        size = network.config.rows // 2, network.config.columns // 2
        self._raster = rasterise(template.mesh, *size)
        covered = self._raster.covered
        self._albedo = sampled_texels(network.mean_log_albedo, size)[covered]
        self._specular = sampled_texels(network.mean_log_specular, size)[covered][:, 0]
        self._lamps: list[Light | None] = [None] * len(pictures)
        self.views: list[View] = []

    def run(self, at: Unknowns) -> tuple[Unknowns, np.ndarray]:
        """The unknowns of shape and cameras, and their covariance.

        Args:
            at: where landmarks have brought them.
        """
        state = State(at, np.zeros(self.places.albedo.shape[1]), ())
        size = self.problem.size
        matrix = np.eye(size)
        for index in range(self.config.pixel_rounds):
            state = self.seen_anew(state, BLUR_MM[min(index, len(BLUR_MM) - 1)])
            state, _, matrix = descended(
                state,
                self.equations,
                lambda here, step: here.moved(step, size),
                STEPS,
                least_gain=SETTLED,
            )
        return state.at, np.linalg.inv(matrix)[:size, :size]

    def equations(self, state: State) -> tuple[float, np.ndarray, np.ndarray]:
        """Cost, normal matrix and half the gradient: landmarks, pixels, outlines, priors."""
        size, count = self.problem.size, len(state.albedo)
        total = size + count + sum(len(x) for x in state.light)
        matrix, right = np.zeros((total, total)), np.zeros(total)
        cost, matrix[:size, :size], right[:size] = self.problem.equations(state.at)
        here = np.arange(size, size + count)
        matrix[here, here] += 1
        right[here] += state.albedo
        cost += float((state.albedo**2).sum())
        begin = size + count
        for index, (view, light) in enumerate(zip(self.views, state.light, strict=True)):
            lights = np.arange(begin, begin + len(light))
            begin += len(light)
            mean, sure = _known_light(view.lit)
            matrix[lights, lights] += sure
            right[lights] += sure * (light - mean)
            cost += float((sure * (light - mean) ** 2).sum())
            columns = np.r_[self.problem.columns(index), here, lights]
            for off, slopes, weight in (
                self.pixel_term(state, index, view.picture, view.places, view.lit),
                self.rim_term(state, index, view.rims),
            ):
                ratio = 1 + off**2 / CUT_OFF**2
                cost += float((weight * off**2 / ratio).sum())
                weighted = slopes * (weight / ratio**2)[:, None]
                matrix[np.ix_(columns, columns)] += weighted.T @ slopes
                right[columns] += weighted.T @ off
        return cost, matrix, right

    def pixel_term(
        self, state: State, index: int, picture: Picture, places: FacePlaces, lit: Lit
    ) -> Term:
        """The pixels of one photograph at some places, by all its unknowns."""
        identity, expression = state.at.identity, state.at.expression[index]
        here = projected(places.model, state.at, index, self.problem.centre(index))
        normal, by_coefficient = normals_with_slopes(places, identity, expression)
        position = places.model.vertices(identity, expression)
        each, by_normal = irradiance(position, normal, lit)
        strength = state.light[index]
        given = np.maximum(each @ strength, DARKEST)
        albedo = np.exp(np.clip(places.pattern + places.albedo @ state.albedo, -7, 3))
        made = albedo * given + lit.shine + DARKEST
        value, slope = picture.at(here.found)
        k = len(identity)
        slopes = np.einsum("si,sik->sk", slope, here.slopes)
        matt = albedo / made
        toward = np.einsum("b,sbi->si", strength, by_normal) * matt[:, None]
        by_shape = np.einsum("si,sip->sp", toward, by_coefficient)
        slopes[:, :k] -= by_shape[:, :k]
        slopes[:, len(slopes.T) - len(expression) :] -= by_shape[:, k:]
        by_albedo = -places.albedo * (matt * given)[:, None]
        by_light = -each * matt[:, None]
        sigma = self.config.pixel_deviation
        whole = np.concatenate([slopes, by_albedo, by_light], axis=1) / sigma
        weight = lit.weight * places.area_mm2 / self.config.pixel_alike_mm2
        return (value - np.log(made)) / sigma, whole, weight

    def rim_term(self, state: State, index: int, rims: Rims) -> Term:
        """The outline of one photograph, by all its unknowns."""
        here = projected(rims.model, state.at, index, self.problem.centre(index))
        sigma = self.config.outline_mm * _px_of_mm(state.at, index)
        off = ((here.found * rims.outward).sum(axis=1) - rims.target_px) / sigma
        slopes = np.einsum("ri,rik->rk", rims.outward, here.slopes) / sigma
        more = np.zeros((len(off), len(state.albedo) + len(state.light[index])))
        return off, np.concatenate([slopes, more], axis=1), rims.weight / OUTLINE_ALIKE_MM

    def seen_anew(self, state: State, blur_mm: float) -> State:
        """Find what is visible, the lamps, shadows, outlines and what is no skin."""
        seen = []
        for index, rgb in enumerate(self.rgb):
            picture = Picture(rgb, blur_mm * _px_of_mm(state.at, index))
            vertices = self.model.vertices(state.at.identity, state.at.expression[index])
            mesh = self.template.mesh.with_vertices(vertices)
            camera = camera_of(state.at, index, rgb.shape[1], rgb.shape[0], str(index))
            lit = self._lit(mesh, camera, picture, index)
            seen.append((picture, lit, find_rims(self.model, mesh, camera, rgb, self.places.rim)))
        light = tuple(_known_light(lit)[0] for _, lit, _ in seen)
        state = dataclasses.replace(state, light=light)
        self.views = []
        for index, (picture, lit, rims) in enumerate(seen):
            off, _, _ = self.pixel_term(state, index, picture, self.places, lit)
            lit = dataclasses.replace(lit, weight=lit.weight * skin(self.places, off, lit.weight))
            # Places that are hidden, dark or no skin have no part in the equations.
            counts = np.flatnonzero(lit.weight > 0)
            self.views.append(View(picture, self.places.kept(counts), lit.kept(counts), rims))
        return state

    def _lit(self, mesh: Mesh, camera: Camera, picture: Picture, index: int) -> Lit:
        """The light of a photograph on the shape so far, and how much its places count."""
        raster, places = self._raster, self.places
        unwrapped = unwrap(self.rgb[index], mesh, raster, camera)
        covered = raster.covered
        face = raster.interpolate(self.model.face[:, None].astype(float))[..., 0] > 0.5
        counts = (unwrapped.seen & face) * np.clip(unwrapped.facing, 0, 1)
        texture = np.nan_to_num(unwrapped.texture[covered].astype(float))
        shows_light = texture.max(axis=1) < picture.clipped_from
        surface = LitSurface(mesh, raster, camera.centre_mm)
        search = LightFit(surface, texture, (counts[covered] * shows_light).astype(float))
        light = self._lamps[index]
        if light is None:
            # By its own rule alone: what is found does not depend on how busy a machine is.
            light = search.find(self._albedo, self._specular, None, np.inf)
            self._lamps[index] = light
        _, lobe = search.columns(light.lamps_mm)
        strength = light.rgb @ LUMINANCE
        openness, shine = (
            _at_places(values, covered, places.uv)
            for values in (search.openness, self._specular * (lobe @ strength))
        )
        lamps = np.array(light.lamps_mm).reshape(-1, 3)
        normals = vertex_normals(mesh.vertices, mesh.triangles())[places.vertices]
        position = mesh.vertices[places.vertices]
        caster = ShadowCaster(mesh.vertices, mesh.triangles(), position, normals)
        seen = caster.seen(lamps, np.zeros(len(lamps), bool), cast_only=True).astype(float)
        seen = (places.near @ seen.T).T
        # At a shadow's border a shape that is nearly right gives no useful error.
        share = strength[:-1] / max(float(strength.sum()), 1e-6)
        border = np.clip(share @ (4 * seen * (1 - seen)), 0, 1)
        place_px = camera.project(position)[0]
        value = sampled(picture.light, place_px).astype(float)
        weight = visible(mesh, camera, position, normals) * (1 - border) ** 2
        weight *= np.clip(1 - sampled(picture.clipped, place_px) / MOST_CLIPPED, 0, 1)
        return Lit(lamps, seen, openness, strength, shine, weight * (value / (value + DARK)) ** 2)


def visible(mesh: Mesh, camera: Camera, position: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(s,) 0..1, how well places of a mesh are seen: 0 where hidden, grazing or out of the picture.

    Args:
        mesh: in the camera's world, mm.
        camera: that sees it.
        position: (s, 3) on the mesh.
        normals: (s, 3) unit.
    """
    toward = camera.centre_mm - position
    distance = np.linalg.norm(toward, axis=1)
    cosine = (normals * toward).sum(axis=1) / distance
    met = cast_from(scene_of(mesh), camera.centre_mm, -toward / distance[:, None])["t_hit"]
    place, depth = camera.project(position)
    free = (met > distance - SAME_MM) & (depth > 0) & (place > 1).all(axis=1)
    free &= (place < [camera.width_px - 1, camera.height_px - 1]).all(axis=1)
    found: np.ndarray = free * np.clip((cosine - GRAZING) / (FULL - GRAZING), 0, 1)
    return found


def skin(places: FacePlaces, off: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(s,) 0..1, low where a neighbourhood is far off: hair, glasses, a hand.

    Args:
        places: the face's.
        off: (s,) residuals over their deviation.
        weight: (s,) how much the places count before.
    """
    squared = np.minimum(off**2, LARGEST_OFF**2) * weight
    far = np.sqrt((places.near @ squared) / np.maximum(places.near @ weight, 1e-9))
    some = weight > 0.2
    typical = max(float(np.median(far[some])), 1.0) if some.any() else 1.0
    found: np.ndarray = 1 / (1 + (far / (NOT_SKIN * typical)) ** 4)
    return found


def _known_light(lit: Lit) -> tuple[np.ndarray, np.ndarray]:
    """(l + 1 + 8,) strengths that the search found, and how certain they are."""
    whole = max(float(lit.strength.sum()), 1e-3)
    spread = np.r_[np.full(len(lit.strength), STRENGTH), np.full(HARMONICS, CORRECTION)]
    return np.r_[lit.strength, np.zeros(HARMONICS)], 1 / (spread * whole) ** 2


def _px_of_mm(at: Unknowns, index: int) -> float:
    """Pixels of a millimetre at the head's origin."""
    return float(np.exp(at.log_focal[index] - at.log_depth[index]))


def _at_places(values: np.ndarray, covered: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(s,) of values of the texels with a surface, at (s, 2) UV."""
    image = np.zeros(covered.shape)
    image[covered] = values
    found: np.ndarray = sample_bilinear(spread_outside(image, covered)[..., None], uv)[:, 0]
    return found
