"""Registration: ears of people of ICT's model and of the scanned head with our own template.

python -m benchmarks.registration_ears
"""

from __future__ import annotations

import itertools
import time

from benchmarks.networks_people import chosen, of_other_topology, outside_of
from benchmarks.record import record
from lightstage.formats.template import default_template_path, load_template
from processing.registration.config import RegisterConfig
from processing.registration.providers import DetectedLandmarks, landmarks_of_mesh
from processing.registration.stage import register_mesh

PEOPLE, ROWS = 4, 96


def main() -> None:
    template = load_template(default_template_path())
    rows = []
    config, provider = RegisterConfig(), DetectedLandmarks(template)
    heads = [*chosen(["ict"], PEOPLE, False), *chosen(["scan"], 1, False)]
    for who, source in itertools.product(heads, ("true", "detected")):
        subject, kept = of_other_topology(who, ROWS)
        scan, landmarks_mm = outside_of(subject, kept), subject.landmarks_mm
        if source == "detected":
            marks_mm = template.mesh.vertices[template.landmarks]
            found = landmarks_of_mesh(scan, provider, config.detected_agree_mm, marks_mm)
            landmarks_mm = found.landmarks.points_mm
        begin = time.process_time()
        _, facts = register_mesh(scan, landmarks_mm, template, config)
        seconds = time.process_time() - begin
        areas = facts["scan_in_common_by_area"]
        cells = [
            f"{areas[area][figure]:.2f}"
            for area in ("ears", "around the ears")
            for figure in ("median_mm", "p95_mm")
        ]
        faults = [str(facts[name]) for name in ("triangles_flipped", "triangles_against_scan")]
        ears = str(facts["ears_found"])
        rows.append([who.name, source, ears, *cells, *faults, f"{seconds:.1f}"])
        print(rows[-1], flush=True)
    record(
        "Registration: ears",
        [
            "person",
            "landmarks",
            "ears found",
            "scan to mesh at the ears, median mm",
            "95 %",
            "within 20 mm of them, median mm",
            "95 %",
            "folded",
            "against the scan",
            "processor s",
        ],
        rows,
        "Our own template. Asked at the ears: .15 mm and 1.5 mm, no fold.",
    )


if __name__ == "__main__":
    main()
