"""A Rerun file (.rrd) of what there is to see: the only module that knows Rerun.

/world/CAMERA            its pose, lens (without distortion: the images are as taken) and images
/world/CAMERA/found      tags found in the image, with their ids
/world/CAMERA/placed     the object where tracking puts it
/world/BODY              its pose; below, its faces and tags
/world/predicted/BODY    the same of a run's rollouts
/world/uncertainty/BODY  covariance of its position, magnified
/path                    trajectories, coloured by phase
/toss, /phase, /plots    over time
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipelines.cli.console import Console
from pipelines.drawing.recording_view import (
    SINCE_1970,
    Moving,
    ViewContent,
    faces_in_view,
    is_placed,
    moments_of,
)
from tossid.errors import InputError
from tossid.rotations import matrix_to_quat, quat_rotate, wxyz_to_xyzw
from tossid.types import Detection, Phase
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.recording import FrameFile
from tossid.vision.setup.faces import FAMILY_SIZE, tag_bitmap, tag_corners
from tossid.vision.setup.layout import DEFAULT_FAMILY, BodyTag

with contextlib.suppress(ImportError):  # the extra "view"; `need_rerun` says where it is missing
    import rerun as rr
    import rerun.blueprint as rrb

Array = NDArray[np.float64]

COLOURS = {
    Phase.UNKNOWN: (150, 150, 150),
    Phase.FLIGHT: (60, 130, 240),
    Phase.IMPACT: (220, 50, 50),
    Phase.SLIDE: (240, 160, 40),
    Phase.ROLL: (150, 80, 200),
    Phase.REST: (110, 170, 90),
}
BODY = (200, 200, 205)
PREDICTED = ((240, 120, 60), (80, 190, 190))
FOUND, PLACED = (60, 200, 60), (255, 140, 0)
STORED = (".jpg", ".jpeg", ".png")
"""Files of images that a Rerun file takes as they are."""
HALF = 0.5
"""Rerun counts pixels from the first one's corner, we from its middle."""


def need_rerun() -> None:
    """Raise an InputError that says how to install Rerun where it is missing."""
    try:
        import rerun  # noqa: F401
    except ImportError:
        raise InputError(
            "Rerun is not installed (its viewer takes 500 MB): pip install 'tossid[view]', or from a clone "
            "pip install -e '.[view]'; without it, sheet=FILE.png draws a contact sheet"
        ) from None


def write_rerun(content: ViewContent, path: Path, *, magnify: float, console: Console) -> int:
    """Write a file that the viewer opens offline.

    Args:
        content: Everything that is shown.
        path: The file to write.
        magnify: Of the covariance ellipsoids, which are drawn at three standard deviations.
        console: Shows the progress.

    Returns:
        The number of images in it.
    """
    stream = rr.RecordingStream("tossid", recording_id=content.name)
    stream.save(path, default_blueprint=_blueprint(content))
    stream.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for camera in content.cameras:
        if is_placed(camera):
            _log_camera(stream, camera)
    for body in content.moving:
        _log_body(stream, f"/world/{body.name}", body, BODY)
        _log_plots(stream, body)
        if body.position_cov is not None:
            _log_covariance(stream, body, body.position_cov, magnify)
    for k, (name, bodies) in enumerate(content.predicted.items()):
        for body in bodies:
            _log_body(stream, f"/world/{name}/{body.name}", body, PREDICTED[k % len(PREDICTED)])
            _log_path(stream, f"/world/path/{name}/{body.name}", body, PREDICTED[k % len(PREDICTED)])
    if content.notes:
        stream.log("/notes", rr.TextDocument(content.notes, media_type=rr.MediaType.MARKDOWN), static=True)
    _log_paths(stream, content)
    _log_tosses(stream, content)
    count = _log_frames(stream, content, console)
    stream.flush()
    stream.disconnect()
    return count


def _at(t: float) -> dict[str, Any]:
    return {"timestamp": t} if t > SINCE_1970 else {"duration": t}


def _times(t: Array) -> rr.TimeColumn:
    return rr.TimeColumn("time", timestamp=t) if t[0] > SINCE_1970 else rr.TimeColumn("time", duration=t)


def _log_camera(stream: rr.RecordingStream, camera: Camera) -> None:
    T, K = camera.T_world_cam, camera.matrix.copy()
    K[:2, 2] += HALF
    width, height = camera.resolution
    stream.log(
        f"/world/{camera.name}",
        rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]),
        rr.Pinhole(
            image_from_camera=K,
            resolution=[width, height],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.15,
        ),
        static=True,
    )


