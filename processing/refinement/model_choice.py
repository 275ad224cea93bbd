"""Which model of light a face has: the simplest that predicts readings which it was not fitted to.

The simplest is Beckmann's round lobe, no light from skin to skin and none that wanders inside the
skin. GGX's tails, a stretched lobe, a mirror that does not rise toward grazing angles, skin that
all light enters, light from skin to skin and each amount of scattering are steps beyond it. One
half of some pixels of every view fits the gloss of each model. In the other half the patterns of
one axis after the other are left out, and predicted from the rest: a gradient and its complement go
together, for each is `full` less the other whatever the face. A step is taken where it predicts
better, by more than a margin and than what parts of the face differ by.

Noisy readings choose wrongly: what a model errs by in colour, which distinguishes the lobes, then
weighs little beside what the mesh errs by in all colours alike. So readings are averaged over
neighbouring pixels first.

Source: [Stone1974] for choice by cross-validation.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from lightstage.patterns import complement
from processing.lighting.facets import BECKMANN, Facets
from processing.refinement.averaging import averaged, averaged_side
from processing.refinement.config import RefineConfig
from processing.refinement.gloss import better_gloss, sum_at_vertices
from processing.refinement.joint import (
    Given,
    Scattered,
    gloss_evidence,
    held_out,
    solve_jointly,
    solve_searching,
)
from processing.refinement.scene import Scene, View, from_edge, given_of, steady

ROUNDS = 3
"""Steps by which gloss and normals are fitted to each model, from the same start: a model that went
on from another's gloss would be farther from its own best."""
SHINIER = (0.5, 0.25)
"""Shares of `RefineConfig.roughness` that all models start from instead where that predicts better:
`ROUNDS` steps do not go from the lobe of skin to that of a film of oil."""
STRETCH = 1.2
"""By what factor a lobe's stretch is tried wider, as long as that helps."""
MOST_STRETCHED = 2.0
MARGIN = 0.003
"""A richer model must predict so much better: the mean logarithm of the squared errors' ratio."""
SCATTERING_MARGIN = 0.01
"""The same of scattering: a blurred picture is calm where sharp relief should be, too."""
SURE = 2.0
"""So many standard errors of the mean over parts of the face the gain must be above the margin."""
SIDES = 4
"""Quarters of directions, seen from a camera: sideways both ways, upward, downward."""
ASLANT_DEG = 35.0
"""Skin seen more steeply than this is a part of its own on each side."""
LEAST_PIXELS = 20
"""Least number of pixels of a part of the face."""
HOPELESS = -0.02
"""A step that gains less is not tried again beside another one."""
FIRST_LOOK = 4
"""Of so many pairs of pixels, one that is fitted to and one that is predicted, one is inspected
first, and both models are fitted to these alone; a step that is hopeless by more than its error
there is not tried with all of them."""


@dataclasses.dataclass(frozen=True)
class Model:
    """What light does.

    Attributes:
        facets: of the mirror lobe.
        bounces: light goes from skin to skin.
        scattering: number of the configuration's amount.
    """

    facets: Facets = BECKMANN
    bounces: bool = False
    scattering: int = 0


@dataclasses.dataclass(frozen=True)
class Step:
    """The gain of one step beyond a model.

    Attributes:
        name: of the step.
        gain: how much better left-out readings are predicted: the mean over parts of the face of
            the logarithm of the squared errors' ratio.
        error: standard error of that mean.
        taken: whether the step was made.
    """

    name: str
    gain: float
    error: float
    taken: bool

    @property
    def fact(self) -> str:
        """For the report."""
        gain = f"{100 * self.gain:+.1f} % +- {100 * self.error:.1f}"
        return f"{gain}, {'taken' if self.taken else 'left out'}"


