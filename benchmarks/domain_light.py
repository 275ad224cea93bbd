"""A domain's light: what `domain-light` finds in textures whose light is known.

`python -m benchmarks.domain_light` lights heads that the network knows nothing of (people of ICT's
model, the scanned head) by the simulator's own light transport, all under one light, and searches
that light in their textures: in closed form, and after the descent through the renderer. Meshes are
the registered ones; no error of a fit is in them.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

import numpy as np

from benchmarks.networks_lights import light_of
from benchmarks.networks_people import Head, chosen, make
from benchmarks.photo import in_head
from benchmarks.record import record, table
from learning.checkpoint import load_whole_face, shipped_weights
from learning.domain.closed import find_light
from learning.domain.config import DomainConfig
from learning.domain.descent import descend
from learning.domain.sample import Sample, sample_of
from learning.networks.whole_face import WholeFaceNetwork
from learning.whole.refine import CAMERA_MM
from lightstage.formats.environment import LightSet

LIGHTS = ("front", "warm-cool", "hard-oblique")
NUMBER = 3
"""Of the lights' draw."""
ROWS = 384
HEADER = [
    "light",
    "textures",
    "strongest lamp, deg: closed form, descent",
    "its strength, of the true one",
    "its colour off, %",
    "second lamp, deg",
    "ambient light, of the true one",
    "difference from the textures",
    "s: closed form, descent",
]


@dataclasses.dataclass(frozen=True)
class Off:
    """How far a light is from the true one.

    Attributes:
        degrees: of the true lamps in the order of their strength, to the nearest found one.
        strength: of the strongest, found over true.
        colour: mean difference of the logarithms of its channels, their mean taken out.
        ambient: found over true.
    """

    degrees: list[float]
    strength: float
    colour: float
    ambient: float


def off(found: LightSet, true: LightSet) -> Off:
    """Compare two lights of one frame."""
    order = np.argsort(-true.rgb.sum(axis=1))
    toward = found.position_mm / np.linalg.norm(found.position_mm, axis=1, keepdims=True)
    degrees, nearest = [], []
    for place in true.position_mm[order]:
        cosine = toward @ place / np.linalg.norm(place)
        nearest.append(int(cosine.argmax()))
        degrees.append(float(np.degrees(np.arccos(np.clip(cosine.max(), -1, 1)))))
    own, real = found.rgb[nearest[0]], true.rgb[order[0]]
    apart = np.log(np.maximum(own, 1e-6) / real)
    return Off(
        degrees,
        float(own.sum() / real.sum()),
        float(np.abs(apart - apart.mean()).mean()),
        float(found.ambient_rgb.sum() / true.ambient_rgb.sum()),
    )


def sampled(head: Head, light: LightSet, network: WholeFaceNetwork) -> Sample:
    """A head's texture under a light of the world, as `domain-light` reads it."""
    texture = head.image(head.lit.under(light)).astype(np.float32)
    return sample_of(network, texture, head.mesh, (head.who.name, "its mesh"))


def row(name: str, samples: list[Sample], true: LightSet, network: WholeFaceNetwork) -> list[str]:
    """Of the table: one light, head frame, in some textures."""
    config = DomainConfig()
    began = time.perf_counter()
    light = find_light(samples, network, CAMERA_MM, config.seconds, config.rounds).light
    lit = light.rgb[:-1].max(axis=1) > 0
    closed = LightSet(name, np.array(light.lamps_mm)[lit], light.rgb[:-1][lit], light.rgb[-1])
    middle = time.perf_counter()
    refined = descend(samples, closed, CAMERA_MM, config.steps, config.rate, config.shadow_steps)
    end = time.perf_counter()
    first, last = off(closed, true), off(refined.light, true)
    second = "-"
    if len(first.degrees) > 1:
        second = f"{first.degrees[1]:.1f}, {last.degrees[1]:.1f}"
    return [
        name,
        str(len(samples)),
        f"{first.degrees[0]:.1f}, {last.degrees[0]:.1f}",
        f"{first.strength:.2f}, {last.strength:.2f}",
        f"{100 * first.colour:.0f}, {100 * last.colour:.0f}",
        second,
        f"{first.ambient:.2f}, {last.ambient:.2f}",
        f"{refined.before:.4f}, {refined.after:.4f}",
        f"{middle - began:.0f}, {end - middle:.0f}",
    ]


def main() -> None:
    """Measure, print, record."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=4, help="people of ICT's model")
    parser.add_argument("--unseen", action="store_true", help="the half of ICT's people kept apart")
    parser.add_argument("--lights", default=",".join(LIGHTS), help="with commas")
    asked = parser.parse_args()
    network, _ = load_whole_face(shipped_weights())
    heads = [make(who, ROWS) for who in chosen(["ict", "scan"], asked.count, asked.unseen)]
    body = []
    for name in asked.lights.split(","):
        light = light_of(name, NUMBER)
        samples = [sampled(head, light, network) for head in heads]
        true = dataclasses.replace(light, position_mm=in_head(heads[0], light.position_mm))
        for count in sorted({1, len(samples)}):
            body.append(row(name, samples[:count], true, network))
            print(" | ".join(body[-1]), flush=True)
    if asked.lights != ",".join(LIGHTS) or asked.count != 4 or asked.unseen:
        print(table(HEADER, body))
        return
    record(
        "The light of a domain of textures",
        HEADER,
        body,
        f"`python -m benchmarks.domain_light`: {asked.count} people of ICT's model and the scanned "
        f"head, textures of {ROWS} rows lit by sim. Each pair: in closed form, after the descent.",
    )


if __name__ == "__main__":
    main()
