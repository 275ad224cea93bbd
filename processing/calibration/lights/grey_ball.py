"""How strong lamps are, from a grey ball: what its places read under each pattern.

A Lambertian place of normal n at p reads s sum_l level_l w_l max(0, n . l) (d0 / d)^2 c^e, with w_l
what the lamp gives, s the camera's scale, c the cosine to the lamp's axis. A cosine lobe is broad,
so a few patterns cannot measure each lamp: gains are sought nearest to what is known of them (their
highlights in the mirror ball, or 1), e the same. What lamps cannot explain is kept as an affine and
quadratic function of the normal for each pattern.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from processing.calibration.lights.config import GreyBallConfig
from processing.errors import ProcessingError

LEAST_FACING = 0.35
"""Cosine to the camera below which a grey ball is no longer Lambertian, and its rim is near."""
SOLVES = 20
"""Rounds at most: lamps near what is known of them settle in five, unlike ones (a standard
deviation of 0.5 of the logarithms) in twenty."""
CHANNELS = 3
MEASURED_SHARE = 0.5
"""The balls measure the exponent when they leave less than this share of its uncertainty."""
FIXED = 1e-6
CONVERGED = 1e-5
LARGEST_STEP = 0.5
"""Largest step of a gain's logarithm in one round: a larger one leaves where the linear model
holds, and grows until it overflows where the readings are not of this ball and these lamps."""
SETTLED = 1e-3
"""A last round that moves a gain by a larger share has found nothing."""
QUADRATIC = 9
"""Terms of a function of a unit normal up to the second degree: its constant is in the squares."""


@dataclasses.dataclass(frozen=True)
class Readings:
    """n places of a grey ball, as cameras read them under P patterns.

    Attributes:
        patterns: P names.
        levels: (P, L) that were driven.
        points_mm: (n, 3).
        normals: (n, 3) mean over each place, so a little shorter than 1.
        rgb: (n, P, 3) linear, finite, ambient light taken off.
        group: (n,) whose scale each is on: a camera's, in one pose.
    """

    patterns: tuple[str, ...]
    levels: np.ndarray
    points_mm: np.ndarray
    normals: np.ndarray
    rgb: np.ndarray
    group: np.ndarray


@dataclasses.dataclass(frozen=True)
class Gains:
    """Lamps' gains as the grey ball gives them.

    Attributes:
        rgb: (L, 3) gains relative to the nominal radiant intensity, mean 1 in each channel.
        sigma: (L,) standard deviation of one, as a share.
        exponent: of the lamps' fall-off.
        exponent_sigma: its standard deviation; near the configuration's where the balls do not
            measure it and its exponent is taken.
        stray: pattern to (3, 3, 4), see formats.lights.
        before: root mean square error of a reading with nominal gains, as a share of the typical
            one under all lamps.
        after: the same with these gains.
        left: the same with stray light too.
    """

    rgb: np.ndarray
    sigma: np.ndarray
    exponent: float
    exponent_sigma: float
    stray: Mapping[str, np.ndarray]
    before: float
    after: float
    left: float


def solve_gains(
    readings: Readings,
    lamps_mm: np.ndarray,
    known_log: np.ndarray,
    known_sigma: np.ndarray,
    config: GreyBallConfig,
) -> Gains:
    """Gains, fall-off and stray light from a grey ball.

    Args:
        readings: of one pose or more.
        lamps_mm: (L, 3) positions.
        known_log: (L, 3) natural logarithms of what is known of the gains; NaN where nothing is.
        known_sigma: (L,) their standard errors.
        config: the ball.

    Raises:
        ProcessingError: readings that no lamps explain.
    """
    count = len(lamps_mm)
    log, prior = expected_gains(known_log, known_sigma, config)
    nominal = np.zeros(count)
    group_count = int(readings.group.max()) + 1
    found, spread = np.zeros((count, CHANNELS)), np.zeros((count, CHANNELS))
    grey = readings.rgb.mean(axis=2)
    _, _, exponent, sigma = _solve(
        readings, grey, lamps_mm, log.mean(axis=1), prior, group_count, config
    )
    if sigma > MEASURED_SHARE * config.exponent_sigma:
        # A ball in the middle sees every lamp along its axis, and would fit its own noise.
        exponent = config.exponent
    exponent = max(exponent, 0.0)
    fixed = dataclasses.replace(config, exponent=exponent, exponent_sigma=FIXED)
    for c in range(CHANNELS):
        found[:, c], spread[:, c], _, _ = _solve(
            readings, readings.rgb[:, :, c], lamps_mm, log[:, c], prior, group_count, fixed
        )
    found -= np.log(np.exp(found).mean(axis=0))
    before = _misfit(readings, lamps_mm, np.tile(nominal[:, None], 3), config.exponent)
    after = _misfit(readings, lamps_mm, found, exponent)
    stray = _stray(readings, lamps_mm, found, exponent, config)
    left = _misfit(readings, lamps_mm, found, exponent, stray)
    return Gains(
        rgb=np.exp(found),
        sigma=spread.mean(axis=1),
        exponent=exponent,
        exponent_sigma=sigma,
        stray=stray,
        before=before,
        after=after,
        left=left,
    )


def expected_gains(
    known_log: np.ndarray, known_sigma: np.ndarray, config: GreyBallConfig
) -> tuple[np.ndarray, np.ndarray]:
    """(L, 3) logarithms of gains before the grey ball is used, and (L,) how well known."""
    measured = np.isfinite(known_log).all(axis=1) & np.isfinite(known_sigma)
    log = np.where(measured[:, None], known_log, 0.0)
    known = np.hypot(np.where(measured, known_sigma, 0.0), config.highlight_sigma)
    usual = config.gain_sigma**2
    # How unlike a stage's lamps are shows where highlights err less than lamps usually differ.
    sharp = measured & (known < 2 * config.gain_sigma)
    if sharp.any():
        spread = 1.4826 * float(np.median(np.abs(log[sharp] - np.median(log[sharp], axis=0))))
        usual = max(usual, spread**2 - float(np.median(known[sharp])) ** 2)
    share = np.where(measured, usual / (usual + known**2), 0.0)
    return log * share[:, None], np.where(measured, known * np.sqrt(share), np.sqrt(usual))


def lamp_readings(
    points_mm: np.ndarray, normals: np.ndarray, lamps_mm: np.ndarray, exponent: float
) -> tuple[np.ndarray, np.ndarray]:
    """What a white reads of each lamp of weight 1, and how it falls with the exponent.

    Returns:
        (n, L) readings; (n, L) their derivative by the exponent.
    """
    way = lamps_mm - points_mm[:, None]
    far = np.linalg.norm(way, axis=2)
    reference = np.linalg.norm(lamps_mm, axis=1)
    facing = np.maximum(np.einsum("nlk,nk->nl", way, normals) / far, 0)
    aside = np.einsum("nlk,lk->nl", way, lamps_mm) / (far * reference)
    aside = np.clip(aside, 1e-6, 1)
    light = facing * (reference / far) ** 2 * aside**exponent
    return light, light * np.log(aside)


def nominal_weights(lamps_mm: np.ndarray) -> np.ndarray:
    """(L,) what a white at the origin that faces lamps of equal intensity reads, up to a scale."""
    return np.asarray(1 / np.sum((lamps_mm / 1000.0) ** 2, axis=1))


def _solve(
    readings: Readings,
    value: np.ndarray,
    lamps_mm: np.ndarray,
    log: np.ndarray,
    prior: np.ndarray,
    groups: int,
    config: GreyBallConfig,
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """(L,) logarithms of gains, (L,) their sigma; exponent and its sigma, by (n, P) readings."""
    count = len(lamps_mm)
    points, normals, group = readings.points_mm, readings.normals, readings.group
    gain, exponent = log.copy(), config.exponent
    weights = nominal_weights(lamps_mm)
    cells = np.eye(groups)[group].T  # (groups, n) which place is of which
    light = fall = np.zeros((0, 0))
    normal = np.eye(count + groups + 1)
    moved = np.inf
    for _ in range(SOLVES):
        if not light.size or config.exponent_sigma > FIXED:
            light, fall = lamp_readings(points, normals, lamps_mm, exponent)
        strength = readings.levels * (weights * np.exp(gain))  # (P, L)
        model = light @ strength.T  # (n, P)
        power, both = cells @ (model**2).sum(axis=1), cells @ (model * value).sum(axis=1)
        scale = (both / np.where(power > 0, power, 1))[group]
        # On the lamps' own scale an error weighs the same all over a group.
        weight = (scale / _sigma(scale[:, None] * model, group, config)[:, 0]) ** 2
        left = np.where(scale[:, None] != 0, value / np.where(scale, scale, 1)[:, None], 0) - model
        by_exponent = fall @ strength.T
        heavy = weight[:, None] * light
        normal = np.zeros((count + groups + 1,) * 2)
        normal[:count, :count] = (light.T @ heavy) * (strength.T @ strength)
        shared = np.stack([((own * weight)[:, None] * light).T @ model for own in cells])
        normal[:count, count:-1] = np.einsum("glk,kl->lg", shared, strength)
        normal[:count, -1] = np.einsum("lk,kl->l", heavy.T @ by_exponent, strength)
        normal[count:-1, count:-1] = np.diag(cells @ (weight * (model**2).sum(axis=1)))
        normal[count:-1, -1] = cells @ (weight * (model * by_exponent).sum(axis=1))
        normal[-1, -1] = weight @ (by_exponent**2).sum(axis=1)
        normal += np.triu(normal, 1).T * (np.arange(len(normal))[:, None] >= count)
        right = np.concatenate(
            [
                np.einsum("lk,kl->l", heavy.T @ left, strength),
                cells @ (weight * (model * left).sum(axis=1)),
                [weight @ (by_exponent * left).sum(axis=1)],
            ]
        )
        normal[np.arange(count), np.arange(count)] += prior**-2
        right[:count] += (log - gain) * prior**-2
        # Scales are free; their own step is undone by the next round's, which is exact.
        normal[np.arange(count, count + groups), np.arange(count, count + groups)] += 1e-6
        normal[-1, -1] += config.exponent_sigma**-2
        right[-1] += (config.exponent - exponent) * config.exponent_sigma**-2
        step = np.linalg.solve(normal, right)
        moved = float(np.abs(step[:count]).max())
        step *= LARGEST_STEP / max(moved, LARGEST_STEP)
        gain += step[:count]
        exponent += float(step[-1])
        if moved < CONVERGED:
            break
    if not moved < SETTLED:
        raise ProcessingError(
            "grey ball",
            field="gains",
            found=f"lamps that do not settle: round {SOLVES} moved one by {moved:.2g}",
            expected="readings that the rig's lamps explain",
            hint="Check that the rig and the levels are those of the shots, that the ball is "
            "where it was photographed, and that nothing but the ball is in its outline.",
        )
    sigma_of = np.sqrt(np.diag(np.linalg.inv(normal)))
    return gain, sigma_of[:count], exponent, float(sigma_of[-1])


def _sigma(model: np.ndarray, group: np.ndarray, config: GreyBallConfig) -> np.ndarray:
    """(n, 1) error expected of a reading: a share of its group's typical brightest pattern."""
    brightest = model.max(axis=1)
    typical = np.array([np.median(brightest[group == g]) if (group == g).any() else 1.0
                        for g in range(int(group.max()) + 1)])  # fmt: skip
    return np.asarray(config.noise_share * np.maximum(typical[group], 1e-12))[:, None]