@dataclasses.dataclass(frozen=True)
class Sample:
    """Some of a view's pixels.

    Attributes:
        view: they are of.
        band: (n,) their numbers.
        trust: (n,) 0..1.
        part: (n,) which way they face: a side, and SIDES more where they are seen aslant.
        whole: what wanders to them if all light did.
    """

    view: View
    band: np.ndarray
    trust: np.ndarray
    part: np.ndarray
    whole: Scattered

    def thinned(self) -> Sample:
        """One of `FIRST_LOOK` pairs of its pixels."""
        some = np.arange(len(self.band)) // 2 % FIRST_LOOK == 0
        whole = Scattered(self.whole.kept, self.whole.rest[some])
        return Sample(self.view, self.band[some], self.trust[some], self.part[some], whole)

    def around(self, amount: float) -> Scattered:
        """What wanders to them: proportional to the amount."""
        if amount == 0:
            return Scattered(np.ones(3), np.zeros_like(self.whole.rest))
        return Scattered(
            1 - amount + amount * self.whole.kept, np.float32(amount) * self.whole.rest
        )


@dataclasses.dataclass(frozen=True)
class Fitted:
    """A model fitted to a sample.

    Attributes:
        scene: with the model and its gloss.
        errors: of each view's sample, squared errors of left-out readings over their variance; NaN
            where none was predicted.
    """

    scene: Scene
    errors: list[np.ndarray]


def best_model(
    scene: Scene,
    views: list[View],
    wandering: list[Scattered],
    bounced: np.ndarray | None,
    config: RefineConfig,
) -> tuple[Scene, list[Step]]:
    """The simplest model that predicts what it was not fitted to.

    Args:
        scene: before anything was found.
        views: of which about `config.choice_pixels` pixels are used.
        wandering: what wanders to each view's pixels if all light did.
        bounced: (V, P, 3) irradiance by light from other skin; None where it is not tried.
        config: see there.

    Returns:
        The scene with its model, and gloss to start from; the steps that were tried last.
    """
    groups = left_out_groups(scene.lights.patterns)
    side = averaged_side(config.noise_sensor)
    config = dataclasses.replace(config, noise_sensor=config.noise_sensor / side)
    samples = list(sampled([averaged(view, side) for view in views], wandering, config, side))
    few = [sample.thinned() for sample in samples]
    scene, of_few = started(scene, few, groups, config)

    def fit(model: Model, to: list[Sample]) -> Fitted:
        return fitted(scene, model, to, groups, bounced, config)

    model = Model()
    best = fit(model, samples)
    steps: dict[str, Step] = {}
    while True:
        tried: list[tuple[Step, Model, Fitted, Fitted]] = []
        for name, richer in richer_models(model, bounced is not None, len(config.scattering)):
            if name in steps and steps[name].gain < HOPELESS:
                continue
            oriented = richer.facets.stretch != 1
            rich_few = fit(richer, few)
            steps[name] = compared(name, of_few, rich_few, few, oriented)
            if steps[name].gain + SURE * steps[name].error >= HOPELESS:
                rich = fit(richer, samples)
                steps[name] = compared(name, best, rich, samples, oriented)
                tried.append((steps[name], richer, rich, rich_few))
        taken = [each for each in tried if each[0].taken]
        if not taken:
            return best.scene, list(steps.values())
        step, model, best, of_few = max(taken, key=lambda each: each[0].gain)
        for other in taken:
            steps[other[0].name] = dataclasses.replace(other[0], taken=other[0] is step)


def started(
    scene: Scene, few: list[Sample], groups: np.ndarray, config: RefineConfig
) -> tuple[Scene, Fitted]:
    """The scene with the lobe width that all models start from, and the simplest of them."""
    start, best = scene, fitted(scene, Model(), few, groups, None, config)
    for share in SHINIER:
        gloss = dataclasses.replace(scene.gloss, roughness=share * scene.gloss.roughness)
        shinier = dataclasses.replace(scene, gloss=gloss)
        found = fitted(shinier, Model(), few, groups, None, config)
        if compared("shinier", best, found, few, False).taken:
            start, best = shinier, found
    return start, best


