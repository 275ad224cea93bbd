"""What publishing patches cannot protect, with the figures of `benchmarks/dataset_privacy.py`."""

CANNOT_PROTECT = (
    "A patch is a person's real skin: whoever has another photograph of the person as sharp as "
    "this can recognise moles, scars and wrinkles. Skin tone, gloss and the form of the surface go "
    "on from patch to patch, so somebody who tries can join some neighbours again: with the "
    "default gap and random turns, an attack that compares edges put the true neighbour first for "
    "12 % of the edges (1.7 % by chance), and a patch of the same person for 61 %; without gap "
    "and turns it was 88 % and 92 %. Where a person's consent was withdrawn, two releases "
    "differ most by that person's patches: with a quarter of everybody's left out, an attacker who "
    "names as many patches as that person has is right for 62 % of them (10 % by chance), and "
    "for more with every further release. What a patch shows tells roughly where it lay, and the "
    "outline of what is no skin tells it to a few texels. Publish only with the consent of those "
    "shown, for this use. The figures are of ten simulated people "
    "(benchmarks/dataset_privacy.py); real skin may be easier."
)
