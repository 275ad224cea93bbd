"""What the renderer does with bad input: the rows of the table in docs/renderer.md, one by one.

Pictures of light are in test_panorama, light sets in test_formats_environment, a mesh without UV in
test_uv_occlusion_view.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from learning.errors import MapsError
from learning.map_checks import looks_encoded
from learning.maps import load_head
from learning.render.environments import Environment
from learning.render.shading import ShadeOptions, shade
from lightstage.errors import FormatError, LightstageError
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.mesh import Mesh, read_obj
from lightstage.formats.processed import ProcessedFolder
from tests.learning.scenes import flat_skin, one_light, random_lights, random_skin

NO_SCATTER = ShadeOptions(subsurface_mm=0)
WAYS = [("physical", "auto"), ("physical", "eager"), ("paper", "auto"), ("ggx", "auto")]


def atlas_with(
    source: ProcessedFolder, folder: Path, name: str, values: np.ndarray, half: bool = False
) -> Path:
    """A copy of a person's atlas with one map in place of another."""
    folder.mkdir()
    for file in (source.root / "atlas").iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    write_exr(folder / f"{name}.exr", values, half=half)
    return folder


def map_of(person: ProcessedFolder, name: str) -> np.ndarray:
    return read_exr(person.atlas_path(name)).astype(np.float32)


@pytest.fixture(scope="module")
def person(people: list[ProcessedFolder]) -> ProcessedFolder:
    return people[0]


@pytest.fixture(scope="module")
def mesh(person: ProcessedFolder) -> Mesh:
    return read_obj(person.registered_mesh)


def test_maps_of_different_sizes_or_channels_are_refused(
    person: ProcessedFolder, mesh: Mesh, tmp_path: Path
) -> None:
    smaller = map_of(person, "specular_normal")[:-2]
    with pytest.raises(MapsError, match="found 94 x 64 texels, expected 96 x 64"):
        load_head(atlas_with(person, tmp_path / "a", "specular_normal", smaller), mesh)
    grey = map_of(person, "diffuse_albedo")[..., 0]
    with pytest.raises(FormatError, match="expected 3 channels"):
        load_head(atlas_with(person, tmp_path / "b", "diffuse_albedo", grey), mesh)
    with pytest.raises(MapsError, match="specular_albedo: found 2 x 2 texels, expected 1 x 1"):
        flat_skin(specular_albedo=torch.zeros(1, 1, 2, 2))
    with pytest.raises(MapsError, match=r"shininess: found 1 x 3 x 1 x 1, expected \(batch, 1,"):
        flat_skin(shininess=torch.ones(1, 3, 1, 1))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_and_infinity_in_a_file_are_refused(
    bad: float, person: ProcessedFolder, mesh: Mesh, tmp_path: Path
) -> None:
    normal = map_of(person, "specular_normal")
    normal[5, 6, 0] = bad
    with pytest.raises(LightstageError, match=r"specular_normal\.exr.*finite|NaN"):
        load_head(atlas_with(person, tmp_path / "a", "specular_normal", normal), mesh)


@pytest.mark.parametrize(("mode", "engine"), WAYS)
@pytest.mark.parametrize("name", ["diffuse_albedo", "diffuse_normal", "shininess", "position_mm"])
def test_nan_in_a_tensor_is_passed_on_and_stays_where_it_is(
    name: str, mode: str, engine: str
) -> None:
    rng = np.random.default_rng(0)
    # Lit and seen from in front, so that every input counts.
    skin, lights = random_skin(rng), random_lights(rng)
    up = torch.tensor([0.0, 0.0, 2.0]).double().view(1, 3, 1, 1)
    skin = dataclasses.replace(
        skin, diffuse_normal=skin.diffuse_normal + up, specular_normal=skin.specular_normal + up
    )
    places = lights.position_mm * torch.tensor([1.0, 1.0, 0.0]) + torch.tensor([0, 0, 2000.0])
    lights = dataclasses.replace(lights, position_mm=places)
    options = ShadeOptions(mode=mode, engine=engine, subsurface_mm=0)
    values = getattr(skin, name).clone()
    values[0, 0, 2, 1] = float("nan")
    found = shade(dataclasses.replace(skin, **{name: values}), lights, options)
    assert torch.isnan(found[0, 0, 2, 1])
    found[0, :, 2, 1] = 0
    assert torch.isfinite(found).all()


