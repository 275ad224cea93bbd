"""A session of simulated calibration targets, small and made once a test run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from lightstage.commands import quiet
from lightstage.formats.files import sha256_file, write_bytes, write_json
from lightstage.formats.session import load_session, save_session
from lightstage.rig import default_rig, save_rig
from sim.camera.flaws import PRESETS
from sim.targets.target_session import TargetsConfig, write_targets

CONFIG = TargetsConfig(board_poses=0, mirror_places_mm=())


def make_targets(out: Path, flaws: str, scale: float = 0.12, cameras: int = 2) -> Path:
    """Chart toward each camera, grey ball, two flats, two darks; truth beside it."""
    rig = default_rig()
    rig = dataclasses.replace(rig, cameras=rig.cameras[:cameras]).scaled(scale)
    return write_targets(rig, out, CONFIG, PRESETS[flaws], 3, quiet)


def make_lab(session: Path, lab: Path, created: str = "20260101T000000Z") -> Path:
    """The same photographs as a lab's shots: one folder a kind, one session a pose."""
    whole = load_session(session)
    file = whole.file
    time = f"{created[:4]}-{created[4:6]}-{created[6:8]}T00:00:00+00:00"
    for kind in ("chart", "grey", "flat", "dark"):
        root = lab / f"{kind}-{created}"
        poses = []
        names = [name for name in file.sequence if name.startswith(f"{kind}-")]
        faced = kind in ("chart", "flat")
        for index, name in enumerate(names):
            pose = root / f"pose-{index + 1:02d}"
            pattern = "dark" if kind == "dark" else "full"
            frames = []
            for frame in file.frames:
                if frame.pattern == name:
                    path = f"frames/{pattern}/{frame.camera}.dng"
                    write_bytes(pose / path, (session / frame.path).read_bytes())
                    frames.append(frame.model_copy(update={"pattern": pattern, "path": path}))
            values = {"sequence": [pattern], "frames": frames}
            values["patterns"] = {pattern: file.patterns[name]}
            save_rig(whole.rig, pose / "rig.json")
            save_session(pose, file.model_copy(update=values))
            poses.append(
                {
                    "index": index,
                    "folder": pose.name,
                    "faces": whole.rig.cameras[index].id if faced else None,
                    "session_sha256": sha256_file(pose / "session.json"),
                    "manifest_sha256": None,
                    "figures": {},
                }
            )
        write_json(
            root / "calibration.json",
            {
                "schema": "lightstage.calibration-shots/1",
                "id": f"{kind}1",
                "kind": kind,
                "created_utc": time,
                "finished_utc": time,
                "expires_utc": "2099-01-01T00:00:00+00:00",
                "rig_sha256": "0",
                "devices": {"cameras": {}, "leds": {}},
                "patterns": ["dark" if kind == "dark" else "full"],
                "poses_wanted": len(poses),
                "poses": poses,
            },
        )
    return lab
