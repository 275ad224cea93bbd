"""Registration: ears of people of ICT's model and of the scanned head with our own template.

python -m benchmarks.registration_ears
"""

from __future__ import annotations

import time

from benchmarks.networks_people import chosen, of_other_topology, outside_of
from benchmarks.record import record
from lightstage.formats.template import default_template_path, load_template
from processing.registration.stage import RegisterConfig, register_mesh

PEOPLE, ROWS = 4, 96


def main() -> None:
    template = load_template(default_template_path())
    rows = []
    for who in [*chosen(["ict"], PEOPLE, False), *chosen(["scan"], 1, False)]:
        subject, kept = of_other_topology(who, ROWS)
        scan = outside_of(subject, kept)
        begin = time.process_time()
        _, facts = register_mesh(scan, subject.landmarks_mm, template, RegisterConfig())
        seconds = time.process_time() - begin
        areas = facts["scan_in_common_by_area"]
        cells = [
            f"{areas[area][figure]:.2f}"
            for area in ("ears", "around the ears")
            for figure in ("median_mm", "p95_mm")
        ]
        faults = [str(facts[name]) for name in ("triangles_flipped", "triangles_against_scan")]
        rows.append([who.name, str(facts["ears_found"]), *cells, *faults, f"{seconds:.1f}"])
        print(rows[-1], flush=True)
    record(
        "Registration: ears",
        [
            "person",
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
        "Our own template, true landmarks. Asked at the ears: .15 mm and 1.5 mm, no fold.",
    )


if __name__ == "__main__":
    main()
