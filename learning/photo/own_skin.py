"""The skin of a photographed person: the photograph over its light, at its own tone.

The photograph is the evidence. What light explains is taken out: the light that was found, and what
is left of it in smooth steps along the normals and in the strengths of its lamps, so that lit and
shaded skin of one cheek agree. All else is the person's: brows, beard, lips, freckles, moles and
wrinkles at their full strength. Smooth differences of lightness alone, which shading of a shape
that is not quite right makes as well, are taken in part.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from learning.networks.whole_face import DARKEST
from learning.photo.face_light import HARMONICS, harmonics
from learning.photo.tone import GREY, SkinColours, Tone, cues_of, find_tone
from learning.whole.detail import blurred, enlarged
from learning.whole.gaps import without_gaps
from learning.whole.light import LightSearch
from learning.whole.refine import Own, TakenOut, at_network_size
from learning.whole.scalp import GRAIN, hair_share, skin_over_scalp
from learning.whole.unlit import DARK_LIGHT

KEY_PERCENTILE = 80.0
"""Of the irradiance on the lit half of the skin: where the key light is strongest."""
LEAST_TEXELS = 50
"""At the network's size, below which the light is left as it was found."""
ALIKE_TEXELS = 40.0
"""So many neighbouring texels of the network's size err as one."""
PATTERN_OFF = 0.12, 0.06
"""Standard deviations of a skin's logarithm beside the mean person's pattern: of its mean over the
channels, and of red and blue over green."""
HARMONICS_OFF, LAMPS_OFF, TINT_SHARE = 0.15, 0.35, 0.3
"""Standard deviations of the logarithm of the light that was found: along the harmonics of orders 1
and 2, in a lamp's strength, and the share of these in its tint."""
ROUNDS = 10
HALF_AT = 1.5
"""Deviations at which a texel weighs a quarter [GemanMcClure1985]."""
MARK = 0.4
"""Difference in lightness, natural logarithm, of which half is a mark for certain: errors of light
are smaller."""
BRIGHT_FEATURES = 0.5
"""Part of a feature that is brighter than skin that is believed."""
SMOOTH_DOUBT, TINT_DOUBT, FINE_DOUBT, FEATURES_DOUBT = 2.0, 0.3, 0.1, 0.02
"""Variance of the error that light makes in smooth differences of lightness, in those of tint, in
what is finer, and in features, of the variance that `trusted` expects."""
EYES_BLUR = 1 / 48
"""Standard deviation over which the light around an eye is a mean, of a texture's rows."""
UNKNOWN = 3.0
"""Standard deviation of the tone's logarithm, which is found afterwards."""
FEATURES_BLUR = 1 / 192
"""Standard deviation of the border between features and other skin, of a texture's rows."""
TOO_BRIGHT = 0.5
"""Natural logarithm over the skin above which a feature is light in the wrong place."""
LEAST_PATCH = 1 / 96
"""Half the side of a square of hair whose strands are continued, of a texture's rows, at least."""
STRANDS_SHARE = 0.6
"""Strength of strands where no photograph shows them."""
SPECK = 1 / 256
"""Width of what is shown of skin, of a texture's rows, below which it is a collar's edge."""
LEAST_HAIR = 0.01
"""Share of the texels with hair that must be known, for all to get their colour."""


PHOTOGRAPHED = LightSearch(most_lamps=2, half_at=0.25)
"""The fitted shape explains less of a photograph than a true one."""


@dataclasses.dataclass(frozen=True)
class PersonTexels:
    """Parts of a person's texture.

    Attributes:
        features: (rows, columns) bool, eyes, brows and lips, which differ between people as they
            please.
        beard: (rows, columns) bool, where beards grow.
        eyes: (rows, columns) bool, texels that show open eyes as they are; None for none.
        hair: (rows, columns) bool, where most people have hair; None where it is not known.
        other: (rows, columns) bool, texels that show something else than the person.
    """

    features: np.ndarray
    beard: np.ndarray
    eyes: np.ndarray | None
    hair: np.ndarray | None
    other: np.ndarray


