"""Inference with a whole-face network: albedo at a texture's own size; normals are the mesh's."""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from learning.devices import CPU
from learning.encoding import shrink
from learning.errors import MapsError
from learning.infer import DISAGREEMENT, Inferred
from learning.infer_checks import (
    UNSEEN,
    look_through,
    require_aspect,
    require_head,
    require_size,
    require_upright,
)
from learning.maps import to_batch
from learning.mesostructure.infer import TrainedMesostructure
from learning.networks.whole_face import WholeFaceNetwork, face_input
from learning.render.shading import unit
from learning.render.uv import UvRaster, rasterise
from learning.whole.closed_eyes import closed_eyes
from learning.whole.detail import enlarged, with_detail
from learning.whole.expected import expected_error, expected_of_refined
from learning.whole.refine import (
    CAMERA_MM,
    LARGEST_MISFIT,
    OF_TRUE_SHAPES,
    Answer,
    OwnSkin,
    Refined,
    refine,
)
from learning.whole.sides import answer_of
from learning.whole.specular_detail import specular_detail
from learning.whole.texture_layout import FARTHEST_MM, apart_mm, brows_to_lips, known_of_both
from lightstage.counting import counted
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import Mesh

CLOSED_EYES = "the eyes show no whites, so the network is not shown them; its tone is less certain"
LEAST_TEXELS = 100
"""A head has about 4,000 at the network's size."""
OTHER_LAYOUT = (
    "Is the mesh another template's, or its --head-pose another head's? Register the head to the "
    "template of the training, or carry its texture there by `lightstage-processing template "
    "transfer`."
)


def infer_whole_face(
    network: WholeFaceNetwork,
    texture: np.ndarray,
    mesh: Mesh,
    head_from_mesh: np.ndarray | None = None,
    named: tuple[str | Path, str | Path] = ("texture", "mesh"),
    shares: list[float] | None = None,
    refine_seconds: float = 0.0,
    device: torch.device = CPU,
    mesostructure: TrainedMesostructure | None = None,
    camera_mm: np.ndarray | None = None,
    largest_misfit: float = LARGEST_MISFIT,
    network_sees: np.ndarray | None = None,
    own: OwnSkin = OF_TRUE_SHAPES,
) -> Inferred:
    """Infer a texture's reflectance.

    Args:
        network: in evaluation mode.
        texture: (rows, columns, 3) linear, with light and shadow in it, of any size that is not
            smaller than what the network sees.
        mesh: with the texture's UV, which must be that of the people trained on.
        head_from_mesh: (3, 4) from the mesh's axes to the head frame, mm. Where None, the mesh is
            aligned rigidly with the mean person of those trained on, texel by texel.
        named: the texture's and the mesh's names in errors.
        shares: of each band of the texture's detail, 0..1; the network's own where None.
        refine_seconds: time to find the texture's light and refine the answer by it (see
            `learning.whole.refine`); 0 for the network's answer.
        device: where the network runs, as a copy; all else is the processor's.
        mesostructure: with refinement, finds pores and folds.
        camera_mm: (3,) from where the texture was photographed, in the mesh's axes; from in front
            of the face where None.
        largest_misfit: of a light that is taken for the texture's; a shape that is only near
            leaves more than a true one.
        network_sees: (rows, columns) bool, texels that the network is shown, which decide the
            light and the tone; all that are photographed where None. A texture of which these are
            stated is not examined for rows in reverse order and closed eyes.
        own: with refinement, what of the texture is the skin's own.

    Returns:
        Maps of the texture's size in the mesh's axes; zero where no surface is. Normals are the
        mesh's own, and where `mesostructure` found pores and folds, with these. Confidence
        follows from the error that is expected (a half at an error of `DISAGREEMENT` in sRGB; see
        `learning.whole.expected`); it is 0 where the texture is black.

    Raises:
        MapsError: a texture too small, black or badly exposed; a mesh that is flat, not of a head's
            size in mm, or in another layout than those trained on.
    """
    rows, columns = texture.shape[:2]
    output = run_network(network, texture, mesh, head_from_mesh, named, device, network_sees)
    answer, head_from_mesh, notes = output.answer, output.head_from_mesh, list(output.notes)
    raster, photographed = output.raster, output.photographed
    covered = raster.covered
    normal = raster.normals(mesh).astype(np.float32)
    log_albedo, low_specular = answer.log_albedo, answer.specular
    refined: Refined | None = None
    if refine_seconds > 0:
        placed = mesh.vertices @ head_from_mesh[:, :3].T + head_from_mesh[:, 3]
        head = dataclasses.replace(mesh, vertices=placed)
        viewed = CAMERA_MM
        if camera_mm is not None:
            viewed = head_from_mesh[:, :3] @ camera_mm + head_from_mesh[:, 3]
        asked = (texture, photographed, head, raster, refine_seconds, mesostructure, viewed)
        found = refine(network, answer, *asked, largest_misfit, own)
        if isinstance(found, str):
            notes = [*notes, f"{named[0]} was not refined, the network's answer is used: {found}"]
        else:
            refined = found
            if not found.settled:
                notes = [
                    *notes,
                    f"{named[0]}: the search for the light was ended after {refine_seconds:g} s "
                    "and may change with more time (--refine)",
                ]
            if mesostructure is not None and found.normals is None:
                notes = [
                    *notes,
                    f"{named[0]} has {counted(rows, 'row')}, too few for pores and folds, which "
                    f"need {mesostructure.least_rows}: normals are the mesh's",
                ]
    light = None if refined is None else in_mesh_axes(refined.light, head_from_mesh)
    if refined is None:
        if shares is None:
            shares = network.detail_shares.tolist()
        diffuse = with_detail(log_albedo, texture, photographed, answer.texture, shares)
    else:
        diffuse = refined.diffuse_albedo
    specular = np.exp(enlarged(np.log(low_specular), rows, columns))
    if refined is not None:
        specular = specular * specular_detail(diffuse, covered)
    error = expected_error(output.deviation, (rows, columns))
    if refined is not None:
        error = expected_of_refined(error, diffuse, log_albedo, refined.known)
    normals = (normal, normal)
    if refined is not None and refined.normals is not None:
        normals = tuple(turned @ head_from_mesh[:, :3] for turned in refined.normals)
    maps = {
        "diffuse_albedo": diffuse * covered[..., None],
        "specular_albedo": specular * covered,
        "diffuse_normal": normals[0],
        "specular_normal": normals[1],
        "confidence": photographed * _trust(error),
    }
    share = None if refined is None else refined.detail_share
    maps = {name: image.astype(np.float32) for name, image in maps.items()}
    return Inferred(maps, 1, tuple(notes), light, share)


