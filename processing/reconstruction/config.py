"""Defaults of the stage `reconstruct`."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class ReconstructConfig:
    """Settings of pose check, matching, consistency and fusion.

    Attributes:
        max_residual_px: a camera whose matches miss the rig's geometry by more is refused, in
            pixels of its own pictures at 1000 rows (scaled with the pictures' height).
        drift_px: a camera whose matches miss by more than this, and by less than the former, is
            warned of: cameras are due to be measured again.
        min_matches: verified matches below which a camera's pose is called unchecked.
        finest_rows: pictures are halved until they have at most this many rows; depth is searched
            in pictures of half that size (unless they have 600 rows or fewer), and refined
            in these.
        coarsest_rows: the pyramid ends at the first level with at most this many rows.
        depth_reach_mm: the surface is within this depth of the point the cameras aim at.
        source_views: each view is matched with this many others.
        min_angle_deg, max_angle_deg: between the directions of two views that are matched.
        patch_radius_px, patch_stride_px: a patch has (2 radius / stride + 1)^2 samples.
        finest_patch_radius_px: `patch_radius_px` at the finest level that is searched: the coarser
            ones have found where the surface is, and narrow patches end nearer to its edges.
        min_cosine: a view that sees a plane under a smaller cosine does not judge it,
        graze_cosine: unless no view sees it better, and this one under more than this.
        contrast_floor: share of the radiance below which contrast is noise.
        smoothness: weight of the neighbours' planes beside the matching cost.
        iterations: sweeps of propagation a level, from the coarsest level to the finest.
        still_px: a pixel whose matching cost is least within this of the depth that the coarser
            level gave it, in pixels of disparity (a quarter is the most that is searched), tries
            no depth nearer than half a pixel in the level's first sweep; 0 has all try.
        max_cost: a depth of a higher matching cost is dropped.
        agree_mm: two views agree where their surfaces are within this, along the normal.
        agree_views: a point is kept when at least this many other views agree.
        alone_cost: a depth that no other view agrees on is taken where its matching cost is lower
            and the surface passes there that normals carry on from points that others agree on.
        carry_mm: where there is no such depth, normals alone carry the surface on until it may be
            so far off, by how much they differ from the points around; 0 has only points that
            other views agree on.
        look_again: run a second round, with the first mesh's planes, pictures of twice the size,
            and normals mended for the shadows that it casts.
        relief_mm: shapes smaller than this come from the normals, larger ones from matched depth;
            0 leaves the points as they were matched.
        bias_mm: normals are trusted in what is smaller than this alone; the rest of them is
            replaced by that of the points.
        doubt_deg: where normals and points disagree by more than this in what is a third of
            `bias_mm`, normals are trusted in still smaller shapes alone.
        cell_mm: width of the finest cells of the fused surface.
        settle_mm: the mesh's vertices are moved onto the points' mean under a Gaussian of this
            sigma; 0 leaves them where the fused surface is.
        splits: how often the fused surface's triangles are split in four; the finer mesh follows
            the points' positions and normals more closely.
        split_settle_mm: `settle_mm` of the split mesh.
        trim_mm: the surface is cut where no point is within this distance, or two pixels.
        mesh: PLY or OBJ file of this head as it sat, mm, in the rig's axes, taken in place of a
            reconstructed one; empty for none.
        occluders: PLY or OBJ file of what else casts shadows on the skin or hides it, such as
            clothes, hair and glasses, in the same axes; empty for what the pictures show of it.
        find_occluders: find it where no file is named.
        find_hull: where it is searched for, add a coarse hull of what shows in two photographs and
            was not matched.
        colmap_to: folder to which pictures, poses and depth maps are written in COLMAP's formats;
            empty for none.
        colmap_from: such a folder whose depth maps are taken in place of our own matching; empty
            for none.
    """

    max_residual_px: float = 2.0
    drift_px: float = 0.6
    min_matches: int = 20
    finest_rows: int = 1600
    coarsest_rows: int = 170
    depth_reach_mm: float = 200.0
    source_views: int = 4
    min_angle_deg: float = 8.0
    max_angle_deg: float = 50.0
    patch_radius_px: int = 2
    finest_patch_radius_px: int = 1
    patch_stride_px: int = 1
    min_cosine: float = 0.2
    graze_cosine: float = 0.05
    contrast_floor: float = 0.003
    smoothness: float = 0.01
    iterations: tuple[int, ...] = (3, 2, 1)
    still_px: float = 0.25
    max_cost: float = 0.7
    agree_mm: float = 0.4
    agree_views: int = 1
    alone_cost: float = 0.6
    carry_mm: float = 0.2
    look_again: bool = True
    relief_mm: float = 1.5
    bias_mm: float = 3.0
    doubt_deg: float = 2.0
    cell_mm: float = 1.2
    settle_mm: float = 0.6
    splits: int = 1
    split_settle_mm: float = 0.5
    trim_mm: float = 1.0
    mesh: str = ""
    occluders: str = ""
    find_occluders: bool = True
    find_hull: bool = True
    colmap_to: str = ""
    colmap_from: str = ""