@dataclasses.dataclass
class PhotographedSkin:
    """Decides what of one photograph's texture is the person's own; see `OwnSkin`.

    Attributes:
        places: in the texture.
        people: tints of people.
        whites: (2, 3) linear value of the eyes' whites, NaN where not seen; None for none.
        normals_off: standard deviation of the fitted shape's normals, radians along each axis.
        penumbra: standard deviation over which shadows are softened, of a texture's rows.
        search: for the light.
        tone: of the skin, once it was found.
    """

    places: PersonTexels
    people: SkinColours
    whites: np.ndarray | None = None
    normals_off: float = 0.15
    penumbra: float = 1 / 160
    search: LightSearch = PHOTOGRAPHED
    tone: Tone | None = None

    def own(self, taken: TakenOut) -> Own:
        """Decide it, and find the tone."""
        places = self.places
        shown = taken.lit & ~places.other
        features = places.features | places.beard
        skin = taken.known & ~places.other & ~features
        if places.hair is not None:
            skin &= ~places.hair
        left = light_left(taken, skin)
        wide = enlarged(left, *skin.shape)
        gain, tone_off = self._found_tone(taken, skin, wide)
        wide -= gain
        base = enlarged(np.log(taken.low_albedo) - tone_off, *skin.shape)
        # A lit place that the model has in shadow is far too bright, and no brow or beard.
        bright = (np.log(taken.unlit) - wide - base).mean(axis=2) > TOO_BRIGHT
        known = shown & (taken.known | (features & ~bright))
        specks = max(1, round(SPECK * len(skin)))
        whole = cv2.morphologyEx(
            known.astype(np.uint8), cv2.MORPH_OPEN, np.ones((specks, specks), np.uint8)
        )
        known &= (whole > 0) | features
        hair = np.zeros(skin.shape, np.float32)
        if places.hair is not None:
            skin_log = skin_over_scalp(taken.low_albedo, places.hair, taken.covered) - tone_off
            unlit = np.clip(taken.unlit * np.exp(-wide), DARKEST, 1.0)
            hair = hair_share(unlit, shown, places.hair, skin_log, taken.trust)
            known = np.where(hair > 0.5, shown, known)
            # What most people have there, hair, is no measure of bare skin.
            base += (1 - hair)[..., None] * (enlarged(skin_log, *skin.shape) - base)
        if places.eyes is not None:
            known |= places.eyes & taken.lit
            eyes = _lit_as_around(taken, skin) + gain
            taken = dataclasses.replace(taken, trust=np.where(places.eyes, 1, taken.trust))

        def albedo(unlit: np.ndarray) -> np.ndarray:
            own = np.log(unlit) - wide
            if places.eyes is not None:
                own = np.where(places.eyes[..., None], eyes, own)
            return self._albedo(own, base, known, hair, taken)

        return Own(known, known & (hair <= 0.5), albedo, known.astype(np.float32), np.exp(-gain))

    def _found_tone(
        self, taken: TakenOut, skin: np.ndarray, wide: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find the skin's tone.

        Args:
            taken: the texture over its light.
            skin: (rows, columns) bool, texels that surely show skin.
            wide: (rows, columns, 3) logarithm of the light that is left in it.

        Returns:
            (3,) logarithms: of the skin's tone over that of the texture over its light, and of the
            tone of the skins that people have over it.
        """
        low_log = enlarged(np.log(taken.low_albedo), *skin.shape)
        if not skin.any():
            return np.zeros(3), np.zeros(3)
        light = taken.irradiance * np.exp(wide)
        level = light.mean(axis=2)
        # The lit side shows the tone; what light hardly reaches shows the light's errors.
        skin = skin & (level >= np.median(level[skin]))
        known = np.median(low_log[skin], axis=0)
        unlit_log = np.log(taken.unlit) - wide
        unlit = np.median(unlit_log[skin], axis=0)
        key = skin & (level >= np.percentile(level[skin], KEY_PERCENTILE))
        shown = np.exp(np.median(unlit_log[key] + np.log(light[key]), axis=0))
        cues = cues_of(shown, self.whites, np.exp(known))
        self.tone = find_tone(cues, self.people)
        return np.log(self.tone.rgb) - unlit, known - np.log(self.tone.rgb)

    def _albedo(
        self,
        unlit_log: np.ndarray,
        base: np.ndarray,
        known: np.ndarray,
        hair: np.ndarray,
        taken: TakenOut,
    ) -> np.ndarray:
        """(rows, columns, 3) linear albedo of all texels.

        Args:
            unlit_log: (rows, columns, 3) the texture over its light, at the skin's tone.
            base: (rows, columns, 3) logarithm of the skin that is expected.
            known: (rows, columns) bool, where the texture shows the person.
            hair: (rows, columns) share, 0..1.
            taken: the rest of what is known.
        """
        covered, sides, shape = taken.covered, taken.sides, known.shape
        is_hair = hair > 0.5
        beside = unlit_log - base
        own = without_gaps(beside, known & ~is_hair, covered, sides)
        size = taken.low_albedo.shape[:2]
        coarse, _ = at_network_size(own, covered, size)
        trust = at_network_size(taken.trust * covered, covered, size)[0][..., None]
        smooth = coarse.mean(axis=2, keepdims=True)
        # Marks are darker than skin; what is brighter is light, unless it is a grey beard or brow.
        dark = np.minimum(smooth, 0)
        mark = trust * dark**2 / (trust * dark**2 + MARK**2)
        parts = (smooth, SMOOTH_DOUBT), (coarse - smooth, TINT_DOUBT)
        taken_off = sum((1 - mark) * (1 - _share(trust, doubt)) * part for part, doubt in parts)
        # What is finer and the features are not what light and shape make.
        soft = blurred(self.places.features.astype(np.float32), FEATURES_BLUR * len(known))
        soft = soft * np.where(enlarged(smooth[..., 0], *shape) > 0, BRIGHT_FEATURES, 1)
        believed = _share(taken.trust, FINE_DOUBT * (1 - soft) + FEATURES_DOUBT * soft)
        own = believed[..., None] * (own - (1 - soft[..., None]) * enlarged(taken_off, *shape))
        eyes = self.places.eyes
        if eyes is not None and sides:
            # Of two eyes of which one alone is shown, the other is like it.
            alike = (eyes & known)[:, ::-1] & ~known
            own = np.where(alike[..., None], own[:, ::-1], own)
        if (known & is_hair).sum() > LEAST_HAIR * is_hair.sum():
            # Its own colour is continued: as a difference it would make skin beside it glow.
            shown = known & is_hair
            strands = without_gaps(unlit_log, shown, covered, sides) - base
            strands += np.where(shown[..., None], 0, STRANDS_SHARE * grain_beyond(unlit_log, shown))
            own = hair[..., None] * strands + (1 - hair[..., None]) * own
        albedo: np.ndarray = np.exp(np.minimum(base + own, 0.0))
        return albedo


def _lit_as_around(taken: TakenOut, skin: np.ndarray) -> np.ndarray:
    """Take a texture over the light that the skin around each texel has.

    Eyes are deeper in the shade of a fitted shape's lids than the person's are.

    Args:
        taken: the texture and its light.
        skin: (rows, columns) bool, where the light is known.

    Returns:
        (rows, columns, 3) logarithm.
    """
    sigma = EYES_BLUR * len(skin)
    weight = np.maximum(blurred(skin.astype(np.float32), sigma), 1e-3)[..., None]
    around = blurred((taken.irradiance * skin[..., None]).astype(np.float32), sigma) / weight
    return np.log(np.maximum(taken.texture, DARKEST) / np.maximum(around, DARK_LIGHT))


def _share(trust: np.ndarray, doubt: float | np.ndarray) -> np.ndarray:
    """Share of a part of the texture over its light that is believed.

    Args:
        trust: 0..1, of `learning.whole.unlit.trusted`.
        doubt: variance of the error that light makes in this part, of that in all of it.
    """
    found: np.ndarray = trust / (trust + doubt * (1 - trust))
    return found


def grain_beyond(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Continue what is fine in an image: the largest known square of it, mirrored again and again.

    Args:
        image: (rows, columns, 3).
        known: (rows, columns) bool.

    Returns:
        (rows, columns, 3) float32, of mean 0; zeros where no square is large enough.
    """
    bordered = np.pad(known.astype(np.uint8), 1)
    inside = cv2.distanceTransform(bordered, cv2.DIST_C, 3)[1:-1, 1:-1]
    row, column = np.unravel_index(inside.argmax(), known.shape)
    reach = int(inside[row, column]) - 1
    if reach < LEAST_PATCH * len(known):
        return np.zeros(image.shape, np.float32)
    square = slice(row - reach, row + reach + 1), slice(column - reach, column + reach + 1)
    patch = image[square].astype(np.float32)
    patch = patch - cv2.GaussianBlur(patch, (0, 0), max(1.0, GRAIN * len(known)))
    turns = [np.abs((np.arange(n) % (4 * reach)) - 2 * reach) for n in known.shape]
    return np.asarray((patch - patch.mean(axis=(0, 1)))[np.ix_(*turns)])


def light_left(taken: TakenOut, skin: np.ndarray) -> np.ndarray:
    """Find what the light that was found left in a texture, by the skin on all its sides.

    The logarithm of the texture over its light, beside the skin that is expected, is fitted by
    harmonics of the normals [Ramamoorthi2001] and by changes of each light's strength, which what
    is known of both keeps small. Texels that are far off, such as marks, lose their weight.

    Args:
        taken: the texture over its light.
        skin: (rows, columns) bool, texels that surely show skin.

    Returns:
        (h, w, 3) logarithm at the network's size; zeros where too little skin is shown.
    """
    size = taken.low_albedo.shape[:2]
    beside = np.where(skin[..., None], np.log(taken.unlit), 0)
    mean, use = at_network_size(beside, skin, size)
    surface = (taken.normal != 0).any(axis=2)
    use &= surface
    left = np.zeros((*size, 3))
    if use.sum() < LEAST_TEXELS:
        return left
    off = mean - np.log(taken.low_albedo)

    def columns(here: np.ndarray) -> np.ndarray:
        return np.column_stack([harmonics(taken.normal[here])[0], taken.shares[here]])

    basis = np.column_stack([columns(use), np.ones(use.sum())])
    known = np.array([*[HARMONICS_OFF] * HARMONICS, *[LAMPS_OFF] * taken.shares.shape[2]])
    found = np.empty((3, len(known)))
    for index, term in enumerate(GREY):
        tint = index > 0
        spread = np.array([*(known * (TINT_SHARE if tint else 1)), UNKNOWN])
        off_by = PATTERN_OFF[tint]
        found[index] = _robust(basis, off[use] @ term, spread, off_by)[:-1]
    left[surface] = (columns(surface) @ found.T) @ np.linalg.inv(GREY).T
    # What is the same everywhere is the tone's, which is found afterwards.
    left[surface] -= left[use].mean(axis=0)
    return left


def _robust(basis: np.ndarray, values: np.ndarray, spread: np.ndarray, off_by: float) -> np.ndarray:
    """(k,) coefficients of deviations `spread` that give (n,) values by an (n, k) basis."""
    weight = np.ones(len(values))
    found = np.zeros(basis.shape[1])
    for _ in range(ROUNDS):
        weighted = basis * (weight / (off_by**2 * ALIKE_TEXELS))[:, None]
        found = np.linalg.solve(weighted.T @ basis + np.diag(spread**-2), weighted.T @ values)
        weight = 1 / (1 + ((values - basis @ found) / (HALF_AT * off_by)) ** 2) ** 2
    return found
