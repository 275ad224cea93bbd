"""Errors of maps at scored places: albedos, normals, pictures.

Only pixels and texels are scored that are skin in the truth and that the result claims to know
(confidence above 0); the share of the skin that is so covered is printed beside each error,
since a method may not shine by leaving out what is hard.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from lightstage.counting import counted
from processing.colour import srgb_from_linear
from processing.errors import EvaluationError

DIFFUSE = "diffuse_albedo"
ALBEDOS = (DIFFUSE, "specular_albedo", "ambient_occlusion")
NORMALS = ("diffuse_normal", "specular_normal")
MapReader = Callable[[str], np.ndarray]


def samples_of(
    found: MapReader, true: MapReader, skin: np.ndarray, where: str, field: str
) -> dict[str, np.ndarray]:
    """Values of both sides at the scored places: NAME and NAME/true, (n, c) each."""
    confidence = found("confidence")
    if confidence.shape != skin.shape:
        raise EvaluationError(
            where,
            field=field,
            found=f"maps of {confidence.shape}",
            expected=f"the truth's {skin.shape}",
            hint="Is this the truth of another session?",
        )
    scored = skin & (confidence > 0)
    samples: dict[str, np.ndarray] = {}
    if not scored.any():
        return samples
    for name in (*ALBEDOS, *NORMALS):
        mine, theirs = found(name), true(name)
        if mine.size and theirs.size:
            if mine.shape != theirs.shape:
                raise EvaluationError(
                    where,
                    field=f"{field}, {name}",
                    found=f"a map of {mine.shape}",
                    expected=f"{theirs.shape}, as the truth has it",
                )
            samples[name] = mine[scored].reshape(int(scored.sum()), -1).astype(float)
            samples[f"{name}/true"] = theirs[scored].reshape(int(scored.sum()), -1).astype(float)
    return samples


def map_errors(samples: Mapping[str, np.ndarray], skin_pixels: int) -> dict[str, float]:
    """Errors of maps at scored places.

    Args:
        samples: NAME and NAME/true, (n, c) float64 each.
        skin_pixels: how many places are skin in the truth.

    Returns:
        coverage_share; for albedos and occlusion NAME_rmse and NAME_bias (mean of found - true);
        for the specular albedo also the best constant's RMSE and the share of it that is left; for
        the diffuse albedo PSNR (peak 1) of linear and of sRGB values; for normals mean and median
        degrees. `diffuse_as_specular_normal_mean_deg` is what taking the diffuse normal for the
        specular one would score.
    """
    facts: dict[str, float] = {}
    for name in ALBEDOS:
        if name not in samples:
            continue
        difference = samples[name] - samples[f"{name}/true"]
        facts[f"{name}_rmse"] = rms(difference)
        facts[f"{name}_bias"] = float(difference.mean())
    if "diffuse_albedo" in samples:
        mine, theirs = samples["diffuse_albedo"], samples["diffuse_albedo/true"]
        facts["diffuse_albedo_linear_psnr_db"] = psnr_db(mine, theirs)
        facts["diffuse_albedo_srgb_psnr_db"] = psnr_db(
            srgb_from_linear(mine), srgb_from_linear(theirs)
        )
    if "specular_albedo" in samples:
        theirs = samples["specular_albedo/true"]
        constant = rms(theirs - theirs.mean())
        facts["specular_albedo_best_constant_rmse"] = constant
        if constant > 0:
            facts["specular_albedo_share_of_best_constant"] = (
                facts["specular_albedo_rmse"] / constant
            )
    for name in NORMALS:
        if name in samples:
            _add_angles(facts, name, samples[name], samples[f"{name}/true"])
    if "diffuse_normal" in samples and "specular_normal" in samples:
        angles = angle_deg(samples["diffuse_normal"], samples["specular_normal/true"])
        facts["diffuse_as_specular_normal_mean_deg"] = float(angles.mean())
    count = max((len(values) for values in samples.values()), default=0)
    return {"coverage_share": count / max(1, skin_pixels), **facts}


def _add_angles(facts: dict[str, float], name: str, mine: np.ndarray, theirs: np.ndarray) -> None:
    angles = angle_deg(mine, theirs)
    facts[f"{name}_mean_deg"] = float(angles.mean())
    facts[f"{name}_median_deg"] = float(np.median(angles))


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between (n, 3) vectors of any length, (n,) degrees; 90 where one is zero."""
    # atan2 keeps small angles, where acos of a rounded dot product does not.
    cross = np.linalg.norm(np.cross(a, b), axis=1)
    dot = np.einsum("ni,ni->n", a, b)
    angles = np.degrees(np.arctan2(cross, dot))
    return np.where((cross == 0) & (dot == 0), 90.0, angles)


def psnr_db(found: np.ndarray, true: np.ndarray) -> float:
    """Peak signal-to-noise ratio of two (...) arrays in decibels for a peak of 1; at most 120."""
    return -20 * math.log10(max(rms(found - true), 1e-6))


def rms(difference: np.ndarray) -> float:
    """Root of the mean square of a (...) array."""
    return float(np.sqrt(np.mean(np.square(difference))))


def picture_errors(found: np.ndarray, true: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """Errors of a linear picture over a mask.

    Args:
        found: (h, w, 3) linear.
        true: (h, w, 3) linear.
        mask: (h, w) bool, not empty.

    Returns:
        rmse (linear, white = 1), relative_rmse (of the true picture's RMS) and srgb_psnr_db.
    """
    if found.shape != true.shape or not mask.any():
        raise EvaluationError(
            "picture",
            found=f"shape {found.shape}, {counted(int(mask.sum()), 'pixel')}",
            expected=f"shape {true.shape} and a mask",
        )
    mine, theirs = found[mask].astype(float), true[mask].astype(float)
    error = rms(mine - theirs)
    return {
        "rmse": error,
        "relative_rmse": error / max(rms(theirs), 1e-12),
        "srgb_psnr_db": psnr_db(srgb_from_linear(mine), srgb_from_linear(theirs)),
    }
