"""Five shots in a hundred meet a fault of a camera, five one of the lights: a trial's story."""

from __future__ import annotations

import collections
import json
from pathlib import Path

from lightstage.formats.files import write_json
from lightstage.rig import Rig
from sim.devices.coded_stage import CodedStage
from sim.devices.fault_names import NAMES, OF_ICL
from sim.devices.faults import Fault, Story

SHARE = 0.05
"""Of all shots that meet a fault of any camera; and of all that meet one of the LED device."""
PACKETS_A_SHOT = 12
"""To the LED device: levels, and each camera asks whether they lasted."""
WAYS = ("request", "answer")
DURING = ("trigger", "download")
LAMPS = (3, 20, 41, 77, 102, 140)
"""Lamps that stick or die, some of each side."""
LASTING = ("fill-up", "duplicate-serial", "reset-on-open", "swapped-bank")


def trial_story(rig: Rig, shots: int, seed: int) -> Story:
    """Every kind of fault that these devices can have.

    Faults that happen once are drawn for each photograph and each packet; faults that last have
    their time: two windows of some shots, at a third and at two thirds of the trial.

    Args:
        rig: whose cameras they are.
        shots: of the whole trial.
        seed: of what is drawn.
    """
    camera: list[tuple[str, dict[str, str]]] = []
    line: list[tuple[str, dict[str, str]]] = []
    for name, kind in NAMES.items():
        if kind.lasts or kind.counted == "open" or name in OF_ICL:
            continue
        variants: list[dict[str, str]] = [{}]
        if "way" in kind.fields:
            variants = [{"way": way} for way in WAYS]
        elif "during" in kind.fields:
            variants = [{"during": during} for during in DURING]
        (line if kind.device == "leds" else camera).extend((name, each) for each in variants)
    packet = SHARE / PACKETS_A_SHOT / len(line)
    photograph = SHARE / len(rig.cameras) / len(camera)
    faults = [Fault(n, probability=packet, **more) for n, more in line]
    faults += [Fault(n, probability=photograph, **more) for n, more in camera]
    faults += [Fault("claimed", probability=SHARE), Fault("reset-on-open", at=2, until=2)]
    lamps = [n for n, k in NAMES.items() if "lights" in k.fields] + ["swapped-bank"]
    for number, name in enumerate(lamps):
        at = round(PACKETS_A_SHOT * shots * (number + 1) / (len(lamps) + 1))
        more = {} if name == "swapped-bank" else {"lights": LAMPS}
        # One that the device reports stops every capture at once; others pass unseen for shots.
        lasts = 8 if name in ("stuck-on", "dead-light") else 2 * PACKETS_A_SHOT
        faults.append(Fault(name, at=at, until=at + lasts, **more))
    ids = [each.id for each in rig.cameras]
    third = max(2, shots // 3)
    faults.append(Fault("fill-up", camera=ids[2], at=third, until=third + 1))
    # Last, so that to take it out of a camera's story changes nothing that is drawn.
    faults.append(Fault("duplicate-serial", camera=ids[5], at=2 * third, until=2 * third + 2))
    described = {fault.name for fault in faults}
    possible = set(NAMES) - set(OF_ICL)
    assert described == possible, possible - described
    return Story(faults, seed)


def operator_mends(stage: CodedStage) -> None:
    """Mend as an operator does before going on: batteries, wheels and cables of every camera."""
    for camera_id in stage.cameras.camera_ids:
        folder = stage.cameras.folder(camera_id)
        state = json.loads((folder / "state.json").read_text())
        state |= {"off": False, "changed": {}, "plug": folder.name}
        write_json(folder / "state.json", state)
        value = json.loads((folder / "camera.json").read_text())
        faults = value["story"]["fault"]
        last = faults[-1] if faults else {}
        at_shot = last.get("at", 0) <= state["shots"] + 1 <= last.get("until", 0)
        if last.get("name") == "duplicate-serial" and last.get("camera") == camera_id and at_shot:
            value["story"]["fault"] = faults[:-1]  # the right camera is plugged in again
            write_json(folder / "camera.json", value)


def faults_injected(log: Path) -> collections.Counter[str]:
    """Count how often each fault happened."""
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    return collections.Counter(str(line["name"]) for line in lines)
