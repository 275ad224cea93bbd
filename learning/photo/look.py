"""One photograph at a fitted head: what of it is skin, hair or worn, and its texels."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from learning.errors import MapsError
from learning.infer import Inferred
from learning.mesostructure.infer import TrainedMesostructure
from learning.networks.whole_face import WholeFaceNetwork
from learning.photo.enlarge import Enlarged, enlarged, texels_a_pixel
from learning.photo.eye_texels import eye_texels, with_eyes
from learning.photo.foreground import foreground
from learning.photo.fringe import Forehead
from learning.photo.glasses import worn_before
from learning.photo.shape_fit import Photograph, Shape, aside_deg
from learning.photo.skin_mask import (
    above_mouth,
    around_eyes,
    beard_texels,
    features,
    hair_texels,
    in_no_light,
    no_skin,
    open_mouth,
    other_tint,
    own_hair,
)
from learning.photo.unwrap import Unwrapped, unwrap, without_slivers
from learning.render.uv import UvRaster, rasterise
from learning.upscale.network import Rcan
from learning.whole.detail import enlarged as resized
from learning.whole.infer import infer_whole_face
from learning.whole.light import SEARCH_SECONDS
from learning.whole.refine import OF_TRUE_SHAPES, OwnSkin
from lightstage.formats.mesh import Mesh
from lightstage.formats.template import Template
from lightstage.rig import Camera

COARSE_ROWS = 384
"""Of the texture on which the mask of the skin is found."""
LEAST_SEEN = 0.05
"""Share of the face's texels that a photograph must show."""
LARGEST_MISFIT = 3.0
"""Of a light by which skin is distinguished from what else a photograph shows. Shadows fall a
little beside where the fitted shape casts them: hard lights leave 1.8 to 2.4 and are found within 7
to 17 degrees; a hat or glasses leave 3.4. The last light, without these, is taken in any case."""
MOST_ASIDE_DEG = 15.0
"""How far off straight in front a photograph fills the texels of eyes, at most. Seven photographs
from in front gained 1.4 dB of albedo, four from 20 and 35 degrees to the side, where the shape's
own texels show more white, lost 6."""


@dataclasses.dataclass(frozen=True)
class Looked:
    """A photograph at the coarse size: its skin and its light.

    Attributes:
        photograph: itself.
        index: of the photograph.
        mesh: the person as it shows them.
        camera: of it.
        person: (h, w) bool, its pixels that show the person.
        other: (rows, columns) bool, texels that it shows and that are no skin.
        hair: (rows, columns) bool, hair beyond where most people have it, and a cap.
        masked: share of these in the face.
        found: skin and light; None where they were not asked for.
        notes: for the user.
    """

    photograph: Photograph
    index: int
    mesh: Mesh
    camera: Camera
    person: np.ndarray
    other: np.ndarray
    hair: np.ndarray
    masked: float
    found: Inferred | None
    notes: tuple[str, ...]


