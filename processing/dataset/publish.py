"""What may leave the lab: patches without person, place or order.

    PUBLISHED/
      dataset.json      lightstage.realfacedb/1: channels, counts, statistics over all patches
      patches/NAME/     one zarr array a map, (patches, size, size, channels)

A patch holds diffuse albedo, specular albedo, both normals and the shape (mm, head frame, the
patch's mean removed) of one place. Patches of a scan do not overlap, so no two share a texel;
nothing says which patches are of one person, session or place in the texture, and their order is
drawn with a seed that is written nowhere.
"""

from __future__ import annotations

import dataclasses
import secrets
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.files import atomic_folder, write_json
from processing.dataset.scan import DatasetError
from processing.dataset.statistics import Statistics
from processing.dataset.store import SCHEMA, Store

CANNOT_PROTECT = (
    "A patch is a person's real skin: whoever has another photograph of the person as sharp as "
    "this can recognise moles, scars, wrinkles and eyes. Neighbouring patches meet at their "
    "edges, and skin tone and pore pattern stay the same over a face, so somebody who tries can "
    "guess which patches belong together and join some of them again. What a patch shows (an eye, "
    "a lip) tells roughly where it lay, and normals and shape hold the form of that place. "
    "Publish only with the consent of those shown, for this use."
)
AVERAGED = ("diffuse_albedo", "specular_albedo", "shape")
CHANNELS: dict[str, int] = {
    "diffuse_albedo": 3,
    "specular_albedo": 1,
    "diffuse_normal": 3,
    "specular_normal": 3,
    "shape": 3,
}


@dataclasses.dataclass(frozen=True)
class PublishConfig:
    """Settings of publishing.

    Attributes:
        patch_px: side of a patch in texels.
        min_coverage: smallest share of a patch's texels that show the face.
        fewest_subjects: statistics are left out where fewer people than this would hide in them.
        shard_patches: patches that share a file.
    """

    patch_px: int = 512
    min_coverage: float = 0.5
    fewest_subjects: int = 3
    shard_patches: int = 16


def publish(
    store: Store,
    out: Path,
    seed: int | None = None,
    config: PublishConfig | None = None,
    progress: ProgressCallback = quiet,
) -> Path:
    """Write the patches of a store that may be published.

    Args:
        store: the lab's store.
        out: the published folder; an older one there is replaced.
        seed: of the shuffle. Whoever knows it can undo the shuffle, so it is written nowhere; None
            takes 128 bits from the system's randomness and forgets them.
        config: settings.
        progress: called after each patch.

    Returns:
        `out`.

    Raises:
        DatasetError: no patch covers enough of a face, or `out` lies in the store.
    """
    config = config or PublishConfig()
    if out.resolve().is_relative_to(store.path.resolve()):
        raise DatasetError(out, found="a folder in the lab's store", expected="one outside it")
    size = config.patch_px
    # At least one texel must be measured, or a patch would have no mean to remove.
    coverage = max(config.min_coverage, 0.5 / size**2)
    places = [
        (scan.index, row, column)
        for scan in store.scans
        # A step of a whole patch: no two patches share a texel.
        for row, column in store.patch_origins(scan.index, size, size, coverage)
    ]
    if not places:
        raise DatasetError(
            store.path,
            found=f"no {size} x {size} patch with {config.min_coverage:.0%} of face",
            expected="at least one",
            hint="Are the maps smaller than a patch? Choose a smaller one.",
        )
    rng = np.random.default_rng(secrets.randbits(128) if seed is None else seed)
    order = rng.permutation(len(places))
    with atomic_folder(out, "dataset.json") as beside:
        arrays = {
            name: _create(beside / "patches" / name, len(places), size, channels, config)
            for name, channels in CHANNELS.items()
        }
        statistics = Statistics({name: CHANNELS[name] for name in AVERAGED})
        for first in range(0, len(order), config.shard_patches):
            chosen = [places[i] for i in order[first : first + config.shard_patches]]
            patches = []
            for place in chosen:
                patch, measured = _patch(store, place, size)
                patches.append(patch)
                statistics.add(patch, measured)
                progress(first + len(patches), len(order))
            for name, array in arrays.items():
                block = np.stack([patch[name] for patch in patches]).astype(array.dtype)
                array[first : first + len(patches)] = block
        subjects = len({scan.subject for scan in store.scans})
        shown = statistics.facts() if subjects >= config.fewest_subjects else {}
        write_json(
            beside / "dataset.json",
            {
                "schema": SCHEMA,
                "kind": "published",
                "patch": size,
                "stride": size,
                "channels": CHANNELS,
                "frame": "head, each patch's mean position removed",
                "counts": {"subjects": subjects, "patches": len(places)},
                "statistics": shown,
                "cannot_protect": CANNOT_PROTECT,
            },
        )
    return out


def _create(path: Path, count: int, size: int, channels: int, config: PublishConfig) -> Any:
    return zarr.create_array(
        path,
        shape=(count, size, size, channels),
        dtype="float32" if path.name == "shape" else "float16",
        chunks=(1, size, size, channels),
        shards=(min(config.shard_patches, count), size, size, channels),
        compressors=zarr.codecs.ZstdCodec(level=3),
        fill_value=0,
    )


def _patch(
    store: Store, place: tuple[int, int, int], size: int
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Maps of one place, (size, size, c) float32, zero where not measured; (size, size) where."""
    scan, row, column = place
    rows, columns = slice(row, row + size), slice(column, column + size)
    seen = store.read(scan, "confidence", rows, columns) > 0
    measured = seen[:, :, 0]
    patch = {
        name: store.read(scan, name, rows, columns) * seen for name in CHANNELS if name != "shape"
    }
    position = store.read(scan, "position", rows, columns).astype(float)
    mean = position[measured].mean(axis=0)
    patch["shape"] = ((position - mean) * seen).astype(np.float32)
    return patch, measured