def _log_body(stream: rr.RecordingStream, entity: str, body: Moving, colour: tuple[int, int, int]) -> None:
    poses = rr.Transform3D.columns(translation=body.p, quaternion=wxyz_to_xyzw(body.quat))
    stream.send_columns(entity, [_times(body.t)], poses)
    if body.polygons:
        corners, triangles, normals = _triangles(body.polygons)
        mesh = rr.Mesh3D(
            vertex_positions=corners, triangle_indices=triangles, vertex_normals=normals, albedo_factor=[*colour, 255]
        )
        stream.log(f"{entity}/faces", mesh, static=True)
    for tag in body.tags:
        _log_tag(stream, f"{entity}/tag_{tag.id}", tag)


def _triangles(polygons: Sequence[Array]) -> tuple[Array, NDArray[np.int64], Array]:
    """Convex faces as triangles: corners (n, 3), indices (m, 3), normals (n, 3)."""
    triangles, normals, start = [], [], 0
    for polygon in polygons:
        normal = np.cross(polygon[1] - polygon[0], polygon[2] - polygon[1])
        normals += [normal / np.linalg.norm(normal)] * len(polygon)
        triangles += [[start, start + i, start + i + 1] for i in range(1, len(polygon) - 1)]
        start += len(polygon)
    return np.concatenate(polygons), np.array(triangles), np.array(normals)


def _log_tag(stream: rr.RecordingStream, entity: str, tag: BodyTag) -> None:
    assert tag.T_body_tag is not None
    corners = tag_corners(tag) + 2e-4 * tag.T_body_tag[:3, 2]
    stream.log(entity, rr.LineStrips3D([[*corners, corners[0]]], colors=[(30, 30, 30)], radii=[4e-4]), static=True)
    if tag.family == DEFAULT_FAMILY and 0 <= tag.id < FAMILY_SIZE:
        picture = np.repeat(np.kron(255 * tag_bitmap(tag.id), np.ones((16, 16), np.uint8))[:, :, None], 3, axis=2)
        mesh = rr.Mesh3D(
            vertex_positions=corners,
            triangle_indices=[[0, 1, 2], [0, 2, 3]],
            vertex_normals=[tag.T_body_tag[:3, 2]] * 4,
            vertex_texcoords=[[0, 1], [1, 1], [1, 0], [0, 0]],
            albedo_texture=picture.astype(np.uint8),
        )
        stream.log(f"{entity}/code", mesh, static=True)


def _log_covariance(stream: rr.RecordingStream, body: Moving, cov: Array, magnify: float) -> None:
    """Ellipsoids at the positions, in the world's axes."""
    value, axes = np.linalg.eigh(cov)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    ellipsoids = rr.Ellipsoids3D.columns(
        centers=body.p,
        half_sizes=3 * magnify * np.sqrt(np.maximum(value, 0.0)),
        quaternions=wxyz_to_xyzw(matrix_to_quat(axes)),
        colors=np.tile([255, 210, 60], (len(body.t), 1)).astype(np.uint8),
    )
    stream.send_columns(f"/world/uncertainty/{body.name}", [_times(body.t)], ellipsoids)


def _log_plots(stream: rr.RecordingStream, body: Moving) -> None:
    times = [_times(body.t)]
    low = body.p[:, 2]
    if body.polygons:
        corners = np.unique(np.concatenate(body.polygons), axis=0)
        low = low + quat_rotate(body.quat[:, None], corners[None])[..., 2].min(axis=1)
    series = {"height_m": low}
    if body.position_cov is not None and body.angle_sigma is not None:
        sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(body.position_cov)[:, -1], 0.0))
        series |= {"sigma_position_mm": 1e3 * sigma, "sigma_angle_deg": np.rad2deg(body.angle_sigma)}
    for name, values in series.items():
        entity = f"/plots/{name}/{body.name}"
        stream.log(entity, rr.SeriesLines(names=f"{body.name} {name}"), static=True)
        stream.send_columns(entity, times, rr.Scalars.columns(scalars=values))


def _log_path(stream: rr.RecordingStream, entity: str, body: Moving, colour: tuple[int, int, int]) -> None:
    parts = np.split(body.p, np.flatnonzero(np.diff(body.t) > 0.1) + 1)
    n = len(parts)
    stream.log(entity, rr.LineStrips3D(parts, colors=[colour] * n, radii=[8e-4] * n), static=True)