@dataclasses.dataclass(frozen=True)
class NetworkAnswer:
    """A network's input texture and its output.

    Attributes:
        answer: both at the network's size.
        deviation: (h, w) error that it expects of the encoded albedo.
        raster: the texture's.
        photographed: (rows, columns) bool, texels of the surface that are not black.
        head_from_mesh: (3, 4) from the mesh's axes to the head frame, mm.
        notes: what looks wrong in the texture.
    """

    answer: Answer
    deviation: np.ndarray
    raster: UvRaster
    photographed: np.ndarray
    head_from_mesh: np.ndarray
    notes: tuple[str, ...]


def run_network(
    network: WholeFaceNetwork,
    texture: np.ndarray,
    mesh: Mesh,
    head_from_mesh: np.ndarray | None,
    named: tuple[str | Path, str | Path],
    device: torch.device = CPU,
    network_sees: np.ndarray | None = None,
) -> NetworkAnswer:
    """Run a network on a texture; arguments and errors as of `infer_whole_face`."""
    rows, columns = texture.shape[:2]
    size = network.config
    if rows < size.rows or columns < size.columns:
        raise MapsError(
            named[0],
            found=f"{rows} x {columns} texels",
            expected=f"at least {size.rows} x {size.columns}, which the network sees",
        )
    require_size(rows, columns, named[0])
    require_aspect(rows, columns, (size.rows, size.columns), named[0])
    require_head(mesh, named[1])
    raster = rasterise(mesh, rows, columns)
    covered = raster.covered
    notes = look_through(texture, covered, named[0])
    normal = raster.normals(mesh).astype(np.float32)
    shape = (size.rows, size.columns)
    low_position = _mean_over(to_batch(raster.interpolate(mesh.vertices)), to_batch(covered), shape)
    head_from_mesh, low_position = _placed(network, low_position, head_from_mesh, named[1])
    if network_sees is None:
        _require_layout(network, low_position, named[1])
    photographed = covered & (texture.max(axis=2) > UNSEEN)
    seen = to_batch(photographed if network_sees is None else photographed & network_sees)
    small = _mean_over(to_batch(texture), seen, shape)
    shown = (shrink(seen, shape) > 0.5).float()
    if network_sees is None:
        # Else the caller made the texture, and knows its rows: half a face may look like anything.
        front = brows_to_lips(network.mean_position_mm)
        require_upright(_image(small), _image(network.mean_log_albedo * front), named[0])
        parts = (small, shown, network.mean_log_albedo, front)
        texels, known, mean, face = (_image(part) for part in parts)
        closed = closed_eyes(texels, known[..., 0] > 0, mean, face[..., 0])
        if closed.any():
            shown = shown * to_batch(~closed)
            notes = [*notes, CLOSED_EYES]
    low_normal = _turned(unit(shrink(to_batch(normal), shape)), head_from_mesh)
    given = face_input(small * shown, low_normal, low_position, shown)
    there = network if device == CPU else copy.deepcopy(network).to(device)
    output = answer_of(there, given)
    deviation = _image(output.deviation)[..., 0]
    answer = Answer(
        _image(small),
        _image(shown)[..., 0] > 0,
        _image(output.diffuse_albedo.log()),
        np.exp(_image(output.specular_albedo.log())[..., 0]),
        _trust(deviation),
    )
    return NetworkAnswer(answer, deviation, raster, photographed, head_from_mesh, tuple(notes))


