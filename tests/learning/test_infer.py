from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
import torch.nn.functional as functional

from learning.data import DataConfig
from learning.errors import MapsError
from learning.infer import infer, run_tiles
from learning.infer_checks import look_through
from learning.networks.generator import Generator, GeneratorConfig
from learning.resample import resampled_texture
from lightstage.formats.mesh import Mesh

CONFIG = GeneratorConfig(width=8, downsamplings=2, global_blocks=1, local_blocks=1)


def random_generator() -> Generator:
    torch.manual_seed(1)
    return Generator(CONFIG).eval()


def face_like(rows: int, columns: int) -> torch.Tensor:
    """Six channels of broad shading, so that tiles have different statistics."""
    y, x = np.mgrid[:rows, :columns] / 60.0
    broad = np.stack([np.sin(x * (1 + c / 5) + c) * np.cos(y - c) for c in range(6)])
    return torch.tensor(broad[None], dtype=torch.float32)


def coarse(picture: torch.Tensor) -> torch.Tensor:
    """Means of 8 x 8 texels: the network's strides leave a finer pattern of their own."""
    return functional.avg_pool2d(picture, 8)


def border_steps(picture: torch.Tensor, spacing: int) -> tuple[float, float]:
    """Mean absolute difference of neighbours across tile borders, and elsewhere."""
    cells = coarse(picture)
    step = (cells[..., 1:] - cells[..., :-1]).abs().mean(dim=(0, 1, 2))
    borders = np.arange(1, cells.shape[-1]) % (spacing // 8) == 0
    return float(step[borders].mean()), float(step[~borders].mean())


def test_tile_borders_show_no_step() -> None:
    generator, inputs = random_generator(), face_like(192, 320)
    context = face_like(64, 64)[:, :3]
    blended, _ = run_tiles(generator, inputs, context, 64)
    across, elsewhere = border_steps(blended, 32)
    assert across < 1.1 * elsewhere
    # The same measure finds the steps of tiles laid side by side.
    with torch.inference_mode():
        rows = [
            torch.cat(
                [
                    generator(torch.cat([inputs[..., r : r + 64, c : c + 64], context], dim=1))
                    for c in range(0, 320, 64)
                ],
                dim=3,
            )
            for r in range(0, 192, 64)
        ]
    tiled_across, tiled_elsewhere = border_steps(torch.cat(rows, dim=2), 64)
    assert tiled_across > 1.5 * tiled_elsewhere


def test_a_picture_of_one_tile_is_the_networks_output() -> None:
    generator, inputs = random_generator(), face_like(32, 32)
    context = face_like(32, 32)[:, :3]
    found, spread = run_tiles(generator, inputs, context, 32)
    with torch.inference_mode():
        expected = generator(torch.cat([inputs, context], dim=1))
    torch.testing.assert_close(found, expected, atol=2e-5, rtol=1e-4)
    assert float(spread.max()) < 1e-3
    # The network itself is as it was.
    with torch.inference_mode():
        torch.testing.assert_close(generator(torch.cat([inputs, context], dim=1)), expected)


def test_moving_the_tiles_changes_little() -> None:
    generator, inputs = random_generator(), face_like(192, 192)
    context = face_like(64, 64)[:, :3]
    whole, _ = run_tiles(generator, inputs, context, 64)
    moved, _ = run_tiles(generator, inputs[..., 8:, 8:], context, 64)
    change = coarse(moved[..., 56:120, 56:120]) - coarse(whole[..., 64:128, 64:128])
    assert float(change.abs().mean()) < 0.25 * float(coarse(whole).std())


DATA = DataConfig(patch_px=32, relative=True)


def lit_ball(rows: int = 64, columns: int = 64) -> np.ndarray:
    y, x = np.mgrid[:rows, :columns] / 64.0
    shading = 0.4 + 0.3 * np.sin(6 * x) * np.cos(5 * y)
    return (shading[..., None] * [0.6, 0.4, 0.3]).astype(np.float32)


def test_maps_come_out_in_range_and_in_the_meshs_axes(ball_mesh: Mesh) -> None:
    generator = random_generator()
    inferred = infer(generator, DATA, lit_ball(), ball_mesh, np.eye(3, 4))
    found = inferred.maps
    assert set(found) == {
        "diffuse_albedo",
        "specular_albedo",
        "diffuse_normal",
        "specular_normal",
        "confidence",
    }
    assert found["diffuse_albedo"].shape == (64, 64, 3)
    assert found["specular_albedo"].shape == (64, 64)
    assert 0 <= found["specular_albedo"].min() <= found["specular_albedo"].max() <= 0.1
    assert 0 < found["confidence"].min() <= found["confidence"].max() <= 1
    for name in ("diffuse_normal", "specular_normal"):
        assert np.isfinite(found[name]).all()
        assert np.linalg.norm(found[name], axis=2).max() < 1 + 1e-4
    # The same head in a turned world: its normals turn with it, its albedo stays.
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned = ball_mesh.with_vertices(ball_mesh.vertices @ turn.T)
    other = infer(generator, DATA, lit_ball(), turned, np.column_stack([turn.T, np.zeros(3)])).maps
    np.testing.assert_allclose(other["diffuse_albedo"], found["diffuse_albedo"], atol=1e-3)
    np.testing.assert_allclose(other["diffuse_normal"], found["diffuse_normal"] @ turn.T, atol=5e-3)


def test_a_darker_photo_of_the_same_face_gives_proportional_albedo(ball_mesh: Mesh) -> None:
    generator = random_generator()
    first = infer(generator, DATA, 0.2 * lit_ball(), ball_mesh, np.eye(3, 4)).maps
    second = infer(generator, DATA, 0.1 * lit_ball(), ball_mesh, np.eye(3, 4)).maps
    np.testing.assert_allclose(
        second["diffuse_albedo"], 0.5 * first["diffuse_albedo"], rtol=1e-2, atol=1e-3
    )
    np.testing.assert_allclose(second["diffuse_normal"], first["diffuse_normal"], atol=1e-2)


def test_nothing_is_found_where_no_surface_is(ball_mesh: Mesh) -> None:
    assert ball_mesh.uvs is not None
    half = dataclasses.replace(ball_mesh, uvs=ball_mesh.uvs * [0.5, 1.0])
    found = infer(random_generator(), DATA, lit_ball(), half, np.eye(3, 4)).maps
    for image in found.values():
        assert not image[:, 33:].any()
        assert image[:, :31].any()


def test_a_texture_smaller_than_a_patch_is_refused(ball_mesh: Mesh) -> None:
    with pytest.raises(MapsError, match="found 16 x 16 texels, expected at least 32"):
        infer(random_generator(), DATA, lit_ball(16, 16), ball_mesh, np.eye(3, 4))


@pytest.mark.parametrize(("gain", "message"), [(1000.0, "a median of"), (1e-3, "a median of")])
def test_a_texture_of_another_exposure_is_refused(
    gain: float, message: str, ball_mesh: Mesh
) -> None:
    with pytest.raises(MapsError, match=f"photo.exr.*exposure: found {message}"):
        infer(
            random_generator(),
            DATA,
            gain * lit_ball(),
            ball_mesh,
            np.eye(3, 4),
            named=("photo.exr", "head.obj"),
        )


def test_negative_and_burnt_out_textures_are_refused(ball_mesh: Mesh) -> None:
    rng = np.random.default_rng(0)
    covered = np.ones((24, 16), bool)
    texture = rng.uniform(0.02, 0.5, (24, 16, 3)).astype(np.float32)
    assert look_through(texture, covered, "t.exr") == []
    with pytest.raises(MapsError, match=r"t\.exr: found \d+\.\d % of .* texels negative"):
        look_through(texture - 0.2, covered, "t.exr")
    noisy = texture.copy()
    noisy[0, :4] = -0.001  # noise about black
    assert look_through(noisy, covered, "t.exr") == []
    burnt = texture.copy()
    burnt[:2] *= 40
    with pytest.raises(MapsError, match=r"exposure: .* 95th percentile"):
        look_through(burnt, covered, "t.exr")


def test_a_black_texture_is_refused_and_black_texels_have_no_confidence(ball_mesh: Mesh) -> None:
    with pytest.raises(MapsError, match=r"found 100\.0 % of the surface's texels black"):
        infer(random_generator(), DATA, 0 * lit_ball(), ball_mesh, np.eye(3, 4))
    holes = lit_ball()
    holes[:, :40] = 0
    found = infer(random_generator(), DATA, holes, ball_mesh, np.eye(3, 4))
    assert not found.maps["confidence"][:, :40].any()
    assert found.maps["confidence"][:, 40:].all()
    assert any("62 % of the surface was not photographed" in note for note in found.notes)


def test_a_mesh_that_is_no_head_in_millimetres_is_refused(ball_mesh: Mesh) -> None:
    for scale in (1e-3, 0.1, 100.0):
        other = ball_mesh.with_vertices(scale * ball_mesh.vertices)
        with pytest.raises(MapsError, match="expected a head in millimetres, 100 to 1000"):
            infer(random_generator(), DATA, lit_ball(), other, np.eye(3, 4))
    flat = ball_mesh.with_vertices(ball_mesh.vertices * [1, 1, 0.01])
    with pytest.raises(MapsError, match="expected a head, which is not flat"):
        infer(random_generator(), DATA, lit_ball(), flat, np.eye(3, 4))


def test_albedo_is_never_above_one_and_that_it_was_cut_off_is_reported(ball_mesh: Mesh) -> None:
    found = infer(random_generator(), DATA, 3 * lit_ball(), ball_mesh, np.eye(3, 4))
    assert found.maps["diffuse_albedo"].max() == 1.0
    assert any("above 1 was cut off" in note for note in found.notes)


def test_a_texture_too_large_to_resample_is_refused_before_it_is_made() -> None:
    with pytest.raises(MapsError, match="found 6144 x 6144000 texels at the size"):
        resampled_texture(np.ones((2, 2000, 3), np.float32), 6144, "wide.exr")
