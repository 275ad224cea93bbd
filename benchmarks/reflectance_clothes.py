"""What clothes do to the maps of a face: a person in a grey collar with shoulders.

The collar shadows neck and chin, the shoulders hide lamps from below; neither is skin. Maps are
made with the person's true mesh and with our own, each without the clothes in the scene, with
what `reconstruct` finds of them, and with their true mesh. The simulator that photographs them
shares its model of skin with `refine`; of clothes, `processing` knows nothing.

``python -m benchmarks.reflectance_clothes``; ``--rows 360`` to try.
"""

from __future__ import annotations

import argparse
import dataclasses
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.record import record
from benchmarks.reflectance_scores import (
    STEEPEST_DEG,
    joined,
    read_maps,
    rms,
    scores,
    sure_share,
    true_view,
    view_samples,
)
from lightstage.commands import quiet
from lightstage.formats.landmarks import read_points_mm
from lightstage.formats.mesh import Mesh, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from lightstage.formats.template import default_template_path
from lightstage.rig import Rig, default_rig
from processing.pipeline import run
from processing.pipeline_config import PipelineConfig
from sim.light.world import World
from sim.people.clothing import CHIN, collar, dressed
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.people.traits import Traits
from sim.reference.world import ReferenceWorld
from sim.session import SessionConfig, truth_path, write_direct
from sim.truth import write_truth

SEED = 301
PEOPLE = {"light": Traits("female", 33, 2), "dark": Traits("male", 41, 5)}
CLOTH = (0.2, 0.2, 0.2)


def photographed(
    person: Subject, rig: Rig, world: World | ReferenceWorld, seed: int, root: Path
) -> Path:
    """A session of what a world shows, with the truth of its person; the session folder."""
    write_direct(world, root / "session", SessionConfig(sequence="binary"), seed, quiet)
    write_truth(World(person, rig), truth_path(root / "session"))
    return root / "session"


def rig_of(rows: int) -> Rig:
    """The default rig with pictures of so many rows."""
    return default_rig().scaled(rows / default_rig().cameras[0].height_px)


def errors(
    out: Path, session_path: Path, left_out: Mapping[str, np.ndarray] | None = None
) -> dict[str, float]:
    """Errors over all views' skin that is seen less steeply than 70 degrees.

    Args:
        out: processed folder.
        session_path: with its truth beside it.
        left_out: (h, w) bool of each camera, pixels that are not scored; None scores all skin.

    Returns:
        Mean angle of the diffuse normals of all, above and below the chin; RMSE of the diffuse
        albedo, as found and after the one factor that suits it best, since programs differ in
        whether albedo is given inside or outside of the interface that mirrors; share of the best
        constant's error that is left of the specular albedo over 2 mm; mean angle of the specular
        normals; share of confidence above .5.
    """
    found, true = ProcessedFolder(out), ProcessedFolder(truth_path(session_path))
    chin_mm = read_points_mm(true.true_landmarks)[CHIN, 1]
    parts, upper, albedos, known = [], [], [], []
    for camera in load_session(session_path).rig.cameras:
        truth, maps = true_view(true, camera), read_maps(found, camera.id)
        scored = np.ones(len(truth.albedo), bool)
        if left_out is not None:
            scored = ~left_out[camera.id][truth.skin]
        parts.append(view_samples(maps, truth).of(scored))
        high = true.read_view(camera.id, "position")[truth.skin][:, 1] > chin_mm
        upper.append(high[scored])
        albedos.append(maps.diffuse_albedo[truth.skin][scored])
        known.append(truth.albedo[scored])
    samples, above = joined(parts), np.concatenate(upper)
    albedo, exact = np.concatenate(albedos).astype(float), np.concatenate(known)
    gain = float((albedo * exact).sum() / max(float((albedo**2).sum()), 1e-12))
    every = scores(samples)
    return {
        "all": every["diffuse_normal_deg"],
        "above": float(samples.diffuse_deg[above].mean()),
        "below": float(samples.diffuse_deg[~above].mean()),
        "albedo": every["albedo_rmse"],
        "albedo_after_gain": rms(gain * albedo - exact),
        "specular": every["specular_2mm_share"],
        "specular_normal": every["specular_normal_deg"],
        "sure": sure_share(samples),
    }


def main() -> None:
    """Make the people, the maps, and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=720, help="of a picture [720]")
    parser.add_argument("--skins", default=",".join(PEOPLE), help="light,dark")
    chosen = parser.parse_args()
    rows: list[tuple[Any, ...]] = []
    for skin in chosen.skins.split(","):
        with tempfile.TemporaryDirectory(prefix="lightstage-clothes-") as name:
            root = Path(name)
            person = load_subject("parametric", SEED, None, 1536, PEOPLE[skin])
            clothes, rig = collar(person), rig_of(chosen.rows)
            wearing = dressed(person, clothes, CLOTH)
            photographed(wearing, rig, World(wearing, rig), SEED, root)
            write_ply(Mesh(person.mesh.vertices, person.mesh.triangles()), root / "skin.ply")
            write_ply(clothes, root / "clothes.ply")
            rows += [(skin, *cells) for cells in compared(root)]
    record(
        "Reflectance: clothes that cast shadows",
        (
            "skin", "mesh", "clothes", "diffuse normals: all / above the chin / below, deg",
            "albedo RMSE", "confidence above .5, %", "reconstruct, s", "refine, s",
        ),
        rows,
        f"Nine views of {chosen.rows} rows, no noise, skin seen under {STEEPEST_DEG:g} degrees; a "
        "grey collar and shoulders, which our simulator photographed.",
    )  # fmt: skip


def compared(root: Path) -> list[tuple[Any, ...]]:
    """Rows of the table for one person."""
    rows = []
    for mesh in ("true", "own"):
        for clothes in ("not in the scene", "as found", "true"):
            out = root / "out"
            shutil.rmtree(out, ignore_errors=True)
            base = PipelineConfig()
            how = dataclasses.replace(
                base.reconstruct,
                mesh=str(root / "skin.ply") if mesh == "true" else "",
                occluders=str(root / "clothes.ply") if clothes == "true" else "",
                find_occluders=clothes == "as found",
            )
            config = dataclasses.replace(base, reconstruct=how)
            report = run(root / "session", out, default_template_path(), config, until="refine")[
                "stages"
            ]
            error = errors(out, root / "session")
            degrees = " / ".join(f"{error[part]:.2f}" for part in ("all", "above", "below"))
            seconds = [f"{report[stage]['seconds']:.0f}" for stage in ("reconstruct", "refine")]
            albedo, sure = f"{error['albedo']:.4f}", f"{100 * error['sure']:.1f}"
            rows.append((mesh, clothes, degrees, albedo, sure, *seconds))
            print(*rows[-1], sep=" | ", flush=True)
    return rows


if __name__ == "__main__":
    main()
