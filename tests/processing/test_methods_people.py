"""Methods of separation on a simulated person, through the stages, against the person's truth."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightstage.commands import quiet
from lightstage.formats.config import make_config
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from lightstage.rig import default_rig
from processing.coarse_maps import write_as_views
from processing.decode.config import DecodeConfig
from processing.decode.stage import decode
from processing.separation.config import SeparateConfig
from processing.separation.stage import separate
from sim.light.world import World
from sim.session import SessionConfig, write_direct
from tests.processing.lit_ball import angle_deg
from tests.sim.conftest import one_person, write_truth_of_one_person

SEQUENCES = ("binary", "linear", "binary-polarised")


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Path]]:
    """Sequence to a session of one person and its decoded folder; `truth` lies beside them."""
    root = tmp_path_factory.mktemp("people")
    rig = default_rig().scaled(0.04)
    world = World(one_person(), dataclasses.replace(rig, cameras=rig.cameras[:1]))
    write_truth_of_one_person(world, root / "truth")
    made = {}
    for sequence in SEQUENCES:
        session, out = root / sequence, root / f"{sequence}.out"
        write_direct(world, session, SessionConfig(sequence=sequence), 3, quiet)
        decode(load_session(session), out, DecodeConfig())
        made[sequence] = session, out
    return made


def separated(
    people: dict[str, tuple[Path, Path]], sequence: str, told: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, float]]:
    """Facts of the stage, and errors on skin seen at less than 60 degrees or so."""
    session, out = people[sequence]
    facts = separate(load_session(session), out, make_config(SeparateConfig, told, "test"))
    write_as_views(out, ["cam0"])
    truth, found = ProcessedFolder(out.parent / "truth"), ProcessedFolder(out)
    skin = truth.read_mask("cam0") & (found.read_view("cam0", "confidence") > 0.5)

    def both(name: str) -> tuple[np.ndarray, np.ndarray]:
        return found.read_view("cam0", name)[skin], truth.read_view("cam0", name)[skin]

    albedo, true_albedo = both("diffuse_albedo")
    specular, true_specular = both("specular_albedo")
    return facts, {
        "normal_deg": float(angle_deg(*both("diffuse_normal")).mean()),
        "facet_deg": float(angle_deg(*both("specular_normal")).mean()),
        "albedo": float(np.sqrt(((albedo - true_albedo) ** 2).mean())),
        "specular": float(np.abs(specular - true_specular).mean()),
        "covered": float(skin.sum() / truth.read_mask("cam0").sum()),
    }


@pytest.mark.parametrize(
    ("sequence", "method", "relief"),
    [("binary", "colour", "diffuse"), ("linear", "linear", "detail"),
     ("binary-polarised", "polarised", "mirror")],
)  # fmt: skip
def test_the_method_of_each_sequence_beats_the_published_formulas(
    people: dict[str, tuple[Path, Path]], sequence: str, method: str, relief: str
) -> None:
    facts, ours = separated(people, sequence, {})
    assert (facts["method"], facts["specular_normals"]) == (method, relief)
    assert facts["lights"] == "nominal"
    assert 0 < facts["ill_posed_share"]["cam0"] < 0.3
    for peer in ("kampouris", "ratios"):
        _, theirs = separated(people, "binary", {"method": peer})
        for error in ("normal_deg", "facet_deg", "albedo", "specular"):
            if (peer, error) != ("ratios", "specular"):  # a constant near the truth
                assert ours[error] < 0.9 * theirs[error], (peer, error)
    assert ours["covered"] > 0.9


def test_chroma_keeps_the_highlight_out_of_the_normals_and_red_and_blue_do_not(
    people: dict[str, tuple[Path, Path]],
) -> None:
    errors = [
        separated(people, "binary", {"normals": part})[1]["normal_deg"]
        for part in ("chroma", "red", "blue")
    ]
    assert errors[0] < errors[1] < errors[2]
