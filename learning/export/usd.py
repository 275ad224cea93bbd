"""A head as USD: UsdPreviewSurface, and MaterialX's standard surface beside it.

The library is Pixar's usd-core, an extra of this package: pip install 'lightstage[usd]'.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np

from learning.errors import MapsError
from learning.export.encode import SPECULAR_WHITE, perceptual
from learning.export.gltf import unit_normals
from learning.export.pictures import CONSTANT_ROUGHNESS
from learning.export.source import Source
from learning.render.dielectric import INDEX
from lightstage.formats.files import atomic_path

MM_IN_METRES = 0.001
SCATTERING_MM = 1.4
"""Mean free path of the recipe's subsurface."""


def require_usd() -> None:
    """MapsError where usd-core is not installed."""
    if importlib.util.find_spec("pxr") is None:
        raise MapsError(
            "--format",
            found="usd, without the package usd-core",
            expected="the extra `usd`",
            hint="pip install 'lightstage[usd]', or leave usd out of --format.",
        )


def write_usd(path: Path, source: Source, paths: dict[str, str]) -> Path:
    """Write a head as .usda, atomically.

    Args:
        path: the file.
        source: mesh and maps.
        paths: of the 8-bit pictures, relative to the file (see `write_pictures`).

    Returns:
        `path`.

    Source: [UsdPreview23], [StandardSurface19].
    """
    from pxr import Usd, UsdGeom, UsdShade

    with atomic_path(path) as beside:
        stage = Usd.Stage.CreateNew(str(beside))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, MM_IN_METRES)
        root = UsdGeom.Xform.Define(stage, "/head")
        stage.SetDefaultPrim(root.GetPrim())
        mesh = _mesh(stage, source)
        material = UsdShade.Material.Define(stage, "/head/skin")
        _preview(stage, material, paths)
        _materialx(stage, material, paths)
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
        stage.GetRootLayer().Save()
    return path


