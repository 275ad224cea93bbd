"""Settings of `refine`."""

from __future__ import annotations

import dataclasses

from processing.refinement.joint import Noise


@dataclasses.dataclass(frozen=True)
class RefineConfig:
    """Settings of `refine`."""

    most_faces: int = 120_000
    """A denser mesh is thinned: shadows are cast from its vertices."""
    finest_mm: float = 1.2
    """A coarser mesh is split to edges of this length, which hold the edges of shadows."""
    shadow_offset_mm: float = 0.1
    """Shadow rays start this far off the mesh, beyond its own roughness."""
    smoothing_mm: float = 1.0
    """Distance over which the mesh's normals are averaged, mm."""
    occlusion_directions: int = 200
    """Directions over the sphere for ambient occlusion."""
    bounce_rays: int = 512
    """Rays of each vertex to other skin, at most; 0 leaves out light from skin to skin."""
    bounce_rays_all: int = 8_000_000
    """Rays of all vertices together, at most."""
    scattering: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75)
    """Shares of light that wanders inside the skin that are tried, each after the one before it."""
    noise_from_photographs: bool = True
    """Whether the sensor's noise is measured where pairs of patterns show it (`noise`)."""
    noise_sensor: float = 0.001
    """Root of the shot noise's variance for a reading of 1 (`joint.Noise`), where no pair of
    patterns shows it."""
    noise_floor: float = 0.25
    """Variance of the noise without light, as a multiple of the shot noise's variance for a reading
    of 1, where no pair of patterns shows it."""
    noise_model: float = 0.003
    """Error of the model of one channel's reading, as a share of the reading."""
    noise_shade_gloss: float = 0.03
    """`noise_shade` in the search for gloss, where colour counts more than the model of light."""
    noise_shade_choice: float = 0.06
    """`noise_shade` in the choice of the model of light, where colour counts still more."""
    noise_shade: float = 0.003
    """Error of a pattern's modelled irradiance, as a share of it, in all channels alike."""
    gloss_rounds: int = 3
    """Steps of the search for roughness and specular albedo."""
    gloss_pixels: int = 150_000
    """At most this many pixels of a view, on a regular grid, give evidence of gloss."""
    light_step_mm: float = 0.25
    """Light is gathered at nodes so far apart and interpolated between them; in pictures whose
    pixels are larger than half of it, and everywhere for 0, each pixel's own is gathered."""
    choice_pixels: int = 16_000
    """Number of pixels of all views that choose the model of light (`model_choice`); 0 takes the
    simplest: Beckmann's round lobe, no light from skin to skin, the first of `scattering`."""
    roughness: float = 0.28
    """m to start from; skin has .2 to .35."""
    roughness_pool_mm: float = 5.0
    """Sigma over which all views' evidence of roughness is pooled on the mesh."""
    specular_pool_mm: float = 3.0
    """Sigma over which all views' evidence of specular albedo is pooled on the mesh."""
    specular_detail_mm: float = 0.5
    """Sigma over which one view's pixels share a specular albedo finer than the mesh's."""
    specular_detail_spread: float = 0.002
    """Standard deviation of that detail."""
    gloss_prior: float = 0.02
    """The face's own mean counts as this share of a typical vertex's evidence."""
    gloss_spread: float = 0.003
    """Standard deviation of the specular albedo over a face."""
    mistaken: float = 0.004
    """Error of the specular albedo, as a share of the diffuse albedo, where light goes from skin to
    skin or inside it: some of that light is mistaken for gloss."""
    mistaken_bounces: float = 0.2
    """The same error per unit of light from other skin (1 = white under `full`); it is added."""
    rounds: int = 2
    """Steps of the last solve of each pixel."""
    albedo_prior_power: float = 0.005
    """Weight of the neighbours' albedo against a pixel's squared irradiance (2 in the open)."""
    grey_saturation: float = 0.05
    """Below this saturation colour has no weight; from twice as much it has full weight."""
    dark_level: float = 0.004
    """A pixel whose brightest pattern stays below this is not used (1 = white under `full`)."""
    dark_power: float = 0.1
    """A squared irradiance of this (2 in the open) halves the confidence."""
    doubtful_misfit: float = 20.0
    """A residual's variance of this many times the usual one on the face halves the confidence."""
    doubtful_turn_deg: float = 2.0
    """Noise that turns the normal by this much halves the confidence."""
    coarse_confidence: float = 0.3
    """Share of their confidence that coarse maps keep where the mesh has a hole."""
    doubtful_apart_deg: float = 5.0
    """This angle between the diffuse normal and that of all readings halves the confidence."""
    apart_deg: float = 2.0
    """Turn of the diffuse normals by light that wanders inside the skin, in degrees. Where noise
    beyond the expected turns the normals of chroma by as much, those of all readings weigh half."""
    steady_below: float = 0.4
    """Normals of less confidence are drawn to the mesh's."""
    edge_px: float = 3.0
    """Confidence falls to 0 over this many pixels before an edge of mask or depth."""
    depth_step_mm: float = 4.0
    """A larger step between neighbouring pixels is an edge."""

    @property
    def noise(self) -> Noise:
        """Of the readings, for normals and albedo."""
        return Noise(self.noise_sensor, self.noise_model, self.noise_shade, self.noise_floor)

    @property
    def gloss_noise(self) -> Noise:
        """Of the readings, for gloss."""
        return Noise(self.noise_sensor, self.noise_model, self.noise_shade_gloss, self.noise_floor)

    @property
    def choice_noise(self) -> Noise:
        """Of the readings, for the choice of the model of light."""
        return Noise(self.noise_sensor, self.noise_model, self.noise_shade_choice, self.noise_floor)

    detail_edge_mm: float = 0.0
    """Length of the edges of detailed_mesh.ply, the base mesh displaced so that it has the specular
    normals' relief; 0 writes none."""
    detail_below_mm: float = 3.0
    """What of the relief is smaller comes from the normals."""
