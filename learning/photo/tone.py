"""The tone of a photographed skin: how bright the light on it was, by all that shows it.

A photograph shows the skin times its light, and the light's shape on the face does not show how
strong it was: a dark skin under a strong light looks like a light skin under a weak one. What
distinguishes them are cues, each of which knows the logarithm of the light or of the skin with an
error of its own. The answer is the most probable skin, and its error follows from theirs.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from learning.networks.whole_face import WholeFaceNetwork
from learning.whole.texture_layout import brows_to_lips
from processing.tones import ita_deg

GREY = np.array([[1 / 3, 1 / 3, 1 / 3], [1, -1, 0], [0, -1, 1]])
"""Of the logarithms of red, green and blue: their mean, red over green, and blue over green."""
DISPLAY_WHITE = 1.0
"""Value of a white surface in the key light in a photograph that somebody found well exposed, of
display white. Cameras that meter on a face, or on a room that it is in, give more: the mean of 14
rendered photographs is 1.4."""
EXPOSED = 0.8, 0.12, 0.15
"""Standard deviations of the logarithm of that, in the terms of `GREY`: exposure, and the white
balance of a photograph that somebody found right. Cameras that meter on a face make a dark one as
bright as a light one (docs/notes/photo.md)."""
WHITE_OF_EYE = np.array([0.60, 0.53, 0.50])
"""Linear albedo of the white of an eye, whose vessels and lens make it warmer than grey."""
WHITE_SEEN = 0.25, 0.3, 0.3
"""Its standard deviations among people and by its measurement: narrow eyes show the lids' red."""
SHADED = 0.5
"""Standard deviation of the logarithm by which lids and brow shade the whites: they show how strong
the light is at least."""
NETWORK_OFF = 0.3, 0.12, 0.15
"""Standard deviations of the network's tone; on a photograph of another kind than its training's it
is far off, and loses weight (`HALF_AT`)."""
NETWORK_DARKER = 0.2
"""Logarithm by which it is darker than the skin of cameras' photographs, whose contrast and
sharpening its training had not: .1 on rendered ones, .5 on real ones by the eye."""
TINT_OFF = 0.10, 0.12
"""Standard deviations of red and of blue over green among people of one lightness: blood, bile and
sun, beside melanin, which the trained people have."""
LIGHTEST, DARKEST = 0.50, 0.035
"""Bounds of the mean of a skin's three channels."""
BEYOND = 0.1
"""Standard deviation of the logarithm beyond these bounds."""
STEPS = 241
"""Lightnesses that are tried."""
HALF_AT = 2.5
"""Standard deviations off at which a cue counts half [GemanMcClure1985]; the photograph's exposure
always counts whole, so that it decides where cues disagree."""


@dataclasses.dataclass(frozen=True)
class Cue:
    """One cue's value of the skin's tone.

    Attributes:
        name: for messages and records.
        log_skin: (3,) terms of `GREY` of the skin's logarithm that the cue alone would give.
        deviations: (3,) standard deviations of these.
        below: standard deviation of a lightness below the cue's, where it differs: whites in the
            shade of lids are darker than the light, and the skin then darker than they show.
    """

    name: str
    log_skin: np.ndarray
    deviations: tuple[float, float, float]
    below: float | None = None


@dataclasses.dataclass(frozen=True)
class Tone:
    """A skin's tone.

    Attributes:
        rgb: (3,) linear albedo.
        deviation: standard deviation of the logarithm of its lightness.
        ita_deg: its typology angle [Chardon1991].
        span_deg: the angles at one standard deviation darker and lighter.
        cues: each cue's lightness over the answer's, natural logarithm.
    """

    rgb: np.ndarray
    deviation: float
    ita_deg: float
    span_deg: tuple[float, float]
    cues: dict[str, float]


