"""Faces to train on: people of the fit's own model, in any light, with hair and what is worn.

Shapes are drawn as `fit` expects them (`learning.photo.model`), skins are those of a store. Hair
and beards are a second surface over the first, which has an irregular edge; glasses, teeth and what
hides a part of the face are drawn into the picture.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from learning.photo.config import FitConfig
from learning.photo.model import ShapeModel, shape_model
from learning.points.raster import FAR, draw, lit, normals_of
from learning.render.view import scene_of
from lightstage.formats.mesh import vertex_normals
from lightstage.formats.template import Template
from processing.colour import srgb_from_linear

SIDE_PX = 216
"""Side of a drawn picture."""
SHADOW_PX, SHADOW_MM = 128, 360.0
"""Side of a lamp's depth buffer, and of what it holds."""
NEAREST_MM, FARTHEST_MM = 350.0, 2500.0
SHOWN_MM = 300.0
"""Side of what a picture shows at the face's distance, about."""
MOST_YAW_DEG = 45.0
OPENNESS_RAYS = 64
SIDES_MM = 6.0
"""Distance from the middle within which an expression's two sides blend."""


@dataclasses.dataclass(frozen=True)
class Drawn:
    """A picture of a face.

    Attributes:
        picture: (SIDE_PX, SIDE_PX, 3) uint8 sRGB.
        points_px: (n, 2) where it shows the template's vertices, hidden or not.
        facing: (n,) cosine between their normals and the direction to the camera.
    """

    picture: np.ndarray
    points_px: np.ndarray
    facing: np.ndarray