def _mesh(stage: Any, source: Source) -> Any:
    from pxr import Sdf, UsdGeom, Vt

    shape = source.mesh
    assert shape.uvs is not None  # read_source refuses a mesh without
    assert shape.face_uvs is not None
    there = shape.faces >= 0
    mesh = UsdGeom.Mesh.Define(stage, "/head/mesh")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(shape.vertices.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(there.sum(axis=1).astype(np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(shape.faces[there].astype(np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(unit_normals(source).astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([low, high]).astype(np.float32)))
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
    )
    st.Set(Vt.Vec2fArray.FromNumpy(shape.uvs.astype(np.float32)))
    st.SetIndices(Vt.IntArray.FromNumpy(shape.face_uvs[there].astype(np.int32)))
    return mesh


def _preview(stage: Any, material: Any, paths: dict[str, str]) -> None:
    """UsdPreviewSurface in its specular workflow, which takes F0 itself."""
    from pxr import Gf, Sdf, UsdShade

    kinds = Sdf.ValueTypeNames
    shader = UsdShade.Shader.Define(stage, "/head/skin/preview")
    shader.CreateIdAttr("UsdPreviewSurface")
    reader = UsdShade.Shader.Define(stage, "/head/skin/st")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", kinds.String).Set("st")
    reader.CreateOutput("result", kinds.Float2)

    def picture(name: str, output: str, space: str, scale: float = 1.0, bias: float = 0.0) -> Any:
        node = UsdShade.Shader.Define(stage, f"/head/skin/{name}")
        node.CreateIdAttr("UsdUVTexture")
        node.CreateInput("file", kinds.Asset).Set(f"./{paths[name]}")
        node.CreateInput("sourceColorSpace", kinds.Token).Set(space)
        node.CreateInput("wrapS", kinds.Token).Set("clamp")
        node.CreateInput("wrapT", kinds.Token).Set("clamp")
        if scale != 1 or bias != 0:
            node.CreateInput("scale", kinds.Float4).Set(Gf.Vec4f(scale, scale, scale, 1))
            node.CreateInput("bias", kinds.Float4).Set(Gf.Vec4f(bias, bias, bias, 0))
        node.CreateInput("st", kinds.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        return node.CreateOutput(output, kinds.Float3 if output == "rgb" else kinds.Float)

    shader.CreateInput("useSpecularWorkflow", kinds.Int).Set(1)
    shader.CreateInput("ior", kinds.Float).Set(INDEX)
    shader.CreateInput("diffuseColor", kinds.Color3f).ConnectToSource(
        picture("base_color", "rgb", "sRGB")
    )
    shader.CreateInput("specularColor", kinds.Color3f).ConnectToSource(
        picture("specular", "rgb", "raw", SPECULAR_WHITE)
    )
    shader.CreateInput("normal", kinds.Normal3f).ConnectToSource(
        picture("normal", "rgb", "raw", 2, -1)
    )
    rough = shader.CreateInput("roughness", kinds.Float)
    if "roughness" in paths:
        rough.ConnectToSource(picture("roughness", "r", "raw"))
    else:
        rough.Set(float(perceptual(np.array(CONSTANT_ROUGHNESS))))
    if "occlusion" in paths:
        shader.CreateInput("occlusion", kinds.Float).ConnectToSource(
            picture("occlusion", "r", "raw")
        )
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")


def _materialx(stage: Any, material: Any, paths: dict[str, str]) -> None:
    """MaterialX's standard surface, with subsurface in the skin's colour."""
    from pxr import Gf, Sdf, UsdShade

    kinds = Sdf.ValueTypeNames

    def node(name: str, kind: str) -> Any:
        found = UsdShade.Shader.Define(stage, f"/head/skin/mtlx_{name}")
        found.CreateIdAttr(f"ND_{kind}")
        return found

    def picture(name: str, colour: bool) -> Any:
        kind = "color3" if colour else "vector3" if name == "normal" else "float"
        of = {"color3": kinds.Color3f, "vector3": kinds.Float3, "float": kinds.Float}[kind]
        image = node(name, f"image_{kind}")
        file = image.CreateInput("file", kinds.Asset)
        file.Set(f"./{paths[name]}")
        if colour:
            file.GetAttr().SetColorSpace("srgb_texture")
        return image.CreateOutput("out", of)

    shader = node("surface", "standard_surface_surfaceshader")
    shader.CreateInput("base", kinds.Float).Set(1.0)
    colour = picture("base_color", True)
    shader.CreateInput("base_color", kinds.Color3f).ConnectToSource(colour)
    shader.CreateInput("subsurface", kinds.Float).Set(1.0)
    shader.CreateInput("subsurface_color", kinds.Color3f).ConnectToSource(colour)
    shader.CreateInput("subsurface_radius", kinds.Color3f).Set(Gf.Vec3f(1, 0.35, 0.15))
    shader.CreateInput("subsurface_scale", kinds.Float).Set(SCATTERING_MM)

    def of(name: str, kind: str, first: Any, second: Any) -> Any:
        found = node(name, f"{kind}_float")
        for slot, value in (("in1", first), ("in2", second)):
            given = found.CreateInput(slot, kinds.Float)
            if isinstance(value, float):
                given.Set(value)
            else:
                given.ConnectToSource(value)
        return found.CreateOutput("out", kinds.Float)

    # The weight is a share, and a share of the index's rim: an index of its own for each texel
    # mirrors all light at grazing angles, and the map's from in front. n = (1 + r) / (1 - r), where
    # r is the root of the reflectance.
    root = of(
        "root",
        "power",
        of("reflectance", "multiply", picture("specular", False), SPECULAR_WHITE),
        0.5,
    )
    index = of("index", "divide", of("above", "add", root, 1.0), of("below", "subtract", 1.0, root))
    shader.CreateInput("specular_IOR", kinds.Float).ConnectToSource(index)
    shader.CreateInput("specular", kinds.Float).Set(1.0)
    rough = shader.CreateInput("specular_roughness", kinds.Float)
    if "roughness" in paths:
        rough.ConnectToSource(picture("roughness", False))
    else:
        rough.Set(float(perceptual(np.array(CONSTANT_ROUGHNESS))))
    normal = node("normal_map", "normalmap")
    normal.CreateInput("in", kinds.Float3).ConnectToSource(picture("normal", False))
    shader.CreateInput("normal", kinds.Float3).ConnectToSource(
        normal.CreateOutput("out", kinds.Float3)
    )
    output = material.CreateSurfaceOutput("mtlx")
    output.ConnectToSource(shader.CreateOutput("surface", kinds.Token))