def cues_of(
    skin_at_key: np.ndarray, whites: np.ndarray | None, network_rgb: np.ndarray
) -> list[Cue]:
    """List what a photograph shows of its light's strength, the exposure first.

    Args:
        skin_at_key: (3,) linear value of the skin where the key light is strongest.
        whites: (2, 3) linear value of each eye's white, NaN where it is not seen.
        network_rgb: (3,) albedo that the network found.
    """
    shown = GREY @ np.log(np.maximum(skin_at_key, 1e-4))
    found = [Cue("exposure", shown - GREY @ np.full(3, np.log(DISPLAY_WHITE)), EXPOSED)]
    if whites is not None and np.isfinite(whites).all(axis=1).any():
        brightest = whites[np.nanargmax(whites.mean(axis=1))]
        light = GREY @ np.log(np.maximum(brightest, 1e-4) / WHITE_OF_EYE)
        found.append(Cue("whites of the eyes", shown - light, WHITE_SEEN, SHADED))
    told = GREY @ (np.log(np.maximum(network_rgb, 1e-4)) + NETWORK_DARKER)
    found.append(Cue("network", told, NETWORK_OFF))
    return found


@dataclasses.dataclass(frozen=True)
class SkinColours:
    """Tints of people's skin as they follow its lightness, by the people that a network has seen.

    Attributes:
        lightness: mean of the mean logarithm.
        tint: (2,) mean of red and of blue over green there.
        slope: (2,) change of these by the lightness.
    """

    lightness: float
    tint: np.ndarray
    slope: np.ndarray

    def at(self, lightness: np.ndarray) -> np.ndarray:
        """(n, 2) tints of (n,) lightnesses."""
        return self.tint + np.multiply.outer(lightness - self.lightness, self.slope)


def skin_colours(network: WholeFaceNetwork) -> SkinColours:
    """Take the mean and the main directions of the skins that a network was trained on."""
    front = brows_to_lips(network.mean_position_mm)[0, 0].numpy() > 0
    mean = network.mean_log_albedo[0].permute(1, 2, 0).numpy()[front].mean(axis=0)
    modes = network.albedo_modes.permute(2, 3, 1, 0).numpy()[front].mean(axis=0)
    along = GREY @ (modes * network.mode_deviations.numpy())
    spread = along @ along.T
    centre = GREY @ mean
    slope = spread[1:, 0] / max(float(spread[0, 0]), 1e-9)
    return SkinColours(float(centre[0]), centre[1:], slope)


def find_tone(cues: list[Cue], people: SkinColours) -> Tone:
    """Find the most probable tone.

    The lightness is tried at `STEPS` values; at each one the tint is the mean of all cues' tints
    and of the people's there, by their variances. How well the tints agree has no part in the
    lightness: a camera's saturation changes them more than melanin does. A cue that is far from the
    answer loses weight.

    Args:
        cues: the first one always counts whole.
        people: the tints of people.
    """
    bounds = np.log([DARKEST, LIGHTEST])
    lightness = np.linspace(bounds[0] - 3 * BEYOND, bounds[1] + 3 * BEYOND, STEPS)
    beyond = np.maximum(lightness - bounds[1], 0) + np.maximum(bounds[0] - lightness, 0)
    tints = np.stack([people.at(lightness), *(np.tile(c.log_skin[1:], (STEPS, 1)) for c in cues)])
    exact = np.array([TINT_OFF, *(c.deviations[1:] for c in cues)])[:, None] ** -2.0
    tint = (exact * tints).sum(axis=0) / exact.sum(axis=0)
    off = np.stack([lightness - cue.log_skin[0] for cue in cues])
    deviation = np.stack(
        [
            np.where((each < 0) & (cue.below is not None), cue.below or 0, cue.deviations[0])
            for each, cue in zip(off, cues, strict=True)
        ]
    )
    square = (off / deviation) ** 2
    robust = square / (1 + square / HALF_AT**2)
    robust[0] = square[0]
    cost = (beyond / BEYOND) ** 2 + robust.sum(axis=0)
    share = np.exp(-0.5 * (cost - cost.min()))
    share /= share.sum()
    middle = float(share @ lightness)
    spread = float(np.sqrt(share @ (lightness - middle) ** 2))

    def rgb(level: float) -> np.ndarray:
        here = [np.interp(level, lightness, tint[:, k]) for k in (0, 1)]
        return np.asarray(np.exp(np.linalg.solve(GREY, [level, *here])))

    angles = [ita_deg(rgb(middle + step * spread)[None]) for step in (-1, 0, 1)]
    return Tone(
        rgb(middle),
        spread,
        angles[1],
        (angles[0], angles[2]),
        {cue.name: float(cue.log_skin[0] - middle) for cue in cues},
    )
