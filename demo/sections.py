"""The report's sections: a picture of every stage, with words for a newcomer."""

from __future__ import annotations

import numpy as np
import zarr

from demo.context import FRONT, LARGEST, Demo, show_difference
from demo.pictures import (
    labelled,
    line_chart,
    marks,
    mesh_picture,
    stage_picture,
    wireframe,
)
from lightstage.formats.exr import read_exr
from lightstage.formats.files import read_json
from lightstage.formats.landmarks import read_points_mm
from lightstage.formats.mesh import read_obj, read_ply
from lightstage.formats.template import default_template_path, load_template
from lightstage.rig import Camera
from processing.closest import ClosestPoints
from processing.frames.read import read_frames
from processing.pages import SPECULAR_WHITE, show
from processing.report import (
    Link,
    Picture,
    Section,
    display,
    display_error,
    display_normals,
    resize,
    side_by_side,
)

ROW_PX = 300
MESH_PX = 1080
NAMES = {
    "diffuse_albedo": "Diffuse albedo: the skin's own colour, without light or shadow.",
    "specular_albedo": "Specular albedo: how much a mirror-like part reflects, seen straight on; "
    f"{SPECULAR_WHITE} shows as white, skin is near 0.028.",
    "diffuse_normal": "Diffuse normals: which way the skin faces, from its shading; red, green and "
    "blue are right, up and toward the camera.",
    "specular_normal": "Specular normals: the surface with its finest relief, from all "
    "readings; the simulated skin shades by one normal, so that both kinds should look alike.",
    "ambient_occlusion": "Ambient occlusion: white where the surface sees the whole stage, darker "
    "in folds.",
}
WHITE = (255, 255, 255)


