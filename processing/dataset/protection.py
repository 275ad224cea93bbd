"""What publishing patches cannot protect, with the figures of two benchmarks.

`benchmarks/dataset_privacy.py` and `benchmarks/reidentify.py`.
"""

from __future__ import annotations

DEFAULT_GAP = 0.5
"""Fewest texels between two patches, as a share of a patch's side."""
NARROW_GAP = 0.25
"""From here on the attack found no more than with the default."""
CANNOT_PROTECT = (
    "A patch is a person's real skin: whoever has another photograph of the person as sharp as "
    "this can recognise moles, scars and wrinkles. Skin tone, gloss and the form of the surface "
    "go on from patch to patch, so somebody who tries can join some neighbours again: with the "
    "default gap and random turns, an attack that compares edges put the true neighbour first for"
    " 16 % of the edges (1.6 % by chance), and a patch of the same person for 67 %; without gap "
    "and turns it was 91 % and 93 %. Tone of skin alone distinguishes people: of forty simulated "
    "people the patch most like another in tone was of the same person for 50 % (5 % by chance). "
    "Order, files, their times and sizes reveal no more than chance. Where a person's consent was "
    "withdrawn, two releases differ most by that person's patches: with a quarter of everybody's "
    "left out, an attacker who names as many patches as that person has is right for 60 % of them"
    " (10 % by chance), and for more with every further release. What a patch shows reveals roughly"
    " where it was, and the outline of what is no skin reveals it to a few texels. Publish only "
    "with the consent of those shown, for this use. The other figures are of ten simulated people"
    " (benchmarks/dataset_privacy.py, benchmarks/reidentify.py); real skin may be easier."
)


def narrow_gap(gap: float) -> str:
    """What a narrow gap gives away; empty where it is wide enough.

    Args:
        gap: fewest texels between two patches, as a share of a patch's side.
    """
    if gap >= NARROW_GAP:
        return ""
    return (
        f"a gap of {gap:g} of a patch's side lets patches be put together again: without a gap an "
        "attack that compares edges joined 54 neighbours of ten people (19 % of the edges) and put "
        "a patch of the same person first for 76 %; with the default gap of "
        f"{DEFAULT_GAP:g} it joined 26 (16 %), and 67 % were of the same person"
    )


def cannot_protect(gap: float) -> str:
    """The statement of a published set of such a gap."""
    narrow = narrow_gap(gap)
    return f"{CANNOT_PROTECT} Of this set: {narrow}." if narrow else CANNOT_PROTECT
