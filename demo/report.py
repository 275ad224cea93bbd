"""The demo's report: a picture of every stage and the table of errors, seconds and memory.

`python -m demo.report build/demo` reads what `demo.run` left there and writes report.html,
figures.json and readme.jpg.
"""

from __future__ import annotations

import datetime
import sys
from pathlib import Path
from typing import Any

import typer

from benchmarks.record import commit, machine
from demo.context import Demo, read_demo
from demo.sections import (
    atlas_section,
    dataset_section,
    geometry_section,
    learning_section,
    maps_section,
    readme_strip,
    relit_section,
    stage_section,
)
from lightstage.counting import counted
from lightstage.errors import LightstageError
from lightstage.formats.files import read_json, write_bytes, write_json
from processing.report import Picture, Section, Table, encode, write_report

README_BYTES = 300_000

Row = tuple[str, str, float, str]
"""Part, what, value, unit."""


def write_demo_report(root: Path) -> dict[str, Any]:
    """Write report.html, figures.json and readme.jpg; returns the figures.

    Args:
        root: the folder of a demo whose steps are all done.

    Raises:
        LightstageError: a part is missing or damaged.
    """
    demo = read_demo(root)
    steps = read_json(demo.at.steps)["steps"]
    report = read_json(demo.at.processed / "report.json")
    strip = readme_strip(demo)
    errors = error_rows(demo)
    sections = [
        Section(
            "In one picture",
            [
                Picture(
                    strip,
                    "From left to right: one of the photographs; the skin's colour without light; "
                    "the directions in which it faces; the reconstructed shape; the captured head "
                    "under a light in which it was never photographed; the true head under it.",
                    "the whole way",
                )
            ],
        ),
        stage_section(demo),
        maps_section(demo),
        geometry_section(demo),
        atlas_section(demo),
        dataset_section(demo),
        learning_section(demo),
        relit_section(demo),
        Section("Figures", figure_parts(errors, steps, report)),
    ]
    figures = {
        "schema": "lightstage.figures/1",
        "errors": [
            {"part": part, "what": what, "value": value, "unit": unit}
            for part, what, value, unit in errors
        ],
        "steps": steps,
        "coarse": demo.coarse_errors,
        "evaluation": demo.errors,
        "inference": demo.inference,
        "input_as_albedo": demo.input_errors,
        "relit": {relit.name: relit.errors for relit in demo.relit},
    }
    write_json(root / "figures.json", figures)
    quality = 90
    while len(picture := encode(strip, quality=quality)) > README_BYTES and quality > 40:
        quality -= 10
    write_bytes(root / "readme.jpg", picture)
    write_report(
        demo.at.report,
        "A face, captured and relit",
        sections,
        f"The person shown: {demo.source}. Captured in simulation.",
    )
    return figures


def error_rows(demo: Demo) -> list[Row]:
    """Every headline error: part, what, value, unit."""
    rows: list[Row] = []
    for part, facts in (("coarse maps", demo.coarse_errors), ("exact maps", demo.errors)):
        rows += _pick(part, facts["views"], VIEW_ROWS)
    rows += _pick("mesh", demo.errors["base_mesh"], MESH_ROWS)
    rows += _pick("registration", demo.errors["registered_mesh"], REGISTRATION_ROWS)
    rows += _pick("atlas", demo.errors["atlas"], ATLAS_ROWS)
    # The network fills the whole texture; it is scored where the captured atlas is.
    rows += _pick("inference", demo.inference, ATLAS_ROWS[1:])
    rows.append(
        (
            "inference",
            "the lit texture itself taken as albedo, PSNR in sRGB",
            demo.input_errors["srgb_psnr_db"],
            "dB",
        )
    )
    rows += _pick(
        "training of the demo, simulated person held out", demo.metrics[-1], HELD_OUT_ROWS
    )
    for relit in demo.relit:
        part = f"relit, {relit.name}"
        rows.append((part, "skin that is covered", relit.errors["coverage_share"], "1"))
        rows.append((part, "RMSE as a share of the picture's", relit.errors["relative_rmse"], "1"))
        rows.append((part, "PSNR in sRGB", relit.errors["srgb_psnr_db"], "dB"))
    return rows


