"""Which method a session's patterns allow, and each method's function."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from lightstage.formats.session import Session
from processing.errors import ProcessingError
from processing.lighting.lights import PatternLights, fix_normals, pattern_lights, rank
from processing.separation import colour, kampouris, linear, mux, polarised, ratios
from processing.separation.config import Relief, SeparateConfig
from processing.separation.view_readings import Pixels
from processing.view_maps import PixelMaps


@dataclasses.dataclass(frozen=True)
class Method:
    """What is known of a method of separation.

    Attributes:
        separate: separates one view's pixels under the lights of their patterns.
        normals: what it takes its diffuse normals from by itself, in a word.
        relief: what its specular normals are by itself.
        normals_taken: values that `normals` of the configuration may have beside ``auto``; None
            for all of them.
        reliefs_taken: the same for `specular_normals`.
        pairs_alone: whether it takes nothing from other photographs than `full` and the pairs.
    """

    separate: Callable[[Pixels, PatternLights, SeparateConfig], PixelMaps]
    normals: str
    relief: Relief
    normals_taken: tuple[str, ...] | None = None
    reliefs_taken: tuple[str, ...] | None = None
    pairs_alone: bool = False


METHODS = {
    "colour": Method(colour.separate_pixels, "chroma", colour.RELIEF),
    "kampouris": Method(kampouris.separate_pixels, "separated", kampouris.RELIEF, pairs_alone=True),
    "ratios": Method(
        ratios.separate_pixels, "mean", "diffuse", reliefs_taken=("diffuse",), pairs_alone=True
    ),
    "polarised": Method(polarised.separate_pixels, "crossed", polarised.RELIEF),
    "linear": Method(linear.separate_pixels, "chroma", linear.RELIEF),
    "mux": Method(
        mux.separate_pixels, "channels", "diffuse", normals_taken=(), reliefs_taken=("diffuse",)
    ),
}
"""Every method by its name, which `SeparateConfig.method` lists too."""


def chosen_method(lights: PatternLights, config: SeparateConfig) -> str:
    """The method that separates a session's photographs.

    Args:
        lights: of the session's patterns, without dark ones.
        config: its `method`, where it is not ``auto``, is taken if the patterns allow it.

    Raises:
        ProcessingError: no method, or not the one named, can separate these patterns.
    """
    fitting = fitting_methods(lights)
    found = ", ".join(lights.patterns)
    if not fitting:
        raise no_normals(lights.patterns)
    method = fitting[0] if config.method == "auto" else config.method
    if method not in fitting:
        raise ProcessingError(
            "configuration",
            field="separate.method",
            found=f"{config.method} for the patterns {found}",
            expected=f"auto, {', '.join(fitting)} for these patterns",
            hint="Leave the method to `auto`, or capture the sequence that it needs.",
        )
    chosen = METHODS[method]
    for option, wanted, taken in (
        ("normals", config.normals, chosen.normals_taken),
        ("specular_normals", config.specular_normals, chosen.reliefs_taken),
    ):
        if taken is not None and wanted not in ("auto", *taken):
            raise ProcessingError(
                "configuration",
                field=f"separate.{option}",
                found=wanted,
                expected=", ".join(("auto", *taken)) + f" with the method {method}",
                hint="It has no others.",
            )
    return method


def give_normals(session: Session, patterns: tuple[str, ...]) -> bool:
    """Whether a session's photographs under P lit patterns give normals by any method."""
    return bool(fitting_methods(pattern_lights(session, patterns)))


def no_normals(patterns: Sequence[str]) -> ProcessingError:
    """Warnings of photographs whose patterns no method separates."""
    return ProcessingError(
        "session.json",
        field="sequence",
        found=", ".join(patterns),
        expected=f"patterns that light a face from three directions: {_lacking(patterns)}",
        hint="A mesh needs no more than one light: `lightstage-processing run SESSION --out OUT "
        "--until reconstruct`. For maps, capture with `--sequence binary`.",
    )


def _lacking(patterns: Sequence[str]) -> str:
    """Which photographs would make normals of what there is, in words."""
    banks = {name.partition("@")[2] for name in patterns}
    bases = {name.partition("@")[0].removeprefix("lin-") for name in patterns}
    if bases & {"mux-1", "mux-2"}:
        return "both mux-1 and mux-2, of a rig whose lamps have colours of their own"
    axes = [f"{axis}+" for axis in "xyz" if not bases & {f"{axis}+", f"{axis}-"}]
    names = " and ".join(filter(None, [", ".join(axes[:-1]), *axes[-1:]]))
    if banks != {""}:
        return (
            f"photographs under {names or 'the same patterns'} as well, each as @cross and as "
            "@parallel, or all without polarisers"
        )
    return f"photographs under {names or 'lights elsewhere'} as well, by every camera"


def fitting_methods(lights: PatternLights) -> list[str]:
    """Methods that can separate photographs under these lights, the best first."""
    names = lights.patterns
    if lights.polarised:
        banks = [
            tuple(n for n in names if n.endswith(f"@{bank}")) for bank in ("cross", "parallel")
        ]
        whole = all(banks) and len(banks[0]) + len(banks[1]) == len(names)
        return ["polarised"] if whole and rank(lights.of(banks[0])) == 3 else []
    if rank(lights) < 3:
        return []
    if mux_shots(lights):
        return ["mux"]
    # One shot of `mux` has three directions, but each in a channel of its own.
    if not fix_normals(lights):
        return []
    if any(name.startswith("lin-") for name in names):
        return ["linear", "colour"]
    pairs = all(f"{axis}{sign}" in names for axis in "xyz" for sign in "+-")
    return ["colour", "linear", *(("kampouris", "ratios") if pairs else ())]


def normals_of(method: str, config: SeparateConfig) -> str:
    """What a method's diffuse normals are taken from, in a word."""
    return METHODS[method].normals if config.normals == "auto" else config.normals


def used_patterns(method: str, lights: PatternLights) -> tuple[str, ...]:
    """The patterns whose photographs a method takes anything from, in their order."""
    if not METHODS[method].pairs_alone:
        return lights.patterns
    wanted = {"full", *(f"{axis}{sign}" for axis in "xyz" for sign in "+-")}
    return tuple(name for name in lights.patterns if name in wanted)


def mux_shots(lights: PatternLights) -> bool:
    """Whether these are two shots whose colour channels hold three gradients of their own."""
    return set(lights.patterns) == {"mux-1", "mux-2"}
