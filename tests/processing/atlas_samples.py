"""What tests of the atlas ask of its samples."""

import numpy as np

from processing.atlas.blend import Blender
from processing.atlas.config import BlendConfig, WeightConfig
from processing.atlas.sampling import Reading, readable, room, side_by_side
from processing.atlas.weights import Sampler, ViewSamples


def look(cam, mesh, texels, measured, *, confidence=None, mask=None, finest=1.0):
    """A view's samples; confident and usable everywhere unless told."""
    shape = (cam.height_px, cam.width_px)
    sampler = Sampler(mesh.vertices, mesh.triangles(), texels, finest, WeightConfig())
    return sampler.look(
        cam,
        np.ones(shape, np.float32) if confidence is None else confidence,
        np.ones(shape, bool) if mask is None else mask,
        measured,
    )


def samples_of(pixel, weight, shape=(20, 20), usable=None):
    usable = np.ones(shape, bool) if usable is None else usable
    reading = Reading(
        readable(usable),
        np.arange(len(pixel), dtype=np.int32),
        np.asarray(pixel, np.float32),
        np.asarray(weight, np.float32),
    )
    return ViewSamples((slice(0, usable.shape[0]), slice(0, usable.shape[1])), reading, 1.0)


def blended(count, views, best=None, config=None):
    """(count, c) of [(samples, picture)], the skip of detail off unless `best` is given."""
    samples = [one for one, _ in views]
    none = np.zeros(count, np.float32)
    blender = Blender(none if best is None else best, samples, config or BlendConfig())
    channels = views[0][1].shape[2]
    out = np.zeros((count, room(channels)), np.float32)
    for index, (one, picture) in enumerate(views):
        blender.add(index, side_by_side([picture[one.window]], channels), out)
    blender.finish(out)
    assert not out[:, channels:].any()
    return out[:, :channels]
