"""Which lenses of the cameras that were found are not to be believed, in words."""

from __future__ import annotations

from collections.abc import Sequence

from lightstage.poses_from_photos.lenses import Lens
from lightstage.poses_from_photos.solving import Solved

SHORTEST, LONGEST = 0.3, 12.0
"""Focal lengths as shares of the picture's longer side that photographs of heads are taken with."""
OTHER_FOCAL = 0.1
"""Share by which a focal length may differ from that of EXIF or a file."""


def lens_warnings(solved: Solved) -> list[str]:
    """What is odd about lenses; each warning names its cameras."""
    return [*_of_groups(solved), *_bent(solved), *_of_lengths(solved)]


def _of_groups(solved: Solved) -> list[str]:
    found = []
    if solved.together_px is not None:
        found.append(
            "the photographs were not taken with one focal length: "
            f"{_listed(solved.lenses)}. With one they fit worse ({solved.together_px:.2f} px). "
            "--lenses FILE states who shares a lens"
        )
    if solved.doubted is not None:
        doubted = solved.doubted
        odd = ", ".join(name for lens in doubted.odd for name in lens.cameras)
        found.append(
            f"{odd}: bends the others, sharing the focal length that EXIF or --lenses gives. The "
            f"photographs fit better ({doubted.apart_px:.2f} px in place of "
            f"{doubted.told_px:.2f} px) with {_listed(doubted.lenses)}. Give the lenses in "
            "--lenses FILE, or leave out what was not taken with them"
        )
    return found


def _bent(solved: Solved) -> list[str]:
    if not solved.bent:
        return []
    return [
        f"{', '.join(solved.bent)}: a lens that moves the picture's corners by "
        f"{100 * max(solved.bent.values()):.0f} % is implausible; its distortion was left out. Is "
        "the subject large enough in the photographs, and are they whole?"
    ]


def _of_lengths(solved: Solved) -> list[str]:
    """Each message names all cameras that it holds for: those of one lens have the same."""
    by_text: dict[str, list[str]] = {}
    for name, camera in solved.cameras.items():
        times = camera.fx_px / max(camera.width_px, camera.height_px)
        if not SHORTEST <= times <= LONGEST:
            text = (
                f"a focal length of {times:.2g} times the picture's longer side is implausible "
                f"(usual are {SHORTEST:g} to {LONGEST:g}). Is the photograph cropped?"
            )
            by_text.setdefault(text, []).append(name)
        known = solved.told_px[name]
        if known and abs(camera.fx_px / known - 1) > OTHER_FOCAL:
            text = (
                f"the focal length came out as {camera.fx_px:.0f} px, "
                f"{100 * (camera.fx_px / known - 1):+.0f} % off the {known:.0f} px that EXIF or "
                "--lenses gives. Was the photograph cropped or made smaller?"
            )
            by_text.setdefault(text, []).append(name)
    return [f"{', '.join(names)}: {text}" for text, names in by_text.items()]


def _listed(lenses: Sequence[Lens]) -> str:
    return "; ".join(f"{lens.focal_px:.0f} px by {', '.join(lens.cameras)}" for lens in lenses)
