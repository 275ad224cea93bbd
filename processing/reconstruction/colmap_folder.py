"""Depth maps in COLMAP's folder and formats [Schoenberger2016]: ours out, others' in.

Where there is a GPU, COLMAP's own patch matching runs on what is written here, and its depth maps
go through our consistency and fusion; and COLMAP's fusion takes ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.formats.files import (
    atomic_folder,
    require_replaceable,
    write_bytes,
    write_json,
)
from processing.colmap import pycolmap
from processing.reconstruction.views import Level, depth_to_points

SCHEMA = "lightstage.colmap-folder/1"
NAME = "lightstage.json"
MARKS_EVERY_PX = 12
"""Every so many pixels a point goes into the sparse model, from which COLMAP takes depth's range
and which views overlap."""
SAME_MM = 0.5
PICTURE = ".pgm"
"""A grey picture needs no library, and COLMAP reads it."""
KINDS = ("geometric", "photometric")
MAPS = ("depth_maps", "normal_maps")
OWN = (
    *(NAME, f"images/*{PICTURE}", "sparse/*.bin", "stereo/fusion.cfg", "stereo/patch-match.cfg"),
    *(f"stereo/{maps}/*{PICTURE}.{kind}.bin" for maps in MAPS for kind in KINDS),
)
"""All that is in the folder; COLMAP's patch matching writes over the maps."""
READ_COST = 0.2
"""Matching cost that depth of others is given: surer than most, less sure than our best."""


def write_colmap(
    folder: Path,
    names: Sequence[str],
    level: Level,
    depths: Sequence[np.ndarray],
    sources: Sequence[np.ndarray],
) -> None:
    """Write pictures, poses, depth and normal maps as COLMAP's dense workspace; it appears at once.

    Args:
        folder: made; one that was written before is replaced.
        names: of the views.
        level: the finest that was matched.
        depths: of each view (h, w) inverse depth, 0 where there is none.
        sources: of each view (s,) the views it is matched with.

    Raises:
        FormatError: `folder` is something else, or has files of others.
    """
    with atomic_folder(folder, NAME, own=OWN) as beside:
        for part in ("images", "sparse", *(f"stereo/{maps}" for maps in MAPS)):
            (beside / part).mkdir(parents=True)
        for k, name in enumerate(names):
            shown = _shown(level.pictures[k])
            head = f"P5\n{shown.shape[1]} {shown.shape[0]}\n255\n".encode()
            write_bytes(beside / "images" / f"{name}{PICTURE}", head + shown.tobytes())
            depth = np.zeros(depths[k].shape, np.float32)
            np.divide(1, depths[k], out=depth, where=depths[k] > 0)
            write_map(depth, _map_path(beside, MAPS[0], name))
            turned = level.normals[k] @ level.poses[k][:, :3].T
            turned[depth == 0] = 0
            write_map(turned, _map_path(beside, MAPS[1], name))
        _sparse(names, level, depths).write(beside / "sparse")
        listed = "".join(f"{name}{PICTURE}\n" for name in names)
        write_bytes(beside / "stereo" / "fusion.cfg", listed.encode())
        matched = "".join(
            f"{name}{PICTURE}\n{', '.join(f'{names[k]}{PICTURE}' for k in own)}\n"
            for name, own in zip(names, sources, strict=True)
        )
        write_bytes(beside / "stereo" / "patch-match.cfg", matched.encode())
        write_json(beside / NAME, {"schema": SCHEMA, "views": list(names)})


