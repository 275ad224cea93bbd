"""Training of the `modern` preset: whole faces at low resolution, by squared errors alone."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from learning.augment import AugmentConfig
from learning.devices import CPU, moved
from learning.encoding import srgb_from_linear
from learning.errors import TrainingError
from learning.infer_checks import same_aspect
from learning.losses import masked_mean
from learning.network_trainer import NetworkTrainer
from learning.networks.whole_face import WholeFace, WholeFaceConfig, WholeFaceNetwork
from learning.run import Run
from learning.samples import MOST, Sample
from learning.training import Task
from learning.whole.config import WholeTrainConfig
from learning.whole.detail import Shares, bands, enlarged
from learning.whole.faces import LEAST_ALBEDO, FaceBatch, Faces, FacesConfig
from learning.whole.score import FaceScore, score_faces
from learning.whole.sides import answer_of
from processing.dataset import Store

LEAST_DOUBT = 1e-3
"""Added to the variance of the network's error, so that it is never taken for certain."""
WARM_UP_STEPS = 50
"""Steps in which the rate rises, as Adam's means of gradients settle."""


class WholeFaceTrainer(NetworkTrainer[WholeTrainConfig, FaceBatch, WholeFaceNetwork]):
    """The whole-face network and its optimiser."""

    watched = "diffuse"

    def fresh(self) -> WholeFaceNetwork:
        """See `NetworkTrainer`."""
        return WholeFaceNetwork(self.config.network)

    def optimiser(self) -> torch.optim.Adam:
        """See `NetworkTrainer`."""
        rate, decay = self.config.learning_rate, self.config.weight_decay
        return torch.optim.AdamW(self.network.parameters(), rate, weight_decay=decay)

    def rate(self, done: float, number: int) -> float:
        """It rises in the first steps and falls as a cosine."""
        rate = self.config.learning_rate * min(1.0, (number + 1) / WARM_UP_STEPS)
        return rate * (0.5 + 0.5 * math.cos(math.pi * min(1.0, done)))

    def losses(self, batch: FaceBatch) -> dict[str, Tensor]:
        """See `face_losses`."""
        losses = face_losses(self.forward, batch)
        if self.processes.count > 1:
            own = self.processes.weight(batch.weight.sum())
            losses = {name: own * value for name, value in losses.items()}
        return losses

    def weights(self) -> dict[str, float]:
        """See `NetworkTrainer`."""
        config = self.config
        return {"specular": config.specular_weight, "deviation": config.deviation_weight}


def face_losses(network: Callable[[Tensor], WholeFace], batch: FaceBatch) -> dict[str, Tensor]:
    """Squared errors of the network's answer, and how badly it knows its own error.

    Returns:
        diffuse: mean square of the sRGB-encoded diffuse albedo's error.
        specular: mean square of the error of the specular albedo's natural logarithm.
        deviation: of a normal distribution's negative log likelihood, with the expected error as
            its deviation; the error itself is given here, and is not made smaller by it.
    """
    answer = network(batch.inputs)
    error = srgb_from_linear(answer.diffuse_albedo) - srgb_from_linear(batch.diffuse_albedo)
    square = error.square()
    shine = answer.specular_albedo.log() - batch.specular_albedo.clamp_min(1e-3).log()
    variance = answer.deviation.square()
    given = square.detach().mean(dim=1, keepdim=True)
    return {
        "diffuse": masked_mean(square, batch.weight),
        "specular": masked_mean(shine.square(), batch.weight),
        "deviation": masked_mean(given / variance + variance.log(), batch.weight),
    }