def left_out_groups(patterns: Sequence[str]) -> np.ndarray:
    """(P,) number of the group in which each pattern is left out, -1 for those that never are.

    A gradient goes with its complement, and with itself through another polariser.
    """
    numbers: dict[frozenset[str], int] = {}
    groups = []
    for pattern in patterns:
        base = pattern.partition("@")[0]
        if base == "full":
            groups.append(-1)
            continue
        together = frozenset({base, complement(base) or base})
        groups.append(numbers.setdefault(together, len(numbers)))
    return np.array(groups)


def richer_models(model: Model, bounces: bool, amounts: int) -> Iterator[tuple[str, Model]]:
    """Names of the steps beyond a model, and the models to which they lead."""
    facets = model.facets
    if not facets.tails:
        yield "tails", dataclasses.replace(model, facets=dataclasses.replace(facets, tails=True))
    for name, factor in (("wider sideways", STRETCH), ("wider upward", 1 / STRETCH)):
        stretch = facets.stretch * factor
        # Never back.
        if (facets.stretch - 1) * (factor - 1) < 0 or abs(np.log(stretch)) > np.log(MOST_STRETCHED):
            continue
        yield name, dataclasses.replace(model, facets=dataclasses.replace(facets, stretch=stretch))
    if facets.covers:
        yield (
            "all light enters",
            dataclasses.replace(model, facets=dataclasses.replace(facets, covers=False)),
        )
    if facets.rises:
        yield (
            "mirrors alike at all angles",
            dataclasses.replace(model, facets=dataclasses.replace(facets, rises=False)),
        )
    if facets.rises and not facets.tails:
        # Either alone may predict worse: long tails stand in for what rises, and the other way.
        yield (
            "tails, alike at all angles",
            dataclasses.replace(model, facets=dataclasses.replace(facets, tails=True, rises=False)),
        )
    if bounces and not model.bounces:
        yield "light from skin to skin", dataclasses.replace(model, bounces=True)
    if model.scattering + 1 < amounts:
        yield "scattering", dataclasses.replace(model, scattering=model.scattering + 1)


