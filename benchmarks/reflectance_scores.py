"""Errors of one person's maps against truth, as the accuracy benchmark states them.

All visible skin counts: pixels of the truth's skin that the camera sees less steeply than 70 deg.
Where a method has no result its maps are 0, and it is scored with that.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from lightstage.formats.processed import ProcessedFolder
from lightstage.rig import Camera
from processing.evaluation.maps import angle_deg
from processing.lighting.facets import BECKMANN, Facets
from processing.readings import px_per_mm

STEEPEST_DEG = 70.0
SURE = 0.5
"""Confidence above which a pixel is scored apart."""
AVERAGE_MM = 2.0
"""Side of the square that specular albedo is averaged over."""
FINE_MM = 2.0
"""Relief of a shorter wavelength is the specular normals' fine band."""
FINE_SIGMA_MM = FINE_MM * float(np.sqrt(np.log(2) / 2)) / np.pi
"""Sigma of the Gaussian that halves a wave of length FINE_MM."""


@dataclasses.dataclass(frozen=True)
class Maps:
    """One view's maps, (h, w) or (h, w, 3), 0 where the method has no result.

    Attributes:
        diffuse_normal, specular_normal, diffuse_albedo: (h, w, 3).
        specular_albedo, roughness, confidence: (h, w).
        facets: the family of lobes whose m the map of roughness holds.
    """

    diffuse_normal: np.ndarray
    specular_normal: np.ndarray
    diffuse_albedo: np.ndarray
    specular_albedo: np.ndarray
    roughness: np.ndarray
    confidence: np.ndarray
    facets: Facets = dataclasses.field(default=BECKMANN, kw_only=True)


def read_maps(folder: ProcessedFolder, camera_id: str, facets: Facets = BECKMANN) -> Maps:
    """A view's maps as a stage left them, whose report names the facets."""
    names = [field.name for field in dataclasses.fields(Maps) if field.name != "facets"]
    return Maps(*(folder.read_view(camera_id, name) for name in names), facets=facets)


@dataclasses.dataclass(frozen=True)
class Samples:
    """What n scored pixels of a person show; errors in the units of their names.

    Attributes:
        confidence: (n,) 0..1.
        solved: (n,) bool, the method gave a normal.
        albedo: (n,) mean over channels of the squared error of the diffuse albedo.
        diffuse_deg, specular_deg: (n,) angles of the normals.
        fine_deg: (n, 3) angle that the fine band of the specular normal, of the diffuse normal
            taken for it, and of no relief at all is off by.
        mirror, mirror_true: (n,) specular albedo.
        mirror_mean, mirror_mean_true: (n,) the same averaged over AVERAGE_MM.
    """

    confidence: np.ndarray
    solved: np.ndarray
    albedo: np.ndarray
    diffuse_deg: np.ndarray
    specular_deg: np.ndarray
    fine_deg: np.ndarray
    mirror: np.ndarray
    mirror_true: np.ndarray
    mirror_mean: np.ndarray
    mirror_mean_true: np.ndarray

    def of(self, chosen: np.ndarray) -> Samples:
        """Some of the pixels, by mask or index."""
        return Samples(*(getattr(self, f.name)[chosen] for f in dataclasses.fields(self)))


def joined(parts: list[Samples]) -> Samples:
    """The samples of several views as one."""
    return Samples(
        *(np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(Samples))
    )


@dataclasses.dataclass(frozen=True)
class TrueView:
    """One view's truth, read once for all methods.

    Attributes:
        mask: (h, w) bool, all skin.
        skin: (h, w) bool, the skin that is scored.
        albedo: (n, 3) of the scored skin's pixels, as all that follow.
        diffuse, specular: (n, 3) normals.
        fine: (n, 3) the specular normal's fine band.
        mirror, mirror_mean: (n,) specular albedo, and averaged over AVERAGE_MM.
        per_mm: pixels a millimetre.
    """

    mask: np.ndarray
    skin: np.ndarray
    albedo: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    fine: np.ndarray
    mirror: np.ndarray
    mirror_mean: np.ndarray
    per_mm: float


def true_view(truth: ProcessedFolder, camera: Camera) -> TrueView:
    """Read one view's truth."""
    mask = truth.read_mask(camera.id)
    albedo, mirror, diffuse, specular = (
        truth.read_view(camera.id, name)
        for name in ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal")
    )
    cosine = np.einsum("hwk,hwk->hw", specular, -camera.pixel_rays()[1])
    skin = mask & (cosine >= np.cos(np.radians(STEEPEST_DEG)))
    per_mm = px_per_mm(camera)
    return TrueView(
        mask,
        skin,
        albedo[skin],
        diffuse[skin],
        specular[skin],
        relief(specular, skin, FINE_SIGMA_MM * per_mm)[skin],
        mirror[skin],
        averaged(mirror, skin, _side(per_mm)),
        per_mm,
    )


def _side(per_mm: float) -> int:
    return max(1, round(AVERAGE_MM * per_mm))