def test_a_negative_albedo_in_a_file_is_refused(
    person: ProcessedFolder, mesh: Mesh, tmp_path: Path
) -> None:
    albedo = map_of(person, "diffuse_albedo")
    albedo[3, 4, 1] = -0.2
    with pytest.raises(MapsError, match=r"texel \(3, 4, 1\): found 1 negative"):
        load_head(atlas_with(person, tmp_path / "a", "diffuse_albedo", albedo), mesh)


def test_normals_of_another_length_are_made_unit_and_counted(
    person: ProcessedFolder, mesh: Mesh, tmp_path: Path
) -> None:
    normal = map_of(person, "diffuse_normal")
    normal[40:42, 10:13] *= 1.5
    head = load_head(atlas_with(person, tmp_path / "a", "diffuse_normal", normal), mesh)
    assert head.notes == ("diffuse_normal: 6 normals not of length 1, made unit",)
    plain, lights = load_head(person.root / "atlas", mesh), one_light((0, 0, 1000.0))
    for mode, engine in WAYS:
        options = ShadeOptions(mode=mode, engine=engine)
        found, expected = (shade(h.skin, lights, options) for h in (head, plain))
        torch.testing.assert_close(found, expected, atol=1e-3, rtol=1e-3)


def test_normals_too_short_for_a_direction_fade_and_missing_ones_are_the_meshs(
    person: ProcessedFolder, mesh: Mesh, tmp_path: Path
) -> None:
    lights = one_light((0, 0, 1000.0))
    for length, share in ((1.0, 1.0), (1e-5, 1.0), (5e-7, 0.5), (0.0, 0.0)):
        found = shade(flat_skin((0, 0, length)), lights, NO_SCATTER)
        assert float(found[0, 0, 0, 0]) == pytest.approx(0.7 * share)
    normal = map_of(person, "diffuse_normal")
    normal[40:50] = 0
    head = load_head(atlas_with(person, tmp_path / "a", "diffuse_normal", normal), mesh)
    filled = head.skin.diffuse_normal[0, :, 40:50].numpy().transpose(1, 2, 0)
    np.testing.assert_allclose(filled, head.raster.normals(mesh)[40:50], atol=1e-6)
    assert head.notes == ()


def test_an_albedo_that_was_not_decoded_is_reported_and_a_linear_one_is_not(
    person: ProcessedFolder, mesh: Mesh, tmp_path: Path
) -> None:
    encoded = np.round(255 * map_of(person, "diffuse_albedo") ** (1 / 2.2)) / 255
    for folder, half in ((tmp_path / "a", False), (tmp_path / "b", True)):
        head = load_head(atlas_with(person, folder, "diffuse_albedo", encoded, half), mesh)
        (note,) = head.notes
        assert "8-bit sRGB" in note
    everywhere = np.ones((96, 64), bool)
    rng = np.random.default_rng(0)
    bytes_of = rng.integers(20, 230, (96, 64, 3)) / 255
    decoded = np.where(bytes_of < 0.04045, bytes_of / 12.92, ((bytes_of + 0.055) / 1.055) ** 2.4)
    assert looks_encoded(bytes_of, everywhere)
    assert not looks_encoded(decoded, everywhere)
    assert not looks_encoded(rng.uniform(0, 1, (96, 64, 3)), everywhere)
    assert not looks_encoded(np.full((4, 4, 3), 0.4), np.ones((4, 4), bool))


