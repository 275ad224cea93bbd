"""What `evaluate` does: read pairs of folders, measure, write a table, return the facts."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from learning.bootstrap import Interval, interval
from learning.errors import MapsError
from learning.evaluation.dlib_recogniser import DlibRecogniser, installed
from learning.evaluation.measures import (
    albedo_measures,
    normal_measures,
    specular_measures,
)
from learning.evaluation.people import by_tone, spread
from learning.evaluation.portrait import portrait
from learning.evaluation.recogniser import COSINE, Recogniser, RecogniserRequest
from learning.export.source import maps_folder
from learning.maps import SHININESS, TRANSLUCENCY, TexturedHead, skin_maps_from
from learning.photo.command import FIT
from learning.relight import lit_texture, shadows_of
from learning.render.uv import UvRaster, rasterise
from lightstage.commands import ProgressCallback
from lightstage.commands.outputs import try_file
from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.formats.environment import LightSet
from lightstage.formats.files import read_json, without_nan, write_json, write_text
from lightstage.formats.mesh import Mesh, read_mesh
from lightstage.formats.processed import ProcessedFolder, read_map
from processing.colour import srgb_from_linear
from processing.dataset import read_head_pose
from processing.evaluation.maps import psnr_db
from processing.tones import ita_deg

SCHEMA = "lightstage.evaluation/1"
NEEDED = ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal")
RELIT_ROWS = 384
"""Rows at which heads are rendered under new lights."""
CAMERA_MM = np.array([0.0, 0.0, 1100.0])
NEW_LIGHTS = {
    "key": [(0.5, 0.45, 0.75, 0.9)],
    "split": [(1.0, 0.1, 0.15, 1.0)],
    "rim": [(-0.8, 0.3, -0.5, 1.0), (0.3, 0.2, 0.9, 0.2)],
}
"""Direction in the head frame and strength of the lamps of each light."""
PORTRAIT_LIGHT = "key"
"""Under which recognisers see a head."""
NEAREST_MM = 1000.0
AMBIENT = 0.08
NOT_MEASURED = "not measured"
LABELS = ("captured", "simulated")
OVER_PEOPLE, OVER_PHOTOGRAPHS = "over people", "over photographs of one person"
WHOLE = 0.999
"""Share of skin of a texel made of smaller ones from which on it is skin alone."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """Figures of one inferred folder beside its truth.

    Attributes:
        name: the inferred folder.
        person: folder of the true maps, resolved: one person's photographs have the same.
        figures: by name.
        ita_deg: typology angle, (found, true).
        faces: (2, d) embeddings of the inferred and of the true head; None without a recogniser,
            or without the true mesh where none was named.
    """

    name: str
    person: Path
    figures: dict[str, float]
    ita_deg: tuple[float, float]
    faces: np.ndarray | None


def evaluate_command(
    inferred: tuple[Path, ...],
    truth: tuple[Path, ...],
    label: str,
    out: Path | None,
    progress: ProgressCallback,
    recognise: RecogniserRequest | None = None,
) -> dict[str, Any]:
    """Measure inferred maps against captured ones, person by person; the facts.

    Args:
        inferred: folders of maps, such as `infer`, `fit` and `avatar` write.
        truth: processed folders or their atlases, one for each, or one for all of them. Folders
            with the same truth are of one person, who counts once; how far they agree is measured.
        label: whose truth it is, of `LABELS`.
        out: JSON to write; a table of the same name with .md is written beside it.
        progress: of the people.
        recognise: by which identity is measured; dlib's where None, if it is installed.

    Raises:
        LightstageError: bad input; nothing is written then.
    """
    began = time.monotonic()
    if label not in LABELS:
        raise ConfigError("--data", found=repr(label), expected=" or ".join(LABELS))
    if len(truth) not in (1, len(inferred)):
        raise ConfigError(
            "--truth",
            found=counted(len(truth), "folder"),
            expected=f"one for each of {counted(len(inferred), 'inferred folder')}, or one for all",
        )
    if out is not None:
        _require_replaceable(out)
    recogniser = installed() if recognise is None else Recogniser(recognise)
    true_of = truth * len(inferred) if len(truth) == 1 else truth
    pairs: list[Pair] = []
    albedos: dict[Path, list[np.ndarray]] = {}
    for done, (mine, theirs) in enumerate(zip(inferred, true_of, strict=True)):
        pair, albedo = _measured(mine, theirs, recogniser)
        pairs.append(pair)
        albedos.setdefault(pair.person, []).append(albedo)
        progress(done + 1, len(inferred))
    one = len(albedos) == 1
    names = sorted({name for pair in pairs for name in pair.figures})
    means = {name: _over_people(pairs, [p.figures.get(name) for p in pairs]) for name in names}
    if len(albedos) < len(pairs):
        each = [agreement(found) for found in albedos.values()]
        means["agreement_db"] = interval(each[0] if one else [_mean(values) for values in each])
    seen = recogniser is not None and all(pair.faces is not None for pair in pairs)
    if recogniser is not None and seen and not one:
        means[f"identity_others_{recogniser.measure}"] = _over_people(
            pairs, others(pairs, recogniser.measure)
        )
    true_deg = _by_person(pairs, [pair.ita_deg[1] for pair in pairs])
    off_deg = _by_person(pairs, [pair.figures["ita_error_deg"] for pair in pairs])
    tones = by_tone([*map(_mean, true_deg)], [*map(_mean, off_deg)])
    facts = {
        "data": label,
        "people": len(albedos),
        "photographs": len(pairs),
        "intervals": OVER_PHOTOGRAPHS if one and len(pairs) > 1 else OVER_PEOPLE,
        "figures": {name: dataclasses.asdict(value) for name, value in means.items()},
        "ita_error_deg": {tone: error for tone, (_, error) in tones.items()},
        "ita_worst_over_best": spread(tones),
        "each": [{"name": p.name, **p.figures} for p in pairs],
        "identity": f"by {recogniser.name}" if recogniser is not None and seen else NOT_MEASURED,
        "seconds": time.monotonic() - began,
    }
    if out is not None:
        write_text(out.with_suffix(".md"), table(facts, means))
        write_json(out, {"schema": SCHEMA, **without_nan(facts)})
    return facts


def _require_replaceable(out: Path) -> None:
    """Refuse a table's place that holds something else than the table of earlier figures there.

    Raises:
        LightstageError: a folder, a file that no evaluation wrote, or figures that are none.
    """
    beside = out.with_suffix(".md")
    try_file("--out", beside)
    if not beside.exists():
        return
    if not out.exists():
        raise MapsError(
            beside,
            field="--out",
            found="a file that no evaluation wrote",
            expected=f"none, as the table of {out.name} goes there",
            hint="Choose another --out.",
        )
    read_json(out, SCHEMA)


def _by_person(pairs: list[Pair], values: Sequence[float | None]) -> list[list[float]]:
    """Values of the pairs, by the person of whom they are; None is left out."""
    found: dict[Path, list[float]] = {pair.person: [] for pair in pairs}
    for pair, value in zip(pairs, values, strict=True):
        if value is not None:
            found[pair.person].append(value)
    return list(found.values())


def _over_people(pairs: list[Pair], values: Sequence[float | None]) -> Interval:
    """Mean and interval over people, each with the mean of their photographs.

    With one person they are over photographs.
    """
    each = _by_person(pairs, values)
    return interval(each[0] if len(each) == 1 else [_mean(own) for own in each])


def _mean(values: list[float]) -> float:
    """NaN where there is none."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")


