"""What is known of a release, in words: its datasheet and its Croissant file use the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightstage import __version__
from lightstage.counting import counted
from processing.dataset.about import About

MAPS = {
    "diffuse_albedo": "linear red, green and blue; 1 is a perfect white diffuser",
    "specular_albedo": "reflectance at normal incidence; skin has about 0.028",
    "diffuse_normal": "unit vectors that explain the diffuse shading",
    "specular_normal": "unit vectors of the surface itself",
    "shape": "mm from the patch's mean position",
}
READ_BY = {
    "zarr": "any reader of zarr, format 3: one group with an array for each map",
    "webdataset": "the package webdataset, or any reader of tar and npy: one sample a patch",
}


def description(facts: Mapping[str, Any]) -> str:
    """What the set is.

    Args:
        facts: of the release's dataset.json, here and below.
    """
    counts, size = facts["counts"], facts["patch"]
    return (
        f"{counted(counts['patches'], 'square patch', 'square patches')} of facial skin of "
        f"{counted(counts['subjects'], 'person', 'people')}, {size} texels wide: diffuse and "
        "specular albedo, two maps of normals, and shape in mm. Nothing shows which patches are of "
        "one person, where they were, or when they were taken."
    )


def collection(facts: Mapping[str, Any]) -> str:
    """How the data came about."""
    simulated = facts["consent"]["subjects_simulated"]
    captured = facts["counts"]["subjects"] - simulated
    sentences = []
    if captured:
        sentences.append(
            f"{counted(captured, 'person', 'people')} sat in a light stage, a sphere of lamps with "
            "cameras, and were photographed under known patterns of light."
        )
    if simulated:
        sentences.append(
            f"{counted(simulated, 'person', 'people')} of the set are simulated: drawn from a "
            "model of heads and skin. Nobody was photographed for them."
        )
    return " ".join(sentences) + " Nothing was taken from the web or from another data set."


def captured(facts: Mapping[str, Any]) -> bool:
    """Whether the set shows anybody who was photographed."""
    return bool(facts["counts"]["subjects"] > facts["consent"]["subjects_simulated"])


def raw_data(facts: Mapping[str, Any]) -> str:
    """What the lab keeps besides the patches."""
    if not captured(facts):
        return "There are no photographs; whole maps stay in the lab."
    return "Photographs and whole maps; they stay in the lab."


def errors(facts: Mapping[str, Any]) -> str:
    """What is wrong in the maps."""
    if not captured(facts):
        return (
            "The maps are drawn from a model, without a camera's noise, and rounded as they are "
            "stored. The set's own errors are not known."
        )
    return (
        "Noise of the cameras and errors of the maps are those that the project measures (its "
        "benchmarks/RESULTS.md). The set's own are not known."
    )


def preprocessing(facts: Mapping[str, Any]) -> str:
    """What was computed of the photographs, if there were any."""
    if not captured(facts):
        return (
            "There were no photographs: maps of reflectance, a mesh and one texture of each face "
            f"were drawn from a model, by the software lightstage {__version__}."
        )
    return (
        "Of the photographs maps of reflectance, a mesh and one texture of the face were computed, "
        f"by the software lightstage {__version__}. What no camera saw is 0. Texels that cameras "
        "saw badly, at a grazing angle or beside an edge, were averaged with what is around them "
        "and on the face's other side: by a half where they were seen a fiftieth as well as from "
        "straight in front, and the less the better they were seen."
    )


def manipulation(facts: Mapping[str, Any]) -> str:
    """What was done so that patches are hard to trace."""
    turned = "turned at random" in facts["frame"]
    return (
        f"Of everybody {facts['left_out_share']:.0%} of the patches were left out, drawn for this "
        f"release. Patches of one face lie at least {counted(facts['gap'], 'texel')} apart and on "
        f"no common grid, and none shows more than {facts['most_of_a_face']:.1%} of the measured "
        "skin of its face. "
        + ("Each was turned and mirrored at random, in axes of its own. " if turned else "")
        + "Random numbers as small as their rounding were added to normals and shape. "
        "The order is random."
    )


def missing() -> str:
    """What is not there."""
    return (
        "A texel that shows no clear skin is 0 in all maps; a patch of which less than half is "
        "clear skin is not published. Eyes, lips' opening and hair are not shown; brows and beard "
        "of captured people count as skin, those of simulated people do not."
    )


def people(facts: Mapping[str, Any]) -> list[str]:
    """Who is shown, as far as it may be published."""
    return [str(each["said"]) for each in facts["people_by"]]


def personal(facts: Mapping[str, Any]) -> list[str]:
    """What of it is personal."""
    consent = facts["consent"]
    sentences = [
        "A patch is a picture of somebody's skin and may show a mole, a scar or a wrinkle. Skin "
        "tone is seen in every patch. Names, identifiers, dates, age and sex are at no patch.",
        f"A consent is on record of {counted(consent['subjects_on_record'], 'person', 'people')}; "
        f"{consent['subjects_simulated']} are simulated, and of {consent['subjects_without']} "
        "there is no record.",
    ]
    return sentences


def limitations(facts: Mapping[str, Any]) -> list[str]:
    """What the set cannot do, and what it cannot protect."""
    return [
        "Whole faces cannot be put together from it: places and directions of the patches, and all "
        "that lies between them, are missing.",
        str(facts["cannot_protect"]),
    ]


def uses() -> list[str]:
    """What it is fit for, and what not."""
    return [
        "Statistics and textures of facial skin, and networks that work on patches.",
        "Not for finding out who is shown, not for distinguishing people, not for medicine.",
    ]


def maintenance(about: About) -> str:
    """Whom to write to."""
    text = (
        f"Version {about.version}. Questions, errors and withdrawals of consent: {about.contact}."
    )
    return f"{text} {about.answers.maintenance}".strip()