def _log_paths(stream: rr.RecordingStream, content: ViewContent) -> None:
    for body in content.moving:
        _log_path(stream, f"/world/path/{body.name}", body, COLOURS[Phase.UNKNOWN])
    for toss in content.tosses:
        cuts = np.flatnonzero(np.diff(toss.phase)) + 1
        edges = [0, *cuts.tolist(), len(toss) - 1]
        strips = [toss.q[a : b + 1, :3] for a, b in itertools.pairwise(edges) if b > a]
        colours = [COLOURS[Phase(int(toss.phase[a]))] for a, b in itertools.pairwise(edges) if b > a]
        lines = rr.LineStrips3D(strips, colors=colours, radii=[1.2e-3] * len(strips))
        stream.log(f"/world/path/tosses/{toss.name}", lines, static=True)


def _log_tosses(stream: rr.RecordingStream, content: ViewContent) -> None:
    for toss in content.tosses:
        stream.set_time("time", **_at(float(toss.t[0])))
        stream.log("/toss", rr.StateChange(state=toss.name))
        for i in [0, *(np.flatnonzero(np.diff(toss.phase)) + 1).tolist()]:
            stream.set_time("time", **_at(float(toss.t[i])))
            stream.log("/phase", rr.StateChange(state=Phase(int(toss.phase[i])).name.lower()))
        stream.set_time("time", **_at(float(toss.t[-1])))
        stream.log("/toss", rr.StateChange(state="between tosses"))
        stream.log("/phase", rr.StateChange(state="between tosses"))
    stream.reset_time()


def _log_frames(stream: rr.RecordingStream, content: ViewContent, console: Console) -> int:
    """Images, and what was found in them; returns how many images."""
    times = {camera.name: moments_of(content, camera.name) for camera in content.cameras}
    found: dict[tuple[str, int], list[Detection]] = {}
    for d in content.detections:
        found.setdefault((d.camera, round(d.t * 1e6)), []).append(d)
    with console.progress("write", sum(map(len, times.values())), unit="frames") as progress:
        for camera in content.cameras:
            entity = f"/world/{camera.name}"
            for i, t in enumerate(times[camera.name]):
                stream.set_time("time", **_at(float(t)))
                if content.frames is not None:
                    stream.log(entity, _image(content, content.frames[camera.name][i]))
                seen = found.get((camera.name, round(float(t) * 1e6)), [])
                strips = [HALF + np.array([*d.corners, d.corners[0]]) for d in seen]
                words = [str(d.tag_id) for d in seen]
                lines = rr.LineStrips2D(strips, labels=words, colors=[FOUND] * len(seen), radii=[-1.5] * len(seen))
                stream.log(f"{entity}/found", lines)
                outlines = faces_in_view(content, camera, float(t)) if is_placed(camera) else ()
                shapes = [HALF + np.array([*o, o[0]]) for o in outlines if np.isfinite(o).all()]
                colours, widths = [PLACED] * len(shapes), [-0.75] * len(shapes)
                stream.log(f"{entity}/placed", rr.LineStrips2D(shapes, colors=colours, radii=widths))
                progress.advance()
    stream.reset_time()
    return sum(map(len, times.values())) if content.frames is not None else 0


def _image(content: ViewContent, file: FrameFile) -> rr.EncodedImage:
    """A frame as it lies on the disk, or as JPEG where it is in a video, a bag or another format."""
    if file.path.suffix.lower() in STORED:
        return rr.EncodedImage(path=file.path)
    assert content.recording is not None
    return rr.Image(content.recording.read(file).image, color_model="L").compress(jpeg_quality=85)


def _blueprint(content: ViewContent) -> rrb.Blueprint:
    scene = rrb.Spatial3DView(origin="/world", name="Scene")
    below = [rrb.TimeSeriesView(origin="/plots/height_m", name="Height of the lowest corner [m]")]
    if any(body.position_cov is not None for body in content.moving):
        below.append(rrb.TimeSeriesView(origin="/plots/sigma_position_mm", name="Position's standard deviation [mm]"))
        below.append(rrb.TimeSeriesView(origin="/plots/sigma_angle_deg", name="Rotation's standard deviation [°]"))
    views: list[Any] = [scene, rrb.Horizontal(*below)]
    if content.tosses:
        views.append(rrb.StateTimelineView(origin="/", contents=["/toss", "/phase"], name="Tosses and phases"))
    if content.notes:
        views.append(rrb.TextDocumentView(origin="/notes", name="Gap"))
    left = rrb.Vertical(*views, row_shares=[5, 2, 1, 2][: len(views)])
    if not content.cameras:
        return rrb.Blueprint(left, collapse_panels=True)
    images = [rrb.Spatial2DView(origin=f"/world/{camera.name}", name=camera.name) for camera in content.cameras]
    return rrb.Blueprint(rrb.Horizontal(left, rrb.Vertical(*images), column_shares=[3, 2]), collapse_panels=True)
