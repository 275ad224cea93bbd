"""Training on patches: generator against discriminators, with the rendering loss."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor, nn

from learning.average import follow, moving_average
from learning.checkpoint import AVERAGE, adam_tensors, fill, fill_adam, part_of
from learning.clock import RENDERING
from learning.data import Batch
from learning.devices import CPU
from learning.encoding import Reflectance
from learning.forward import Forward
from learning.losses import maps_loss, rendering_loss
from learning.networks.discriminator import Discriminators, feature_loss, verdict_loss
from learning.networks.generator import IN_CHANNELS, OUT_CHANNELS, Generator, initialise
from learning.patch_config import TrainConfig
from learning.processes import ALONE, Processes
from learning.score import answers_of
from learning.training import Trainer


class PatchTrainer(Trainer[TrainConfig, Batch]):
    """A generator, discriminators and their optimisers."""

    watched = "error"
    renders = True
    role = "generator"

    def __init__(
        self,
        config: TrainConfig,
        device: torch.device = CPU,
        processes: Processes = ALONE,
        in_channels: int = IN_CHANNELS,
        out_channels: int = OUT_CHANNELS,
    ) -> None:
        """Networks of the published channels, or of others."""
        super().__init__(config, device, processes)
        self.generator = Generator(config.generator, in_channels, out_channels)
        self.discriminators = Discriminators(in_channels + out_channels, config.discriminator)
        # Drawn on the processor, so that every device begins with the same weights.
        for network in self.networks():
            initialise(network)
            network.to(device)
        self.discriminators.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = moving_average(self.generator) if config.ema else None
        self._generate: Forward[Tensor] = Forward(self.generator, device, config)
        # Compiled they would be compiled anew for each of the ways in which they are called.
        uncompiled = dataclasses.replace(config, compile="off")
        self._judge: Forward[list[list[Tensor]]] = Forward(self.discriminators, device, uncompiled)
        betas = (config.beta1, config.beta2)
        self._generator_adam = torch.optim.Adam(
            self.generator.parameters(), config.learning_rate, betas
        )
        self._discriminator_adam = torch.optim.Adam(
            self.discriminators.parameters(), config.learning_rate, betas
        )

    def set_rate(self, done: float, _: int = 0) -> float:
        """See `Trainer`."""
        constant = self.config.constant_share
        left = min(1.0, (1 - done) / max(1e-9, 1 - constant))
        rate = self.config.learning_rate * max(0.0, left)
        for optimiser in (self._generator_adam, self._discriminator_adam):
            for group in optimiser.param_groups:
                group["lr"] = rate
        return rate

    def step(self, batch: Batch, number: int = 0) -> dict[str, float]:
        """Step `number` of both; returns the losses, and the maps' unweighted L1 as `error`."""
        config, processes = self.config, self.processes
        if processes.count > 1:
            (texel_mm,) = processes.mean([batch.skin.texel_mm])
            batch = dataclasses.replace(
                batch, skin=dataclasses.replace(batch.skin, texel_mm=texel_mm)
            )
        # Of this process's covered texels; patches are as many in each process.
        own = processes.weight(batch.covered.sum())
        found = self._generate(batch.inputs) * batch.covered_channels
        real_pair = torch.cat([batch.inputs, batch.target], dim=1)
        judged_real = self._judge(real_pair)
        judged_fake = self._judge(torch.cat([batch.inputs, found.detach()], dim=1))
        # Halved, so that the discriminators learn at half the generator's pace [Wang2018].
        judging = 0.5 * (verdict_loss(judged_fake, False) + verdict_loss(judged_real, True))
        self._discriminator_adam.zero_grad(set_to_none=True)
        judging.backward()
        processes.average_gradients(self.discriminators.parameters())
        self._discriminator_adam.step()

        self.discriminators.requires_grad_(False)
        judged = self._judge(torch.cat([batch.inputs, found], dim=1))
        # By the discriminators as they are now, as the fake pair is judged: features of those of
        # before the step would differ even where the generator is right.
        with torch.no_grad():
            real_features = self._judge(real_pair)
        error = own * maps_loss(found, batch)
        parts = {
            "adversarial": verdict_loss(judged, True),
            "features": config.feature_weight * feature_loss(real_features, judged),
            "maps": config.map_weight * error,
        }
        if config.render_weight > 0:
            with self.clock.part(RENDERING):
                rendered = rendering_loss(found, batch, config.render_norm)
            # Over patches the norm's mean is one over patches, over texels one over texels.
            share = own if config.render_norm == "texel" else 1.0
            parts["rendering"] = share * config.render_weight * rendered
        total = torch.stack(list(parts.values())).sum()
        self._generator_adam.zero_grad(set_to_none=True)
        total.backward()
        processes.average_gradients(self.generator.parameters())
        self._generator_adam.step()
        self.discriminators.requires_grad_(True)
        if self.average is not None:
            follow(self.average, self.generator, config.ema, number)
        losses = {name: float(value.detach()) for name, value in parts.items()}
        beside = {"discriminators": judging, "error": error}
        return {**losses, **{name: float(value.detach()) for name, value in beside.items()}}

    @property
    def trained(self) -> Generator:
        """The generator to score and to infer with: the average where there is one."""
        return (self.generator if self.average is None else self.average).eval()

    def answers(self) -> Callable[[Batch], Reflectance]:
        """What the generator to infer with finds on patches of the processor."""
        return answers_of(self.trained)

    def batch_tensors(self, batch: Batch) -> dict[str, Tensor]:
        """See `Trainer`."""
        return {name: getattr(batch, name) for name in ("inputs", "target", "covered", "texture")}

    def networks(self) -> tuple[nn.Module, ...]:
        """See `Trainer`."""
        return self.generator, self.discriminators

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """See `Trainer`."""
        state = {
            "generator": dict(self.generator.state_dict()),
            "training": {
                **{f"discriminators.{k}": v for k, v in self.discriminators.state_dict().items()},
                **adam_tensors(self._generator_adam, "generator_adam"),
                **adam_tensors(self._discriminator_adam, "discriminator_adam"),
            },
        }
        if self.average is not None:
            state[AVERAGE] = dict(self.average.state_dict())
        return state

    def begin_with(self, weights: dict[str, Tensor], where: Path) -> None:
        """See `Trainer`."""
        fill(self.generator, weights, where)
        if self.average is not None:
            fill(self.average, weights, where)

    def take_over(self, saved: dict[str, dict[str, Tensor]], where: Path) -> None:
        """See `Trainer`."""
        with torch.no_grad():
            fill(self.generator, saved["generator"], where)
            if self.average is not None:
                fill(self.average, saved[AVERAGE], where)
            fill(self.discriminators, part_of(saved["training"], "discriminators"), where)
        fill_adam(self._generator_adam, saved["training"], "generator_adam")
        fill_adam(self._discriminator_adam, saved["training"], "discriminator_adam")
