"""What the published size would take on one GPU, from steps that were measured there.

The network's part is measured on the published networks themselves, by patches of the published
size with random maps: what a step takes does not depend on what a patch shows.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from learning.data import Batch
from learning.devices import device_name, moved
from learning.encoding import absolute_reference, covered_channels, encode_maps, network_input
from learning.patch_config import PatchConfig
from learning.patch_light import Scene, target_environment
from learning.presets import preset
from learning.render.shading import ShadeOptions, SkinMaps, unit
from learning.train import TRAINERS
from lightstage.errors import LightstageError
from lightstage.formats.files import read_json, write_json
from processing.dataset import Store

FILE, SCHEMA = "full-size.json", "lightstage.experiment.full-size/1"
WARM, STEPS = 3, 10
PRESETS = ("avatarme", "paper")
SCANS = 200 * 7
"""People and expressions of the published data [Lattas2021]."""
ROWS, PATCH_PX, STRIDE_PX, EPOCHS = 6144, 512, 256, 200


def measure_full_size(out: Path, device: torch.device, store: Store) -> str:
    """Measure steps of the published networks on a device, unless they were measured before.

    Returns:
        A sentence that states it.
    """
    if not (out / FILE).exists():
        try:
            seconds = {name: step_seconds(name, device) for name in PRESETS}
        except RuntimeError as error:
            # The experiment itself needs far less memory.
            return f"the published size was not measured: {' '.join(str(error).split())[:200]}"
        found: dict[str, Any] = {
            "schema": SCHEMA,
            "device": device_name(device),
            "patches_a_scan": patches_a_scan(store),
            "seconds_a_step": seconds,
        }
        write_json(out / FILE, found)
    return full_size_line(out)


def full_size_line(out: Path) -> str:
    """What the published trainings would take; nothing where it was not measured."""
    try:
        found = read_json(out / FILE, SCHEMA)
    except LightstageError:
        return ""
    steps = EPOCHS * SCANS * found["patches_a_scan"]
    each = [
        f"`{name}` {seconds:.3f} s a step, {steps * seconds / 86400:.0f} days"
        for name, seconds in found["seconds_a_step"].items()
    ]
    return (
        f"Full size on one {found['device']}, by {STEPS} measured steps of the published networks "
        f"on patches of {PATCH_PX} texels, one a step, without the time to make the batches: "
        f"{'; '.join(each)} for {EPOCHS} epochs of {SCANS} scans of "
        f"{found['patches_a_scan']:.0f} patches ({steps / 1e6:.0f} million steps)."
    )


def patches_a_scan(store: Store) -> float:
    """Published patches of a scan whose texture shows as much of the face as this store's do."""
    info = store.scans[0]
    size, stride = round(info.rows * PATCH_PX / ROWS), round(info.rows * STRIDE_PX / ROWS)
    return float(len(store.patch_origins(info.index, max(1, size), max(1, stride), 0.5)))


def step_seconds(
    name: str, device: torch.device, patch_px: int = PATCH_PX, width: int = 0
) -> float:
    """Median seconds of a step of a published preset on one patch.

    Args:
        name: of the preset.
        device: where.
        patch_px: side of the patch.
        width: of the networks, in place of the published one; 0 for that.
    """
    sizes = {"generator": {"width": width}, "discriminator": {"width": width}} if width else {}
    config = preset(name, {**sizes, "compile": "off", "data": {"patch_px": patch_px}}, "full size")
    assert isinstance(config, PatchConfig)
    trainer = TRAINERS[config.family][0](config, device)
    batch = moved(random_batch(config), device)
    seconds = []
    for number in range(WARM + STEPS):
        began = time.perf_counter()
        # The losses come back as numbers: the device has done the step by then.
        trainer.step(batch, number)
        seconds.append(time.perf_counter() - began)
    return sorted(seconds[WARM:])[STEPS // 2]


def random_batch(config: PatchConfig) -> Batch:
    """One patch of random maps, lit by the training's own number of environments."""
    size, draw = config.data.patch_px, torch.Generator().manual_seed(0)

    def random(channels: int) -> Tensor:
        return torch.rand(1, channels, size, size, generator=draw)

    one = torch.ones(1, 1, size, size)
    at = torch.linspace(-50, 50, size)
    position = torch.stack([at.expand(size, size), at[:, None].expand(size, size), random(1)[0, 0]])
    normal = unit(random(3) - 0.5 + torch.tensor([0.0, 0.0, 2.0]).view(1, 3, 1, 1))
    skin = SkinMaps(
        diffuse_albedo=random(3),
        specular_albedo=0.05 * random(1),
        diffuse_normal=normal,
        specular_normal=normal,
        shininess=32 * one,
        translucency=0.5 * one,
        position_mm=position[None],
        area=one,
        texel_mm=0.2,
        ambient_occlusion=one,
        edges=one.expand(-1, 2, -1, -1),
    )
    environment = target_environment(config.lights, config.shading, 0)
    seen = torch.ones(1, environment.rgb.shape[1], size, size)
    reference = absolute_reference(normal, config.data.specular_frame)
    channels = covered_channels(one, one)
    return Batch(
        inputs=network_input(skin.diffuse_albedo, normal, skin.diffuse_albedo, reference),
        target=encode_maps(skin, skin.diffuse_albedo, channels, reference),
        covered=one,
        covered_channels=channels,
        skin=skin,
        environment=environment,
        visibility=seen,
        draws=tuple(Scene(environment, seen) for _ in range(config.draws)),
        texture=skin.diffuse_albedo,
        reference=reference,
        smooth_normal=normal,
        options=ShadeOptions(config.shading),
        places=[(0, 0, 0)],
    )