@pytest.mark.parametrize("scale", [1e-3, 0.1])
def test_a_mesh_in_metres_or_centimetres_is_refused(
    scale: float, person: ProcessedFolder, mesh: Mesh
) -> None:
    small = Mesh(mesh.vertices * scale, mesh.faces, mesh.uvs, mesh.face_uvs)
    with pytest.raises(MapsError, match="metres or centimetres"):
        load_head(person.root / "atlas", small)


@pytest.mark.parametrize(("mode", "engine"), WAYS)
def test_no_lights_leave_the_ambient_light_alone(mode: str, engine: str) -> None:
    lights = one_light((0, 0, 1000.0), ambient=0.25)
    none = Environment(
        lights.position_mm[:, :0],
        lights.rgb[:, :0],
        lights.ambient_rgb,
        lights.distant[:, :0],
        lights.camera_mm,
    )
    found = shade(flat_skin(albedo=0.5), none, ShadeOptions(mode=mode, engine=engine))
    # As printed the ambient light multiplies the lights' sum, which is 0.
    assert float(found.max()) == pytest.approx(0.0 if mode == "paper" else 0.125)


@pytest.mark.parametrize(("mode", "engine"), [w for w in WAYS if w[0] != "paper"])
def test_a_light_within_a_millimetre_is_as_bright_as_at_one(mode: str, engine: str) -> None:
    options = ShadeOptions(mode=mode, engine=engine, subsurface_mm=0)
    lights = one_light((0, 0, 1000.0))
    found = []
    for distance in (1.0, 0.5, 1e-3):
        place = torch.tensor([0, 0, 1000.0 - distance]).double().view(1, 3, 1, 1)
        found.append(float(shade(flat_skin(position_mm=place), lights, options)[0, 0, 0, 0]))
    # One millimetre away it is 1000 squared times what it is at the origin.
    assert found[0] == pytest.approx(0.7e6)
    assert max(found[1:]) <= found[0]
    assert np.isfinite(found).all()


@pytest.mark.parametrize(("mode", "engine"), WAYS)
def test_a_light_opposite_to_the_camera_gives_no_gloss(mode: str, engine: str) -> None:
    # Light and camera in the plane of the skin, on its two sides.
    skin = flat_skin(albedo=0.0, specular_albedo=torch.ones(1, 1, 1, 1).double())
    camera = torch.tensor([[-1000.0, 0, 0]]).double()
    lights = dataclasses.replace(one_light((1000.0, 0, 0)), camera_mm=camera)
    options = ShadeOptions(mode=mode, engine=engine, subsurface_mm=0)
    assert float(shade(skin, lights, options).abs().max()) == 0.0


def test_maps_of_another_mesh_are_refused(
    person: ProcessedFolder, mesh: Mesh, tmp_path: Path
) -> None:
    assert mesh.uvs is not None
    turned_over = dataclasses.replace(mesh, uvs=mesh.uvs * [1, -1] + [0, 1])
    with pytest.raises(MapsError, match=r"position\.exr: found positions \d+ mm from flipped\.obj"):
        load_head(person.root / "atlas", turned_over, mesh_named="flipped.obj")
    folder = atlas_with(person, tmp_path / "a", "confidence", map_of(person, "confidence"))
    (folder / "position.exr").unlink()
    with pytest.raises(MapsError, match=r"diffuse_normal\.exr: found normals \d+ degrees from"):
        load_head(folder, turned_over)
    world = mesh.with_vertices(mesh.vertices @ np.diag([-1.0, 1.0, -1.0]))
    with pytest.raises(MapsError, match="normals"):
        load_head(folder, world)


def test_a_mesh_in_metres_is_named(person: ProcessedFolder, mesh: Mesh) -> None:
    small = mesh.with_vertices(mesh.vertices / 1000)
    with pytest.raises(MapsError, match=r"^head\.obj, vertices: found a head of"):
        load_head(person.root / "atlas", small, mesh_named=Path("head.obj"))