def table(facts: dict[str, Any], means: dict[str, Interval]) -> str:
    """The figures as a Markdown table."""
    more = facts["photographs"] > facts["people"]
    photographs = f", {counted(facts['photographs'], 'photograph')}" if more else ""
    lines = [
        f"{facts['data']} truth, {counted(facts['people'], 'person', 'people')}{photographs}; "
        f"intervals of 95 % by bootstrap {facts['intervals']}.",
        "",
        "| figure | mean | 95 % |",
        "|---|---|---|",
    ]
    for name, value in means.items():
        range_ = "-" if np.isnan(value.low) else f"{value.low:.4g} to {value.high:.4g}"
        lines.append(f"| {name} | {value.mean:.4g} | {range_} |")
    for tone, error in facts["ita_error_deg"].items():
        lines.append(f"| skin colour, error of the typology angle, {tone} | {error:.1f} deg | - |")
    lines.append(f"| identity | {facts['identity']} | - |")
    return "\n".join(lines) + "\n"


def agreement(albedos: list[np.ndarray]) -> list[float]:
    """PSNR in dB between one person's albedos of several photographs, pair by pair.

    Args:
        albedos: (rows, columns, 3) linear each, 0 where nothing was found; compared as sRGB, at the
            size of the smaller one.
    """
    values = []
    for index, one in enumerate(albedos):
        for other in albedos[:index]:
            size = min(one.shape[:2], other.shape[:2])
            a, b = _resized(one, size), _resized(other, size)
            known = _known(one, size) & _known(other, size)
            if known.any():
                values.append(psnr_db(srgb_from_linear(a[known]), srgb_from_linear(b[known])))
    return values