def view_samples(maps: Maps, true: TrueView) -> Samples:
    """Compare one view's maps with truth."""
    skin = true.skin
    solved = skin & (np.einsum("hwk,hwk->hw", maps.diffuse_normal, maps.diffuse_normal) > 0.25)
    sigma = FINE_SIGMA_MM * true.per_mm
    fine = [relief(n, solved, sigma)[skin] for n in (maps.specular_normal, maps.diffuse_normal)]
    off = [np.linalg.norm(found - true.fine, axis=1) for found in (*fine, 0.0)]
    return Samples(
        confidence=maps.confidence[skin],
        solved=solved[skin],
        albedo=((maps.diffuse_albedo[skin].astype(float) - true.albedo) ** 2).mean(axis=1),
        diffuse_deg=angle_deg(maps.diffuse_normal[skin], true.diffuse),
        specular_deg=angle_deg(maps.specular_normal[skin], true.specular),
        fine_deg=np.degrees(np.stack(off, axis=1)),
        mirror=maps.specular_albedo[skin],
        mirror_true=true.mirror,
        mirror_mean=averaged(maps.specular_albedo, skin, _side(true.per_mm)),
        mirror_mean_true=true.mirror_mean,
    )


def relief(normals: np.ndarray, good: np.ndarray, sigma_px: float) -> np.ndarray:
    """(h, w, 3) normals less their Gaussian mean over good neighbours; 0 outside `good`."""
    weight = good.astype(np.float32)
    blur = (
        cv2.GaussianBlur(x, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT)
        for x in (np.where(good[..., None], normals, 0).astype(np.float32), weight)
    )
    total, share = blur
    mean = total / np.where(share > 0, share, 1)[..., None]
    return np.where(good[..., None], normals - mean, 0)


def averaged(values: np.ndarray, good: np.ndarray, side_px: int) -> np.ndarray:
    """(n,) means over the good pixels of a square around each good pixel."""
    size = (side_px, side_px)
    total, count = (
        cv2.boxFilter(x, cv2.CV_64F, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for x in (np.where(good, values, 0).astype(float), good.astype(float))
    )
    return np.asarray(total[good] / count[good])


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values, dtype=float))))


def scores(samples: Samples) -> dict[str, float]:
    """A person's errors over the given pixels.

    Returns:
        albedo_rmse; specular_2mm_share and specular_pixel_share (errors over those of the best
        constant), specular_varies (99th percentile of the true 2 mm means over the 1st);
        diffuse_normal_deg (mean) and diffuse_normal_median_deg; specular_normal_deg; fine_deg,
        fine_diffuse_deg and fine_nothing_deg (mean in the fine band of n_s, of n_d for n_s, of no
        relief), fine_gain (share by which n_s is nearer than n_d), fine_gain_rms (the same of RMS,
        which a few pixels in nostrils and lip lines decide); solved_share.
    """
    high, low = np.quantile(samples.mirror_mean_true, [0.99, 0.01])
    fine, as_diffuse, nothing = (float(column.mean()) for column in samples.fine_deg.T)
    squares = [rms(column) for column in samples.fine_deg.T]
    return {
        "albedo_rmse": float(np.sqrt(samples.albedo.mean())),
        "specular_2mm_share": rms(samples.mirror_mean - samples.mirror_mean_true)
        / max(float(samples.mirror_mean_true.std()), 1e-9),
        "specular_pixel_share": rms(samples.mirror - samples.mirror_true)
        / max(float(samples.mirror_true.std()), 1e-9),
        "specular_varies": float(high / max(low, 1e-9)),
        "diffuse_normal_deg": float(samples.diffuse_deg.mean()),
        "diffuse_normal_median_deg": float(np.median(samples.diffuse_deg)),
        "specular_normal_deg": float(samples.specular_deg.mean()),
        "fine_deg": fine,
        "fine_diffuse_deg": as_diffuse,
        "fine_nothing_deg": nothing,
        "fine_gain": 1 - fine / max(as_diffuse, 1e-9),
        "fine_gain_rms": 1 - squares[0] / max(squares[1], 1e-9),
        "solved_share": float(samples.solved.mean()),
    }


def sure_share(samples: Samples) -> float:
    """Share of the scored skin whose confidence is above SURE."""
    return float((samples.confidence > SURE).mean())


def deciles(samples: Samples) -> list[tuple[float, float, float, float]]:
    """Errors of ten equal parts of the pixels, from the least confident to the most.

    Pixels of the same confidence are shuffled, so that parts of one confidence have one error.

    Returns:
        For each: mean confidence, albedo RMSE, mean diffuse normal error in deg, specular RMSE.
    """
    shuffled = np.random.default_rng(0).permutation(len(samples.confidence))
    order = shuffled[np.argsort(samples.confidence[shuffled], kind="stable")]
    rows = []
    for part in np.array_split(order, 10):
        some = samples.of(part)
        rows.append(
            (
                float(some.confidence.mean()),
                float(np.sqrt(some.albedo.mean())),
                float(some.diffuse_deg.mean()),
                rms(some.mirror - some.mirror_true),
            )
        )
    return rows