class Faces:
    """People of a template in some skins."""

    def __init__(self, template: Template, config: FitConfig, skins: list[np.ndarray]) -> None:
        """Skins are (rows, columns, 3) linear albedos in the template's texture."""
        self._model: ShapeModel = shape_model(template, config)
        mesh = template.mesh
        self._triangles = mesh.triangles().astype(np.int32)
        assert mesh.uvs is not None
        self._uvs = mesh.uvs[mesh.triangle_uvs()].astype(np.float32)
        self._skins = [np.ascontiguousarray(skin, np.float32) for skin in skins]
        mean = self._model.mean
        self._identity = self._model.identity.astype(np.float32)
        self._expression = self._model.expression.astype(np.float32)
        self._landmarks = template.landmarks
        self._open = _openness(template, mean)
        marks = mean[template.landmarks]
        self._brows_mm, self._chin_mm = float(marks[17:27, 1].mean()), float(marks[8, 1])
        self._nose_mm, self._mouth_mm = float(marks[33, 1]), float(marks[[48, 54], 1].mean())
        behind = marks[[0, 16], 2].mean()
        self._azimuth = np.degrees(np.arctan2(mean[:, 0], mean[:, 2] - behind))
        self._bare = np.zeros(len(mean), bool)
        for region in ("lips", "eyes"):
            self._bare[template.regions.get(region, np.zeros(0, int))] = True
        self._lids = np.isin(
            np.arange(len(mean)),
            np.flatnonzero(
                np.min([np.linalg.norm(mean - marks[i], axis=1) for i in range(36, 48)], axis=0) < 9
            ),
        )

    def drawn(self, rng: np.random.Generator) -> Drawn:
        """A random person, photographed at random."""
        own = self._vertices(rng)
        cover, height = self._hair(rng)
        normals = normals_of(own, self._triangles)
        # The second surface, of hair.
        over = own + height[:, None] * normals
        over[:, 1] -= 0.25 * height
        turn = self._turn(rng)
        away = float(np.exp(rng.uniform(np.log(NEAREST_MM), np.log(FARTHEST_MM))))
        middle = own[self._landmarks[30]] + np.array([0, 0, -30])
        shift = np.array([rng.normal(0, 12), rng.normal(0, 12), away])
        both = np.concatenate([own, over]).astype(np.float32)
        places = ((both - middle) @ turn.T + shift).astype(np.float32)
        focal = SIDE_PX * away / SHOWN_MM * rng.uniform(0.9, 1.25)
        image = places.copy()
        image[:, :2] = focal * places[:, :2] / np.maximum(places[:, 2:], 1) + SIDE_PX / 2
        hairy = (cover[self._triangles] > 0.3).any(axis=1)
        count = len(own)
        triangles = np.concatenate([self._triangles, self._triangles[hairy] + count])
        opacity = np.concatenate([np.ones(count), cover]).astype(np.float32)
        depth, face, share = _buffers(SIDE_PX)
        draw(image, triangles, opacity, depth, face, share)
        here = face >= 0
        all_normals = normals_of(places, triangles)
        albedo = self._albedo(rng, face, share, here, triangles, both, np.flatnonzero(hairy))
        lamps, colours, around = _lights(rng)
        frames, shadows = _shadows(lamps, places, triangles, opacity, turn, shift)
        gloss = np.full(2 * count, rng.uniform(0.0, 0.25), np.float32)
        gloss[count:] *= rng.uniform(0, 0.5)
        openness = np.concatenate([self._open, np.clip(self._open + 0.1, 0, 1)])
        openness[:count] *= 1 - 0.5 * np.clip(cover, 0, 1)
        matt, shine = lit(
            face, share, triangles, places, all_normals, openness.astype(np.float32), gloss,
            around, lamps, colours, frames, shadows, float(rng.uniform(6, 40)),
        )  # fmt: skip
        linear = matt * albedo + shine
        light = matt[here].mean(axis=0) if here.any() else np.ones(3)
        px_mm = focal / away
        marks = image[self._landmarks]
        inner = marks[60:68, :2]
        if np.linalg.norm(inner[2] - inner[6]) > 2.5 * px_mm and rng.random() < 0.7:
            _teeth(linear, inner, light * rng.uniform(0.25, 0.6) * np.array([1, 0.93, 0.8]), rng)
        level = float(linear[here].mean()) if here.any() else 1.0
        wanted = float(np.exp(rng.normal(np.log(0.17), 0.5)))
        linear *= wanted / max(level, 1e-4)
        background = _background(rng) * float(np.exp(rng.normal(np.log(0.15), 0.8)))
        linear = np.where(here[..., None], linear, background).astype(np.float32)
        if rng.random() < 0.2:
            self._glasses(linear, rng, places[self._landmarks], focal, depth)
        if rng.random() < 0.12:
            _occlude(linear, rng, marks[:, :2], wanted)
        toward = -places[:count] / np.linalg.norm(places[:count], axis=1, keepdims=True)
        facing = (all_normals[:count] * toward).sum(axis=1)
        return Drawn(_photographed(linear, rng), image[:count, :2].astype(float), facing)

    def _vertices(self, rng: np.random.Generator) -> np.ndarray:
        """(n, 3) float32 of a random person with a random expression."""
        identity = rng.normal(0, 1, len(self._identity)).astype(np.float32)
        own = self._model.mean.astype(np.float32) + np.tensordot(identity, self._identity, 1)
        # Mostly weak ones; of strong ones the two sides differ.
        strength = np.abs(rng.normal(0, 0.12, len(self._expression)))
        if rng.random() < 0.5:
            strong = rng.random(len(strength)) < 0.35
            strength = np.where(strong, rng.uniform(0.1, 1.2, len(strength)), strength)
        left = 1 / (1 + np.exp(-own[:, 0] / SIDES_MM))
        uneven = rng.normal(0, 0.2, len(strength))
        for each, power, more in zip(self._expression, strength, uneven, strict=True):
            own += ((power * (1 + more * (2 * left - 1)))[:, None] * each).astype(np.float32)
        return own

    def _turn(self, rng: np.random.Generator) -> np.ndarray:
        """(3, 3) from the head's axes to the camera's: x right, y down, z away."""
        yaw = rng.normal(0, 12) if rng.random() < 0.5 else rng.uniform(-1, 1) * MOST_YAW_DEG
        pitch, roll = rng.normal(0, 9), rng.normal(0, 7)
        turn = Rotation.from_euler("zxy", [roll, pitch, yaw], degrees=True).as_matrix()
        return np.asarray(np.diag([1.0, -1, -1]) @ turn)

    def _hair(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """(n,) share of hair over each vertex, and how far it stands off in mm."""
        mean = self._model.mean
        high, side = mean[:, 1], self._azimuth
        waves = _waves(rng, mean, 9, (6.0, 60.0))
        cover, height = np.zeros(len(mean), np.float32), np.zeros(len(mean), np.float32)
        if rng.random() < 0.75:
            front = self._brows_mm + (
                rng.uniform(-8, 30) if rng.random() < 0.35 else rng.uniform(35, 75)
            )
            ears = self._brows_mm - rng.uniform(0, 40)
            long = rng.random() < 0.4
            cheeks = self._chin_mm - rng.uniform(-40, 60) if long else ears
            neck = self._chin_mm - 60 if long else self._chin_mm + rng.uniform(-20, 40)
            temple = rng.uniform(32, 55)
            knots = [-180, -115, -rng.uniform(72, 95), -temple, 0, temple, rng.uniform(72, 95)]
            tops = [neck, cheeks, ears if not long else cheeks, front - rng.uniform(0, 20), front]
            lines = [*tops, front - rng.uniform(0, 20), tops[2], cheeks, neck]
            line = np.interp(side, [*knots, 115, 180], lines)
            if rng.random() < 0.4:  # combed to one side
                line += rng.uniform(-1, 1) * 0.35 * mean[:, 0] * (np.abs(side) < 50)
            ragged = rng.uniform(2, 10)
            above = high - line + ragged * waves
            thick = rng.uniform(2, 25)
            cover = np.clip(0.5 + above / 4, 0, 1)
            height = np.clip(1 + 0.5 * above, 0, thick) * (1 + 0.25 * waves)
        if rng.random() < 0.25:
            thick = float(np.exp(rng.uniform(np.log(1), np.log(18))))
            sides = self._mouth_mm + rng.uniform(-20, 12) + 0.35 * np.maximum(np.abs(side) - 30, 0)
            below = sides - high
            if rng.random() < 0.8:  # a moustache
                lip = np.minimum(self._nose_mm - 3 - high, 34 - np.abs(mean[:, 0]))
                below = np.maximum(below, np.minimum(lip, high - self._mouth_mm + 12))
            below += rng.uniform(1, 5) * waves
            beard = np.clip(0.5 + below / 4, 0, 1) * (mean[:, 2] > mean[:, 2].min() + 60)
            cover = np.maximum(cover, beard)
            height = np.maximum(height, np.clip(0.3 * below, 0, thick) * (beard > 0))
        cover[self._bare] = 0
        cover[self._lids] *= np.clip((high[self._lids] - self._brows_mm) / 5, 0, 1)
        return cover, height

    def _albedo(
        self,
        rng: np.random.Generator,
        face: np.ndarray,
        share: np.ndarray,
        here: np.ndarray,
        triangles: np.ndarray,
        places: np.ndarray,
        hairy: np.ndarray,
    ) -> np.ndarray:
        """(h, w, 3) float32 of skin and hair; zero where nothing is."""
        count = len(self._triangles)
        skin = self._skins[int(rng.integers(len(self._skins)))]
        number = face[here]
        is_hair = number >= count
        own = np.where(is_hair, 0, number)
        if len(hairy):
            own = np.where(is_hair, hairy[np.clip(number - count, 0, len(hairy) - 1)], number)
        second, third = (share[..., k][here][:, None] for k in range(2))
        first = 1 - second - third
        corners = self._uvs[own]
        uv = first * corners[:, 0] + second * corners[:, 1] + third * corners[:, 2]
        rows, columns = skin.shape[:2]
        texel = np.zeros((*face.shape, 2), np.float32)
        texel[here] = uv * [columns, -rows] + [-0.5, rows - 0.5]
        colour = cv2.remap(skin, texel[..., 0], texel[..., 1], cv2.INTER_LINEAR)[here]
        tint = np.exp(rng.normal(0, 0.15) + rng.normal(0, 0.06, 3))
        kinds = [(0.02, 0.016, 0.0145), (0.06, 0.034, 0.019), (0.26, 0.165, 0.08)]
        kinds += [(0.2, 0.07, 0.022), (0.35, 0.33, 0.31)]
        hair = np.array(kinds[int(rng.choice(5, p=[0.35, 0.3, 0.15, 0.08, 0.12]))])
        hair = hair * np.exp(rng.normal(0, 0.3))
        out = np.zeros((*face.shape, 3), np.float32)
        colour *= tint.astype(np.float32)
        at = places[triangles[number[is_hair], 0]]
        strands = np.exp(0.35 * _waves(rng, at, 6, (2.0, 12.0), along=0.15))
        colour[is_hair] = hair * strands[:, None]
        out[here] = colour
        return out

    def _glasses(
        self,
        linear: np.ndarray,
        rng: np.random.Generator,
        marks: np.ndarray,
        focal: float,
        depth: np.ndarray,
    ) -> None:
        """Draw glasses before the (68, 3) landmarks in the camera's axes."""
        eyes = [marks[36:42].mean(axis=0), marks[42:48].mean(axis=0)]
        across = eyes[1] - eyes[0]
        across = across / np.linalg.norm(across)
        down = marks[8] - marks[27]
        down = down - (down @ across) * across
        down = down / np.linalg.norm(down)
        ahead = np.cross(down, across)
        ahead *= -np.sign(ahead[2])
        wide, high = rng.uniform(20, 28), rng.uniform(14, 24)
        power, off = 2 / rng.uniform(2, 6), rng.uniform(9, 17)
        angle = np.linspace(0, 2 * np.pi, 40)
        cosine, sine = np.cos(angle), np.sin(angle)
        ring = [
            wide * np.sign(cosine) * np.abs(cosine) ** power,
            high * np.sign(sine) * np.abs(sine) ** power,
        ]
        colour = np.exp(rng.uniform(np.log(0.01), np.log(0.3))) * rng.uniform(0.6, 1.2, 3)
        thick = max(1, round(float(rng.uniform(0.8, 4.0)) * focal / marks[27, 2]))

        def seen(points: np.ndarray) -> np.ndarray:
            return np.asarray(focal * points[:, :2] / points[:, 2:] + SIDE_PX / 2)

        tinted = rng.random() < 0.25
        ends = []
        for eye, sign in zip(eyes, (-1, 1), strict=True):
            centre = eye + off * ahead + sign * rng.uniform(0, 3) * across + 2 * down
            rim = centre + ring[0][:, None] * across + ring[1][:, None] * down
            line = np.round(8 * seen(rim)).astype(np.int32)
            lens = np.zeros(linear.shape[:2], np.uint8)
            cv2.fillPoly(lens, [line], 1, shift=3)
            if tinted:
                linear[lens > 0] *= np.float32(0.2)
            elif rng.random() < 0.3:
                linear[lens > 0] += np.float32(rng.uniform(0, 0.08))
            cv2.polylines(linear, [line], True, colour.tolist(), thick, cv2.LINE_AA, 3)
            ends.append((centre - sign * wide * across, centre + sign * wide * across))
        bridge = np.round(8 * seen(np.array([ends[0][0], ends[1][0]]))).astype(np.int32)
        cv2.polylines(linear, [bridge], False, colour.tolist(), thick, cv2.LINE_AA, 3)
        for (_, outer), ear in zip(ends, (marks[0], marks[16]), strict=True):
            steps = np.linspace(0, 1, 24)[:, None]
            arm = outer + steps * (ear + 4 * (outer - ear) / np.linalg.norm(outer - ear) - outer)
            at = seen(arm)
            cell = np.clip(at.astype(int), 0, SIDE_PX - 1)
            free = arm[:, 2] < depth[cell[:, 1], cell[:, 0]] + 4
            for one, two in zip(
                np.flatnonzero(free[:-1]), np.flatnonzero(free[:-1]) + 1, strict=True
            ):
                piece = np.round(8 * at[[one, two]]).astype(np.int32)
                cv2.polylines(linear, [piece], False, colour.tolist(), thick, cv2.LINE_AA, 3)


def _openness(template: Template, mean: np.ndarray) -> np.ndarray:
    """(n,) share of the directions above its surface in which a vertex meets nothing."""
    import open3d

    normals = vertex_normals(mean, template.mesh.triangles())
    rng = np.random.default_rng(0)
    lines = rng.normal(0, 1, (OPENNESS_RAYS, 3))
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    scene = scene_of(template.mesh.with_vertices(mean))
    total, free = np.zeros(len(mean)), np.zeros(len(mean))
    for line in lines:
        cosine = np.maximum(normals @ line, 0)
        rays = np.concatenate([mean + 0.5 * normals, np.tile(line, (len(mean), 1))], axis=1)
        hidden = scene.test_occlusions(open3d.core.Tensor(rays.astype(np.float32))).numpy()
        total += cosine
        free += cosine * ~hidden
    return free / np.maximum(total, 1e-9)


def _buffers(side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    depth = np.full((side, side), FAR, np.float32)
    return depth, np.full((side, side), -1, np.int32), np.zeros((side, side, 2), np.float32)


def _waves(
    rng: np.random.Generator,
    at: np.ndarray,
    count: int,
    lengths_mm: tuple[float, float],
    along: float = 1.0,
) -> np.ndarray:
    """(n,) smooth noise of deviation about 1 at (n, 3) places; slower along y by `along`."""
    out, at = np.zeros(len(at), np.float32), at.astype(np.float32)
    low, high = (float(np.log(length)) for length in lengths_mm)
    for length in np.exp(rng.uniform(low, high, count)):
        line = rng.normal(0, 1, 3)
        line *= 2 * np.pi / (length * np.linalg.norm(line))
        line[1] *= along
        out += np.sin(at @ line.astype(np.float32) + np.float32(rng.uniform(0, 2 * np.pi)))
    return out * np.float32(np.sqrt(2 / count))


def _lights(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(l, 3) directions in the camera's axes, (l, 3) colours, (4, 3) light from everywhere."""
    count = int(rng.integers(1, 4))
    lamps = rng.normal(0, 1, (count, 3))
    # Mostly from the camera's side and from above.
    lamps[:, 2] = -np.abs(lamps[:, 2]) if rng.random() < 0.85 else lamps[:, 2]
    lamps[:, 1] -= 0.4
    lamps /= np.linalg.norm(lamps, axis=1, keepdims=True)
    colours = np.exp(rng.normal(0, 0.6, (count, 1)) + rng.normal(0, 0.12, (count, 3)))
    share = rng.uniform(0.1, 0.9)
    around = np.zeros((4, 3))
    around[0] = np.exp(rng.normal(0, 0.12, 3)) * colours.sum(axis=0).mean() * share / (1 - share)
    around[1:] = around[0] * rng.uniform(-0.5, 0.5, (3, 1)) * np.exp(rng.normal(0, 0.1, (3, 3)))
    around[2] -= 0.2 * around[0]
    return lamps.astype(np.float32), colours.astype(np.float32), around.astype(np.float32)


def _shadows(
    lamps: np.ndarray,
    places: np.ndarray,
    triangles: np.ndarray,
    opacity: np.ndarray,
    turn: np.ndarray,
    shift: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The lamps' frames and depth buffers, see `lit`."""
    frames = np.zeros((len(lamps), 3, 4), np.float32)
    shadows = np.empty((len(lamps), SHADOW_PX, SHADOW_PX), np.float32)
    scale = SHADOW_PX / SHADOW_MM
    centre = shift + turn @ np.array([0.0, 0.0, -60.0])
    for index, lamp in enumerate(lamps.astype(float)):
        aside = np.cross(lamp, [0.3, 1.0, 0.2])
        aside /= np.linalg.norm(aside)
        axes = np.stack([scale * aside, scale * np.cross(lamp, aside), -lamp])
        middle = np.array([SHADOW_PX / 2, SHADOW_PX / 2, 500.0])
        frames[index] = np.column_stack([axes, middle - axes @ centre])
        seen = places @ frames[index, :, :3].T + frames[index, :, 3]
        depth, face, share = _buffers(SHADOW_PX)
        draw(seen, triangles, opacity, depth, face, share)
        shadows[index] = depth
    return frames, shadows


def _background(rng: np.random.Generator) -> np.ndarray:
    """(SIDE_PX, SIDE_PX, 3) smooth or busy colours of about 1."""
    if rng.random() < 0.2:
        return np.full((SIDE_PX, SIDE_PX, 3), np.exp(rng.normal(0, 0.2, 3)), np.float32)
    out = np.zeros((SIDE_PX, SIDE_PX, 3), np.float32)
    for cells in (2, int(rng.integers(3, 9)), int(rng.integers(9, 60))):
        noise = rng.normal(0, rng.uniform(0, 0.6), (cells, cells, 1))
        noise = (noise + rng.normal(0, 0.15, (cells, cells, 3))).astype(np.float32)
        how = cv2.INTER_CUBIC if rng.random() < 0.6 else cv2.INTER_NEAREST
        out += cv2.resize(noise, (SIDE_PX, SIDE_PX), interpolation=how)
    return np.exp(np.clip(out, -3, 2))


def _teeth(
    linear: np.ndarray, inner: np.ndarray, colour: np.ndarray, rng: np.random.Generator
) -> None:
    """Fill a part of an open mouth, within its (8, 2) inner lip, by teeth."""
    upper, lower = inner[[0, 1, 2, 3, 4]], inner[[0, 7, 6, 5, 4]]
    share = rng.uniform(0.4, 1.0)
    edge = upper + share * (lower - upper)
    line = np.round(8 * np.concatenate([upper, edge[::-1]])).astype(np.int32)
    cv2.fillPoly(linear, [line], colour.tolist(), cv2.LINE_AA, 3)


def _occlude(linear: np.ndarray, rng: np.random.Generator, marks: np.ndarray, level: float) -> None:
    """Hide a part of the face by something like a hand, a scarf or a leaf."""
    centre = marks[int(rng.integers(len(marks)))] + rng.normal(0, 15, 2)
    angle = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(5, 12))))
    radius = rng.uniform(8, 40) * rng.uniform(0.4, 1.2, len(angle))
    line = centre + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    colour = level * np.exp(rng.normal(0, 0.7) + rng.normal(0, 0.2, 3))
    cv2.fillPoly(linear, [np.round(8 * line).astype(np.int32)], colour.tolist(), cv2.LINE_AA, 3)


def _photographed(linear: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """uint8 sRGB of a linear picture: blurred, noisy, balanced, compressed as cameras leave it."""
    blur_px = rng.uniform(0.4, 2.0) if rng.random() < 0.4 else 0.5
    linear = cv2.GaussianBlur(linear, (0, 0), float(blur_px))
    if rng.random() < 0.15:
        small = int(SIDE_PX * rng.uniform(0.25, 0.7))
        linear = cv2.resize(linear, (small, small), interpolation=cv2.INTER_AREA)
        linear = cv2.resize(linear, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_LINEAR)
    linear = linear * np.exp(rng.normal(0, 0.05, 3))
    noise = rng.uniform(0, 0.03) * rng.random()
    linear = linear + noise * np.sqrt(np.maximum(linear, 1e-4)) * rng.standard_normal(
        linear.shape, np.float32
    )
    if rng.random() < 0.05:
        linear = np.repeat(linear.mean(axis=2, keepdims=True), 3, axis=2)
    codes = (255 * srgb_from_linear(np.clip(linear, 0, 1)) + 0.5).astype(np.uint8)
    if rng.random() < 0.5:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(30, 95))]
        compressed = cv2.imencode(".jpg", codes, quality)[1]
        return np.asarray(cv2.imdecode(compressed, cv2.IMREAD_COLOR))
    return codes