def _known(albedo: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(rows, columns) bool at another size: texels that no texel without skin is part of."""
    return _resized(np.asarray((albedo > 0).all(axis=2)), size) > WHOLE


def alike(one: np.ndarray, other: np.ndarray, measure: str) -> float:
    """The cosine or the distance between two (d,) embeddings."""
    return float(one @ other if measure == COSINE else np.linalg.norm(one - other))


def others(pairs: list[Pair], measure: str) -> list[float]:
    """Of each pair, the mean `alike` of its true head and the true heads of other people."""
    true = [(pair.person, pair.faces[1]) for pair in pairs if pair.faces is not None]
    return [
        _mean([alike(mine, theirs, measure) for person, theirs in true if person != own])
        for own, mine in true
    ]


def _measured(
    inferred: Path, truth: Path, recogniser: Recogniser | DlibRecogniser | None
) -> tuple[Pair, np.ndarray]:
    """One pair's figures, and the found albedo."""
    mine, theirs = _maps(inferred), _maps(truth)
    pose = _pose(truth)
    theirs = _turned(theirs, pose)
    mine = _turned(mine, _pose(inferred, pose))
    size = mine["diffuse_albedo"].shape[:2]
    whole = theirs["diffuse_albedo"].shape[:2]
    if size[0] * whole[1] != size[1] * whole[0]:
        raise MapsError(
            inferred,
            found=f"{size[0]} x {size[1]} texels",
            expected=f"the shape of the truth's {whole[0]} x {whole[1]}",
            hint="Are both in one template's layout?",
        )
    captured = np.asarray((theirs["diffuse_albedo"] > 0).all(axis=2))
    skin = _resized(captured, size) > 0.5
    for name in ("confidence", "skin"):
        if name in theirs:
            skin &= _resized(theirs[name], size) > 0.5
    theirs = {name: _mean_where(theirs[name], captured, size) for name in NEEDED}
    if not skin.any():
        raise MapsError(
            truth,
            field="confidence",
            found="no skin",
            expected="texels whose confidence is over .5",
        )
    albedo = mine["diffuse_albedo"]
    figures = albedo_measures(albedo, theirs["diffuse_albedo"], skin)
    for name in ("diffuse_normal", "specular_normal"):
        figures |= normal_measures(name, mine[name], theirs[name], skin)
    figures |= specular_measures(mine["specular_albedo"], theirs["specular_albedo"], skin)
    relit, faces = _relit(mine, theirs, skin, truth, pose, recogniser)
    figures |= relit
    if faces is not None and recogniser is not None:
        figures[f"identity_{recogniser.measure}"] = alike(faces[0], faces[1], recogniser.measure)
    found_deg, true_deg = ita_deg(albedo[skin]), ita_deg(theirs["diffuse_albedo"][skin])
    figures["ita_error_deg"] = abs(found_deg - true_deg)
    person = maps_folder(truth).resolve()
    pair = Pair(str(inferred), person, figures, (found_deg, true_deg), faces)
    return pair, albedo * skin[..., None]


def _relit(
    mine: dict[str, np.ndarray],
    theirs: dict[str, np.ndarray],
    skin: np.ndarray,
    truth: Path,
    head_from_world: np.ndarray,
    recogniser: Recogniser | DlibRecogniser | None,
) -> tuple[dict[str, float], np.ndarray | None]:
    """Both maps rendered on the truth's mesh under lights that nobody used.

    Args:
        mine: found maps, normals in the head frame.
        theirs: true ones, the same.
        skin: (rows, columns) bool.
        truth: whose mesh is rendered.
        head_from_world: (3, 4) of this mesh.
        recogniser: or None.

    Returns:
        PSNR in dB by light, and (2, d) what a recogniser makes of both under `PORTRAIT_LIGHT`.
    """
    folder = ProcessedFolder(maps_folder(truth).parent)
    if not folder.registered_mesh.exists():
        if isinstance(recogniser, Recogniser):
            raise MapsError(
                folder.registered_mesh,
                found="no such file",
                expected="the truth's mesh, for --recogniser",
            )
        return {}, None
    mesh = read_mesh(folder.registered_mesh)
    mesh = mesh.with_vertices(mesh.vertices @ head_from_world[:, :3].T + head_from_world[:, 3])
    size = (RELIT_ROWS, RELIT_ROWS * skin.shape[1] // skin.shape[0])
    raster = rasterise(mesh, *size)
    # Lights are about the middle of the vertices, in the head's axes: the same for every head.
    centre = mesh.vertices.mean(axis=0)
    shown = (_resized(skin.astype(np.float32), size) > 0.5) & raster.covered
    heads = [_head(maps, skin, mesh, raster) for maps in (mine, theirs)]
    figures, faces = {}, None
    for name, lamps in NEW_LIGHTS.items():
        given = np.array(lamps)
        direction = given[:, :3] / np.linalg.norm(given[:, :3], axis=1, keepdims=True)
        light = LightSet(
            name,
            centre + NEAREST_MM * direction,
            np.repeat(given[:, 3:], 3, axis=1),
            np.full(3, AMBIENT),
        )
        seen = shadows_of(heads[0], light)
        textures = [lit_texture(head, light, centre + CAMERA_MM, None, seen) for head in heads]
        if shown.any():
            figures[f"relit_{name}_db"] = psnr_db(*(srgb_from_linear(t[shown]) for t in textures))
        if recogniser is not None and name == PORTRAIT_LIGHT:
            pictures = [
                portrait(t, raster.covered, mesh, np.eye(3, 4), recogniser.size) for t in textures
            ]
            faces = np.stack([recogniser.embedding(picture) for picture in pictures])
    return figures, faces


def _head(
    maps: dict[str, np.ndarray], shown: np.ndarray, mesh: Mesh, raster: UvRaster
) -> TexturedHead:
    """Maps on a mesh, at the size of the renderings, by means over what is shown."""
    size = raster.covered.shape
    small = {name: _mean_where(maps[name], shown, size) for name in NEEDED}
    normal = raster.normals(mesh)
    for name in ("diffuse_normal", "specular_normal"):
        missing = np.linalg.norm(small[name], axis=2, keepdims=True) < 0.5
        small[name] = np.where(missing, normal, small[name])
    small["position"] = raster.interpolate(mesh.vertices)
    ones = np.ones(size, np.float32)
    skin = skin_maps_from(small, raster.covered, SHININESS * ones, TRANSLUCENCY * ones)
    return TexturedHead(mesh, raster, skin, raster.covered)


def _pose(given: Path, other: np.ndarray | None = None) -> np.ndarray:
    """(3, 4) from the axes of a folder's normals to the head frame.

    Args:
        given: folder of maps.
        other: pose of maps that have none of their own, such as `infer` writes: they have the axes
            of the mesh that it was given. A fit's are in the head frame.
    """
    folder = ProcessedFolder(maps_folder(given).parent)
    if folder.head_pose.exists():
        return read_head_pose(folder.head_pose)
    if other is None or (folder.root / FIT).exists():
        return np.eye(3, 4)
    return other


def _turned(maps: dict[str, np.ndarray], pose: np.ndarray) -> dict[str, np.ndarray]:
    """Maps with their normals turned."""
    return {
        name: image @ pose[:, :3].T if name.endswith("_normal") else image
        for name, image in maps.items()
    }


def _maps(given: Path) -> dict[str, np.ndarray]:
    """The maps of a folder: those that are needed, confidence and skin where there are."""
    folder = maps_folder(given)
    missing = [name for name in NEEDED if not (folder / f"{name}.exr").exists()]
    if missing:
        raise MapsError(folder, field=f"{missing[0]}.exr", found="no such map", expected="a map")
    names = [n for n in (*NEEDED, "confidence", "skin") if (folder / f"{n}.exr").exists()]
    maps = {name: read_map(folder / f"{name}.exr", name) for name in names}
    shape = maps["diffuse_albedo"].shape[:2]
    for name, image in maps.items():
        if image.shape[:2] != shape:
            raise MapsError(
                folder / f"{name}.exr",
                found=f"{image.shape[0]} x {image.shape[1]} texels",
                expected=f"{shape[0]} x {shape[1]}, as diffuse_albedo",
            )
        if not np.isfinite(image).all():
            raise MapsError(folder / f"{name}.exr", found="NaN", expected="finite numbers")
    return maps


def _resized(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(rows, columns[, c]) at another size of the same shape."""
    if image.shape[:2] == size:
        return image.astype(np.float32)
    way = cv2.INTER_AREA if image.shape[0] > size[0] else cv2.INTER_LINEAR
    return cv2.resize(image.astype(np.float32), size[::-1], interpolation=way)


def _mean_where(image: np.ndarray, where: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """`_resized` by means over some texels alone; over all of them where none of these is near.

    A map holds zeros where nothing was captured, which are no part of the skin beside them.

    Args:
        image: (rows, columns[, c]).
        where: (rows, columns) bool.
        size: new rows and columns.
    """
    if image.shape[:2] == size:
        return image.astype(np.float32)
    mask = where if image.ndim == 2 else where[..., None]
    share = _resized(where, size)
    share = share if image.ndim == 2 else share[..., None]
    plain, own = _resized(image, size), _resized(image * mask, size)
    return np.divide(own, share, out=plain, where=share > 0)