def read_colmap(
    folder: Path, names: Sequence[str], level: Level
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Depth maps of a workspace, ours or COLMAP's own, as the matcher would give them.

    Args:
        folder: COLMAP's dense workspace; geometric maps are taken before photometric ones.
        names: of the views; those without a map get no depth.
        level: that the pictures in the workspace show.

    Returns:
        Of each view (h, w) float32 inverse depth, 0 where there is none, and cost.

    Raises:
        FormatError: no map at all, or maps of another size.
    """
    shape = level.masks.shape[1:]
    depths, costs, found = [], [], 0
    for k, name in enumerate(names):
        paths = [_map_path(folder, "depth_maps", name, kind) for kind in KINDS]
        path = next((path for path in paths if path.is_file()), None)
        inverse = np.zeros(shape, np.float32)
        if path is not None:
            depth = read_map(path)[..., 0]
            if depth.shape != shape:
                raise FormatError(
                    path,
                    found=f"a map of {depth.shape[1]} x {depth.shape[0]}",
                    expected=f"{shape[1]} x {shape[0]}, as the photographs are matched",
                    hint="Match the pictures of this workspace at their own size.",
                )
            usable = np.isfinite(depth) & (depth > 0) & level.masks[k]
            np.divide(1, depth, out=inverse, where=usable)
            found += 1
        depths.append(inverse)
        costs.append(np.where(inverse > 0, READ_COST, 2.0).astype(np.float32))
    if not found:
        raise _no_map(folder)
    return depths, costs


def require_writable(folder: Path) -> None:
    """Refuse what `write_colmap` would not replace, before hours of work; errors as there."""
    require_replaceable(folder, NAME, own=OWN)


def require_maps(folder: Path) -> None:
    """Refuse a folder without any depth map, before work is done that it would waste.

    Raises:
        FormatError: no folder, or no map in it.
    """
    if not any(folder.glob("stereo/depth_maps/*.bin")):
        raise _no_map(folder)


def _no_map(folder: Path) -> FormatError:
    return FormatError(
        folder,
        found="no depth map" if folder.is_dir() else "no such folder",
        expected=f"stereo/depth_maps/CAMERA{PICTURE}.geometric.bin",
        hint="Write the workspace first (`reconstruct.colmap_to`), then let COLMAP match it.",
    )


def write_map(values: np.ndarray, path: Path) -> None:
    """Write (h, w) or (h, w, c) as COLMAP's map: sizes as text, then float32, channel by channel.

    (pycolmap 4.2's own `from_array` mixes rows and columns up.)
    """
    planes = np.atleast_3d(np.asarray(values, "<f4")).transpose(2, 0, 1)
    channels, height, width = planes.shape
    write_bytes(path, f"{width}&{height}&{channels}&".encode() + planes.tobytes())


def read_map(path: Path) -> np.ndarray:
    """Read COLMAP's map: (h, w, c) float32.

    Raises:
        FormatError: missing, or none.
    """
    try:
        raw = path.read_bytes()
        width, height, channels = (int(part) for part in raw[:64].split(b"&")[:3])
        start = len(f"{width}&{height}&{channels}&")
        planes = np.frombuffer(raw, "<f4", width * height * channels, start)
        whole = len(raw) == start + planes.nbytes and min(width, height, channels) > 0
    except (OSError, ValueError) as error:
        raise FormatError(path, found=str(error)[:80], expected="a map of COLMAP's") from None
    if not whole:
        raise FormatError(
            path, found=counted(len(raw), "byte"), expected=f"{start + planes.nbytes}"
        )
    return planes.reshape(channels, height, width).transpose(1, 2, 0).astype(np.float32)


def _map_path(folder: Path, what: str, name: str, kind: str = KINDS[0]) -> Path:
    return folder / "stereo" / what / f"{name}{PICTURE}.{kind}.bin"


def _shown(picture: np.ndarray) -> np.ndarray:
    """(h, w) uint8 of the texture that holds most contrast; black where it may not be used."""
    grey = picture[..., 0]
    known = np.isfinite(grey)
    if not known.any():
        return np.zeros(grey.shape, np.uint8)
    low, high = np.percentile(grey[known], [0.5, 99.5])
    scaled = np.clip((np.nan_to_num(grey) - low) / max(high - low, 1e-12), 0, 1)
    return np.where(known, np.round(1 + 254 * scaled), 0).astype(np.uint8)


def _sparse(
    names: Sequence[str], level: Level, depths: Sequence[np.ndarray]
) -> pycolmap.Reconstruction:
    """Cameras, poses, and some points with the views that see them."""
    height, width = level.masks.shape[1:]
    scene = pycolmap.Reconstruction()
    seen: list[list[np.ndarray]] = [[] for _ in names]
    tracks: list[tuple[np.ndarray, list[tuple[int, int]]]] = []
    for k in range(len(names)):
        grid = depth_to_points(depths[k], level.lenses[k], level.poses[k])
        some = grid[::MARKS_EVERY_PX, ::MARKS_EVERY_PX].reshape(-1, 3)
        for place in some[np.isfinite(some[:, 0])].astype(float):
            track = []
            for other in range(len(names)):
                x, y, z = level.poses[other][:, :3] @ place + level.poses[other][:, 3]
                fx, fy, cx, cy = level.lenses[other]
                u, v = fx * x / z + cx, fy * y / z + cy
                if not (z > 0 and 0 <= u < width and 0 <= v < height):
                    continue
                w = depths[other][int(v), int(u)]
                if w > 0 and abs(1 / w - z) < SAME_MM:
                    track.append((other, len(seen[other])))
                    seen[other].append(np.array([u, v]))
            tracks.append((place, track))
    for k, name in enumerate(names):
        camera = pycolmap.Camera(
            model="PINHOLE",
            width=width,
            height=height,
            params=[float(value) for value in level.lenses[k]],
            camera_id=k + 1,
        )
        scene.add_camera_with_trivial_rig(camera)
        pixels = np.array(seen[k]).reshape(-1, 2)
        image = pycolmap.Image(
            name=f"{name}{PICTURE}", keypoints=pixels, camera_id=k + 1, image_id=k + 1
        )
        pose = pycolmap.Rigid3d(np.ascontiguousarray(level.poses[k], float))
        scene.add_image_with_trivial_frame(image, pose)
    for place, track in tracks:
        if len(track) > 1:
            elements = [pycolmap.TrackElement(view + 1, index) for view, index in track]
            scene.add_point3D(place.reshape(3, 1), pycolmap.Track(elements))
    return scene
