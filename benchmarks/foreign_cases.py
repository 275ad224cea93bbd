"""The scenes of `benchmarks.foreign`: who sits there, of which skin, wearing what, seen how.

A scene is one line of `CASES`. Those marked as seen were looked at while working; the others were
made with other people, and are run by ``--unseen`` alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from benchmarks.reflectance_clothes import rig_of
from lightstage.formats.mesh import Mesh
from lightstage.rig import Rig
from sim.foreign.cameras import Glare, Grain
from sim.foreign.rigs import on_planes
from sim.foreign.world import Effect, ForeignWorld, as_they_are
from sim.light.lamps import LampConfig, Lamps, lamps_of
from sim.people.clothing import collar, dressed
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.people.traits import Traits
from sim.people.worn import beard, fringe, glasses, hair_over_ear

TEXTURE_ROWS = 960
SAMPLES = 1
"""Places of a pixel that are averaged. Four cost four times as much and blur what is compared."""
OILY_ALPHA, DRY_ALPHA = 0.09, 0.42
"""Median alpha of skin as slick as these looks are."""
STRETCH = 1.5
DISCS = LampConfig(radius_mm=20.0, exponent=2.5)
"""Discs of 40 mm behind a lens: their light falls by a power of the cosine that is not in
the rig."""

Colour = tuple[float, float, float]
WORN: dict[str, tuple[Callable[[Subject, int], Mesh], Colour, float, float]] = {
    "grey collar": (lambda who, _: collar(who), (0.2, 0.2, 0.2), 0.0, 0.5),
    "dark collar": (lambda who, _: collar(who), (0.02, 0.02, 0.025), 0.0, 0.5),
    "red collar": (lambda who, _: collar(who), (0.4, 0.03, 0.02), 0.0, 0.5),
    "fringe": (fringe, (0.04, 0.025, 0.015), 0.03, 0.25),
    "beard": (beard, (0.05, 0.03, 0.02), 0.0, 0.5),
    "hair over an ear": (hair_over_ear, (0.03, 0.02, 0.015), 0.03, 0.2),
    "glasses": (lambda who, _: glasses(who), (0.02, 0.02, 0.02), 0.05, 0.1),
}
"""What is worn: how it is made for a person of a seed, its albedo, mirror and roughness."""
CAMERAS: dict[str, Effect] = {"plain": as_they_are, "glare": Glare(), "grain": Grain()}
RIGS: dict[str, Callable[[Rig], Rig]] = {"default": lambda rig: rig, "on planes": on_planes}
ALPHAS = {"plain": None, "oily": OILY_ALPHA, "dry": DRY_ALPHA}


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene.

    Attributes:
        seed: of the person; below 400 it was looked at while working.
        who: ``parametric`` or ``ict``.
        tone: of the skin, 1 to 6.
        material: of `sim.foreign.materials.MATERIALS`.
        wears: of `WORN`.
        gloss: of `ALPHAS`.
        stretch: of the mirror.
        lamps: None for those of the rig.
        rig: of `RIGS`.
        camera: of `CAMERAS`.
    """

    seed: int
    who: str
    tone: int
    material: str
    wears: tuple[str, ...] = ()
    gloss: str = "plain"
    stretch: float = 1.0
    lamps: LampConfig | None = None
    rig: str = "default"
    camera: str = "plain"

    @property
    def seen(self) -> bool:
        """Is true of people who were looked at while working."""
        return self.seed < FIRST_UNSEEN

    @property
    def skin(self) -> str:
        """``light`` or ``dark``: which targets it is held against."""
        return "light" if self.tone <= DARKEST_LIGHT else "dark"

    def person(self) -> Subject:
        """Who sits there, with nothing on."""
        rng = np.random.default_rng([self.seed, 60])
        traits = Traits(("female", "male")[self.seed % 2], float(rng.uniform(20, 70)), self.tone)
        person = load_subject(self.who, self.seed, None, TEXTURE_ROWS, traits)
        alpha = ALPHAS[self.gloss]
        if alpha is None:
            return person
        factor = alpha / float(np.median(person.roughness[person.skin]))
        return dataclasses.replace(person, roughness=person.roughness * np.float32(factor))

    def dressed(self, person: Subject) -> Subject:
        """The person with all that is worn."""
        wearing = person
        for name in self.wears:
            made, albedo, specular, roughness = WORN[name]
            wearing = dressed(wearing, made(person, self.seed), albedo, specular, roughness)
        return wearing

    def stage(self, rows: int) -> Rig:
        """The rig, its pictures of so many rows."""
        return RIGS[self.rig](rig_of(rows))

    def world(self, wearing: Subject, rig: Rig, lamps: Lamps | None = None) -> ForeignWorld:
        """The place that the photographs show, or the same place under other lamps as it is."""
        other = lamps is not None
        return ForeignWorld(
            wearing,
            rig,
            self.material,
            lamps if other else lamps_of(rig, self.lamps),
            samples=SAMPLES,
            stretch=self.stretch,
            effect=as_they_are if other else CAMERAS[self.camera],
        )