def _fitted(
    readings: Readings,
    lamps_mm: np.ndarray,
    log: np.ndarray,
    exponent: float,
    stray: Mapping[str, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, P, 3) readings on the lamps' scale, (n, P, 3) what the lamps give, (P, 3) its mean."""
    light, _ = lamp_readings(readings.points_mm, readings.normals, lamps_mm, exponent)
    weights = nominal_weights(lamps_mm)[:, None] * np.exp(log)
    model = np.einsum("nl,pl,lc->npc", light, readings.levels, weights, optimize=True)
    around = readings.levels @ weights / 4
    if stray:
        cells = np.array([stray[name] for name in readings.patterns])
        model += around * _quadratic(cells, readings.normals)
    out = np.zeros(model.shape)
    for g in range(int(readings.group.max()) + 1):
        own = readings.group == g
        power = np.sum(model[own] ** 2, axis=(0, 1))
        both = np.sum(readings.rgb[own] * model[own], axis=(0, 1))
        good = (power > 0) & (both > 0)
        out[own] = readings.rgb[own] * np.where(good, power / np.where(good, both, 1), 0)
    return out, model, around


def _misfit(
    readings: Readings,
    lamps_mm: np.ndarray,
    log: np.ndarray,
    exponent: float,
    stray: Mapping[str, np.ndarray] | None = None,
) -> float:
    value, model, _ = _fitted(readings, lamps_mm, log, exponent, stray)
    left = value - model
    return float(np.sqrt(np.mean(left**2)) / np.median(model.max(axis=1)))


def _quadratic(cells: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(n, P, 3) n . (A n + b) of (P, 3, 3, 4) cells [A | b]."""
    bent = np.einsum("pcij,nj->npci", cells[..., :3], normals, optimize=True) + cells[..., 3]
    return np.asarray(np.einsum("npci,ni->npc", bent, normals, optimize=True))


def quadratic_terms(normals: np.ndarray) -> np.ndarray:
    """(n, 9) x y z, then x^2 y^2 z^2 xy yz zx: the constant is in the squares' sum."""
    x, y, z = normals.T
    return np.stack([x, y, z, x * x, y * y, z * z, x * y, y * z, z * x], axis=1)


def _stray(
    readings: Readings,
    lamps_mm: np.ndarray,
    log: np.ndarray,
    exponent: float,
    config: GreyBallConfig,
) -> dict[str, np.ndarray]:
    """What is left of each pattern, as an affine and quadratic function of the normal."""
    value, model, around = _fitted(readings, lamps_mm, log, exponent)
    terms = quadratic_terms(readings.normals)
    out = {}
    for k, name in enumerate(readings.patterns):
        cells = np.zeros((3, 3, 4))
        for c in range(CHANNELS):
            left = (value[:, k, c] - model[:, k, c]) / max(around[k, c], 1e-12)
            noise = max(float(np.std(left)), 1e-6)
            # Places next to each other share their errors: each counts for a tenth.
            normal = terms.T @ terms / (10 * noise**2)
            normal[np.diag_indices(QUADRATIC)] += config.stray_share**-2
            found = np.linalg.solve(normal, terms.T @ left / (10 * noise**2))
            a, b, d, xy, yz, zx = found[3:]
            cells[c, :, :3] = [[a, xy / 2, zx / 2], [xy / 2, b, yz / 2], [zx / 2, yz / 2, d]]
            cells[c, :, 3] = found[:3]
        out[name] = cells
    return out
