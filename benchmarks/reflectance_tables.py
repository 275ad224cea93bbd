"""Tables of the accuracy benchmark: targets, people, deciles of confidence."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from benchmarks.reflectance_case import Result
from benchmarks.reflectance_people import person

OURS = ("coarse", "refine", "own-mesh")
"""Methods of our own; all others are peers, the yardstick apart."""
YARDSTICKS = ("polarised", "true maps")
"""How the names of yardsticks begin."""
VARIES = 2.0
"""Specular share counts for people whose specular albedo varies by this factor over the face."""
RISE = 1.02
"""Errors of parts of one confidence differ by chance; more than this counts as a rise."""

NO_GOAL = (float("nan"), float("nan"))


@dataclasses.dataclass(frozen=True)
class Target:
    """One row of the table that the maps are held to.

    Attributes:
        light: which the row is about.
        what: the row's words.
        key: of `scores`.
        goal: for light and dark skin, NO_GOAL where the row is printed beside the others.
        digits: printed.
        higher: whether more is better.
        alone: not held against peers, most of which know no confidence.
    """

    light: str
    what: str
    key: str
    goal: tuple[float, float]
    digits: int = 3
    higher: bool = False
    alone: bool = False


TARGETS = (
    Target("direct", "diffuse albedo RMSE", "albedo_rmse", (0.008, 0.008), 4),
    Target("direct", "specular over 2 mm, share of constant", "specular_2mm_share", (0.5, 0.5)),
    Target("direct", "specular per pixel, share of constant", "specular_pixel_share", (1, 1)),
    Target("direct", "diffuse normal, mean deg", "diffuse_normal_deg", (0.8, 1.3), 2),
    Target(
        "direct", "specular normal under 2 mm, nearer than n_d", "fine_gain", (0.2, 0.2), 3, True
    ),
    Target("direct", "the same by RMS", "fine_gain_rms", NO_GOAL, 3, True),
    Target("direct", "specular normal under 2 mm, mean deg", "fine_deg", NO_GOAL, 2),
    Target("direct", "specular normal, mean deg", "specular_normal_deg", (4, 4), 2),
    Target(
        "direct",
        "confidence above .5, share of skin",
        "sure_share",
        (0.9, 0.9),
        3,
        True,
        alone=True,
    ),
    Target(
        "reference",
        "confidence above .5, share of skin",
        "sure_share",
        (0.9, 0.9),
        3,
        True,
        alone=True,
    ),
    Target("reference", "diffuse albedo RMSE", "albedo_rmse", (0.02, 0.015), 4),
    Target("reference", "specular over 2 mm, share of constant", "specular_2mm_share", (0.7, 0.7)),
    Target("reference", "20 new lights, PSNR dB", "psnr_db", (34, 34), 2, True),
)

Results = dict[tuple[str, str, str], Result]
"""By light, person and method."""


def people_rows(results: Results, light: str) -> list[list[str]]:
    """One row a person and method under a light."""
    rows = []
    for (where, name, method), result in results.items():
        if where != light:
            continue
        for label, found, share in (("all", result.every, 1.0),
                                    ("sure", result.sure, result.every["sure_share"])):  # fmt: skip
            if not found:
                rows.append([name, method, label, f"{100 * share:.1f}", *[""] * 11])
                continue
            rows.append(
                [
                    name,
                    method,
                    label,
                    f"{100 * share:.1f}",
                    f"{found['albedo_rmse']:.4f}",
                    f"{found['specular_2mm_share']:.3f}",
                    f"{found['specular_pixel_share']:.3f}",
                    f"{found['specular_varies']:.2f}",
                    f"{found['diffuse_normal_deg']:.2f} / {found['diffuse_normal_median_deg']:.2f}",
                    f"{found['specular_normal_deg']:.2f}",
                    f"{found['fine_deg']:.2f}",
                    f"{found['fine_diffuse_deg']:.2f}",
                    f"{found['fine_nothing_deg']:.2f}",
                    f"{found['fine_gain']:.3f}",
                    f"{found['psnr_db']:.2f} / {found['psnr_white_db']:.2f}"
                    if "psnr_db" in found
                    else "",
                ]
            )
    return rows


PEOPLE_HEADER = (
    "person", "method", "skin", "share %", "albedo RMSE", "specular 2 mm", "specular px",
    "varies by", "n_d mean / median deg", "n_s deg", "fine n_s", "fine n_d", "fine none",
    "fine gain", "new lights dB (own peak / white 1)",
)  # fmt: skip


def target_rows(results: Results, method: str) -> list[list[str]]:
    """The table of targets: measured, over the target, over the best peer, for light and dark."""
    rows = []
    for target in TARGETS:
        for column, skin in enumerate(("light", "dark")):
            mine = _mean(results, target, method, skin)
            if mine is None:
                continue
            value, worst, count = mine
            goal = target.goal[column]
            aimed = np.isfinite(goal)
            met = value >= goal if target.higher else value <= goal
            peers = {
                peer: found[0]
                for peer in dict.fromkeys(key[2] for key in results)
                if not target.alone
                and peer not in OURS
                and not peer.startswith(YARDSTICKS)
                and (found := _mean(results, target, peer, skin))
            }
            best = min(peers, key=lambda p: -peers[p] if target.higher else peers[p], default="")
            rows.append(
                [
                    target.light,
                    target.what,
                    skin,
                    f"{goal:g}" if aimed else "",
                    f"{value:.{target.digits}f}",
                    f"{worst:.{target.digits}f}",
                    str(count),
                    _against(target, value, goal) if aimed else "",
                    ("yes" if met else "NO") if aimed else "",
                    f"{best} {peers[best]:.{target.digits}f}" if best else "",
                    _against(target, value, peers[best]) if best else "",
                    _better(target, value, peers[best]) if best else "",
                ]
            )
    return rows


def _against(target: Target, value: float, other: float) -> str:
    """The ratio of two figures; the difference of two that are no errors."""
    return f"{value - other:+.{target.digits}f}" if target.higher else f"{value / other:.2f}"


def _better(target: Target, value: float, other: float) -> str:
    return "yes" if (value > other if target.higher else value < other) else "NO"


TARGET_HEADER = (
    "light", "row", "skin", "target", "mean", "worst", "people", "mean / target", "met",
    "best peer", "ours / peer", "better",
)  # fmt: skip


def _mean(
    results: Results, target: Target, method: str, skin: str
) -> tuple[float, float, int] | None:
    """Mean and worst over people of one column, and how many they are."""
    values = [
        result.every[target.key]
        for (light, name, how), result in results.items()
        if light == target.light and how == method and person(name).skin == skin
        and ("specular_2mm" not in target.key or result.every["specular_varies"] >= VARIES)
    ]  # fmt: skip
    if not values:
        return None
    worst = min(values) if target.higher else max(values)
    return float(np.mean(values)), worst, len(values)


def decile_rows(results: Results) -> list[list[str]]:
    """Errors by decile of confidence, and whether they fall."""
    rows = []
    for (light, name, method), result in results.items():
        columns = list(zip(*result.deciles, strict=True))
        for label, column, digits in (
            ("confidence", columns[0], 2),
            ("albedo RMSE", columns[1], 4),
            ("n_d deg", columns[2], 2),
            ("specular RMSE", columns[3], 4),
        ):
            rises = sum(b > RISE * a for a, b in itertools.pairwise(column))
            cells = [f"{value:.{digits}f}" for value in column]
            rise = "" if label == "confidence" else str(rises)
            rows.append([light, name, method, label, *cells, rise])
    return rows


DECILE_HEADER = (
    "light", "person", "method", "by decile of confidence",
    *(f"{10 * k}-{10 * k + 10} %" for k in range(10)), "rises of 9",
)  # fmt: skip
