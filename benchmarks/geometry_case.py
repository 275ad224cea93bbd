"""One person of the geometry benchmarks, photographed with noise, under cameras that were measured.

Poses come from drawn ChArUco boards (geometry_poses.py), never from the truth; meshes are placed in
the truth's world by the turn and shift that no board can show.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from benchmarks.geometry_people import person, session
from benchmarks.geometry_poses import measured, onto_truth, true_rig
from benchmarks.geometry_scores import Skin, true_skin
from benchmarks.reflectance_case import put_frames
from benchmarks.reflectance_people import NOISE, SCALE, folder
from lightstage.formats.mesh import Mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, load_session
from lightstage.rig import Camera, Rig
from processing.coarse_maps import has_coarse
from processing.frames.read import foreground_path
from processing.lighting.lights import PatternLights
from processing.reconstruction.config import ReconstructConfig
from processing.reconstruction.stage import read_views
from processing.reconstruction.stereo import match_views
from processing.reconstruction.two_passes import Depths, meshed, reconstruct_in_two_rounds
from processing.reconstruction.views import View
from processing.separation.config import SeparateConfig
from processing.separation.stage import separate
from sim.session import truth_path

FRONTAL = 3
"""Views of a frontal case."""


class Case:
    """A person's photographs, coarse maps and measured cameras.

    Attributes:
        name: of the person.
        session: with the measured rig in place of the true one.
        out: its processed folder.
        skin: the truth.
    """

    def __init__(
        self,
        name: str,
        light: str = "direct",
        *,
        noise: float = NOISE,
        cameras: tuple[Camera, ...] | None = None,
        label: str = "",
    ) -> None:
        """Add noise, separate; what an earlier run left is used again.

        Args:
            name: of PEOPLE.
            light: ``direct`` or ``reference``; ``frontal-direct`` and ``frontal-reference`` are the
                first three of the nine views.
            noise: of pixels, see `reflectance_people.noisy`.
            cameras: None for those measured from boards.
            label: of the processed folder, where cameras are others.
        """
        known, self.name = person(name), name
        kind = light.removeprefix("frontal-")
        path = session(known, light=kind)
        true: Session = load_session(path)
        cameras = measured().cameras if cameras is None else cameras
        self._turn, self._shift = onto_truth(cameras, true_rig(SCALE))
        label += "" if noise == NOISE else f"-noise-{noise:g}"
        self.out = folder() / f"geometry-out-{name}-{kind}-smooth{label}"
        known_cameras = tuple(c for c in cameras if c.id in true.camera_ids())
        whole = Session(true.root, true.file, Rig(true.rig.lights, known_cameras))
        last = whole.camera_ids()[-1]
        if not foreground_path(self.out, last).is_file():
            put_frames(whole, self.out, np.random.default_rng(known.seed), noise)
        if not has_coarse(self.out, last):
            separate(whole, self.out, SeparateConfig())
        count = len(cameras) if kind == light else FRONTAL
        self.session = Session(true.root, true.file, Rig(true.rig.lights, known_cameras[:count]))
        seen = Rig(true.rig.lights, true.rig.cameras[:count])
        self.skin: Skin = true_skin(ProcessedFolder(truth_path(path)), seen)

    def views(
        self,
        config: ReconstructConfig,
        patterns: Sequence[str] | None = None,
        normals: bool = True,
    ) -> tuple[list[View], PatternLights]:
        """What the matcher sees, of some patterns or of all, and their lights."""
        return read_views(self.session, self.out, config, patterns, normals)

    def meshed(self, depths: Depths, config: ReconstructConfig) -> Mesh:
        """Consistency and fusion; in the truth's world."""
        return self.mesh_placed(meshed(depths, config)[1])

    def mesh_placed(self, mesh: Mesh) -> Mesh:
        """A mesh in the truth's world."""
        return Mesh(self.placed(mesh.vertices), mesh.faces)

    def placed(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) points in the truth's world."""
        return np.asarray(self._turn.apply(points) + self._shift)


def timed(
    views: list[View], lights: PatternLights, config: ReconstructConfig
) -> tuple[Depths, Mesh, float]:
    """Our depths and mesh, in the cameras' world, and processor seconds."""
    start = time.process_time()
    found, _, mesh, _ = reconstruct_in_two_rounds(views, match_views(views, config), config, lights)
    return found, mesh, time.process_time() - start
