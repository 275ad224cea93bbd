"""`template import-gnm`: a file of GNM's published layout becomes a template with its modes.

The file is made here, of our own template in GNM's arrays: the model itself is its users' own.
"""

from __future__ import annotations

import numpy as np
import pytest

from lightstage.formats.mesh import vertex_normals
from lightstage.formats.template import default_template_path, load_template
from processing.atlas.raster import overlap_share, rasterise
from processing.template.build import write_template
from processing.template.config import ImportConfig
from processing.template.gnm import SHAPES
from processing.template.import_gnm import REVERSED, import_gnm

RINGS, AROUND, EYE_MM = 6, 10, 11.0


def ball(middle_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An eyeball of quads: vertices, quads, their corners' UV, which fill a tile of their own."""
    down, along = np.linspace(0.15, np.pi - 0.15, RINGS + 1), np.arange(AROUND) / AROUND
    d, a = np.meshgrid(down, 2 * np.pi * along, indexing="ij")
    place = np.stack([np.sin(d) * np.sin(a), np.cos(d), np.sin(d) * np.cos(a)], axis=2)
    row, column = np.mgrid[:RINGS, :AROUND]
    after = (column + 1) % AROUND
    quads = np.stack(
        [row * AROUND + column, (row + 1) * AROUND + column,
         (row + 1) * AROUND + after, row * AROUND + after], axis=2
    ).reshape(-1, 4)  # fmt: skip
    u0, u1 = column / AROUND, (column + 1) / AROUND
    v0, v1 = 1 - row / RINGS, 1 - (row + 1) / RINGS
    corners = ((u0, v0), (u0, v1), (u1, v1), (u1, v0))
    uvs = np.stack([np.stack(corner, axis=2) for corner in corners], axis=2).reshape(-1, 4, 2)
    return middle_mm + EYE_MM * place.reshape(-1, 3), quads, uvs


@pytest.fixture(scope="module")
def arrays():
    """Our template with two eyeballs and a tongue, as GNM's arrays: metres, other axes."""
    own = load_template(default_template_path())
    mesh = own.mesh
    whole = mesh.faces[:, 3] >= 0
    quads, corners = mesh.faces[whole], mesh.face_uvs[whole]
    normals = vertex_normals(mesh.vertices, mesh.triangles())
    vertices, parts, uvs = [mesh.vertices], [quads], [mesh.uvs[corners]]
    names = {"skin": [np.ones(len(mesh.vertices))]}
    for name, marks in (("right_eye", slice(36, 42)), ("left_eye", slice(42, 48))):
        at = own.landmarks[marks]
        inward = mesh.vertices[at].mean(axis=0) - EYE_MM * normals[at].mean(axis=0)
        place, faces, uv = ball(inward)
        parts.append(faces + sum(map(len, vertices)))
        vertices.append(place)
        uvs.append(uv)
        names[name] = place
    place, faces, uv = ball(np.array([0.0, -60.0, 40.0]))
    parts.append(faces + sum(map(len, vertices)))
    vertices.append(place)
    uvs.append(uv)
    ends = np.cumsum([len(v) for v in vertices])
    count = int(ends[-1])
    groups = np.zeros((4, count))
    for index, (first, end) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
        groups[index, first:end] = 1
    eyes = np.maximum(groups[1], groups[2])
    moved = np.zeros((3, count, 3))
    moved[0] = 0.002 * groups[0][:, None] * [0, 0, 1]
    moved[1] = 0.001 * groups[3][:, None]  # the tongue alone
    moved[2] = 0.003 * groups[0][:, None] * [1, 0, 0]
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # GNM's axes may be any
    everything = 0.001 * np.concatenate(vertices) @ turn.T + [0.1, 1.6, 0.2]
    return {
        "template_vertex_positions": everything.astype(np.float32),
        "quads": np.concatenate(parts).astype(np.int32),
        "quad_uvs": np.concatenate(uvs).astype(np.float32),
        "vertex_identity_basis": (moved[:2] @ turn.T).astype(np.float32),
        "expression_basis": (moved[2:] @ turn.T).astype(np.float32),
        "identity_names": np.array(["head_000", "teeth_000"]),
        "expression_names": np.array(["lower_face_region_000"]),
        "vertex_groups": np.stack([groups[0], eyes, groups[3]]).astype(np.float32),
        "vertex_group_names": np.array(["skin", "eye_exteriors", "tongue"]),
    }


@pytest.fixture(scope="module")
def folder(arrays, tmp_path_factory):
    """A model and its landmarks, where GNM's repository has them."""
    root = tmp_path_factory.mktemp("gnm")
    model = root / "versions" / "v3_0" / "gnm_head.npz"
    model.parent.mkdir(parents=True)
    np.savez(model, **arrays)
    own = load_template(default_template_path())
    text = root / "landmarks" / "head_sparse_68.txt"
    text.parent.mkdir()
    marks = own.landmarks[REVERSED]  # GNM's order of the jaw
    text.write_text("".join(f"{m} 0.8 {m + 1} 0.1 {m + 2} 0.1\n" for m in marks))
    return model, text


@pytest.fixture(scope="module")
def made(folder, tmp_path_factory):
    config = ImportConfig()
    template, facts = import_gnm(folder[0], config=config)
    out = write_template(template, tmp_path_factory.mktemp("made") / "T", config)
    return load_template(out), facts


def test_skin_and_eyes_come_in_the_head_frame_and_the_tongue_stays_behind(made, arrays):
    template, facts = made
    own = load_template(default_template_path())
    count = len(own.mesh.vertices)
    assert len(template.mesh.vertices) == count + 2 * (RINGS + 1) * AROUND
    np.testing.assert_allclose(template.mesh.vertices[:count], own.mesh.vertices, atol=0.3)
    np.testing.assert_array_equal(template.landmarks, own.landmarks)
    assert facts["unit"] == "metres"
    assert len(template.regions["eyes"]) == 2 * (RINGS + 1) * AROUND
    skin = np.isin(np.arange(count), template.regions["skin"])
    assert skin[own.regions["skin"]].mean() > 0.8


def test_all_parts_share_one_tile_without_overlap(made):
    mesh = made[0].mesh
    raster = rasterise(mesh.uvs, mesh.triangle_uvs(), 768, 512)
    assert overlap_share(mesh.uvs, mesh.triangle_uvs(), raster) < 0.002
    # Corners are shared by quads: no seam at each edge.
    assert len(mesh.uvs) < 1.2 * len(mesh.vertices)


def test_modes_are_in_mm_and_those_of_the_tongue_alone_are_left_out(made):
    modes = made[0].modes
    assert (len(modes.identity), modes.expression_names) == (1, ("lower_face_region_000",))
    count = len(load_template(default_template_path()).mesh.vertices)
    np.testing.assert_allclose(modes.identity[0, :count], [[0, 0, 2.0]] * count, atol=0.1)
    np.testing.assert_allclose(modes.expression[0, :count], [[3.0, 0, 0]] * count, atol=0.1)


def test_a_file_that_is_not_gnms_is_refused_by_name(folder, arrays, tmp_path, run_command):
    out = tmp_path / "T"

    def ended(model, *words):
        found = run_command("processing", "template", "import-gnm", model, "--out", out, *words)
        assert found.code == 2
        assert not out.exists()
        assert "Traceback" not in found.err
        return found.err

    def changed(**values):
        path = tmp_path / "changed.npz"
        kept = {**arrays, **values}
        np.savez(path, **{k: v for k, v in kept.items() if v is not None})
        return ended(path, "--landmarks", folder[1])

    assert "gnm_head.npz" in ended(folder[1])
    assert "quads" in changed(quads=None)
    assert "quad_uvs" in changed(quad_uvs=arrays["quad_uvs"][:-1])
    assert "indices below" in changed(quads=arrays["quads"] + 10**6)
    packed = tmp_path / "packed.npz"
    np.savez_compressed(packed, **arrays)
    whole = packed.read_bytes()
    for place in range(300, len(whole) - 300, len(whole) // 40):
        packed.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        assert "packed.npz" in ended(packed, "--landmarks", folder[1])
    positions = arrays["template_vertex_positions"].copy()
    positions[3] = np.nan
    assert "NaN" in changed(template_vertex_positions=positions)
    assert "no numbers" in changed(vertex_groups=np.full(arrays["vertex_groups"].shape, "x"))
    alone = tmp_path / "gnm_head.npz"
    alone.write_bytes(folder[0].read_bytes())
    assert "--landmarks" in ended(alone)
    text = tmp_path / "marks.txt"
    lines = folder[1].read_text().splitlines()
    for words, said in (
        (lines[:67], "67 lines"),
        ([*lines[:67], "1 2 3"], "68 lines"),
        ([*lines[:67], "1 0.5 900000 0.5 2 0"], "landmark 67"),
        (["what"], "something else"),
    ):
        text.write_text("\n".join(words))
        assert said in ended(folder[0], "--landmarks", text)
    assert set(SHAPES) == set(arrays)