def face_task(
    trainer: WholeFaceTrainer, store: Store, trained_on: set[str], held_out: set[str], run: Run
) -> Task[FaceBatch, FaceScore]:
    """Random faces (see `learning.train.TRAINERS`).

    At the end the shares of the texture's detail and the network's doubt are measured, on people
    trained on, and the people held out are scored.
    """
    config = trainer.config
    _require_aspect(config.network, store)
    rng, seed = np.random.default_rng([config.seed, 1]), config.seed

    def faces_of(
        people: set[str], how: FacesConfig, skins: AugmentConfig, lit_on: torch.device = CPU
    ) -> Faces:
        drawn = (config.lights, skins, rng, config.shading)
        own = (store, people, config.network, how)
        return Faces(*own, *drawn, clock=run.clock, lit_on=lit_on, shadows=run.shadows)

    faces = faces_of(trained_on, config.faces, config.augment, trainer.device)
    # Scored are people as they are, and all of their faces, in place.
    whole = dataclasses.replace(
        config.faces, partial_share=0.0, skin_share=0.0, closed_share=0.0, displaced_mm=0.0
    )
    scored = faces_of(held_out, whole, config.augment.as_they_are())
    if run.anew:
        trainer.network.set_people(faces.in_common(config.network.modes))

    def finish() -> tuple[FaceScore, list[Sample]]:
        trained = trainer.trained
        shares = torch.tensor(fit_shares(trained, faces, config))
        doubt = measured_doubt(trained, faces, config)
        for one in {trainer.network, trained}:
            one.detail_shares.copy_(shares)
            one.mode_doubt.copy_(doubt)
        found = score_faces(trained, scored, config.score_lights, seed)
        return found, _samples(trained, scored, seed)

    return Task(faces.draw, config.steps, len(faces.faces), finish)


def _require_aspect(size: WholeFaceConfig, store: Store) -> None:
    """Refuse a network whose faces are wider or narrower than the maps: `infer` takes none such."""
    rows, columns = store.scans[0].rows, store.scans[0].columns
    if not same_aspect(rows, columns, (size.rows, size.columns)):
        raise TrainingError(
            "training",
            field="network.rows, network.columns",
            found=f"{size.rows} x {size.columns}",
            expected=f"rows : columns = {rows} : {columns}, as {store.path} has its maps",
            hint="Change both alike by --config.",
        )


def _samples(network: WholeFaceNetwork, held_out: Faces, seed: int) -> list[Sample]:
    """Each scan of the people held out under one light, and what the network makes of it."""
    rng = np.random.default_rng([seed, 5])
    found = []
    for index, name in enumerate(held_out.names[:MOST]):
        pair = held_out.batch([index], rng)
        found_face = answer_of(network, pair.inputs)
        found.append(Sample(name, pair.texture, found_face.diffuse_albedo, pair.diffuse_albedo))
    return found


def fit_shares(network: WholeFaceNetwork, faces: Faces, config: WholeTrainConfig) -> list[float]:
    """How much of each band of a texture's detail is skin, over people trained on."""
    rng = np.random.default_rng([config.seed, 4])
    shares = Shares()
    for _ in range(config.detail_pairs):
        pair = faces.draw_large(rng)
        output = answer_of(network, pair.inputs)
        low = output.diffuse_albedo[0].permute(1, 2, 0).log().numpy()
        rows, columns = pair.texture.shape[:2]
        small = pair.small[0].permute(1, 2, 0).numpy()
        wanted = np.log(np.maximum(pair.diffuse_albedo, 1e-3)) - enlarged(low, rows, columns)
        shares.add(bands(pair.texture, pair.covered, small), wanted, pair.skin)
    return shares.solve()


def measured_doubt(network: WholeFaceNetwork, faces: Faces, config: WholeTrainConfig) -> Tensor:
    """(modes, modes) mean square of the network's error along the modes, in people's deviations.

    Over people trained on, in lights of other strengths and colours than they were trained in, at
    the same places. It is what refinement takes the network's answer for.
    """
    rng = np.random.default_rng([config.seed, 6])
    mean = network.mean_log_albedo.cpu()
    errors = []
    for _ in range(max(1, config.doubt_faces // config.batch)):
        pair = moved(faces.draw(config.batch, rng), CPU)
        output = answer_of(network, pair.inputs).diffuse_albedo.log()
        true = pair.diffuse_albedo.clamp_min(LEAST_ALBEDO).log()
        known = (output - mean, true - mean, pair.weight)
        for found_one, true_one, weight in zip(*known, strict=True):
            found = network.along_modes(torch.stack([found_one, true_one]), weight)
            errors.append(found[0] - found[1])
    each = torch.stack(errors)
    # A direction that so few people have is known no better than people differ in it.
    return each.T @ each / len(each) + LEAST_DOUBT * torch.eye(len(each[0]))