def sampled(
    views: list[View], wandering: list[Scattered], config: RefineConfig, side: int
) -> Iterator[Sample]:
    """About `config.choice_pixels` pixels, as many of each view, spread evenly.

    Readings are means over `side` pixels a side; those that reach beyond an edge have no trust.
    """
    each = max(1, config.choice_pixels // len(views))
    for view, whole in zip(views, wandering, strict=True):
        band = np.arange(0, len(view.rgb), -(-len(view.rgb) // each))
        rest = Scattered(whole.kept, whole.rest[band])
        inside = from_edge(view.sight, config) > side // 2
        trust = np.where(view.usable & inside, steady(view, config), 0)[band]
        yield Sample(view, band, trust, orientation(view, band), rest)


def orientation(view: View, band: np.ndarray) -> np.ndarray:
    """(n,) which side the mesh's normals point to, seen from the camera, and whether aslant."""
    normals, toward = view.sight.normals[band], view.sight.views[band]
    sideways = np.cross([0.0, 1.0, 0.0], toward)
    upward = np.cross(toward, sideways)
    x, y = (np.einsum("nk,nk->n", normals, axis) for axis in (sideways, upward))
    side = np.where(np.abs(x) > np.abs(y), np.where(x > 0, 0, 1), np.where(y > 0, 2, 3))
    aslant = np.einsum("nk,nk->n", normals, toward) < np.cos(np.radians(ASLANT_DEG))
    return np.asarray(side + SIDES * aslant)


def fitted(
    scene: Scene,
    model: Model,
    samples: list[Sample],
    groups: np.ndarray,
    bounced: np.ndarray | None,
    config: RefineConfig,
) -> Fitted:
    """Gloss fitted to every other pixel, and how the pixels between them predict their readings.

    Colour decides, as for gloss: what bounces and scattering do to a pattern's light would count
    for more than the lobe's shape, in all channels alike.
    """
    light = bounced if model.bounces and bounced is not None else np.zeros_like(scene.bounced)
    amount = config.scattering[model.scattering]
    scene = dataclasses.replace(
        scene, facets=model.facets, bounced=light, bounces=float(model.bounces), scattering=amount
    )
    arounds = [sample.around(amount) for sample in samples]
    normals = [_starts(sample) for sample in samples]
    for _ in range(ROUNDS):
        sums = np.zeros((len(scene.surface.vertices), 5))
        for k, sample in enumerate(samples):
            given = _given(scene, sample, normals[k], arounds[k], config)
            normals[k] = solve_searching(given, config.apart_deg).normal
            fit_from = slice(0, None, 2)
            some = _given(scene, sample, normals[k], arounds[k], config, fit_from)
            evidence = gloss_evidence(some) * sample.trust[fit_from, None]
            shadows = some.place.shadows
            sums += sum_at_vertices(evidence, shadows.corners, shadows.weights, len(sums))
        gloss = better_gloss(
            scene.gloss,
            sums,
            scene.surface,
            roughness_pool_mm=config.roughness_pool_mm,
            specular_pool_mm=config.specular_pool_mm,
            prior=config.gloss_prior,
            spread=config.gloss_spread,
        )
        scene = dataclasses.replace(scene, gloss=gloss)
    errors = []
    for k, sample in enumerate(samples):
        held = slice(1, None, 2)
        given = _given(scene, sample, normals[k], arounds[k], config, held)
        solved = solve_jointly(given, rounds=1)
        given = dataclasses.replace(given, normals=solved.normal)
        off = held_out(given, groups).mean(axis=1)
        good = (solved.misfit > 0) & (sample.trust[held] > 0.5)
        errors.append(np.where(good, off, np.nan))
    return Fitted(scene, errors)


def _starts(sample: Sample) -> np.ndarray:
    """(n, 3) the mesh's normals, zero where no reading can be used."""
    view, band = sample.view, sample.band
    return np.where(view.usable[band, None], view.sight.normals[band], 0)


def _given(
    scene: Scene,
    sample: Sample,
    normals: np.ndarray,
    around: Scattered,
    config: RefineConfig,
    some: slice = slice(None),
) -> Given:
    """What `joint` takes of some of a sample's pixels."""
    part = Scattered(around.kept, around.rest[some])
    noise, band = config.choice_noise, sample.band[some]
    return given_of(scene, sample.view, band, normals[some], part, noise)


def compared(
    name: str, simple: Fitted, rich: Fitted, samples: list[Sample], oriented: bool
) -> Step:
    """How much better a richer model predicts what was left out.

    Args:
        name: of the step.
        simple, rich: fitted to the same samples.
        samples: they were fitted to.
        oriented: the step needs evidence from all sides but one: else what another flaw of the
            model does to one side of the face would pass for it.
    """
    every = np.concatenate([x[np.isfinite(x)] for x in simple.errors])
    # A pixel that is predicted better than most counts no more by being predicted better still.
    usual = float(np.median(every)) if len(every) else 0.0
    gains, sides = [], []
    for sample, ours, theirs in zip(samples, simple.errors, rich.errors, strict=True):
        change = np.log((ours + usual) / (theirs + usual)) if usual > 0 else np.nan * ours
        part = sample.part[1::2]
        for number in range(2 * SIDES):
            there = change[(part == number) & np.isfinite(change)]
            if len(there) >= LEAST_PIXELS:
                gains.append(float(there.mean()))
                sides.append(number % SIDES)
    if len(gains) < 2:
        return Step(name, 0.0, 0.0, taken=False)
    gain = float(np.mean(gains))
    error = float(np.std(gains, ddof=1) / np.sqrt(len(gains)))
    margin = SCATTERING_MARGIN if name == "scattering" else MARGIN
    taken = gain > margin + SURE * error
    if oriented:
        each = [
            float(np.mean([g for g, at in zip(gains, sides, strict=True) if at == side]))
            for side in sorted(set(sides))
        ]
        taken = taken and len(each) >= 3 and sum(bool(x <= margin) for x in each) <= 1
    return Step(name, gain, error, taken)
