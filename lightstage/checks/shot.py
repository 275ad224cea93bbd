"""Checks within seconds of each shot: what is to be taken again, and by which camera."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.checks.ball import BallModel, seen_shares, unlikeness
from lightstage.checks.compare import (
    baseline_findings,
    expected_findings,
    highlight_findings,
    looks_like,
    sharpness_findings,
    unlike_findings,
)
from lightstage.checks.config import ChecksConfig
from lightstage.checks.few_lamps import FewLamps
from lightstage.checks.light import Evidence, judge_sum
from lightstage.checks.photo_measures import Photo, measure_photo
from lightstage.checks.room import Left, room_findings
from lightstage.checks.sharpness import own_sharpness
from lightstage.checks.single import photo_findings, unreadable, where
from lightstage.checks.subject_motion import Shift, sum_shift
from lightstage.checks.sums import Sum, SumFit, find_sums, fit_sum, kind_of
from lightstage.errors import FormatError
from lightstage.findings import Finding
from lightstage.rig import Rig
from lightstage.sequence import Shot

FULL_STEP = 0.999
LAMP_GAIN = 0.15
"""One lamp changes no gain by more than about this (natural logarithm)."""
LAMP_EXPLAINED = 0.8
"""Share of what is wrong in a camera beyond which a gain explains it, and not a lamp."""


class ShotChecks:
    """All photographs of a session as small pictures, and what they show together.

    Memory is bounded: a photograph whose pattern is part of a sum is kept as a small picture (300
    kB at 24 megapixels), of the others the last few of each camera; of every photograph a digest
    and four figures.

    Args:
        rig: cameras and lights.
        shots: everything that will be lit in this session.
        config: limits.
        baseline: `facts()` of an earlier session of the same stage, or None.
    """

    def __init__(
        self,
        rig: Rig,
        shots: Sequence[Shot],
        config: ChecksConfig | None = None,
        baseline: Mapping[str, Any] | None = None,
    ) -> None:
        self.rig = rig
        self.config = config or ChecksConfig()
        self.baseline = baseline
        self._levels = {shot.pattern: np.asarray(shot.levels, float) for shot in shots}
        self._totals = {name: float(level.sum()) for name, level in self._levels.items()}
        self.sums = find_sums(self._levels)
        self._model = BallModel(rig, self._levels)
        self._few = FewLamps(rig, self._levels)
        self._whole = {kind_of(name): self._brightest(kind_of(name)) for name in self._levels}
        needed = {name for s in self.sums for name in s.patterns} | set(self._whole.values())
        needed |= {name for name in self._levels if self._totals[name] == 0 or "@" in name}
        self._needed = needed
        self._photos: dict[tuple[str, str], Photo] = {}
        self._digests: dict[str, tuple[str, str]] = {}
        self._figures: dict[tuple[str, str], dict[str, float]] = {}
        self._shares: dict[str, dict[str, float]] = {}
        self._fits: dict[Sum, dict[str, SumFit]] = {}
        self._shifts: dict[Sum, dict[str, Shift]] = {}
        self._failed: set[tuple[str, str | None]] = set()
        # The findings of a pattern's photographs together, until they are checked again.
        self._blamed: dict[str, set[tuple[str, str | None]]] = {}
        self._broken: set[Sum] = set()
        self._lock = threading.RLock()

    def photograph(self, pattern: str, camera_id: str, path: Path) -> list[Finding]:
        """Measure one photograph and check it by itself; any number of threads at once.

        Args:
            pattern: its light.
            camera_id: whose it is.
            path: the file.

        Returns:
            What was found; a file that cannot be measured is a finding too.
        """
        try:
            photo = measure_photo(path, self.config.thumbnail_px)
        except FormatError as error:
            self.forget(pattern, camera_id)
            return [unreadable(error, pattern, camera_id)]
        return self.add(pattern, camera_id, photo)

    def add(self, pattern: str, camera_id: str, photo: Photo) -> list[Finding]:
        """As `photograph`, of measures that were taken already."""
        camera = self.rig.camera(camera_id)
        found = photo_findings(photo, pattern, camera, self._lit(pattern), self.config)
        with self._lock:
            self.forget(pattern, camera_id)
            old = self._digests.get(photo.digest)
            if old is not None and photo.encoding == "raw" and not photo.flat:
                found.append(_stale(pattern, camera_id, old))
            else:
                self._digests[photo.digest] = pattern, camera_id
            self._photos[pattern, camera_id] = photo
            figures = {"signal": photo.signal, "snr": photo.snr, "mean": photo.mean}
            self._figures[pattern, camera_id] = figures | {"clipped": float(photo.clipped.max())}
            if any(finding.severity == "retake" for finding in found):
                self._failed.add((pattern, camera_id))
            self._drop_old(camera_id)
        return found

    def forget(self, pattern: str, camera_id: str) -> None:
        """A take no longer counts: nothing is compared with it from now on."""
        key = pattern, camera_id
        with self._lock:
            self._photos.pop(key, None)
            self._figures.pop(key, None)
            for blamed in (self._failed, *self._blamed.values()):
                blamed -= {key, (pattern, None)}
            self._few.forget(pattern)
            self._shares.get(pattern, {}).pop(camera_id, None)
            self._digests = {d: k for d, k in self._digests.items() if k != key}
            for kept in (self._fits, self._shifts):
                for one, by_camera in kept.items():
                    if pattern in one.patterns:
                        by_camera.pop(camera_id, None)

    def shot(self, pattern: str) -> list[Finding]:
        """Compare a pattern's photographs with each other and with the session's earlier ones.

        Returns:
            What was found; pattern and camera of each finding name what is to be taken again, and
            that may be an earlier pattern than this one.
        """
        with self._lock:
            self._blamed.pop(pattern, None)
            photos = self._of(pattern)
            whole = self._whole[kind_of(pattern)]
            wholes = self._of(whole)
            found: list[Finding] = []
            if pattern == whole:
                found += unlike_findings(pattern, photos, self.config)
            elif self._totals[pattern] > 0:
                self._note_shares(pattern, photos, wholes)
                against = expected_findings(
                    pattern, whole, photos, wholes, self._model, self._lit_names(), self.config
                )
                if not any(finding.camera is None for finding in against):
                    against += self._of_few(pattern, whole, photos, wholes)
                found += _among((pattern, whole), against)
            references = self._references(pattern)
            for finding in sharpness_findings(pattern, photos, references, self.config):
                found += _among((pattern, references[finding.camera or ""][0]), [finding])
            found += self._summed(pattern, found)
            found += highlight_findings(pattern, self._photos, self._levels, self.config)
            found += baseline_findings(pattern, self._shares, self.baseline, self.config)
            found = _once(found)
            self._blamed[pattern] = {
                (f.pattern, f.camera) for f in found if f.severity == "retake" and f.pattern
            }
            return found

    def _of_few(
        self,
        pattern: str,
        whole: str,
        photos: Mapping[str, Photo],
        wholes: Mapping[str, Photo],
    ) -> list[Finding]:
        """Patterns of few lamps, by photographs without a fault of their own."""
        wrong = self._wrong()
        sound = {c: photo for c, photo in photos.items() if (pattern, c) not in wrong}
        sound = sound if len(sound) > len(photos) / 2 else dict(photos)
        known = {camera: dark for camera in sound if (dark := self._dark(camera)) is not None}
        return self._few.findings(pattern, whole, sound, wholes, known, self._model, self.config)

    def facts(self) -> dict[str, Any]:
        """Figures for a report, and for `baseline` of a later session; JSON-ready."""
        with self._lock:
            wholes = {name: self._of(name) for name in set(self._whole.values())}
            return {
                "photographs": len(self._figures),
                "kept": len(self._photos),
                "figures": {
                    name: {
                        camera: {key: _rounded(value) for key, value in own.items()}
                        for (pattern, camera), own in self._figures.items()
                        if pattern == name
                    }
                    for name in wholes
                },
                "shares": {
                    pattern: {camera: _rounded(share) for camera, share in by_camera.items()}
                    for pattern, by_camera in self._shares.items()
                },
                "sharpness": {
                    camera: _rounded(own_sharpness(photo) or 0.0)
                    for photos in wholes.values()
                    for camera, photo in photos.items()
                },
                "sums": {
                    str(one): {camera: self._sum_facts(one, camera) for camera in by_camera}
                    for one, by_camera in self._fits.items()
                },
            }

    def _sum_facts(self, one: Sum, camera: str) -> dict[str, float]:
        fit, shift = self._fits[one][camera], self._shifts.get(one, {}).get(camera)
        facts = {
            "gain_first": float(fit.gains[0]),
            "gain_second": float(fit.gains[1]),
            "misfit": fit.misfit,
            "ambient": float(fit.ambient[1]),
        }
        if shift is not None:
            facts["motion_px"] = shift.largest_px
        return {key: _rounded(value) for key, value in facts.items()}

    def _summed(self, pattern: str, before: list[Finding]) -> list[Finding]:
        """Judge the sums that this pattern completes, then the light that is left over."""
        named = {(f.pattern, f.camera) for f in before if f.severity == "retake"} | self._wrong()
        found: list[Finding] = []
        fresh: list[Sum] = []
        for one in self.sums:
            if pattern not in one.patterns:
                continue
            cameras = [
                camera.id
                for camera in self.rig.cameras
                if all((name, camera.id) in self._photos for name in one.patterns)
                and not any((name, camera.id) in named for name in one.patterns)
            ]
            if any((name, None) in named for name in one.patterns) or not cameras:
                continue
            self._fit(one, cameras)
            evidence = self._evidence(one)
            if evidence.fits:
                found += _among(one.patterns, judge_sum(evidence, self.config))
                fresh.append(one)
        bad = {f.pattern for f in found if f.severity == "retake"}
        self._broken.difference_update(fresh)
        self._broken.update(one for one in fresh if bad.intersection(one.patterns))
        found += self._room(pattern, [one for one in fresh if one not in self._broken])
        if self._broken.intersection(fresh) and self._maybe_lamp(fresh):
            # A lamp makes small errors of level too; where it explains them, it alone is reported.
            lamps = [f for f in self._room(pattern, fresh) if f.code.startswith("lamp")]
            if lamps:
                kept = [f for f in found if f.code not in ("exposure", "light-level")]
                found = [f for f in kept if f.code not in {lamp.code for lamp in lamps}] + lamps
        return found

    def _room(self, pattern: str, sums: list[Sum]) -> list[Finding]:
        """Light left over: in sums, in a dark photograph, or in an earlier one under `full`."""
        whole = self._whole[kind_of(pattern)]
        darks = [name for name, total in self._totals.items() if total == 0]
        if pattern == whole and not sums:
            shots = [name for name in darks if self._of(name)]
        else:
            shots = [pattern] if sums or pattern in darks else []
        return [
            finding
            for shot in shots
            for finding in room_findings(self._left(shot, sums), self._model, self.rig, self.config)
        ]

    def _maybe_lamp(self, sums: list[Sum]) -> bool:
        """Whether a lamp may be the cause: gains near 1, and none explains its camera's fault."""
        fits = [fit for one in sums for fit in self._fits[one].values()]
        gains = np.abs(np.log(np.clip([fit.gains for fit in fits], 1e-3, 1e3))).max(axis=1)
        explained = [
            fit.misfit < (1 - LAMP_EXPLAINED) * fit.before
            for fit, gain in zip(fits, gains, strict=True)
            if gain > self.config.max_gain_error
        ]
        return bool(gains.max() < LAMP_GAIN) and not any(explained)

    def _fit(self, one: Sum, cameras: list[str]) -> None:
        fits, shifts = self._fits.setdefault(one, {}), self._shifts.setdefault(one, {})
        for camera in cameras:
            first, second, whole = (self._photos[name, camera] for name in one.patterns)
            ambient = self._dark(camera)
            fit = fit_sum(first, second, whole, ambient)
            if fit is None:
                continue
            shift = sum_shift(first, second, whole, fit.gains)
            if not self._holds(fit) and shift is not None:
                # Motion leaves edges behind: is there still a fault when it is undone?
                still = fit_sum(first, second, whole, ambient, shift)
                if still is not None and self._holds(still):
                    fit = still
            fits[camera] = fit
            if shift is not None:
                shifts[camera] = shift

    def _holds(self, fit: SumFit) -> bool:
        """Whether a camera's photographs add up as they should."""
        off = float(np.abs(np.log(fit.gains.clip(1e-3))).max())
        return fit.misfit <= self.config.max_misfit_share and off <= self.config.max_gain_error

    def _evidence(self, one: Sum) -> Evidence:
        fits = self._fits.get(one, {})
        unlike: dict[tuple[str, str], tuple[str, float]] = {}
        names = self._lit_names()
        for camera, fit in fits.items():
            if fit.misfit <= self.config.max_misfit_share:
                continue
            for name in one.patterns[:2]:
                seen = seen_shares(self._photos[name, camera], self._photos[one.whole, camera])
                expected = self._model.shares(camera, self._photos[one.whole, camera], one.whole)
                if seen is not None and expected is not None:
                    unlike[name, camera] = looks_like(
                        name, self._model.patterns, unlikeness(seen, expected), names
                    )
        held = frozenset(
            camera
            for other, by_camera in self._fits.items()
            if other != one and other.whole == one.whole
            for camera, fit in by_camera.items()
            if self._holds(fit)
        )
        scale = {
            camera.id: float(np.linalg.norm(camera.centre_mm)) / camera.fx_px
            for camera in self.rig.cameras
        }
        return Evidence(one, fits, self._shifts.get(one, {}), scale, unlike, held)

    def _left(self, pattern: str, sums: list[Sum]) -> Left:
        """What a dark photograph or the sums leave over, in every camera."""
        light: dict[str, np.ndarray] = {}
        whole = sums[0].whole if sums else self._whole[kind_of(pattern)]
        wholes = self._of(whole)
        dark = self._totals[pattern] == 0
        for camera, photo in wholes.items():
            if dark and (pattern, camera) in self._photos:
                own = self._photos[pattern, camera].coarse[..., 1]
                if own.shape == photo.coarse.shape[:2]:
                    light[camera] = own.astype(float)
                continue
            parts = [
                self._photos[one.first, camera].coarse[..., 1].astype(float)
                + self._photos[one.second, camera].coarse[..., 1]
                - photo.coarse[..., 1]
                for one in sums
                if camera in self._fits.get(one, {})
            ]
            ambient = self._dark(camera)
            if parts:
                light[camera] = np.mean(parts, axis=0)
                if ambient is not None and ambient.shape[:2] == light[camera].shape:
                    light[camera] = light[camera] - ambient[..., 1]
        shares = {
            one: float(np.median([fit.ambient[1] for fit in fits.values()]))
            for one, fits in self._fits.items()
            if fits and one.whole == whole and one not in self._broken
        }
        known = any(self._dark(camera) is not None for camera in wholes)
        return Left(pattern, dark, known, tuple(sums), light, wholes, shares)

    def _wrong(self) -> set[tuple[str, str | None]]:
        """Pattern and camera of photographs with a fault; None is all cameras of the pattern."""
        return self._failed.union(*self._blamed.values())

    def _note_shares(
        self, pattern: str, photos: Mapping[str, Photo], wholes: Mapping[str, Photo]
    ) -> None:
        own = self._shares.setdefault(pattern, {})
        for camera, photo in photos.items():
            if camera in wholes and wholes[camera].mean > 0:
                own[camera] = photo.mean / wholes[camera].mean

    def _references(self, pattern: str) -> dict[str, tuple[str, Photo]]:
        """For each camera another photograph to compare its focus with: `full` or the last one."""
        out: dict[str, tuple[str, Photo]] = {}
        wrong = self._wrong()
        for (name, camera), photo in self._photos.items():
            if name != pattern and self._totals[name] > 0 and (name, camera) not in wrong:
                if camera in out and out[camera][0] == self._whole[kind_of(name)]:
                    continue
                out[camera] = name, photo
        return out

    def _dark(self, camera: str) -> np.ndarray | None:
        for name, total in self._totals.items():
            if total == 0 and (name, camera) in self._photos:
                return self._photos[name, camera].coarse
        return None

    def _of(self, pattern: str) -> dict[str, Photo]:
        return {
            camera.id: self._photos[pattern, camera.id]
            for camera in self.rig.cameras
            if (pattern, camera.id) in self._photos
        }

    def _lit(self, pattern: str) -> float:
        """Light of a pattern as a share of the brightest of its kind."""
        most = self._totals[self._whole[kind_of(pattern)]]
        share = self._totals[pattern] / most if most > 0 else 0.0
        return 1.0 if share >= FULL_STEP else share

    def _lit_names(self) -> list[str]:
        return [name for name, total in self._totals.items() if total > 0]

    def _brightest(self, kind: str) -> str:
        own = [name for name in self._levels if kind_of(name) == kind]
        return max(own, key=lambda name: self._totals[name])

    def _drop_old(self, camera_id: str) -> None:
        """Of patterns that nothing needs, the last few photographs of a camera are kept."""
        spare = [k for k in self._photos if k[1] == camera_id and k[0] not in self._needed]
        for key in spare[: max(len(spare) - self.config.kept_photographs, 0)]:
            del self._photos[key]


def _stale(pattern: str, camera_id: str, old: tuple[str, str]) -> Finding:
    return Finding(
        "retake",
        "stale",
        where(pattern, camera_id),
        f"the very picture of {old[1]} under {old[0]}",
        "a picture of its own: noise never repeats",
        "The camera gave an old picture; retake it.",
        pattern,
        camera_id,
    )


def _among(patterns: Sequence[str], found: Sequence[Finding]) -> list[Finding]:
    """Findings of a contradiction between these patterns: any of them may be the wrong one."""
    return [
        dataclasses.replace(each, suspects=tuple(p for p in patterns if p != each.pattern))
        for each in found
    ]


def _once(found: list[Finding]) -> list[Finding]:
    """The first finding of each code, pattern and camera."""
    seen: dict[tuple[str, str | None, str | None], Finding] = {}
    for finding in found:
        seen.setdefault((finding.code, finding.pattern, finding.camera), finding)
    return list(seen.values())


def _rounded(value: float) -> float:
    """Four digits; endless signal to noise is written as -1, which JSON can hold."""
    return float(f"{value:.4g}") if np.isfinite(value) else -1.0
