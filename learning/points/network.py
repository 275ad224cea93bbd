"""A network that finds template points beside where the detector's points put them.

Features of the warped photograph are read at each point's own place, beside a part that knows the
whole face and how the detector's points differ from the mean head's. Each point has a residual and
a standard deviation.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from learning.checkpoint import Checkpoint, fill, of_family, shipped_points, trained_tensors
from learning.points.layout import POINTS, Layout
from learning.points.trunk import READ_CHANNELS, WIDTHS, Trunk
from lightstage.faces.face_mesh import COUNT
from lightstage.formats.template import Template

FAMILY = "points"
WIDTH = 96
"""Channels of a point's own features."""
WHOLE = 160
"""Channels of the whole face's."""
OF_DETECTOR = 48
"""Numbers in which the detector's points are told to the whole face's part."""
LAST = 4 * WIDTHS[-1]
"""Numbers of the trunk's last features of a square of 128 px."""
FIRST_MM = 3.0
"""Standard deviation of an untrained network's points."""
SAME_MM = 0.01
"""A template whose vertices are farther from those that were trained on is another one."""


@dataclasses.dataclass(frozen=True)
class DensePoints:
    """Template points in a photograph.

    Attributes:
        points_px: (p, 2).
        deviation_mm: (p,) what the network expects its error to be, along each axis.
    """

    points_px: np.ndarray
    deviation_mm: np.ndarray


class PointNetwork(nn.Module):
    """The trunk and what reads it."""

    side_mm: Tensor
    vertices: Tensor
    vertices_mm: Tensor
    places: Tensor
    there: Tensor
    control: Tensor

    def __init__(self, control: int = COUNT, points: int = POINTS) -> None:
        """For so many of the detector's points, and template points."""
        super().__init__()
        self.trunk = Trunk()
        self.detector = nn.Linear(2 * control, OF_DETECTOR)
        self.whole = nn.Sequential(nn.Linear(LAST + OF_DETECTOR, WHOLE), nn.PReLU(WHOLE))
        self.from_whole = nn.Linear(WHOLE, WIDTH)
        self.own = nn.Linear(READ_CHANNELS, WIDTH)
        self.each = nn.Parameter(0.1 * torch.randn(points, WIDTH))
        self.bend = nn.PReLU(WIDTH)
        self.answer = nn.Parameter(0.02 * torch.randn(points, WIDTH, 3))
        self.beside = nn.Linear(WHOLE, 3 * points)
        with torch.no_grad():
            self.beside.weight *= 0.1
            self.beside.bias.zero_()
            self.beside.bias[2::3] = float(np.log(FIRST_MM))
        # The layout that was trained on.
        self.register_buffer("side_mm", torch.zeros(()))
        self.register_buffer("vertices", torch.zeros(points))
        self.register_buffer("vertices_mm", torch.zeros(points, 3))
        self.register_buffer("places", torch.zeros(points, 2))
        self.register_buffer("there", torch.zeros(COUNT))
        self.register_buffer("control", torch.zeros(control, 2))

    def set_layout(self, layout: Layout, template: Template) -> None:
        """Remember where points are expected, and on which template."""
        known = {
            "side_mm": layout.side_mm,
            "vertices": layout.vertices,
            "vertices_mm": template.mesh.vertices[layout.vertices],
            "places": layout.places,
            "there": layout.there,
            "control": layout.control,
        }
        for name, values in known.items():
            getattr(self, name).copy_(torch.as_tensor(np.asarray(values, np.float32)))

    def forward(self, pictures: Tensor, beside: Tensor) -> tuple[Tensor, Tensor]:
        """Residuals (B, p, 2) in mm of the mean head's square, and their deviations' logarithm.

        Args:
            pictures: (B, 3, 128, 128) warped photographs, 0..1.
            beside: (B, c, 2) of `Layout.beside`, mm.
        """
        read, last = self.trunk(pictures)
        at = (2 * self.places - 1).expand(len(pictures), 1, -1, -1)
        seen = [functional.grid_sample(x, at, align_corners=False)[:, :, 0] for x in read]
        told = self.detector(0.1 * beside.flatten(1))
        whole = self.whole(torch.cat([last.flatten(1), told], dim=1))
        own = self.own(torch.cat(seen, dim=1).transpose(1, 2))
        own = own + self.each + self.from_whole(whole)[:, None]
        own = self.bend(own.transpose(1, 2)).transpose(1, 2)
        out = torch.einsum("bpw,pwk->bpk", own, self.answer)
        out = out + self.beside(whole).view(len(whole), -1, 3)
        return out[..., :2], out[..., 2].clamp(-2.0, 4.0)


@dataclasses.dataclass(frozen=True)
class PointFinder:
    """A trained network with the layout of its template."""

    network: PointNetwork
    layout: Layout

    def found(self, picture_srgb: np.ndarray, points_px: np.ndarray) -> DensePoints:
        """Template points of a face.

        Args:
            picture_srgb: (h, w, 3) uint8.
            points_px: (468, 2) the detector's, all of them.
        """
        layout = self.layout
        square = layout.warped(picture_srgb, points_px)
        pictures = torch.from_numpy(square.transpose(2, 0, 1)[None].astype(np.float32) / 255)
        beside = torch.from_numpy(layout.beside_mm(points_px)[None].astype(np.float32))
        with torch.no_grad():
            residual, log_deviation = self.network(pictures, beside)
        turn = layout.similarity(points_px) / layout.side_mm
        residual_px = residual[0].numpy().astype(float) @ turn.T
        deviation_mm = np.exp(log_deviation[0].numpy().astype(float))
        return DensePoints(layout.expected_px(points_px) + residual_px, deviation_mm)


@functools.cache
def _shipped() -> PointNetwork:
    return load_points(shipped_points())[0]


def shipped_finder(template: Template) -> PointFinder | None:
    """The shipped network for a template; None where it is for another one."""
    return finder_of(_shipped(), template)


def load_points(path: Path) -> tuple[PointNetwork, Checkpoint]:
    """The network of a checkpoint of points, ready to infer with.

    Its weights are kept in half floats, which `learning.checkpoint.fill` would refuse.

    Raises:
        CheckpointError, FormatError: as `learning.checkpoint.load_network`.
    """
    checkpoint, where = of_family(path, FAMILY)
    tensors = {k: v.float() for k, v in trained_tensors(checkpoint, "network").items()}
    sizes = (len(tensors[name]) if name in tensors else 1 for name in ("control", "places"))
    network = PointNetwork(*sizes)
    fill(network, tensors, where)
    return network.eval(), checkpoint


def finder_of(network: PointNetwork, template: Template) -> PointFinder | None:
    """A network for a template; None where it was trained on another one."""
    vertices = network.vertices.numpy().round().astype(int)
    mesh_mm = template.mesh.vertices
    if len(mesh_mm) <= vertices.max():
        return None
    away = np.abs(mesh_mm[vertices] - network.vertices_mm.numpy()).max()
    if away > SAME_MM:
        return None
    layout = Layout.of(
        vertices,
        network.places.numpy().astype(float),
        network.there.numpy() > 0.5,
        network.control.numpy().astype(float),
        float(network.side_mm),
    )
    return PointFinder(network, layout)
