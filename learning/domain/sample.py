"""One texture of a domain at the network's size, with the network's answer to it."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np

from learning.networks.whole_face import WholeFaceNetwork
from learning.render.uv import UvRaster, rasterise
from learning.whole.infer import run_network
from learning.whole.refine import Answer
from lightstage.formats.mesh import Mesh


@dataclasses.dataclass(frozen=True)
class Sample:
    """A texture and its head.

    Attributes:
        name: for messages.
        answer: of the network.
        mesh: in the head frame.
        raster: of the network's size.
    """

    name: str
    answer: Answer
    mesh: Mesh
    raster: UvRaster

    @functools.cached_property
    def weights(self) -> np.ndarray:
        """(h, w) how much each texel counts; 0 beside the surface."""
        found: np.ndarray = self.answer.seen * self.answer.trust**2 * self.raster.covered
        return found

    @functools.cached_property
    def weight(self) -> np.ndarray:
        """(n,) the weights of the surface's texels."""
        found: np.ndarray = self.weights[self.raster.covered]
        return found

    @functools.cached_property
    def colours(self) -> np.ndarray:
        """(n, 3) linear, of the texels of the surface."""
        return self.answer.texture[self.raster.covered].astype(float)


def sample_of(
    network: WholeFaceNetwork,
    texture: np.ndarray,
    mesh: Mesh,
    named: tuple[str | Path, str | Path],
    known: np.ndarray | None = None,
) -> Sample:
    """Run the network on a texture.

    Args:
        network: in evaluation mode.
        texture: (rows, columns, 3) linear.
        mesh: with the texture's UV.
        named: the texture's and the mesh's names in errors.
        known: (rows, columns) bool, what a fit took from its photographs; all that is not black
            where None. A fit's rows are in order, of which half a face may look like anything.

    Raises:
        MapsError: see `infer_whole_face`.
    """
    if known is not None:
        texture = texture * known[..., None]
    output = run_network(network, texture, mesh, None, named, network_sees=known)
    pose = output.head_from_mesh
    head = mesh.with_vertices(mesh.vertices @ pose[:, :3].T + pose[:, 3])
    return Sample(str(named[0]), output.answer, head, rasterise(head, *output.answer.seen.shape))
