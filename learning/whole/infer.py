"""Inference with a whole-face network: albedo at a texture's own size; normals are the mesh's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from learning.encoding import shrink
from learning.errors import MapsError
from learning.infer import DISAGREEMENT, Inferred
from learning.infer_checks import UNSEEN, look_through, require_head, require_size
from learning.maps import to_batch
from learning.networks.whole_face import WholeFaceNetwork, face_input
from learning.render.shading import unit
from learning.render.uv import rasterise
from learning.whole.detail import enlarged, with_detail
from lightstage.formats.mesh import Mesh

FARTHEST_MM = 40.0
"""Mean distance of a head's texels from those of the mean person; own people have about 10."""


def infer_whole_face(
    network: WholeFaceNetwork,
    texture: np.ndarray,
    mesh: Mesh,
    head_from_mesh: np.ndarray,
    named: tuple[str | Path, str | Path] = ("texture", "mesh"),
    shares: list[float] | None = None,
) -> Inferred:
    """Infer a texture's reflectance.

    Args:
        network: in evaluation mode.
        texture: (rows, columns, 3) linear, with light and shadow in it, of any size that is not
            smaller than what the network sees.
        mesh: with the texture's UV, which must be that of the people trained on.
        head_from_mesh: (3, 4) from the mesh's axes to the head frame, mm.
        named: the texture's and the mesh's names in errors.
        shares: of each band of the texture's detail, 0..1; the network's own where None.

    Returns:
        Maps of the texture's size in the mesh's axes; zero where no surface is. Both normals are
        the mesh's own: what this network knows of finer ones is nothing. Confidence follows from
        the error that the network expects (a half at an error of `DISAGREEMENT` in sRGB); it is 0
        where the texture is black.

    Raises:
        MapsError: a texture too small, black or badly exposed; a mesh that is flat, not of a head's
            size in mm, or laid out otherwise than those trained on.
    """
    rows, columns = texture.shape[:2]
    size = network.config
    if rows < size.rows or columns < size.columns:
        raise MapsError(
            named[0],
            found=f"{rows} x {columns} texels",
            expected=f"at least {size.rows} x {size.columns}, which the network sees",
        )
    require_size(rows, columns, named[0])
    require_head(mesh, named[1])
    raster = rasterise(mesh, rows, columns)
    covered = raster.covered
    notes = look_through(texture, covered, named[0])
    position = raster.interpolate(mesh.vertices) @ head_from_mesh[:, :3].T + head_from_mesh[:, 3]
    normal = raster.normals(mesh).astype(np.float32)
    shape = (size.rows, size.columns)
    low_position = _mean_over(to_batch(position), to_batch(covered), shape)
    _require_layout(network, low_position, named[1])
    photographed = covered & (texture.max(axis=2) > UNSEEN)
    seen = to_batch(photographed)
    small = _mean_over(to_batch(texture), seen, shape)
    low_normal = unit(shrink(to_batch(normal @ head_from_mesh[:, :3].T), shape))
    shown = (shrink(seen, shape) > 0.5).float()
    with torch.inference_mode():
        said = network(face_input(small * shown, low_normal, low_position, shown))
    diffuse = with_detail(
        _image(said.diffuse_albedo.log()),
        texture,
        photographed,
        _image(small),
        network.detail_shares.tolist() if shares is None else shares,
    )
    specular = np.exp(enlarged(_image(said.specular_albedo.log())[..., 0], rows, columns))
    deviation = enlarged(_image(said.deviation)[..., 0], rows, columns)
    maps = {
        "diffuse_albedo": diffuse * covered[..., None],
        "specular_albedo": specular * covered,
        "diffuse_normal": normal,
        "specular_normal": normal,
        "confidence": photographed / (1 + (deviation / DISAGREEMENT) ** 2),
    }
    return Inferred({n: m.astype(np.float32) for n, m in maps.items()}, 1, tuple(notes))


def _require_layout(network: WholeFaceNetwork, position_mm: Tensor, where: str | Path) -> None:
    """MapsError where the same texel lies at quite another place of the head."""
    known = network.mean_position_mm
    both = (position_mm != 0).any(dim=1) & (known != 0).any(dim=1)
    apart = (position_mm - known).norm(dim=1)[both]
    distance = float(apart.mean()) if len(apart) else np.inf
    if not distance <= FARTHEST_MM:
        raise MapsError(
            where,
            field="uv",
            found=f"texels {distance:.0f} mm from where the people trained on have them",
            expected=f"at most {FARTHEST_MM:g} mm in the mean",
            hint="Is the mesh another template's, or in world axes? Register the head to the "
            "template of the training, and name its --head-pose.",
        )


def _mean_over(image: Tensor, known: Tensor, size: tuple[int, int]) -> Tensor:
    """Mean of (1, c, h, w) over the known texels of each larger one; 0 where most are not."""
    weight = shrink(known, size)
    return shrink(image * known, size) / weight.clamp_min(1e-3) * (weight > 0.5)


def _image(values: Tensor) -> np.ndarray:
    """(1, c, h, w) to (h, w, c)."""
    return np.ascontiguousarray(values[0].permute(1, 2, 0).numpy())