VIEW_ROWS = (
    ("coverage_share", "skin that is covered", "1"),
    ("diffuse_albedo_rmse", "diffuse albedo RMSE", "1"),
    ("specular_albedo_rmse", "specular albedo RMSE", "1"),
    ("specular_albedo_share_of_best_constant", "the same, as a share of the best constant's", "1"),
    ("diffuse_normal_mean_deg", "diffuse normals, mean", "deg"),
    ("diffuse_normal_median_deg", "diffuse normals, median", "deg"),
    ("specular_normal_mean_deg", "specular normals, mean", "deg"),
)
MESH_ROWS = (
    ("base_mesh_median_mm", "mesh to truth, median", "mm"),
    ("base_mesh_p95_mm", "mesh to truth, 95th percentile", "mm"),
    ("skin_median_mm", "true skin to mesh, median", "mm"),
    ("skin_within_share", "true skin within 0.5 mm of the mesh", "1"),
)
REGISTRATION_ROWS = (
    ("skin_median_mm", "true skin to registered surface, median", "mm"),
    ("landmark_mean_mm", "landmarks, mean", "mm"),
    ("correspondence_mean_mm", "corresponding points, mean", "mm"),
)
ATLAS_ROWS = (
    ("coverage_share", "skin that is covered", "1"),
    ("diffuse_albedo_rmse", "diffuse albedo RMSE", "1"),
    ("diffuse_albedo_srgb_psnr_db", "diffuse albedo PSNR in sRGB", "dB"),
    ("specular_albedo_rmse", "specular albedo RMSE", "1"),
    ("diffuse_normal_mean_deg", "diffuse normals, mean", "deg"),
    ("specular_normal_mean_deg", "specular normals, mean", "deg"),
)


HELD_OUT_ROWS = (
    ("psnr_db", "diffuse albedo PSNR", "dB"),
    ("psnr_gain_db", "the same after the best gain a channel", "dB"),
    ("psnr_input_db", "the lit texture itself taken as albedo, PSNR", "dB"),
    ("psnr_mean_db", "the mean of the other people taken as albedo, PSNR", "dB"),
    ("psnr_tone_db", "the person's true tone alone, PSNR", "dB"),
)


def _pick(part: str, facts: dict[str, Any], wanted: tuple[tuple[str, str, str], ...]) -> list[Row]:
    return [(part, words, float(facts[key]), unit) for key, words, unit in wanted if key in facts]


def figure_parts(
    errors: list[Row], steps: list[dict[str, Any]], report: dict[str, Any]
) -> list[str | Picture | Table]:
    """The tables: errors, seconds and memory, versions."""
    seconds = sum(step["seconds"] for step in steps)
    peak = max(step["peak_mb"] for step in steps)
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    versions: dict[str, str] = report["versions"]
    return [
        Table(
            ("part", "error against truth", "value", "unit"),
            errors,
            "Over the face skin of which the result claims to know something (the share is "
            "beside). Albedo: 1 is perfect white. Unit 1 means a plain number.",
        ),
        Table(
            ("step", "seconds", "peak memory, MB"),
            [
                *((s["name"], f"{s['seconds']:.1f}", f"{s['peak_mb']:.0f}") for s in steps),
                ("all", f"{seconds:.0f}", f"{peak:.0f}"),
            ],
            "Each step is one command. Memory is the largest sum over its processes, sampled five "
            "times a second; pages that processes share count once for each.",
        ),
        Table(
            ("stage of processing", "seconds", "peak memory, MB"),
            [
                (name, f"{facts['seconds']:.1f}", f"{facts['peak_rss_mb']:.0f}")
                for name, facts in report["stages"].items()
            ],
            "The same inside the two steps of processing.",
        ),
        Table(("what", "version"), list(versions.items()), f"{today}, {machine()}, {commit()}"),
        *(f"Warning of processing: {warning}" for warning in report.get("warnings", [])),
    ]


def main(root: Path = typer.Argument(Path("build/demo"), help="A finished demo's folder.")) -> None:
    """Write the report."""
    try:
        figures = write_demo_report(root)
    except LightstageError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        raise typer.Exit(2) from None
    size = (root / "report.html").stat().st_size / 1e6
    known = counted(len(figures["errors"]), "figure")
    print(f"{root / 'report.html'}: {known} against known answers, {size:.1f} MB")


if __name__ == "__main__":
    typer.run(main)
