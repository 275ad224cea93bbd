"""What may leave the lab: patches without person, place or order, in one zarr group or in tars.

    PUBLISHED/
      dataset.json      lightstage.realfacedb/1: channels, counts, statistics over all patches
      DATASHEET.md      what people should know of it
      croissant.json    the same for machines
      checksums.json    SHA-256 of every file
      zarr.json         a zarr group (format 3)
      NAME/             one array a map, (patches, size, size, channels)

A patch holds diffuse albedo, specular albedo, both normals and the shape (mm, the patch's mean
removed) of one place, in axes of its own. Nothing shows which patches are of one person, session or
place in the texture. Which patches a release leaves out, and the order of the others, are drawn
anew for each release, with a seed that is written nowhere.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.formats.files import atomic_folder, sha256_file, write_json
from processing.dataset.about import About
from processing.dataset.changes import record_release
from processing.dataset.config import PublishConfig
from processing.dataset.contents import Entry, read_entries
from processing.dataset.croissant import CROISSANT, write_croissant
from processing.dataset.datasheet import DATASHEET, write_datasheet
from processing.dataset.groups import people_tables
from processing.dataset.places import Layout, Place, clear_skin, places_of, size_that_shows, turned
from processing.dataset.protection import cannot_protect
from processing.dataset.release_files import (
    CHANNELS,
    CHECKSUMS,
    TARS,
    ReleaseWriter,
    TarRelease,
    ZarrRelease,
    give_one_time,
    write_checksums,
)
from processing.dataset.scan import DatasetError
from processing.dataset.statistics import Statistics
from processing.dataset.store import DATASET, PUBLISHED, PUBLISHED_SCHEMA, Scan, Store

LEAST_KEPT = 0.5
"""Share of the places that a patch's size must leave, or the size is refused."""
RELEASE_FILES = (
    *(DATASET, DATASHEET, CROISSANT, CHECKSUMS, "zarr.json", TARS),
    *(f"{name}/{file}" for name in CHANNELS for file in ("zarr.json", "c/*/*/*/*")),
)
"""All that a release has, as globs."""
AVERAGED = ("diffuse_albedo", "specular_albedo", "shape")
BLUR = {"diffuse_normal": 2.0**-11, "specular_normal": 2.0**-11, "shape": 2.0**-14}
"""Width of the random numbers that are added before a patch gets its own axes: a step of the stored
half floats, and four of floats of 256 mm. Stored numbers are multiples of a step along the head's
axes alone, and would reveal how those of a patch are turned."""


def publish(
    store: Store,
    out: Path,
    seed: int | None = None,
    config: PublishConfig | None = None,
    progress: ProgressCallback = quiet,
    *,
    about: About,
) -> Path:
    """Write the patches of a store that may be published.

    Args:
        store: the lab's store.
        out: the published folder; an older one there is replaced.
        seed: of what this release leaves out and of the order. Whoever knows it can undo both, so
            it is written nowhere; None takes 128 bits from the system's randomness and forgets
            them. The same seed draws otherwise for another store.
        config: settings.
        progress: called after each patch.
        about: the lab's statements on the release: licence, terms, who made it.

    Returns:
        `out`.

    Raises:
        DatasetError: a scan without a consent record, a patch that shows too much of a face, no
            patch with enough skin, `out` is in the store, or scans that left the store meanwhile.
    """
    config = config or PublishConfig()
    if out.resolve().is_relative_to(store.path.resolve()):
        raise DatasetError(out, found="a folder in the lab's store", expected="one outside it")
    unasked = [scan for scan in store.scans if not (scan.consent or scan.synthetic)]
    if unasked and not config.without_consent:
        _refuse_unasked(store, unasked)
    layout = config.layout(store)
    places = published_places(store, layout, config.most_face)
    entropy = secrets.randbits(128) if seed is None else seed
    rng = np.random.default_rng([entropy, int(store.fingerprint, 16)])
    kept = np.flatnonzero(rng.random(len(places)) >= config.drop)
    # Dropping all of a few patches would leave nothing to publish.
    order = rng.permutation(kept if len(kept) else len(places))
    with atomic_folder(out, DATASET, PUBLISHED, own=RELEASE_FILES) as beside:
        writer: ReleaseWriter = (
            ZarrRelease(beside, len(order), layout.size, config.shard_patches)
            if config.form == "zarr"
            else TarRelease(beside)
        )
        statistics = Statistics({name: CHANNELS[name] for name in AVERAGED})
        for first in range(0, len(order), config.shard_patches):
            chosen = [places[i] for i in order[first : first + config.shard_patches]]
            patches = []
            for place in chosen:
                patch, measured = read_patch(store, place, layout.size)
                patches.append(patch)
                statistics.add(patch, measured)
                progress(first + len(patches), len(order))
            blocks = {name: np.stack([patch[name] for patch in patches]) for name in CHANNELS}
            writer.write(first, blocks)
        # Of those who are shown: a store has people without a place, too.
        shown_scans = [store.scans[k] for k in sorted({places[i].scan for i in order})]
        subjects = len({scan.subject for scan in shown_scans})
        shown = statistics.facts() if subjects >= config.fewest_subjects else {}
        facts = {
            "schema": PUBLISHED_SCHEMA,
            "kind": PUBLISHED,
            "patch": layout.size,
            "stride": layout.size + layout.gap,
            "gap": layout.gap,
            "channels": CHANNELS,
            "frame": "of each patch its own: the head frame, mirrored where the patch is and "
            "turned at random, about the patch's mean position"
            if layout.turned
            else "head, each patch's mean position removed",
            "counts": {"subjects": subjects, "patches": len(order)},
            "left_out_share": config.drop,
            "most_of_a_face": config.most_face,
            "consent": _consent(shown_scans),
            "people_by": _people_by(store, shown_scans),
            "statistics": shown,
            "cannot_protect": cannot_protect(config.gap),
        }
        write_json(beside / DATASET, facts)
        write_datasheet(beside, about, facts, config.form)
        writer.close()
        day = datetime.now(UTC).date().isoformat()
        write_croissant(beside, about, facts, config.form, day)
        write_checksums(beside)
        give_one_time(beside)
        digest = sha256_file(beside / DATASET)
        record_release(
            store,
            {
                "out": str(out.resolve()),
                "name": about.name,
                "version": about.version,
                "dataset_sha256": digest,
            },
        )
    return out