def in_mesh_axes(light: LightSet, head_from_mesh: np.ndarray) -> LightSet:
    """A light of the head frame for a mesh in its own axes, by its (3, 4) pose `head_from_mesh`."""
    rotation, offset_mm = head_from_mesh[:, :3], head_from_mesh[:, 3]
    place = np.linalg.solve(rotation, (light.position_mm - offset_mm).T).T
    # Strength is that at the origin, and falls off with the square of the distance from there.
    nearer = (light.position_mm**2).sum(axis=1) / np.maximum((place**2).sum(axis=1), 1e-9)
    return dataclasses.replace(light, position_mm=place, rgb=light.rgb * nearer[:, None])


def _trust(error: np.ndarray) -> np.ndarray:
    """0..1, a half where an error of `DISAGREEMENT` is expected."""
    found: np.ndarray = 1 / (1 + (error / DISAGREEMENT) ** 2)
    return found


def _placed(
    network: WholeFaceNetwork,
    position_mm: Tensor,
    head_from_mesh: np.ndarray | None,
    where: str | Path,
) -> tuple[np.ndarray, Tensor]:
    """The mesh's pose, found where it is None, and (1, 3, h, w) positions in the head frame."""
    known = _both_known(network, position_mm, where)
    if head_from_mesh is None:
        head_from_mesh = _aligned(network, position_mm, known)
    offset_mm = torch.from_numpy(head_from_mesh[:, 3]).float()[:, None, None]
    here = (position_mm != 0).any(dim=1, keepdim=True)
    placed = (_turned(position_mm, head_from_mesh) + offset_mm) * here
    return head_from_mesh, placed


def _both_known(network: WholeFaceNetwork, position_mm: Tensor, where: str | Path) -> Tensor:
    """(h, w) bool, texels of which both this head's and the mean person's positions are known."""
    known = known_of_both(position_mm, network.mean_position_mm)
    if known.sum() < LEAST_TEXELS:
        raise MapsError(
            where,
            field="uv",
            found=f"{counted(int(known.sum()), 'texel')} of the network's in common with "
            "those trained on",
            expected=f"at least {LEAST_TEXELS}",
            hint=OTHER_LAYOUT,
        )
    return known


def _aligned(network: WholeFaceNetwork, position_mm: Tensor, known: Tensor) -> np.ndarray:
    """(3, 4) least-squares rigid motion of a head's texels onto the mean person's [Umeyama1991]."""
    mine = position_mm[0][:, known].T.double().numpy()
    mean = network.mean_position_mm[0][:, known].T.double().numpy()
    rotation, _ = Rotation.align_vectors(mean - mean.mean(axis=0), mine - mine.mean(axis=0))
    offset_mm = mean.mean(axis=0) - rotation.apply(mine.mean(axis=0))
    return np.column_stack([rotation.as_matrix(), offset_mm])


def _require_layout(network: WholeFaceNetwork, position_mm: Tensor, where: str | Path) -> None:
    """MapsError where the same texel is at quite another place of the head."""
    distance = apart_mm(position_mm, network.mean_position_mm)
    if not distance <= FARTHEST_MM:
        raise MapsError(
            where,
            field="uv",
            found=f"texels {distance:.0f} mm from where the people trained on have them",
            expected=f"at most {FARTHEST_MM:g} mm in the mean",
            hint=OTHER_LAYOUT,
        )


def _turned(vectors: Tensor, head_from_mesh: np.ndarray) -> Tensor:
    """(1, 3, h, w) vectors under the rotation of a pose."""
    return torch.einsum("ij,bjhw->bihw", torch.from_numpy(head_from_mesh[:, :3]).float(), vectors)


def _mean_over(image: Tensor, known: Tensor, size: tuple[int, int]) -> Tensor:
    """Mean of (1, c, h, w) over the known texels of each larger one; 0 where most are not."""
    weight = shrink(known, size)
    return shrink(image * known, size) / weight.clamp_min(1e-3) * (weight > 0.5)


def _image(values: Tensor) -> np.ndarray:
    """(1, c, h, w) to (h, w, c)."""
    return np.ascontiguousarray(values[0].permute(1, 2, 0).numpy())
