"""The tables of `benchmarks.networks`: guesses by kind of head, other maps, flaws of textures."""

from __future__ import annotations

import itertools

import numpy as np

from benchmarks.networks_head import FIT, NETWORK, REFINED, Lit
from benchmarks.networks_lights import GROUPS
from benchmarks.networks_scores import correlation, db, deciles, specular_share
from benchmarks.record import record


def write_guesses(title: str, lit: list[Lit], texture_rows: int) -> None:
    """Record the table of guesses of one kind of head, then by tone and by light."""
    good = [each for each in lit if each.albedo]
    heads, lights = (len({getattr(e, key) for e in lit}) for key in ("name", "light"))
    tones = sorted({each.tone for each in good if each.tone is not None})
    rows = []
    for guess in dict.fromkeys(name for each in good for name in each.albedo):
        scores = [(each.tone, each.albedo[guess]) for each in good if guess in each.albedo]
        by_tone = [db(s.raw for t, s in scores if t == tone) for tone in tones]
        rows.append(
            [
                guess,
                f"{db(s.raw for _, s in scores):.2f}",
                f"{db(s.gain for _, s in scores):.2f}",
                f"{np.nanmin(by_tone):.2f}" if tones else "",
                f"{correlation(s.detail for _, s in scores):.2f}",
                str(len(scores)),
            ]
        )
    fitted = [each.albedo[REFINED].raw for each in good if FIT in each.albedo]
    author = " Head: Lee Perry-Smith, CC BY 3.0." if lit[0].kind == "scan" else ""
    record(
        title,
        [
            "diffuse albedo",
            "PSNR dB",
            "after the best gain a channel",
            f"worst of {len(tones)} tones, dB" if tones else "worst tone, dB",
            "detail in patches",
            "textures",
        ],
        rows,
        f"{heads} heads, none trained on, under {lights} lights rendered by sim at "
        f"{texture_rows} rows; {len(lit) - len(good)} textures were refused. On the "
        f"{len(fitted)} textures of the fit without a network, refined has {db(fitted):.2f} dB."
        f"{author}",
    )
    parts: list[tuple[str, list[Lit]]] = [
        (f"tone {tone}", [each for each in good if each.tone == tone]) for tone in tones
    ]
    for group in dict.fromkeys(GROUPS.values()):
        parts.append((group, [each for each in good if GROUPS[each.light] == group]))
    by = []
    for name, some in parts:
        if not some:
            continue
        cells = [name]
        for guess in (REFINED, NETWORK):
            scores_here = [each.albedo[guess] for each in some]
            cells += [f"{db(s.raw for s in scores_here):.2f}"]
            cells += [f"{db(s.gain for s in scores_here):.2f}"]
        by.append([*cells, str(len(some))])
    record(
        f"{title}, by tone and light",
        ["of", "refined dB", "after gain", "network dB", "after gain", "textures"],
        by,
        "As the table of the same name.",
    )


def write_others(title: str, lit: list[Lit], taken: str) -> None:
    """Record specular albedo, normals, new lights and confidence, a row for each kind of head."""
    rows = []
    for kind in dict.fromkeys(each.kind for each in lit):
        found = [each.other for each in lit if each.kind == kind and each.other is not None]
        if not found:
            continue
        normal = np.mean([each.normal_deg for each in found], axis=0)
        errors = deciles(np.concatenate([each.confidence for each in found]))
        falls = all(one >= other for one, other in itertools.pairwise(errors))
        new = np.mean([each.relit for each in found], axis=0)
        rows.append(
            [
                kind,
                f"{specular_share(each.specular for each in found):.2f}",
                f"{normal[0]:.2f} / {normal[2]:.2f}",
                f"{normal[1]:.2f} / {normal[3]:.2f}",
                f"{db(new):.1f} ({', '.join(f'{db([each]):.1f}' for each in new)})",
                ", ".join(f"{1000 * error:.0f}" for error in errors),
                "yes" if falls else "no",
                f"{np.median([each.light_deg for each in found]):.1f}",
            ]
        )
    record(
        title,
        [
            "heads",
            "specular albedo, of the best constant's error",
            "diffuse normal / the mesh's own, deg",
            "specular normal / the mesh's own, deg",
            "new lights, dB (clamshell, street, low lamp)",
            "error by decile of confidence, 1/1000",
            "falls in every one",
            "strongest lamp off by, deg (median)",
        ],
        rows,
        "Refined maps. The best constant is that of all the heads of a row together. New lights: "
        "the head rendered by sim with found and with true maps, in texture space. Errors by "
        "decile are of sRGB-encoded diffuse albedo, the least sure tenth first. "
        f"{taken}.",
    )


def write_flaws(title: str, lit: list[Lit]) -> None:
    """Record what flaws of textures cost."""
    some = [each for each in lit if each.flaws]
    if not some:
        return
    rows = []
    for flaw in dict.fromkeys(name for each in some for name, _ in each.flaws):
        cells = [flaw]
        for guess in (REFINED, NETWORK):
            scores = [each.flaws[flaw, guess] for each in some if (flaw, guess) in each.flaws]
            cells += [f"{db(s.raw for s in scores):.2f}", f"{db(s.gain for s in scores):.2f}"]
        rows.append([*cells, str(len(scores))])
    lights = ", ".join(dict.fromkeys(each.light for each in some))
    record(
        title,
        ["texture", "refined dB", "after gain", "network dB", "after gain", "textures"],
        rows,
        f"{len({each.name for each in some})} simulated people under {lights}; errors over all "
        "skin, of one side only what was not photographed too.",
    )