def published_places(store: Store, layout: Layout, most_face: float) -> list[Place]:
    """Places of all scans at which a patch shows enough skin and not too much of the face.

    Skin is measured in mm2 on the surface, not in texels: the texture stretches, so that as many
    texels are a pore of the nose or half of the neck.

    Raises:
        DatasetError: no place has enough skin, or at most of them a patch shows too much.
    """
    found = [place for scan in store.scans for place in places_of(store, scan.index, layout)]
    places = [place for place in found if place.face_share <= most_face]
    if len(places) >= LEAST_KEPT * max(1, len(found)):
        return places
    size = layout.size
    if found:
        shares = [place.face_share for place in found]
        reached = f"{size} texels, which show up to {max(shares):.1%} of a face"
    else:
        reached = f"{size} texels; no place has that much skin"
    raise DatasetError(
        store.path,
        field="patch",
        found=reached,
        expected=f"patches that show skin, each at most {most_face:.1%} of a face",
        hint=f"Try --patch {size_that_shows(store, most_face)}.",
    )


def read_patch(store: Store, place: Place, size: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Maps of one place as they are published.

    Returns:
        By name (size, size, c) float32, zero where no clear skin is; (size, size) bool, where it
        is.
    """
    rows = slice(place.row, place.row + size)
    columns = slice(place.column, place.column + size)
    seen = clear_skin(store.read(place.scan, "confidence", rows, columns)[:, :, 0] > 0)[:, :, None]
    patch = {
        name: store.read(place.scan, name, rows, columns) * seen
        for name in CHANNELS
        if name != "shape"
    }
    position = store.read(place.scan, "position", rows, columns).astype(float)
    mean = position[seen[:, :, 0]].mean(axis=0)
    patch["shape"] = (position - mean) * seen
    # The same in every release: the mean of several would be without it.
    rng = np.random.default_rng([int(store.scans[place.scan].sha256, 16), place.row, place.column])
    for name, width in BLUR.items():
        known = (patch[name] != 0).any(axis=2, keepdims=True)
        blurred = patch[name] + known * rng.uniform(-width / 2, width / 2, patch[name].shape)
        patch[name] = blurred @ place.axes.T
    maps = {name: turned(image, place).astype(np.float32) for name, image in patch.items()}
    return maps, turned(seen, place)[:, :, 0]


def _refuse_unasked(store: Store, unasked: list[Scan]) -> None:
    names = sorted({scan.subject for scan in unasked})
    shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    raise DatasetError(
        store.path,
        field="consent",
        found=f"{counted(len(unasked), 'scan')} without a consent record, of {shown}",
        expected="a consent record of everybody who is shown",
        hint="`lightstage capture --consent ID` records one. Leave these scans out of "
        "`dataset build`, or publish them --without-consent; the published set then states it.",
    )


def _people_by(store: Store, scans: Sequence[Scan]) -> list[dict[str, Any]]:
    """People by age, sex and tone as far as the store knows it and it may be published."""
    entries: list[Entry] = []
    # A store of an earlier version does not record it.
    if all(scan.has_sums for scan in store.scans):
        entries = read_entries(store.path)
    tables = people_tables(entries, (scan.subject for scan in scans))
    return [
        {
            "what": table.what,
            "groups": list(table.at_least),
            "at_least": list(table.at_least.values()),
            "said": table.sentence,
        }
        for table in tables
    ]


def _consent(scans: Sequence[Scan]) -> dict[str, int | bool]:
    """How many people are shown with a consent record, without, and how many are simulated."""
    unasked = {s.subject for s in scans if not (s.consent or s.synthetic)}
    simulated = {s.subject for s in scans if s.synthetic} - unasked
    everybody = {s.subject for s in scans}
    return {
        "subjects_on_record": len(everybody - unasked - simulated),
        "subjects_simulated": len(simulated),
        "subjects_without": len(unasked),
        "published_without_consent": bool(unasked),
    }
