"""Settings of publishing a store's patches."""

from __future__ import annotations

import dataclasses
from typing import Literal

from lightstage.errors import ConfigError
from processing.dataset.places import Layout
from processing.dataset.protection import DEFAULT_GAP
from processing.dataset.release_files import FORMS
from processing.dataset.store import PATCH, Store

PATCH_OF_ROWS = 6144
"""Atlas rows at which a patch has `PATCH` texels; other atlases have patches of the same share."""


@dataclasses.dataclass(frozen=True)
class PublishConfig:
    """Settings of publishing.

    Attributes:
        patch_px: side of a patch in texels; None for 512 of 6144 atlas rows, and as much of the
            face at other sizes.
        gap: fewest texels between two patches, as a share of a patch's side.
        wander: most texels by which a patch is off its cell's corner, as a share of its side.
        turned: patches are turned and mirrored at random, directions and shape with them.
        drop: share of everybody's patches that a release leaves out.
        most_face: largest share of a scan's measured skin that a patch may show, by area in mm2.
        min_coverage: smallest share of a patch's texels that show clear skin (`clear_skin`).
        fewest_subjects: statistics are left out where fewer people than this would hide in them.
        form: `zarr`: one group; `webdataset`: tars (`release_files`).
        shard_patches: patches that share a file of a zarr group.
        without_consent: publish scans of people of whom no consent is on record, and state it.
    """

    patch_px: int | None = None
    gap: float = DEFAULT_GAP
    wander: float = 0.5
    turned: bool = True
    drop: float = 0.25
    most_face: float = 1 / 40
    min_coverage: float = 0.5
    fewest_subjects: int = 3
    form: Literal["zarr", "webdataset"] = "zarr"
    shard_patches: int = 16
    without_consent: bool = False

    def __post_init__(self) -> None:
        """Refuse shares that are none, and a form that there is none of."""
        if self.form not in FORMS:
            raise ConfigError(
                "publish", field="format", found=repr(self.form), expected=" or ".join(FORMS)
            )
        for name, most in (("gap", 8.0), ("wander", 8.0), ("drop", 0.95)):
            if not 0 <= getattr(self, name) <= most:
                raise ConfigError(
                    "publish",
                    field=name,
                    found=f"{getattr(self, name)}",
                    expected=f"a share from 0 to {most:g}",
                )

    def layout(self, store: Store) -> Layout:
        """Distances in texels of this store's atlases."""
        size = self.patch_px or max(1, round(PATCH * store.scans[0].rows / PATCH_OF_ROWS))
        gap, wander = round(self.gap * size), round(self.wander * size)
        return Layout(size, gap, wander, self.min_coverage, self.turned)
