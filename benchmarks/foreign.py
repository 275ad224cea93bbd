"""Maps of people whose skin another program made: Mitsuba's materials, with and without clothes.

The simulator gives faces, cameras and lamps; what skin does with light is Mitsuba's. Nothing of it
is known to `processing`, which takes skin for a layer below an interface. Gloss is not scored: the
truth's maps of it are the subject's, and a material has its own. Seeds below 400 were
looked at while working; ``--unseen`` takes others.

``python -m benchmarks.foreign``; ``--rows 360 --skins light --kinds principled`` to try.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.record import record
from benchmarks.reflectance_clothes import CLOTH, PEOPLE, errors, photographed, rig_of
from lightstage.formats.template import default_template_path
from processing.pipeline import PipelineConfig, run
from sim.foreign.materials import MATERIALS
from sim.foreign.world import ForeignWorld
from sim.people.clothing import collar, dressed
from sim.people.subjects import load_subject

SEED, UNSEEN = 301, 401


def main() -> None:
    """Make the people, their maps, and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=720, help="of a picture [720]")
    parser.add_argument("--skins", default=",".join(PEOPLE), help="light,dark")
    parser.add_argument("--kinds", default=",".join(MATERIALS), help=", ".join(MATERIALS))
    parser.add_argument("--unseen", action="store_true", help="people not looked at while working")
    chosen = parser.parse_args()
    seed = UNSEEN if chosen.unseen else SEED
    rows: list[tuple[Any, ...]] = []
    rig = rig_of(chosen.rows)
    for skin in chosen.skins.split(","):
        for kind in chosen.kinds.split(","):
            for clothed in (False, True):
                with tempfile.TemporaryDirectory(prefix="lightstage-foreign-") as name:
                    person = load_subject("parametric", seed, None, 1536, PEOPLE[skin])
                    if clothed:
                        person = dressed(person, collar(person), CLOTH)
                    world = ForeignWorld(person, rig, kind)
                    session = photographed(person, rig, world, seed, Path(name))
                    cells = maps_of(session, Path(name) / "out")
                rows.append((skin, kind, "collar" if clothed else "none", *cells))
                print(*rows[-1], sep=" | ", flush=True)
    record(
        "Reflectance: skins of another program",
        (
            "skin", "material", "clothes",
            "diffuse normals: all / above the chin / below, deg",
            "albedo RMSE / after one gain", "confidence above .5, %", "lobe", "scattering",
            "light from skin to skin", "reconstruct, s", "refine, s",
        ),
        rows,
        f"Own mesh, nine views of {chosen.rows} rows, no noise, skin seen under 70 degrees; "
        + ("people not looked at before." if chosen.unseen else "people looked at while working.")
        + " Truth has a round lobe, no scattering, no light from skin to skin.",
    )  # fmt: skip


def maps_of(session: Path, out: Path) -> tuple[str, ...]:
    """Cells of the table for one session."""
    stages = run(session, out, default_template_path(), PipelineConfig(), until="refine")["stages"]
    error, found = errors(out, session), stages["refine"]
    return (
        " / ".join(f"{error[part]:.2f}" for part in ("all", "above", "below")),
        f"{error['albedo']:.4f} / {error['albedo_after_gain']:.4f}",
        f"{100 * error['sure']:.1f}",
        f"{found['mirror_lobe']} x {found['mirror_lobe_stretch']:.2f}",
        f"{found['scattering']:g}",
        "yes" if found["light_from_skin_to_skin"] else "no",
        *(f"{stages[stage]['seconds']:.0f}" for stage in ("reconstruct", "refine")),
    )


if __name__ == "__main__":
    main()
