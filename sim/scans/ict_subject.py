"""A person of ICT Face Model Light, with our skin on it, sitting in the stage."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from lightstage.formats.mesh import vertex_normals
from sim.errors import SimError
from sim.head.modes import EXPRESSIONS
from sim.light.texture import raster_uv, texture_of
from sim.people.person import require_rows, sitting
from sim.people.subject import Subject
from sim.people.traits import Traits, random_traits
from sim.scans.ict import SOURCE, IctModel, load_ict
from sim.scans.ict_match import head_from_ict, own_grid_uv_of
from sim.scans.ict_paint import paint_inner_parts
from sim.scans.ict_tile import FACE, LEFT_EYE, RIGHT_EYE, parts_of
from sim.skin.normals import bend_normals
from sim.skin.paint import face_from, make_skin, random_complexion

LARGEST_DRAW = 2.0
"""Standard deviations at which a draw is cut off, as the parametric head's are."""
SEAM_MM = 8.0

# Our expressions as blends of the model's shapes; _L and _R together where the name has no side.
BLENDS: dict[str, dict[str, float]] = {
    "smile": {"mouthSmile": 0.85, "cheekSquint": 0.5, "eyeSquint": 0.25},
    "jaw_open": {"jawOpen": 0.55},
    "brow_raise": {"browInnerUp": 0.9, "browOuterUp": 0.9, "eyeWide": 0.4},
    "brow_furrow": {"browDown": 1.0, "noseSneer": 0.3, "eyeSquint": 0.4},
    "pucker": {"mouthPucker": 0.9, "mouthFunnel": 0.15},
    "eyes_closed": {"eyeBlink": 1.0},
}
CLOSING = "eyeBlink"
WIDER_RANGE = (0.7, 1.6)
LID_MM = (0.2, 1.5)
"""How far above the eyeball a lid's margin and its outer skin stay at least."""
LEAST_MOVE_MM = 0.8
# iBUG's upper and lower lid points of the right and the left eye.
_LID_PAIRS = (((37, 41), (38, 40)), ((43, 47), (44, 46)))


@dataclasses.dataclass(frozen=True)
class _Draws:
    """All that a person's seed decides but the skin."""

    identity: np.ndarray
    turn: np.ndarray
    shift_mm: np.ndarray
    traits: Traits


