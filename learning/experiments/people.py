"""Which people of a store an experiment trains on, and on which it measures."""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np

from learning.errors import TrainingError
from learning.experiments.config import ExperimentConfig
from learning.experiments.variants import Variant
from learning.same_scans import KNOWN, listed, require_other_scans
from lightstage.counting import counted
from processing.dataset import Scan, Store
from processing.tones import ita_deg

QUARTER = 0.25
"""Share of the people that a setting leaves out, by their tone or by chance."""
TRAINED, HELD_OUT = "a", "b"
"""Before people's names: a training holds out the last ones by name."""
TONE_STEP = 4
"""Step over a texture's rows and columns, for the mean colour of a skin."""


@dataclasses.dataclass(frozen=True)
class Halves:
    """People of a store, in no order that matters but their names'.

    Attributes:
        trained: pseudonyms.
        held_out: pseudonyms.
    """

    trained: tuple[str, ...]
    held_out: tuple[str, ...]


def halves_of(store: Store, config: ExperimentConfig) -> Halves:
    """Who is trained on, and who is measured.

    Raises:
        TrainingError: too few people, names that the store does not have, people in both halves by
            name or by their scans.
    """
    everyone = sorted({scan.subject for scan in store.scans})
    _require_known(store, everyone, "held_out_names", config.held_out_names)
    _require_known(store, everyone, "train_names", config.train_names)
    held_out = config.held_out_names
    if not held_out:
        rest = [name for name in everyone if name not in config.train_names]
        held_out = tuple(rest[-config.held_out :])
        if len(held_out) < config.held_out:
            raise _too_few(store, len(rest), config.held_out)
    trained = config.train_names or tuple(n for n in everyone if n not in held_out)
    _require_apart(store, trained, held_out)
    if not trained:
        raise _too_few(store, len(everyone), len(held_out))
    return Halves(tuple(sorted(trained)), tuple(sorted(held_out)))


def of_variant(
    store: Store, halves: Halves, variant: Variant, config: ExperimentConfig, seed: int
) -> tuple[str, ...]:
    """Who of the people trained on one setting takes.

    A smaller number of people is drawn by the seed, and so are the three quarters of all tones, so
    that the differences between seeds include those between choices.

    Raises:
        TrainingError: fewer people than the setting is about.
    """
    chosen = halves.trained
    if variant.without:
        if variant.without == "any":
            ordered = [str(name) for name in np.random.default_rng([seed, 10]).permutation(chosen)]
        else:
            tones = tones_of(store, chosen)
            ordered = sorted(chosen, key=lambda name: tones[name])
        count = max(1, round(QUARTER * len(ordered)))
        left_out = ordered[-count:] if variant.without == "lightest" else ordered[:count]
        chosen = tuple(name for name in chosen if name not in left_out)
    most = variant.people or config.people
    if variant.people > len(halves.trained):
        raise TrainingError(
            store.path,
            field="subjects",
            found=f"{counted(len(halves.trained), 'person', 'people')} to train on",
            expected=f"{variant.people}, as the setting {variant.name} has",
            hint="Build a larger store, or leave this setting out by --only.",
        )
    if most and most < len(chosen):
        order = np.random.default_rng([seed, 9]).permutation(len(chosen))[:most]
        chosen = tuple(chosen[index] for index in sorted(order))
    if not chosen:
        raise _too_few(store, len(halves.trained), 1)
    return chosen


def store_of(store: Store, trained: tuple[str, ...], held_out: tuple[str, ...]) -> Store:
    """The store with these people alone, those held out being the last ones by name."""
    halves = {**dict.fromkeys(trained, TRAINED), **dict.fromkeys(held_out, HELD_OUT)}
    digest = hashlib.sha256(store.fingerprint.encode())
    scans: list[Scan] = []
    for scan in store.scans:
        if scan.subject in halves:
            name = f"{halves[scan.subject]}-{scan.subject}"
            digest.update(f"{name}, {scan.sha256}; ".encode())
            scans.append(dataclasses.replace(scan, index=len(scans), subject=name))
    return dataclasses.replace(store, scans=tuple(scans), fingerprint=digest.hexdigest())


def subject_of(name: str) -> str:
    """The pseudonym of a person of `store_of`."""
    return name.partition("-")[2]


def tones_of(store: Store, names: tuple[str, ...]) -> dict[str, float]:
    """Individual typology angle of each person's skin, degrees: light above, dark below."""
    found: dict[str, float] = {}
    everything = slice(None)
    for scan in store.scans:
        if scan.subject in names and scan.subject not in found:
            albedo = store.read(scan.index, "diffuse_albedo", everything, everything)
            seen = store.read(scan.index, "confidence", everything, everything)[..., 0] > 0
            step = slice(None, None, TONE_STEP)
            some = albedo[step, step][seen[step, step]]
            found[scan.subject] = ita_deg(some) if len(some) else 0.0
    return found


def _require_known(store: Store, everyone: list[str], field: str, asked: tuple[str, ...]) -> None:
    unknown = sorted(set(asked) - set(everyone))
    if unknown:
        raise TrainingError(
            store.path,
            field=field,
            found=listed(unknown),
            expected=f"people of this store, such as {listed(everyone)}",
        )


def _require_apart(store: Store, trained: tuple[str, ...], held_out: tuple[str, ...]) -> None:
    """Refuse a person of whom a network would know what it is measured on."""
    both = sorted(set(trained) & set(held_out))
    if both:
        raise TrainingError(
            store.path,
            field="train_names, held_out_names",
            found=f"{listed(both)} in both",
            expected="each person in one half",
            hint=KNOWN,
        )
    require_other_scans(store, trained, held_out)


def _too_few(store: Store, found: int, held_out: int) -> TrainingError:
    return TrainingError(
        store.path,
        field="subjects",
        found=counted(found, "person", "people"),
        expected=f"{held_out + 1} or more: {held_out} held out, the others trained on",
        hint="Add people to the store, or set a smaller held_out by --config.",
    )
