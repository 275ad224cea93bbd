"""README.txt of an export: units, colour spaces, and what to plug in where."""

from __future__ import annotations

from collections.abc import Sequence

from learning.export.encode import SPECULAR_WHITE
from learning.export.morphs import PHOTO
from learning.export.pictures import CONSTANT_ROUGHNESS
from learning.render.dielectric import F0, INDEX

RECIPE = f"""\
Blender (4.0 and later), Principled BSDF
  Colour spaces of the Image Texture nodes: sRGB for diffuse_albedo.png and base_color.png;
  Non-Color for every other PNG. OpenEXR files: diffuse_albedo.exr is Linear Rec.709, all others
  Non-Color.
  Base Color          diffuse_albedo
  Metallic            0
  Roughness           roughness.png (Blender squares it; of roughness.exr take the root first)
  IOR                 1.5, so that 1 in Specular > IOR Level is a reflectance of {SPECULAR_WHITE:g}
  IOR Level           specular_albedo.png (of the .exr: divided by {SPECULAR_WHITE:g})
  Normal              a Normal Map node (Tangent Space, Strength 1) on normal_specular.png
  Subsurface Weight   1, Scale 1.4 mm (0.0014 in metres), Radius 1, 0.35, 0.15, Random Walk (Skin)
  The OBJ is in mm: import it with Scale 0.001. Of its material Blender takes specular.png and
  roughness.png for sRGB (set Non-Color), and leaves normal.png out (add it as above). Of the .usda
  it takes the reflectance for a tint, so that skin hardly shines: connect the specular picture as
  above. The .glb comes in metres, with its whole material.

Unreal Engine, shading model Subsurface Profile (or Substrate skin)
  Import: base_color.png or diffuse_albedo.png with sRGB on; all others with sRGB off and
  compression Masks; normal maps as Normalmap with Flip Green Channel ON (Unreal's green is down).
  Unreal is in cm: import the .glb as it is, or the OBJ with a uniform scale of 0.1.
  Base Color          diffuse_albedo
  Specular            specular_albedo.png: Unreal reflects {SPECULAR_WHITE:g} x Specular
  Roughness           roughness.png (Unreal squares it)
  Normal              normal_specular
  Ambient Occlusion   ambient_occlusion
  Subsurface profile  mean free path colour 1, 0.35, 0.15; distance 0.14 cm
  A material with a second normal for the diffuse light takes normal_diffuse there.

What no such material has
  The roughness was measured with Beckmann's distribution; GGX of the same middle has longer tails,
  so highlights look a little softer. The index of skin is {INDEX:g}: F0 = {F0:.4f}.
"""


def readme(
    formats: Sequence[str],
    size: tuple[int, int],
    maps: Sequence[tuple[str, str, str]],
    notes: Sequence[str],
    morphs: Sequence[str],
    has_roughness: bool,
    levels: Sequence[int] = (),
    opens_with: str | None = None,
) -> str:
    """The text, for what was written.

    Args:
        formats: of the export.
        size: rows and columns of the maps.
        maps: of `write_maps`.
        notes: what a user should know.
        morphs: names of the morph targets.
        has_roughness: whether there is a map of it.
        levels: triangles of each level of detail.
        opens_with: the morph target that is shown at first; None for none.
    """
    lines = [
        f"A captured or inferred head; maps of {size[0]} rows x {size[1]} columns.",
        "",
        "Row 0 is the top; texture coordinates (u, v) with v upward in OBJ and USD, downward in "
        "glTF. Right-handed axes, +y up, +z out of the face.",
        "",
    ]
    if "gltf" in formats:
        lines.append(
            "head.glb     glTF 2.0, metres; KHR_materials_ior and KHR_materials_specular; its "
            "pictures inside."
        )
        what = ", ".join(morphs) if morphs else "none"
        lines.append(f"             Morph targets: {what}.")
    if PHOTO in morphs:
        lines.append(
            f"The face is neutral; morph target `{PHOTO}` has the photograph's expression."
            if opens_with is None
            else f"The face has the photograph's expression: morph target `{PHOTO}` of the neutral "
            "face in glTF and on the page, the mesh's own in OBJ and USD."
        )
    if "obj" in formats:
        lines.append("head.obj     mm, the template's quads; head.mtl; textures/*.png, 8 bits.")
    if "usd" in formats:
        lines.append(
            "head.usda    mm (metersPerUnit 0.001); UsdPreviewSurface, MaterialX; textures/*.png."
        )
    if "page" in formats:
        lines.append("page.html    opens in a browser from the disk.")
    if levels:
        what = ", ".join(str(count) for count in levels)
        lines.append(
            f"lod1/ ...    the head for larger distances: {what} triangles; pictures of half the "
            "rows each time, normal maps of their own meshes."
        )
    if not has_roughness:
        lines.append(
            f"No map of roughness: Beckmann's m is {CONSTANT_ROUGHNESS:.3f} everywhere, "
            f"a roughness of {CONSTANT_ROUGHNESS**0.5:.3f}."
        )
    if maps:
        lines += ["", "maps/        16-bit PNG, half-float OpenEXR", ""]
        lines.append(f"  {'file':<20}{'the PNG stores':<36}the OpenEXR file holds")
        lines += [f"  {name:<20}{stores:<36}{exr}" for name, stores, exr in maps]
        lines.append("  PNG values 0..65535 mean 0..1; the step is 1/65535 of what is stored.")
    if notes:
        lines += ["", *(f"Note: {note}." for note in notes)]
    return "\n".join([*lines, "", RECIPE])
