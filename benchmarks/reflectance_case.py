"""One person of the accuracy benchmark under our own stages: noisy frames, maps, errors."""

from __future__ import annotations

import dataclasses
import functools
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reflectance_people import NOISE, SCALE, Known, noisy, session
from benchmarks.reflectance_relight import Relighter, relit
from benchmarks.reflectance_scores import (
    SURE,
    Maps,
    Samples,
    TrueView,
    deciles,
    joined,
    read_maps,
    scores,
    sure_share,
    true_view,
    view_samples,
)
from lightstage.formats.config import make_config
from lightstage.formats.exr import read_exr
from lightstage.formats.mesh import read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, load_session
from processing.coarse_maps import write_as_views
from processing.frames.read import Frames, foreground_path, write_foreground, write_frames
from processing.lighting.facets import BECKMANN, Facets
from processing.masks import foreground
from processing.reconstruction.stage import ReconstructConfig, reconstruct
from processing.refinement.config import RefineConfig
from processing.refinement.stage import refine
from processing.separation.config import SeparateConfig
from processing.separation.stage import separate
from sim.session import truth_path

FOREGROUND_SHARE = 0.03
"""Foreground is brighter than this share of the picture's 99th percentile."""


@dataclasses.dataclass(frozen=True)
class Result:
    """Errors of one method on one person.

    Attributes:
        every: `scores` of all visible skin; `sure_share`, the part of confidence above SURE;
            `psnr_db` and `psnr_white_db` of re-rendering.
        sure: `scores` where confidence is above SURE; empty where it nowhere is.
        deciles: of confidence.
    """

    every: dict[str, float]
    sure: dict[str, float]
    deciles: list[tuple[float, float, float, float]]


class Case:
    """A person's session with noise, in a processed folder of its own."""

    def __init__(
        self,
        known: Known,
        light: str,
        out: Path,
        *,
        sequence: str = "binary",
        scale: float = SCALE,
    ) -> None:
        """Write the noisy frames.

        Args:
            known: who.
            light: ``direct`` or ``reference``.
            out: an empty folder, or one of an earlier run: its frames are taken again.
            sequence: of patterns.
            scale: of the pictures, see `session`.
        """
        self.known, self.light, self.out = known, light, out
        path = session(known, light=light, sequence=sequence, scale=scale)
        self.session: Session = load_session(path)
        self.truth = ProcessedFolder(truth_path(path))
        if not foreground_path(out, self.session.camera_ids()[-1]).is_file():
            put_frames(self.session, out, np.random.default_rng(known.seed))

    def separated(self, settings: Mapping[str, Any] | None = None) -> dict[str, Maps]:
        """Maps of the coarse pass, with settings of SeparateConfig."""
        config = make_config(SeparateConfig, settings or {}, "benchmark")
        separate(self.session, self.out, config)
        write_as_views(self.out, self.session.camera_ids())
        return self._maps()

    def refined(self, settings: Mapping[str, Any] | None = None) -> dict[str, Maps]:
        """Maps of `refine` with the true mesh, with settings of RefineConfig."""
        shutil.copy(self.truth.base_mesh, ProcessedFolder(self.out).base_mesh)
        config = make_config(RefineConfig, settings or {}, "benchmark")
        return self._maps(facets_of(refine(self.session, self.out, config)))

    def true_maps(self, roughness: float) -> dict[str, Maps]:
        """Truth's own maps, which have no roughness: what re-rendering can reach at best."""
        maps = {}
        for name in self.session.camera_ids():
            mask = self.true[name].mask.astype(np.float32)
            common = {
                field: self.truth.read_view(name, field)
                for field in (
                    "diffuse_normal", "specular_normal", "diffuse_albedo", "specular_albedo",
                )
            }  # fmt: skip
            maps[name] = Maps(
                **common, roughness=mask * roughness, confidence=mask, facets=BECKMANN
            )
        return maps

    def refined_on_own_mesh(self) -> dict[str, Maps]:
        """Maps of `refine` with the mesh of `reconstruct`, from these few views."""
        self.separated()
        reconstruct(self.session, self.out, ReconstructConfig())
        return self._maps(facets_of(refine(self.session, self.out, RefineConfig())))

    @functools.cached_property
    def true(self) -> dict[str, TrueView]:
        """Camera id to its view's truth."""
        rig = self.session.rig
        return {name: true_view(self.truth, rig.camera(name)) for name in self.session.camera_ids()}

    @functools.cached_property
    def relighter(self) -> Relighter:
        """Of the true mesh."""
        return Relighter(read_ply(self.truth.base_mesh), self.session.rig)

    def samples(self, maps: Mapping[str, Maps]) -> Samples:
        """All views' maps held against truth."""
        return joined([view_samples(view, self.true[name]) for name, view in maps.items()])

    def result(
        self, maps: Mapping[str, Maps], *, own_mesh: bool = False, pictures: bool = True
    ) -> Result:
        """Errors of maps.

        Args:
            maps: camera id to its maps.
            own_mesh: re-rendered with the shadows of our own mesh instead of the true one.
            pictures: whether they are re-rendered.
        """
        samples = self.samples(maps)
        every = scores(samples) | {"sure_share": sure_share(samples)}
        if pictures:
            relighter = self.relighter
            if own_mesh:
                mesh = read_ply(ProcessedFolder(self.out).base_mesh)
                relighter = Relighter(mesh, self.session.rig)
            shown = relit(maps, relighter, self.session.rig, self.true, self.session.root)
            every["psnr_db"], every["psnr_white_db"] = shown.psnr_db(), shown.psnr_db(1.0)
        sure = samples.of(samples.confidence > SURE)
        return Result(
            every,
            scores(sure) if len(sure.confidence) else {},
            deciles(samples),
        )

    def _maps(self, facets: Facets = BECKMANN) -> dict[str, Maps]:
        folder = ProcessedFolder(self.out)
        return {name: read_maps(folder, name, facets) for name in self.session.camera_ids()}


def facets_of(facts: Mapping[str, Any]) -> Facets:
    """The family of lobes that `refine` found."""
    return Facets(
        facts["mirror_lobe_tails"],
        facts["mirror_lobe_stretch"],
        facts["mirror_rises_at_grazing_angles"],
        facts["diffuse_layer_below_the_mirror"],
    )


def put_frames(
    stage_session: Session, out: Path, rng: np.random.Generator, share: float = NOISE
) -> None:
    """Write a session's linear frames with noise into a processed folder, as `decode` would.

    Args:
        stage_session: of linear frames.
        out: processed folder.
        rng: of the noise.
        share: of the noise, see `noisy`.
    """
    patterns = tuple(stage_session.file.sequence)
    for camera_id in stage_session.camera_ids():
        frames = [stage_session.frame(name, camera_id) for name in patterns]
        images = np.stack([read_exr(stage_session.frame_path(frame)) for frame in frames])
        mask = foreground(images.max(axis=(0, 3)), FOREGROUND_SHARE)
        images = noisy(images, rng, share)
        valid = np.ones(mask.shape, bool)
        write_frames(out, camera_id, Frames.of(patterns, images, valid))
        write_foreground(out, camera_id, mask)
        ProcessedFolder(out).write_mask(camera_id, mask)
