"""Processed folder: names, channels and texels as the format says."""

import numpy as np
import pytest

from lightstage.errors import FormatError
from lightstage.formats.exr import write_exr
from lightstage.formats.processed import MAPS, ProcessedFolder


@pytest.mark.parametrize("name", MAPS)
def test_each_map_survives_in_view_and_atlas(tmp_path, name):
    folder = ProcessedFolder(tmp_path)
    channels = MAPS[name].channels
    shape = (4, 6) if channels == 1 else (4, 6, channels)
    image = np.random.default_rng(0).uniform(-300, 300, shape).astype(np.float32)
    folder.write_view("cam0", name, image)
    folder.write_atlas(name, image)
    for read in (folder.read_view("cam0", name), folder.read_atlas(name)):
        assert np.allclose(read, image, rtol=0 if name == "position" else 1e-3)
    assert folder.view_path("cam0", name) == tmp_path / "views" / "cam0" / f"{name}.exr"
    assert folder.atlas_path(name) == tmp_path / "atlas" / f"{name}.exr"


def test_positions_keep_more_than_half_floats_hold(tmp_path):
    folder = ProcessedFolder(tmp_path)
    image = np.full((2, 2, 3), 123.4567, np.float32)
    folder.write_atlas("position", image)
    assert np.array_equal(folder.read_atlas("position"), image)


def test_wrong_channels_unknown_names_and_nan_are_refused(tmp_path):
    folder = ProcessedFolder(tmp_path)
    with pytest.raises(FormatError, match="3 channels"):
        folder.write_view("cam0", "diffuse_albedo", np.ones((2, 2)))
    with pytest.raises(FormatError, match=r"map 'albedo': found an unknown name, expected diff"):
        folder.view_path("cam0", "albedo")
    assert list(tmp_path.iterdir()) == []
    write_exr(folder.atlas_path("diffuse_albedo"), np.full((2, 2, 3), np.nan))
    with pytest.raises(FormatError, match=r"diffuse_albedo\.exr, element \(0, 0, 0\): found 12"):
        folder.read_atlas("diffuse_albedo")
    write_exr(folder.atlas_path("specular_albedo"), np.ones((2, 2, 3)))
    with pytest.raises(FormatError, match="1 channels"):
        folder.read_atlas("specular_albedo")


def test_masks_survive_and_views_are_listed(tmp_path):
    folder = ProcessedFolder(tmp_path)
    mask = np.random.default_rng(0).uniform(size=(5, 7)) > 0.5
    for camera in ("cam1", "cam0"):
        folder.write_mask(camera, mask)
    assert np.array_equal(folder.read_mask("cam1"), mask)
    assert folder.view_ids() == ["cam0", "cam1"]
    with pytest.raises(FormatError, match=r"cam2.*no readable picture"):
        folder.read_mask("cam2")
