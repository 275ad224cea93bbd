"""Detail finer than what the whole-face network sees: its bands, and their shares."""

from __future__ import annotations

import numpy as np

from learning.encoding import shrink
from learning.maps import to_batch
from learning.whole.detail import BANDS, Shares, bands, enlarged, with_detail


def test_bands_are_the_whole_texture_and_hold_nothing_of_what_was_not_photographed() -> None:
    rng = np.random.default_rng(0)
    texture = rng.uniform(0.1, 0.5, (192, 128, 3)).astype(np.float32)
    small = shrink(to_batch(texture), (48, 32))[0].permute(1, 2, 0).numpy()
    seen = np.ones((192, 128), bool)
    total = sum(bands(texture, seen, small))
    wanted = np.log(texture) - enlarged(np.log(small), 192, 128)
    np.testing.assert_allclose(total, wanted, atol=1e-5)
    seen[:, 64:] = False
    hidden = np.where(seen[..., None], texture, 0)
    other = np.where(seen[..., None], texture, 77.0)
    for first, second in zip(bands(hidden, seen, small), bands(other, seen, small), strict=True):
        np.testing.assert_array_equal(first, second)
        assert not first[:, 64:].any()


def test_shares_that_made_an_albedo_are_found_again() -> None:
    rng = np.random.default_rng(0)
    shares, true = Shares(), [0.9, 0.6, 0.3, 0.0]
    for _ in range(2):
        parts = [rng.normal(size=(24, 16, 3)) for _ in range(BANDS)]
        wanted = sum(s * p for s, p in zip(true, parts, strict=True))
        shares.add(parts, np.asarray(wanted), np.ones((24, 16)))
    np.testing.assert_allclose(shares.solve(), true, atol=1e-3)
    assert Shares().solve() == [0.0] * BANDS


def test_with_full_shares_the_albedo_is_the_texture_over_its_slow_light() -> None:
    rng = np.random.default_rng(0)
    skin = rng.uniform(0.2, 0.4, (192, 128, 3)).astype(np.float32)
    light = np.linspace(0.5, 1.0, 192, dtype=np.float32)[:, None, None]
    low = shrink(to_batch(skin * light), (48, 32))[0].permute(1, 2, 0).numpy()
    true_low = shrink(to_batch(skin), (48, 32))[0].permute(1, 2, 0).numpy()
    seen = np.ones((192, 128), bool)
    found = with_detail(np.log(true_low), skin * light, seen, low, [1.0] * BANDS)
    np.testing.assert_allclose(found[8:-8], skin[8:-8], rtol=0.02)