FIRST_UNSEEN = 400
DARKEST_LIGHT = 3
CASES: dict[str, Case] = {
    "lambert-ggx": Case(301, "parametric", 2, "lambert-ggx"),
    "principled": Case(302, "ict", 5, "principled"),
    "roughplastic": Case(303, "parametric", 5, "roughplastic"),
    "burley": Case(304, "ict", 2, "burley"),
    "stretched": Case(305, "parametric", 6, "lambert-ggx", stretch=STRETCH),
    "oily": Case(306, "ict", 4, "lambert-ggx", gloss="oily"),
    "dry": Case(307, "parametric", 1, "principled", gloss="dry"),
    "grey-collar": Case(308, "parametric", 3, "principled", ("grey collar",)),
    "fringe-glasses": Case(309, "ict", 3, "roughplastic", ("fringe", "glasses")),
    "discs": Case(310, "parametric", 5, "principled", lamps=DISCS),
    "planes": Case(311, "ict", 1, "lambert-ggx", rig="on planes"),
    "glare": Case(312, "parametric", 2, "roughplastic", camera="glare"),
    "grain": Case(313, "ict", 6, "roughplastic", camera="grain"),
    "beard": Case(314, "parametric", 3, "lambert-ggx", ("beard", "hair over an ear")),
    "dark-collar": Case(315, "ict", 3, "principled", ("dark collar",)),
    "beard-collar": Case(316, "parametric", 1, "roughplastic", ("beard", "red collar", "glasses")),
    "new-lambert-ggx": Case(401, "ict", 4, "lambert-ggx"),
    "new-principled": Case(402, "parametric", 1, "principled"),
    "new-roughplastic": Case(403, "ict", 2, "roughplastic"),
    "new-burley": Case(404, "parametric", 5, "burley"),
    "new-stretched": Case(405, "ict", 3, "lambert-ggx", stretch=STRETCH),
    "new-oily": Case(406, "parametric", 3, "lambert-ggx", gloss="oily"),
    "new-dry": Case(407, "ict", 6, "principled", gloss="dry"),
    "new-dark-collar": Case(408, "ict", 2, "lambert-ggx", ("dark collar",)),
    "new-red-collar": Case(409, "parametric", 6, "roughplastic", ("red collar", "glasses")),
    "new-fringe": Case(410, "parametric", 4, "principled", ("fringe",)),
    "new-discs": Case(411, "ict", 1, "roughplastic", lamps=DISCS),
    "new-planes": Case(412, "parametric", 4, "principled", rig="on planes"),
    "new-glare": Case(413, "ict", 5, "lambert-ggx", camera="glare"),
    "new-grain": Case(414, "parametric", 3, "principled", camera="grain"),
    "new-beard": Case(415, "parametric", 2, "principled", ("beard", "red collar", "glasses")),
}
"""Every scene by name: one line is one more."""