def ict_subject(
    name: str,
    path: Path,
    seed: int,
    expression: str = "neutral",
    texture_rows: int = 1536,
    traits: Traits | None = None,
) -> Subject:
    """A person drawn from the model.

    Identity coefficients are independent standard normal draws, as the model's makers sample them,
    cut off at two deviations; skin, traits and pose have their own streams of the seed. Sex and age
    of the traits show in the skin alone: the model's modes do not name them.

    Args:
        name: pseudonym.
        path: the model, see `sim.scans.ict.load_ict`.
        seed: chooses the person.
        expression: ``neutral`` or one of `sim.head.modes.EXPRESSIONS`.
        texture_rows: rows of the maps, a multiple of 3 of at least 96; columns are two thirds.
        traits: who the person is; None draws it from the seed.

    Raises:
        SimError: see `load_ict`; an unknown expression, one whose shapes the copy lacks, or a size
            that the tile cannot have.
    """
    require_rows(texture_rows, f"subject {name}, texture_rows")
    model = load_ict(path)
    parts = parts_of(model)
    drawn = _draw(seed, len(model.identity), traits)
    person = model.mesh.vertices.copy()
    for weight, mode in zip(drawn.identity, model.identity, strict=True):
        person += weight * mode
    motion = head_from_ict(person, model)
    neutral = person @ motion[:, :3].T + motion[:, 3]
    moved = over_eyeballs(person + blend(model, expression, person), person, model)
    moved = moved @ motion[:, :3].T + motion[:, 3]
    shift = drawn.shift_mm
    world = moved @ drawn.turn.T + shift
    mesh = parts.mesh(world[parts.vertices])
    resting = parts.mesh(neutral[parts.vertices])

    face, weights = raster_uv(mesh, texture_rows, texture_rows * 2 // 3)
    triangles = mesh.triangles()
    own_grid_uv, on_skin = own_grid_uv_of(model, texture_rows)
    positions = texture_of(resting.vertices, triangles, face, weights)
    rng = np.random.default_rng([seed, 1])
    complexion = random_complexion(rng, drawn.traits)
    painted = face_from(positions, own_grid_uv, on_skin, int(rng.integers(2**20)))
    skin = make_skin(complexion, painted, rng)
    inner = paint_inner_parts(skin, positions, face, parts, resting, complexion)
    height = np.where(on_skin, skin.height_mm(expression), 0).astype(np.float32)
    smooth = texture_of(vertex_normals(mesh.vertices, triangles), triangles, face, weights)
    placed = texture_of(mesh.vertices, triangles, face, weights)
    return Subject(
        name=name,
        expression=expression,
        mesh=mesh,
        diffuse_albedo=inner.diffuse_albedo,
        specular_albedo=inner.specular_albedo,
        roughness=inner.roughness,
        normal=bend_normals(placed, smooth, height, face >= 0, SEAM_MM),
        translucency=inner.translucency,
        landmarks_mm=world[model.landmarks],
        skin=skin.skin & on_skin,
        head_from_world=np.concatenate([drawn.turn.T, -(drawn.turn.T @ shift)[:, None]], axis=1),
        source=SOURCE,
        distribution=skin.distribution,
        anisotropy=skin.anisotropy,
        synthetic=True,
    )


def blend(model: IctModel, expression: str, person: np.ndarray | None = None) -> np.ndarray:
    """Displacement of an expression.

    Args:
        model: the model.
        expression: ``neutral`` or one of `BLENDS`.
        person: (n, 3) mm the neutral face it is for: wide eyes close as far as narrow ones. None
            for the mean face.

    Returns:
        (n, 3) mm for all the model's vertices.

    Raises:
        SimError: an unknown expression, or one whose shapes the copy lacks.
    """
    out = np.zeros_like(model.mesh.vertices)
    if expression == "neutral":
        return out
    if expression not in BLENDS:
        raise SimError(
            "subject ict",
            field="expression",
            found=repr(expression),
            expected="neutral, " + ", ".join(EXPRESSIONS),
        )
    missing = []
    for name, strength in BLENDS[expression].items():
        sides = [name] if name in model.expression else [f"{name}_L", f"{name}_R"]
        for side in sides:
            if side in model.expression:
                wider = 1.0
                if name == CLOSING and person is not None:
                    wider = _lids_apart(person, model, side) / _lids_apart(
                        model.mesh.vertices, model, side
                    )
                out += np.clip(wider, *WIDER_RANGE) * strength * model.expression[side]
            else:
                missing.append(side)
    if missing:
        raise SimError(
            model.where,
            field=f"expression {expression}",
            found=f"no {', '.join(missing)}",
            expected="the whole model's expression shapes",
            hint="Is the clone complete (Git LFS files fetched)?",
        )
    return out


def _lids_apart(vertices: np.ndarray, model: IctModel, shape: str) -> float:
    """How much of a lid-closing shape brings a face's lids together, at the eye that it closes."""
    move = model.expression[shape][model.landmarks]
    marks = vertices[model.landmarks]
    pairs = max(_LID_PAIRS, key=lambda eye: float(np.abs(move[[up for up, _ in eye]]).sum()))
    gap = np.array([marks[low] - marks[up] for up, low in pairs])
    closing = np.array([move[up] - move[low] for up, low in pairs])
    return float((gap * closing).sum() / (closing**2).sum())


def over_eyeballs(vertices: np.ndarray, neutral: np.ndarray, model: IctModel) -> np.ndarray:
    """Lids that an expression moves kept outside of the eyeballs, as they slide over the cornea.

    The model's shapes are straight lines, so that a lid would cut through a bulging eye.

    Args:
        vertices: (n, 3) mm all the model's vertices with the expression.
        neutral: (n, 3) without it.
        model: where the eyeballs are.

    Returns:
        (n, 3) mm.
    """
    parts = parts_of(model)
    skin = parts.faces[parts.part == FACE]
    skin = parts.vertices[np.unique(skin[skin >= 0])]
    skin = skin[np.linalg.norm(vertices[skin] - neutral[skin], axis=1) > LEAST_MOVE_MM]
    out = vertices.copy()
    for eye in (LEFT_EYE, RIGHT_EYE):
        corners = parts.faces[parts.part == eye]
        ball = parts.vertices[np.unique(corners[corners >= 0])]
        away, distance, radius = _from_ball(vertices[skin], vertices[ball])
        near = (distance < radius + LID_MM[1]) & (away[:, 2] > 0)
        _, rest, rest_radius = _from_ball(neutral[skin], neutral[ball])
        # The lid's margin stays below its outer skin, or the two would cut through each other.
        least = radius + np.clip(rest - rest_radius, *LID_MM)
        pushed = away * np.maximum(0.0, least / distance - 1.0)[:, None]
        out[skin[near]] += pushed[near]
    return out


def _from_ball(points: np.ndarray, ball: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """From an eyeball's middle to points: (n, 3), its length, and the ball's radius that way."""
    centre = (ball.min(axis=0) + ball.max(axis=0)) / 2
    away, out = points - centre, ball - centre
    distance, radius = np.linalg.norm(away, axis=1), np.linalg.norm(out, axis=1)
    tree = cKDTree(out / radius[:, None])
    nearest = np.asarray(tree.query(away / distance[:, None], k=3)[1])
    return away, distance, radius[nearest].max(axis=1)


def _draw(seed: int, count: int, traits: Traits | None) -> _Draws:
    identity_rng, pose_rng, traits_rng = (np.random.default_rng([seed, k]) for k in (0, 2, 3))
    turn, shift = sitting(pose_rng)
    return _Draws(
        np.clip(identity_rng.normal(size=count), -LARGEST_DRAW, LARGEST_DRAW),
        turn,
        shift,
        random_traits(traits_rng) if traits is None else traits,
    )