def look(
    photograph: Photograph,
    shape: Shape,
    index: int,
    template: Template,
    network: WholeFaceNetwork,
    rounds: int,
    light: bool,
) -> Looked:
    """Find in a photograph what is skin, and its light where it is asked for.

    Raises:
        MapsError: it shows too little of the face, or in too much or too little light.
    """
    mesh, camera, vertices = shape.meshes[index], shape.cameras[index], shape.model.face
    person = foreground(photograph.rgb_linear, mesh, vertices, camera)
    if photograph.mouth_px is not None:
        person &= ~open_mouth(photograph.mouth_px, person.shape)
    notes: tuple[str, ...] = ()
    worn = worn_before(photograph.rgb_linear, mesh.vertices[template.landmarks], camera)
    if worn is not None:
        person &= ~worn.hidden
        behind = "the eyes behind them are" if worn.dark else "the skin behind the frame is"
        notes = (f"{photograph.name}: {worn.name} were removed; {behind} guessed",)
        if worn.dark:
            photograph = dataclasses.replace(photograph, eyes_px=None, whites=None)
    nothing = np.zeros((COARSE_ROWS, COARSE_ROWS * 2 // 3), bool)
    looked = Looked(photograph, index, mesh, camera, person, nothing, nothing, 0.0, None, notes)
    coarse = Texels(looked, COARSE_ROWS, template, vertices)
    face = coarse.raster.interpolate(vertices[:, None].astype(float))[..., 0] > 0.5
    shown = coarse.unwrapped.seen
    share = float((shown & face).sum() / max(face.sum(), 1))
    if share < LEAST_SEEN:
        raise MapsError(
            photograph.name,
            found=f"{100 * share:.0f} % of the face",
            expected=f"{100 * LEAST_SEEN:.0f} % or more",
            hint="Take a photograph from farther in front.",
        )
    keep, hair = coarse.features | coarse.beard, nothing
    texture = coarse.unwrapped.texture
    skin, found = shown & ~other_tint(texture, shown, template, coarse.raster), None
    settled = False
    for index_of_round in range(rounds - 1):
        found = coarse.inferred(network, texture, skin, SEARCH_SECONDS, camera, None)
        other = no_skin(found.maps["diffuse_albedo"], network, skin, keep)
        if found.light is None:
            # A hat or glasses may keep every light from explaining the photograph.
            normal = coarse.raster.normals(mesh)
            other |= in_no_light(texture, found.maps["diffuse_albedo"], normal, skin, keep)
        if index_of_round == 0:
            # Later there is no hair left in it.
            hair = Forehead(template, coarse.raster).fringe(
                found.maps["diffuse_albedo"], shown, other
            )
        if coarse.hair is not None:
            above = above_mouth(template, coarse.raster)
            hair = hair | own_hair(shown & (other | ~skin), coarse.hair & shown, above)
        before, skin = skin, skin & ~other
        settled = bool((before != skin).mean() < 1e-3)
        if settled:
            break
    if light and not settled:
        found = coarse.inferred(network, texture, skin, SEARCH_SECONDS, camera, None)
    masked = float(1 - (skin & face).sum() / max((shown & face).sum(), 1))
    return dataclasses.replace(
        looked, other=shown & ~skin & ~hair, hair=hair, masked=masked, found=found
    )


class Texels:
    """A photograph in the texels of its mesh."""

    def __init__(
        self,
        looked: Looked,
        rows: int,
        template: Template,
        face: np.ndarray,
        super_resolution: Rcan | None = None,
    ) -> None:
        self.name, self.mesh = looked.photograph.name, looked.mesh
        camera, person = looked.camera, looked.person
        self.raster: UvRaster = rasterise(self.mesh, rows, rows * 2 // 3)
        shown = Enlarged(looked.photograph.rgb_linear, person, camera)
        self.pixels = 1 / max(texels_a_pixel(self.mesh, self.raster, face, camera), 1e-6)
        if super_resolution is not None:
            larger = enlarged(
                shown.rgb_linear, person, self.mesh, self.raster, face, camera, super_resolution
            )
            shown = shown if larger is None else larger
        self.shown, self.enlarged = shown, shown.camera is not camera
        self.shown_pixels = self.pixels * shown.camera.fx_px / camera.fx_px
        self.features = features(template, self.raster)
        self.unwrapped: Unwrapped = without_slivers(
            unwrap(shown.rgb_linear, self.mesh, self.raster, shown.camera, shown.person),
            self.features,
        )
        self.beard = beard_texels(template, self.raster)
        self.read = ~around_eyes(template, self.raster)
        self.hair = hair_texels(template, self.raster)
        self.own_hair = self._resized(looked.hair)
        if self.hair is not None:
            self.hair |= self.own_hair
        self.skin = ~self._resized(looked.other)
        self.eyes: np.ndarray | None = None
        openings_px = looked.photograph.eyes_px
        if openings_px is not None and aside_deg(camera) <= MOST_ASIDE_DEG:
            eyes = eye_texels(template, self.raster)
            if eyes is not None:
                self.unwrapped, self.eyes = with_eyes(
                    self.unwrapped, looked.photograph.rgb_linear, openings_px, eyes
                )

    def _resized(self, mask: np.ndarray) -> np.ndarray:
        return resized(mask.astype(np.float32), *self.raster.covered.shape) > 0.5

    def inferred(
        self,
        network: WholeFaceNetwork,
        texture: np.ndarray,
        shown: np.ndarray,
        seconds: float,
        camera: Camera,
        mesostructure: TrainedMesostructure | None,
        network_sees: np.ndarray | None = None,
        own: OwnSkin = OF_TRUE_SHAPES,
    ) -> Inferred:
        """Skin and light of the texels that are shown; neither depends on the eyes' texels.

        Args:
            network: as of `infer_whole_face`.
            texture: (rows, columns, 3) linear.
            shown: (rows, columns) bool, texels that the texture has.
            seconds: of the refinement.
            camera: from where it was photographed.
            mesostructure: as of `infer_whole_face`.
            network_sees: (rows, columns) bool, as of `infer_whole_face`.
            own: as of `infer_whole_face`.
        """
        return infer_whole_face(
            network,
            np.where(shown[..., None], texture, 0).astype(np.float32),
            self.mesh,
            np.eye(3, 4),
            (self.name, "the fitted mesh"),
            refine_seconds=seconds,
            mesostructure=mesostructure,
            camera_mm=camera.centre_mm,
            largest_misfit=LARGEST_MISFIT if network_sees is None else math.inf,
            network_sees=self.read if network_sees is None else self.read & network_sees,
            own=own,
        )