def stage_section(demo: Demo) -> Section:
    """The lights, and the photographs that they gave."""
    session = demo.session
    shown = "x+" if "x+" in session.file.sequence else session.file.sequence[0]
    lights = [
        labelled(stage_picture(session.rig, session.levels(name)), name) for name in ("full", shown)
    ]
    cameras = session.camera_ids()
    full = [_photo(demo, camera, 0) for camera in cameras]
    half = -(-len(full) // 2)
    rows = [side_by_side(full[:half], ROW_PX), side_by_side(full[half:], ROW_PX)]
    frames = read_frames(demo.at.processed, FRONT)
    patterns = [
        labelled(resize(display(image[demo.crop(FRONT)]), ROW_PX), name)
        for name, image in zip(frames.patterns, frames.images, strict=True)
    ]
    return Section(
        "The stage and its photographs",
        [
            f"{len(session.rig.lights)} lamps on a sphere of 2.5 m face a head in its middle, "
            f"and so do {len(cameras)} cameras. Each light pattern is photographed by all cameras. "
            "In this demo stage and head are simulated; every photograph is a RAW file that came "
            "through the same drivers, and the same checks, as one from a real camera.",
            Picture(
                side_by_side(lights, 420),
                f"The stage from the front. Left: every lamp lit. Right: {shown}, the lamps on the "
                "side of positive x. Lit lamps are yellow, cameras are blue squares, the head is "
                "the disc in the middle. Half the sphere should be lit, the other half dark.",
                "lamps",
            ),
            Picture(
                _stack(rows),
                f"One photograph by each of the {len(cameras)} cameras, all lamps lit, decoded "
                "from RAW to linear light. The head should be sharp, evenly lit and nowhere burnt "
                "out.",
                "photographs",
            ),
            Picture(
                side_by_side(patterns, ROW_PX + 24),
                "All patterns by the frontal camera. x is the person's left and right, y up and "
                "down, z front and back: the light should come from the side that the name gives, "
                "and each pair added should give `full`.",
                "light patterns",
            ),
        ],
    )


def _photo(demo: Demo, camera: str, pattern: int) -> np.ndarray:
    return display(read_frames(demo.at.processed, camera).image(pattern))


def _stack(rows: list[np.ndarray]) -> np.ndarray:
    width = max(row.shape[1] for row in rows)
    padded = [
        np.pad(r, ((0, 6), (0, width - r.shape[1]), (0, 0)), constant_values=255) for r in rows
    ]
    return np.concatenate(padded, axis=0)


def maps_section(demo: Demo) -> Section:
    """Masks, coarse and exact maps beside the truth."""
    masks = []
    for camera in demo.session.camera_ids()[:5]:
        photo, mask = _photo(demo, camera, 0), demo.found.read_mask(camera)
        tinted = photo.copy()
        tinted[~mask] = photo[~mask] // 4 + np.array([0, 0, 70], np.uint8)
        masks.append(tinted)
    crop = demo.crop(FRONT)
    mask = demo.truth.read_mask(FRONT)[crop] & (demo.found.read_view(FRONT, "confidence")[crop] > 0)
    parts: list[str | Picture] = [
        "From the photographs each camera's own maps are solved twice: coarsely, as if the head "
        "were a far-away sphere, to get a first shape; and again when the mesh is known, with the "
        "true distance, the cast shadows and Fresnel's reflection.",
        Picture(
            side_by_side(masks, ROW_PX),
            "What counts as face in five of the views; blue is left out. Hair, eyes' surroundings "
            "and background may be left out, the skin may not.",
            "masks",
        ),
    ]
    for name, words in NAMES.items():
        row = []
        for label, folder in (
            ("coarse", demo.coarse),
            ("with the mesh", demo.found),
            ("truth", demo.truth),
        ):
            if folder.view_path(FRONT, name).is_file():
                image = show(name, folder.read_view(FRONT, name)[crop])
                row.append(labelled(resize(image, ROW_PX), label))
        found, true = (f.read_view(FRONT, name)[crop] for f in (demo.found, demo.truth))
        difference = show_difference(name, found, true, mask)
        unit = " degrees" if name.endswith("_normal") else ""
        row.append(labelled(resize(difference, ROW_PX), "difference"))
        parts.append(
            Picture(
                side_by_side(row, ROW_PX + 24),
                f"{words} The second should resemble the truth. Difference: dark is none, "
                f"yellow {LARGEST[name]:g}{unit} or more.",
                name,
            )
        )
    return Section("Maps of each view", parts)


def geometry_section(demo: Demo) -> Section:
    """Reconstructed and registered mesh."""
    base, true = read_ply(demo.found.base_mesh), read_ply(demo.truth.base_mesh)
    away = ClosestPoints(true.vertices, true.triangles()).query(base.vertices).distance_mm
    colours = display_error(away[None], 1.0)[0] / 255.0
    ids = demo.session.camera_ids()
    side = demo.session.rig.camera(ids[min(3, len(ids) - 1)])
    views = (demo.camera, side)
    row = [mesh_picture(base, camera, 420) for camera in views]
    row += [mesh_picture(true, camera, 420) for camera in views]
    row.append(mesh_picture(base, demo.camera, 420, colours))
    registered = read_obj(demo.found.registered_mesh)
    template = load_template(default_template_path())
    marked = mesh_picture(registered, demo.camera, MESH_PX)
    wires = wireframe(marked, registered, demo.camera)
    true_marks = read_points_mm(demo.truth.true_landmarks)
    marked = marks(marked, true_marks, demo.camera, (30, 150, 50))
    marked = marks(marked, registered.vertices[template.landmarks], demo.camera, (220, 40, 40))
    profile = mesh_picture(registered, side, MESH_PX)[_larger(demo, side)]
    faces = [marked, wires]
    faces = [face[_larger(demo, demo.camera)] for face in faces]
    return Section(
        "Shape",
        [
            "Pairs of views give depth, all of them together a surface. Then a template head, "
            "whose every vertex has a name and a place in the texture, is bent onto that surface.",
            Picture(
                side_by_side(row, 420),
                "Reconstructed mesh from the front and from the side, the true mesh likewise, and "
                "the distance between them: dark 0, yellow 1 mm or more. The face should be "
                "smooth and dark; hair, ears and neck may be rough or missing.",
                "mesh",
            ),
            Picture(
                side_by_side([profile, *faces], 480),
                "The template on this person from the side; its 68 landmarks (red) on the true "
                "ones (green); its quads. Red should cover green, quads should flow around eyes "
                "and mouth.",
                "registration",
            ),
        ],
    )


def _larger(demo: Demo, camera: Camera) -> tuple[slice, slice]:
    """A camera's crop to the face in a picture of MESH_PX rows."""
    scale = MESH_PX / camera.height_px
    rows, columns = demo.crop(camera.id)
    return (
        slice(round((rows.start or 0) * scale), round((rows.stop or camera.height_px) * scale)),
        slice(
            round((columns.start or 0) * scale), round((columns.stop or camera.width_px) * scale)
        ),
    )


def atlas_section(demo: Demo) -> Section:
    """The atlas beside the truth in the same texture."""
    parts: list[str | Picture] = [
        "All views are blended into the template's texture: the same place of every face is at "
        "the same texel. Black was seen by no camera."
    ]
    covered = demo.found.read_atlas("confidence") > 0
    for name in ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal"):
        found, true = demo.found.read_atlas(name), demo.true_atlas[name]
        mask = demo.true_atlas["confidence"] > 0
        shape = covered if found.ndim == 2 else covered[:, :, None]
        row = [
            labelled(resize(show(name, found * shape), 420), "atlas"),
            labelled(resize(show(name, true), 420), "truth"),
            labelled(resize(show_difference(name, found, true, mask), 420), "difference"),
        ]
        unit = " degrees" if name.endswith("_normal") else ""
        parts.append(
            Picture(
                side_by_side(row, 444),
                f"{NAMES[name]} No seams should show where one view ends and the next begins. "
                f"Difference over the skin: yellow is {LARGEST[name]:g}{unit} or more.",
                f"atlas {name}",
            )
        )
    return Section("Atlas", parts)


def dataset_section(demo: Demo) -> Section:
    """The people learnt from, and the published patches."""
    people = [
        display(read_exr(demo.at.people.joinpath(folder, "atlas", "diffuse_albedo.exr")))
        for folder in sorted(p.parent.name for p in demo.at.people.glob("*/report.json"))
    ]
    names = ("diffuse_albedo", "specular_albedo", "diffuse_normal", "shape")
    published = zarr.open_group(demo.at.published, mode="r")
    arrays = {name: np.asarray(published[name][:6], np.float32) for name in names}
    count = len(arrays["shape"])
    rows = []
    for name in names:
        patches = list(arrays[name])
        if name == "shape":
            reach = max(float(abs(patch).max()) for patch in patches) or 1.0
            shown = [display_normals(patch / reach) for patch in patches]
        else:
            shown = [show(name, patch) for patch in patches]
        rows.append(side_by_side(shown, 150))
    facts = read_json(demo.at.published / "dataset.json")
    return Section(
        "Dataset",
        [
            "The network learns from other people than the one captured: simulated ones, whose "
            "maps are known. The lab keeps whole maps; what could be published are small patches "
            "apart from each other, shuffled, some left out, without name or place.",
            Picture(
                side_by_side(people, ROW_PX),
                "Diffuse albedo of the simulated people: different skins, the same layout.",
                "people",
            ),
            Picture(
                _stack(rows),
                f"{count} of {facts['counts']['patches']} published patches, from top to bottom: "
                "diffuse albedo, specular albedo, diffuse normals, and the shape as colour (the "
                "patch's mean place removed). Each patch is turned at random, its directions with "
                "it, and neighbours in a row come from anywhere.",
                "patches",
            ),
            f"What publishing cannot protect: {facts['cannot_protect']}",
        ],
    )


def learning_section(demo: Demo) -> Section:
    """Training curve and the maps inferred from a lit texture."""
    rows = [("texture with light in it", display(read_exr(demo.at.baked)))]
    for name in ("diffuse_albedo", "specular_normal"):
        label = name.replace("_", " ")
        inferred = read_exr(demo.at.inferred / f"{name}.exr")
        rows.append((f"inferred {label}", show(name, inferred)))
        rows.append((f"true {label}", show(name, demo.true_atlas[name])))
    return Section(
        "Learning",
        [
            "A network is shown a texture with light and shadow in it, as a photograph gives, and "
            "learns to find albedo. Training on the few people above for less than a minute shows "
            "that training works; the maps below come from the weights that are shipped, which "
            "were trained on other simulated people alone.",
            _losses(demo),
            Picture(
                side_by_side([labelled(resize(i, 420), t) for t, i in rows], 444),
                "The captured head's texture under a light that no pattern used, and what the "
                "network makes of it beside the truth: light and shadow should go, the skin's "
                "colour should stay. The network never saw this person. It sees 96 x 64 texels; "
                "what is finer comes from the texture itself, and with it some of the edges of "
                "hard shadows. A scanned head is unlike the people that it was trained on: where "
                "its shadows are deep, brows, lips and closed eyes give way to the mean person's, "
                "and its colour comes out too dull. The normals are the mesh's own.",
                "inference",
            ),
        ],
    )


def _losses(demo: Demo) -> str | Picture:
    """The training's curves, or a sentence where it was too short for any."""
    curves = {}
    for name in ("diffuse", "specular"):
        known = [(x["seconds"], x[name]) for x in demo.metrics if x.get(name, 0) > 0]
        if len(known) > 1:
            x, y = np.array(known).T
            curves[name] = (x, y)
    if not curves:
        return "The training was too short for a curve."
    return Picture(
        line_chart(curves, "seconds of training"),
        "Losses while training: the mean squared error of the diffuse albedo, sRGB-encoded, and of "
        "the specular albedo's logarithm. Both should fall.",
        "losses",
        lossless=True,
    )


def relit_section(demo: Demo) -> Section:
    """The captured head under new light beside the truth."""
    crop = demo.crop(FRONT)
    parts: list[str | Link | Picture] = [
        "The purpose of it all: the captured head under light in which it was never photographed, "
        "drawn by the project's renderer from the captured maps, beside the picture that the "
        "simulator makes of the true head by other code. Both show skin's surface as a rough "
        "dielectric with Fresnel's reflection."
    ]
    for relit in demo.relit:
        mask = relit.mask[crop]
        scale = exposure(relit.true[crop][mask])
        error = abs(relit.found - relit.true).mean(axis=2)[crop] * scale
        row = [
            labelled(resize(display(relit.found[crop], scale), 420), "captured, relit"),
            labelled(resize(display(relit.true[crop], scale), 420), "truth"),
            labelled(resize(display_error(error, 0.2, mask), 420), "difference"),
        ]
        share = relit.errors["relative_rmse"]
        parts.append(
            Picture(
                side_by_side(row, 444),
                f"Light set {relit.name}: error over the skin {share:.0%} of the picture's own "
                f"level, {relit.errors['srgb_psnr_db']:.1f} dB. Highlights and cast shadows should "
                "be in the same places. Hair and clothes are not captured.",
                f"relit {relit.name}",
            )
        )
    page = (demo.at.head / "page.html").relative_to(demo.at.root)
    parts.append(
        Link(str(page), "Turn the head and its light in the browser, captured or inferred.")
    )
    return Section("Relighting", parts)


def exposure(values: np.ndarray) -> float:
    """The factor that brings the 99th percentile of linear values to 0.8."""
    return 0.8 / max(float(np.percentile(values, 99)), 1e-6)


def readme_strip(demo: Demo, width: int = 1600) -> np.ndarray:
    """Photograph, albedo, normals, mesh, relit and truth in a row, for the README."""
    crop = demo.crop(FRONT)
    relit = demo.relit[0]
    scale = exposure(relit.true[relit.mask])
    whole = mesh_picture(read_ply(demo.found.base_mesh), demo.camera, demo.camera.height_px)
    panels = [
        ("photograph", _photo(demo, FRONT, 0)[crop]),
        (
            "diffuse albedo",
            show("diffuse_albedo", demo.found.read_view(FRONT, "diffuse_albedo")[crop]),
        ),
        ("normals", show("specular_normal", demo.found.read_view(FRONT, "specular_normal")[crop])),
        ("mesh", whole[crop]),
        ("relit", display(relit.found[crop], scale)),
        ("truth", display(relit.true[crop], scale)),
    ]
    row = side_by_side([labelled(resize(image, 480), text) for text, image in panels], 504)
    return resize(row, max(1, round(row.shape[0] * width / row.shape[1])))
