"""Settings that no stage and no calibration can work with, refused before any work begins.

The bounds are a table and no annotations of the fields, which pydantic would check: numbers without
a row have bounds too, its message has one of two bounds, and it checks no configuration that code
made or changed.
"""

from __future__ import annotations

from collections.abc import Mapping

from lightstage.formats.config import MOST

SOME = 1e-3
"""The least of what is divided by."""
FINE = 1e-6
"""The same of what is a share of light."""
BOUNDS: Mapping[str, tuple[float, float]] = {
    "decode.clip_share": (0.1, 1),
    "decode.foreground_share": (1e-6, 0.9),
    "decode.prepare.cells_per_mm": (0.01, 100),
    "decode.prepare.ambient_sigma_mm": (SOME, MOST),
    "separate.iterations": (1, 1000),
    "separate.roughness": (0.01, 1),
    "separate.specular_prior": (0, 1),
    "separate.grey_saturation": (FINE, MOST),
    "separate.noise": (FINE, MOST),
    "separate.half_trust_deg": (SOME, MOST),
    "separate.kampouris.most_specular": (0, 1),
    "separate.ratios.specular": (0, 1),
    "separate.polarised.roughness": (0.01, 1),
    "separate.polarised.mirror.spread_deg": (SOME, MOST),
    "separate.linear.roughness": (0.01, 1),
    "separate.linear.mirror.spread_deg": (SOME, MOST),
    "reconstruct.finest_rows": (16, MOST),
    "reconstruct.coarsest_rows": (16, MOST),
    "reconstruct.depth_reach_mm": (1, MOST),
    "reconstruct.source_views": (1, MOST),
    "reconstruct.patch_radius_px": (1, 64),
    "reconstruct.finest_patch_radius_px": (1, 64),
    "reconstruct.patch_stride_px": (1, 64),
    "reconstruct.min_cosine": (0, 1),
    "reconstruct.graze_cosine": (0, 1),
    "reconstruct.min_angle_deg": (0, 180),
    "reconstruct.max_angle_deg": (0, 180),
    "reconstruct.iterations": (0, 100),
    "reconstruct.cell_mm": (0.05, MOST),
    "reconstruct.splits": (0, 4),
    "refine.most_faces": (100, MOST),
    "refine.finest_mm": (0.05, MOST),
    "refine.occlusion_directions": (1, MOST),
    "refine.scattering": (0, 0.99),
    "refine.roughness": (0.01, 1),
    "refine.gloss_pixels": (1, MOST),
    "refine.gloss_spread": (FINE, MOST),
    "refine.specular_detail_spread": (FINE, MOST),
    "refine.shadow_offset_mm": (SOME, MOST),
    "refine.rounds": (1, 1000),
    "refine.grey_saturation": (FINE, MOST),
    "refine.doubtful_misfit": (SOME, MOST),
    "refine.doubtful_turn_deg": (SOME, MOST),
    "refine.doubtful_apart_deg": (SOME, MOST),
    "refine.edge_px": (SOME, MOST),
    "refine.depth_step_mm": (SOME, MOST),
    "reconstruct.bias_mm": (SOME, MOST),
    "reconstruct.max_residual_px": (SOME, MOST),
    "register.modes.scale_sigma": (FINE, MOST),
    "register.modes.expression_sigma": (FINE, MOST),
    "register.modes.landmark_sigma_mm": (SOME, MOST),
    "register.modes.landmark_robust_mm": (SOME, MOST),
    "register.modes.surface_sigma_mm": (SOME, MOST),
    "register.nonrigid.stiffness_mm": (0.05, MOST),
    "register.nonrigid.iterations": (1, 1000),
    "register.nonrigid.plate.iterations": (1, 100_000),
    "atlas.largest_gap_mm": (SOME, MOST),
    "atlas.blend.weights.feather_mm": (SOME, MOST),
    "atlas.blend.weights.least_cos": (0, 1),
    "chart.max_tilt_deg": (0, 90),
    "chart.clip_share": (0.1, 1),
    "flat.grid_px": (2, MOST),
    "flat.min_level": (0, 1),
    "lights.mirror.place_sigma_mm": (SOME, MOST),
    "lights.mirror.position_sigma_mm": (SOME, MOST),
    "lights.mirror.radius_sigma_mm": (SOME, MOST),
    "lights.grey.gain_sigma": (FINE, MOST),
    "lights.grey.exponent_sigma": (FINE, MOST),
    "lights.grey.noise_share": (FINE, MOST),
    "lights.grey.stray_share": (FINE, MOST),
    "cameras.max_residual_px": (SOME, MOST),
    "cameras.outlier_px": (SOME, MOST),
    "cameras.min_sights": (1, MOST),
    "grey.radius_mm": (1, MOST),
    "grey.reflectance": (0.01, 1),
    "grey.facing": (0, 1),
    "grey.lit_share": (0, 1),
}
"""Least and largest value of a setting, also of each of several; of all others 0 and `MOST`."""
