"""The sheet of people held out: what it shows is what went in, and who may read it."""

from __future__ import annotations

import base64
import dataclasses
import html
import os
import re
import stat
from pathlib import Path

import cv2
import numpy as np
import torch

from learning.encoding import shrink
from learning.maps import from_batch, to_batch
from learning.samples import MOST, SAMPLES, Sample, write_samples
from learning.train import train
from processing.colour import srgb_from_linear
from processing.dataset import open_store
from tests.learning.test_event_file import records, scalars
from tests.learning.test_whole_face import TINY as FACES


def pictures(page: str) -> list[np.ndarray]:
    found = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    images = [np.frombuffer(base64.b64decode(data), np.uint8) for data in found]
    return [np.asarray(cv2.imdecode(image, cv2.IMREAD_COLOR))[..., ::-1] for image in images]


def test_a_sheet_shows_each_person_and_is_one_file_of_its_owner(tmp_path: Path) -> None:
    ramp = torch.linspace(-0.1, 1.2, 24).view(1, 1, 4, 6).repeat(1, 3, 1, 1)
    broken = ramp.clone()
    broken[0, :, 0, 0] = torch.nan
    half = torch.full((1, 3, 4, 6), 0.21404)
    before = os.umask(0o002)
    try:
        path = write_samples(tmp_path, "A <run>", "20 dB", [Sample("<b>", ramp, broken, half)])
        assert os.umask(0o002) == 0o002
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    page = path.read_text()
    assert not re.search(r"<script|https?:|src=\"(?!data:)|<b>", page)
    assert "&lt;b&gt;" in page
    texture, found, truth = pictures(page)
    assert texture.shape == (4, 6, 3)
    assert (texture[0, 0, 0], texture[-1, -1, 0]) == (0, 255)
    assert found[0, 0].tolist() == [0, 0, 0]
    assert np.array_equal(found.reshape(-1, 3)[1:], texture.reshape(-1, 3)[1:])
    assert np.abs(truth.astype(int) - 127.5).max() <= 1


def test_a_sheet_shows_so_many_people_at_most(tmp_path: Path) -> None:
    image = torch.zeros(1, 3, 2, 2)
    many = [Sample(f"person-{i}", image, image, image) for i in range(MOST + 3)]
    page = write_samples(tmp_path, "run", "", many).read_text()
    assert len(pictures(page)) == 3 * MOST


def test_a_training_leaves_a_sheet_of_people_held_out_and_its_scalars(
    store_path: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    config = dataclasses.replace(FACES, steps=2, detail_pairs=1, score_lights=1)
    result = train(open_store(store_path), run, config)
    sheet = run / SAMPLES
    assert stat.S_IMODE(sheet.stat().st_mode) == 0o600
    page = sheet.read_text()
    assert result.score.sentence() in html.unescape(page)
    assert "person-2" in page
    assert "person-0" not in page
    texture, found, truth = (image.astype(float) for image in pictures(page))
    store, everything = open_store(store_path), slice(None)
    known = to_batch(store.read(2, "diffuse_albedo", everything, everything))
    expected = 255 * srgb_from_linear(from_batch(shrink(known, truth.shape[:2])))
    assert np.abs(truth - expected).max() < 2
    assert texture.std() > truth.std()
    assert found.std() > 0
    (events,) = run.glob("events.out.tfevents.*")
    steps = [scalars(body)[1:] for body in records(events.read_bytes())[1:]]
    assert [step for step, _ in steps] == [0, 1, 2]
    assert {"diffuse", "specular", "learning_rate"} <= steps[0][1].keys()
    assert steps[2][1]["psnr_db"] == np.float32(result.score.psnr_db)
