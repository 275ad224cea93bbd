"""What the demo does: its configuration, where its parts are, its commands in order."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path

from lightstage.formats.template import default_template_path

ABOUT = Path(__file__).with_name("about.toml")
"""The demo's statements on the patches that it publishes."""


@dataclasses.dataclass(frozen=True)
class DemoConfig:
    """What the demo shows and how large.

    Attributes:
        subject: `lps` (the scanned head) or a pseudonym of a parametric person.
        seed: of the session's noise and of a parametric person.
        tiny_rig: the rig of `demo.tiny` in place of the default one.
        scale: of the rig's pixels a side; 0.1795 makes 720 x 1080 of the default rig's.
        atlas_rows: height of the atlas in texels; its width is two thirds of it.
        skin_rows: height of the maps of the simulated person who is photographed.
        people: parametric people that the network learns from.
        train_seconds: how long the network learns.
        refine_seconds: how long, at most, the inferred albedo is refined.
    """

    subject: str
    seed: int = 1
    tiny_rig: bool = False
    scale: float = 1080 / 6016
    atlas_rows: int = 1536
    skin_rows: int = 1536
    people: int = 4
    train_seconds: int = 40
    refine_seconds: int = 30


@dataclasses.dataclass(frozen=True)
class Step:
    """One command: a short name, what it does, and its arguments after `python -m`."""

    name: str
    title: str
    arguments: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Layout:
    """Where each part of the demo is."""

    root: Path

    @property
    def rig(self) -> Path:
        """Lights and cameras, where they are not the default ones."""
        return self.root / "rig.json"

    @property
    def session(self) -> Path:
        """Photographs and what was driven."""
        return self.root / "session"

    @property
    def truth(self) -> Path:
        """What the simulator knows."""
        return self.root / "session.truth"

    @property
    def processed(self) -> Path:
        """Maps, meshes and atlas of the session."""
        return self.root / "processed"

    @property
    def atlas(self) -> Path:
        """The captured head's maps in the template's texture."""
        return self.processed / "atlas"

    @property
    def mesh(self) -> Path:
        """The template on the captured head."""
        return self.processed / "registered_mesh.obj"

    @property
    def coarse(self) -> Path:
        """The views' maps as they were before the mesh was known."""
        return self.root / "coarse"

    @property
    def people(self) -> Path:
        """Atlas maps of parametric people."""
        return self.root / "people"

    @property
    def store(self) -> Path:
        """The lab's store of them."""
        return self.root / "store"

    @property
    def published(self) -> Path:
        """Their patches without person, place or order."""
        return self.root / "published"

    @property
    def training(self) -> Path:
        """Checkpoint and losses."""
        return self.root / "training"

    @property
    def baked(self) -> Path:
        """The captured head's texture as a photograph would give it."""
        return self.root / "baked.exr"

    @property
    def inferred(self) -> Path:
        """Maps that the network made of it."""
        return self.root / "inferred"

    @property
    def relit(self) -> Path:
        """The captured head under light that no pattern used."""
        return self.root / "relit"

    @property
    def head(self) -> Path:
        """The captured head beside the inferred one, as a page for a browser."""
        return self.root / "head"

    @property
    def steps(self) -> Path:
        """What each step cost."""
        return self.root / "steps.json"

    @property
    def report(self) -> Path:
        """Pictures and errors of every stage."""
        return self.root / "report.html"

    def all_of_people(self) -> list[str]:
        """What a shell's `people/*` names: the parametric people's folders and their list."""
        return sorted(str(path) for path in self.people.glob("*") if path.name[0] != ".")

    def light_sets(self) -> list[Path]:
        """The truth's light sets, by name."""
        return sorted((self.truth / "relit").glob("*.json"))


def steps(config: DemoConfig, at: Layout) -> Iterator[Step]:
    """The demo's commands in order; each is asked for when those before it have run."""

    def step(name: str, title: str, command: str, **values: object) -> Step:
        values |= {"config": config, "at": at, "template": default_template_path()}
        # Split before filling in, so that a path may hold spaces.
        return Step(name, title, tuple(word.format(**values) for word in command.split()))

    size = "--rows {config.skin_rows} --scale {config.scale:.6f}"
    size += " --rig {at.rig}" if config.tiny_rig else ""
    yield step(
        "session",
        f"photograph {config.subject} on the simulated stage",
        "sim session --subject {config.subject} --seed {config.seed} --out {at.session} " + size,
    )
    yield step("check", "check the session", "lightstage check {at.session}")
    process = "processing run {at.session} --out {at.processed} --template {template}"
    process += " --atlas-rows {config.atlas_rows}"
    yield step("separate", "coarse maps, without geometry", f"{process} --until separate")
    shutil.copytree(at.processed / "views", at.coarse / "views", dirs_exist_ok=True)
    yield step(
        "evaluate coarse",
        "errors of the coarse maps",
        "processing evaluate {at.coarse} {at.truth}",
    )
    yield step("processing", "mesh, exact maps, registration, atlas", process)
    yield step(
        "evaluate",
        "errors of everything against truth",
        "processing evaluate {at.processed} {at.truth}",
    )
    yield step(
        "people",
        f"maps of {config.people} parametric people",
        "sim dataset --subjects {config.people} --expressions 1 --seed {seed} --out {at.people}"
        " --maps-only --rows {config.atlas_rows}",
        seed=config.seed + 1,
    )
    yield Step(
        "dataset build",
        "gather them into the lab's store",
        ("processing", "dataset", "build", *at.all_of_people(), "--out", str(at.store)),
    )
    yield step(
        "dataset publish",
        "patches that may leave the lab",
        "processing dataset publish {at.store} --about {about} --out {at.published}",
        about=ABOUT,
    )
    yield step(
        "train",
        f"train a network for {config.train_seconds} s",
        "learning train --data {at.store} --out {at.training} --seconds {config.train_seconds}",
    )
    lights = at.light_sets()
    yield step(
        "bake",
        "the texture that a photograph would give",
        "learning bake --maps {at.atlas} --mesh {at.mesh} --environment {light} --out {at.baked}"
        " --template {template}",
        light=lights[0],
    )
    yield step(
        "infer",
        "reflectance maps from that texture, by the weights that are shipped",
        "learning infer --texture {at.baked} --mesh {at.mesh}"
        " --out {at.inferred} --head-pose {at.processed}/head_from_world.json"
        " --refine {config.refine_seconds}",
    )
    for light in lights:
        yield step(
            f"render {light.stem}",
            f"the captured head under the light set {light.stem}",
            "learning render --maps {at.atlas} --mesh {at.mesh} --environment {light}"
            " --rig {at.session}/rig.json --camera cam0 --out {at.relit}/{light.stem}.exr"
            " --template {template} --background black",
            light=light,
        )
    yield step(
        "export",
        "a page on which the head turns, captured beside inferred",
        "learning export {at.processed} --format page --compare {at.inferred} --out {at.head}",
    )
