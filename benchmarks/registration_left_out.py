"""Landmarks left out of a fit: how far from them the registered mesh's own ones are.

python -m benchmarks.registration_left_out [--scan HEAD.ply --landmarks L.json]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.record import record
from benchmarks.registration_case import make_case, model
from lightstage.formats.landmarks import read_points_mm
from lightstage.formats.mesh import Mesh, read_ply
from lightstage.formats.template import Template, default_template_path, load_template
from processing.registration.config import RegisterConfig
from processing.registration.stage import register_mesh
from sim.scans.lps import load_scan, scan_folder

PROTOCOLS = {"every second": 2, "each fifth": 5}
"""So many fits; each leaves out one landmark of so many, and every one is left out once."""
PARTS = {
    "all": slice(0, 68),
    "jaw line": slice(0, 17),
    "brows": slice(17, 27),
    "nose": slice(27, 36),
    "eyes": slice(36, 48),
    "mouth": slice(48, 68),
}


def left_out(scan: Mesh, landmarks_mm: np.ndarray, template: Template, fits: int) -> np.ndarray:
    """(68,) mm from each landmark to its vertex in the fit that did not have it."""
    error = np.full(len(landmarks_mm), np.nan)
    for first in range(fits):
        given = landmarks_mm.copy()
        given[first::fits] = np.nan
        found, _ = register_mesh(scan, given, template, RegisterConfig())
        away = np.linalg.norm(found[template.landmarks] - landmarks_mm, axis=1)
        error[first::fits] = away[first::fits]
    return error


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--scan", type=Path, help="a reconstructed head")
    parser.add_argument("--landmarks", type=Path, help="of that scan")
    arguments = parser.parse_args()
    ours = load_template(default_template_path())
    ict = model()
    cases: dict[str, tuple[Mesh, np.ndarray, Template]] = {}
    for seed in (1,):
        case = make_case(ict, seed, expression="neutral")
        cases[f"person {seed} of ICT's, its topology"] = (
            case.scan,
            case.landmarks_mm,
            case.template,
        )
    folder = scan_folder()
    if folder is not None and not arguments.scan:
        head = load_scan(folder, 96)
        cases["Lee Perry-Smith's scan"] = (head.mesh, head.landmarks_mm, ours)
    if arguments.scan:
        cases["Lee Perry-Smith's, reconstructed"] = (
            read_ply(arguments.scan),
            read_points_mm(arguments.landmarks),
            ours,
        )
    rows = []
    for name, parts in cases.items():
        for protocol, fits in PROTOCOLS.items():
            error = left_out(*parts, fits)
            rows.append([name, protocol, *(f"{np.nanmean(error[p]):.2f}" for p in PARTS.values())])
            print(rows[-1], flush=True)
    record(
        "Registration: landmarks left out of the fit",
        ["head", "left out", *(f"{part}, mm mean" for part in PARTS)],
        rows,
        "ICT's people have neutral faces, no modes and landmarks at the same vertices as the "
        "template. Lee Perry-Smith's (CC BY 3.0) were read off pictures of the scan and are fitted "
        "with our template, whose landmarks are our own: its row has both definitions in it.",
    )


if __name__ == "__main__":
    main()
