"""What the fit of a head to photographs is configured by."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class FitConfig:
    """The only defaults of `fit`; `learning.limits` has their bounds.

    Attributes:
        rows: of the texture, a multiple of 3 (rows : columns = 3 : 2).
        search_rows: in which the light and the skin under it are sought, at most. A texture of more
            rows is enlarged from these, with what the photographs show that is finer.
        landmark_percent: standard deviation of a landmark, of the distance between the eyes'
            outer corners.
        focal_spread: standard deviation of the focal length's logarithm where no file states it.
        focal_told_spread: the same where EXIF states it.
        identity_modes: of the template, at most.
        depth_deviation: standard deviation of a face's depth, of the template's.
        mesh_share: where the template has a population, so far the fit begins from its mean head
            towards the template's own mesh. The template's own modes remain beside the people's.
        mesh_deviation: standard deviation of the rest of the way, of its whole length.
        free_modes: smooth changes of the shape beside the template's modes.
        free_mm: standard deviations of these changes on the face, one for each of their sizes,
            the smallest first.
        free_length_mm: distances over which they are alike, for each of these sizes.
        asymmetry: standard deviation of what the two sides of a face do not share, of `free_mm`.
        expression_spread: standard deviation of an expression's strength; 1 is its full one. Less
            than none, such as eyes that are wider than open, has a third of it.
        refine_seconds: for the last search of the light and the skin under it, at most.
        rounds: of light, skin and mask in turns.
        pixel_rounds: of the shape from pixels and outlines after the landmarks; 0 for landmarks
            alone.
        pixel_deviation: standard deviation of a pixel's logarithm from that of the model.
        pixel_alike_mm2: so much of the face errs as one. With less of both, people who are not
            ours are found less well (docs/notes/photo.md).
        albedo_deviation: standard deviation of the albedo's logarithm, beside the mean person's
            pattern and the ways in which our people differ from it.
        outline_mm: standard deviation of an outline.
        super_resolution: whether a photograph of fewer pixels than texels is enlarged.
    """

    rows: int = 1536
    search_rows: int = 3072
    landmark_percent: float = 12.0
    focal_spread: float = 0.35
    focal_told_spread: float = 0.03
    identity_modes: int = 100
    depth_deviation: float = 0.12
    mesh_share: float = 0.3
    mesh_deviation: float = 0.4
    free_modes: int = 100
    free_mm: tuple[float, ...] = (1.0, 3.0)
    free_length_mm: tuple[float, ...] = (18.0, 40.0)
    asymmetry: float = 0.25
    expression_spread: float = 0.6
    refine_seconds: float = 20.0
    rounds: int = 2
    pixel_rounds: int = 3
    pixel_deviation: float = 0.2
    pixel_alike_mm2: float = 80.0
    albedo_deviation: float = 0.02
    outline_mm: float = 1.5
    super_resolution: bool = True
