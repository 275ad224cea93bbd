"""A head as OBJ with its material file: the mesh's own quads and order, 8-bit pictures beside."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from learning.export.encode import SPECULAR_WHITE, perceptual
from learning.export.gltf import unit_normals
from learning.export.pictures import CONSTANT_ROUGHNESS, NORMAL, Pictures
from learning.export.source import Source
from lightstage.formats.files import write_bytes, write_text
from lightstage.formats.mesh import write_obj

PICTURES = "textures"


def write_pictures(folder: Path, pictures: Pictures) -> dict[str, str]:
    """Write the 8-bit pictures under `folder`; returns their paths in it by name."""
    made = {
        "base_color": pictures.base_colour,
        "normal": pictures.normal,
        "specular": pictures.specular,
        "roughness": pictures.roughness,
        "occlusion": pictures.occlusion,
    }
    paths = {}
    for name, data in made.items():
        if data is not None:
            paths[name] = f"{PICTURES}/{name}.png"
            write_bytes(folder / paths[name], data)
    return paths


def write_obj_material(path: Path, source: Source, paths: dict[str, str]) -> Path:
    """Write PATH.obj and PATH.mtl.

    The material is given twice: as Blinn and Phong's, which every reader takes, and by the
    extension for physical materials (Pr, Pm, norm), of which Blender reads all but norm.

    Args:
        path: of the mesh, ending in .obj.
        source: mesh and maps.
        paths: of `write_pictures`.
    """
    name = f"{path.stem}.mtl"
    # The normal map is of these normals: programs that find none shade each triangle flat.
    mesh = write_obj(source.mesh, path, unit_normals(source))
    lines = mesh.read_text()
    head = (
        "# Millimetres, +y up, +z out of the face; texture coordinates with v upward.\n"
        f"mtllib {name}\nusemtl skin\n"
    )
    write_text(path, head + lines)
    roughness = source.maps.get("roughness")
    mean = CONSTANT_ROUGHNESS
    if roughness is not None:
        mean = float(np.mean(roughness[source.covered], dtype=np.float64))
    mean = max(mean, 0.01)
    material = [
        "# Pictures: base_color is sRGB; specular, roughness and normal are plain numbers.",
        f"# White in specular is a reflectance of {SPECULAR_WHITE:g} along the normal (Ks).",
        f"# normal: {NORMAL}, MikkTSpace, green up.",
        "newmtl skin",
        "illum 2",
        "Ka 0 0 0",
        "Kd 1 1 1",
        f"Ks {SPECULAR_WHITE:g} {SPECULAR_WHITE:g} {SPECULAR_WHITE:g}",
        # The exponent whose lobe is as wide as Beckmann's m [Walter2007].
        f"Ns {2 / mean**2 - 2:.2f}",
        # Not skin's own: with this index a white specular level is SPECULAR_WHITE in Blender.
        "Ni 1.5",
        "d 1",
        f"map_Kd {paths['base_color']}",
        f"map_Ks {paths['specular']}",
        f"norm {paths['normal']}",
        "Pm 0",
        f"Pr {perceptual(np.array(mean)):.4f}",
    ]
    if "roughness" in paths:
        material.append(f"map_Pr {paths['roughness']}")
    write_text(path.with_name(name), "\n".join(material) + "\n")
    return path
