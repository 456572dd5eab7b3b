"""Detections sorted into a scene: which tag on which body was seen by which camera in which time step."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.types import Detection
from tossid.vision.camera import Camera
from tossid.vision.layout import Body, BodyTag, Coordinate, Distance, TagLayout
from tossid.vision.resect import tag_poses

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SAME_STEP = 0.55
"""Frames of different cameras within so many periods of the fastest camera are one time step."""


ACUTE = 0.05
"""1 + cos of the angle between two edges' normals, at least: a sharper corner would run away when edges spread."""
SCATTER = 3.0
"""A static tag in a static camera's images does not move by more [px]."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies, cameras and tags by number, and a row for each sighting, in order of time steps.

    rig: (cameras,) the body that each camera sits on. body: (tags,) the body that each tag sits on.
    t: (n,) the steps' times [s]. step, camera, tag: (d,). late: (d,) time of each frame after its step's [s].
    pixels: (d, 4, 2). seen: (d, 4, 2) the same, normalised. to_pixels: (d, 4, 2, 2) takes small errors of these
    to pixels. whiten: (d, 4, 2, 2) takes them to unit variance. grow: (d, 4, 2) by how much they move where the tag's
    edges all spread by one pixel. count: (d,) frames that a row stands for: a static camera's sightings of a static
    tag are one row, with their mean. T_cam_tag: (d, 2, 4, 4), of `tag_poses`. measurements: between tags of
    static bodies.
    """

    cameras: tuple[Camera, ...]
    bodies: tuple[Body, ...]
    tags: tuple[BodyTag, ...]
    rig: Ints
    body: Ints
    t: Array
    step: Ints
    camera: Ints
    tag: Ints
    late: Array
    pixels: Array
    seen: Array
    to_pixels: Array
    whiten: Array
    grow: Array
    count: Array
    T_cam_tag: Array
    measurements: tuple[Distance | Coordinate, ...] = ()

    def take(self, rows: Ints) -> Scene:
        """Some of its sightings."""
        arrays = (
            "step",
            "camera",
            "tag",
            "late",
            "pixels",
            "seen",
            "to_pixels",
            "whiten",
            "grow",
            "count",
            "T_cam_tag",
        )
        return replace(self, **{name: getattr(self, name)[rows] for name in arrays})

    @property
    def half(self) -> Array:
        """Half the size of each sighting's tag [m]. (d,)."""
        return np.array([0.5 * tag.size for tag in self.tags])[self.tag]


def observe(
    detections: Iterable[Detection], cameras: Sequence[Camera], layout: TagLayout, *, dropped: Counter[str]
) -> Scene:
    """Sort detections into a scene.

    Tags that the layout does not list belong to its default body, and their poses are unknown.

    Args:
        detections: in any order. dropped: counts, by reason, what is left out.

    Raises:
        InputError: a detection of a camera that is not calibrated, or of a rig that is no body; nothing to use.
    """
    names = {camera.name: c for c, camera in enumerate(cameras)}
    bodies = {body.name: b for b, body in enumerate(layout.bodies)}
    for model in cameras:
        if model.rig_body not in bodies:
            raise InputError(f"camera '{model.name}' sits on '{model.rig_body}', which is no body of the layout")
    tags = [(b, tag) for b, body in enumerate(layout.bodies) for tag in body.tags]
    number = {tag.id: i for i, (_, tag) in enumerate(tags)}
    kept: list[Detection] = []
    at: list[int] = []
    for detection in _once(detections, layout, dropped):
        if detection.camera not in names:
            raise InputError(f"a detection is of camera '{detection.camera}', which is not calibrated")
        if not (np.isfinite(detection.corners).all() and (np.linalg.det(detection.corner_cov) > 0).all()):
            dropped["corners or covariance not finite"] += 1
            continue
        if detection.tag_id not in number:
            new = _new_tag(detection.tag_id, layout)
            if new is None:
                dropped["id on no body"] += 1
                continue
            number[detection.tag_id] = len(tags)
            tags.append((bodies[str(layout.default_body)], new))
        kept.append(detection)
        at.append(number[detection.tag_id])
    if not kept:
        raise InputError(f"no detection of any tag of the scene: nothing to track ({words(dropped)})")
    order = np.argsort([detection.t for detection in kept], kind="stable")
    kept, tag = [kept[i] for i in order], np.array(at, dtype=np.int64)[order]
    camera = np.array([names[detection.camera] for detection in kept], dtype=np.int64)
    times = np.array([detection.t for detection in kept])
    step, t = time_steps(times, camera)
    # of the frames of a step, the cameras' order matters, not which was a microsecond earlier
    order = np.lexsort((tag, camera, step))
    kept = [kept[i] for i in order]
    tag, camera, times, step = tag[order], camera[order], times[order], step[order]
    pixels = np.stack([detection.corners for detection in kept])
    cov = np.stack([detection.corner_cov for detection in kept])
    static = np.array([body.is_static for body in layout.bodies])
    still = static[[bodies[model.rig_body] for model in cameras]] & [model.wiggle is None for model in cameras]
    still_rows = still[camera] & static[[b for b, _ in tags]][tag]
    rows, pixels, cov, count = _merged(pixels, cov, still_rows, camera, tag)
    seen, to_pixels = _undistorted(cameras, camera[rows], pixels)
    lens = np.isfinite(seen).all(axis=(1, 2)) & np.isfinite(to_pixels).all(axis=(1, 2, 3))
    if not lens.all():
        dropped["outside the lens model"] += int(count[~lens].sum())
    root = np.swapaxes(np.linalg.cholesky(np.linalg.inv(cov)), -1, -2)
    half = np.array([0.5 * tags[i][1].size for i in tag[rows]])
    rows = rows[lens]
    return Scene(
        tuple(cameras),
        layout.bodies,
        tuple(tag for _, tag in tags),
        np.array([bodies[model.rig_body] for model in cameras], dtype=np.int64),
        np.array([b for b, _ in tags], dtype=np.int64),
        t,
        step[rows],
        camera[rows],
        tag[rows],
        (times - t[step])[rows],
        pixels[lens],
        seen[lens],
        to_pixels[lens],
        (root @ to_pixels)[lens],
        _normalised(to_pixels, grown(pixels))[lens],
        count[lens],
        tag_poses(seen[lens], half[lens]),
        layout.measurements,
    )


def grown(pixels: Array) -> Array:
    """How a tag's corners move where all its edges spread by one pixel. (d, 4, 2) [px] -> (d, 4, 2)."""
    edge = np.roll(pixels, -1, axis=1) - pixels
    outward = np.stack([edge[..., 1], -edge[..., 0]], axis=-1)
    outward /= np.maximum(np.linalg.norm(outward, axis=-1, keepdims=True), 1e-9)
    middle = pixels - pixels.mean(axis=1, keepdims=True)
    outward *= np.sign(np.sum(outward * middle, axis=-1, keepdims=True))
    before = np.roll(outward, 1, axis=1)
    # to where both edges have moved: at a right angle by √2, further where the corner is acute
    return np.asarray((outward + before) / np.maximum(1 + np.sum(outward * before, axis=-1, keepdims=True), ACUTE))


def _normalised(to_pixels: Array, shift: Array) -> Array:
    """Small shifts [px] in normalised coordinates; 0 outside the lens model."""
    inside = np.isfinite(to_pixels).all(axis=(1, 2, 3), keepdims=True)
    safe = np.where(inside, to_pixels, np.eye(2))
    return np.asarray(np.squeeze(np.linalg.inv(safe) @ shift[..., None], -1))


def _merged(pixels: Array, cov: Array, still: Bools, camera: Ints, tag: Ints) -> tuple[Ints, Array, Array, Array]:
    """Rows with those of a static camera and a static tag merged into their first one.

    The mean corners of n frames, with n times the information, have the same sum of squares as the n, but for a
    constant. A tag that did move (by more than `SCATTER`) is left as it is.

    Returns:
        the rows left (r,), their pixels (r, 4, 2) and covariances (r, 4, 2, 2), and how many each stands for (r,).
    """
    count = np.ones(len(pixels))
    keep = np.ones(len(pixels), dtype=bool)
    pixels, cov = pixels.copy(), cov.copy()
    label = camera * (tag.max() + 1) + tag
    for name in np.unique(label[still]):
        rows = np.flatnonzero(still & (label == name))
        if len(rows) < 2:
            continue
        middle = np.median(pixels[rows], axis=0)
        near = rows[np.linalg.norm(pixels[rows] - middle, axis=-1).max(axis=1) < SCATTER]
        if len(near) < 0.9 * len(rows):
            continue
        information = np.linalg.inv(cov[near])
        cov[near[0]] = np.linalg.inv(information.sum(axis=0))
        pixels[near[0]] = np.squeeze(cov[near[0]] @ (information @ pixels[near][..., None]).sum(axis=0), -1)
        count[near[0]] = len(near)
        keep[near[1:]] = False
    index = np.flatnonzero(keep)
    return index, pixels[index], cov[index], count[index]


def _once(detections: Iterable[Detection], layout: TagLayout, dropped: Counter[str]) -> list[Detection]:
    """Detections under their remapped ids, without the squashed and the doubtful ones."""
    found: dict[tuple[str, float, int], Detection | None] = {}
    for d in detections:
        if layout.max_hamming is not None and d.hamming > layout.max_hamming:
            dropped["too many corrected bits"] += 1
            continue
        if any(
            d.tag_id in squash.tags
            and squash.camera in (None, d.camera)
            and (squash.time is None or abs(squash.time - d.t) < 1e-6)
            for squash in layout.squashes
        ):
            dropped["squashed"] += 1
            continue
        tag_id = d.tag_id
        for remap in layout.remaps:
            if remap.id == d.tag_id and remap.start <= d.t <= remap.end and remap.camera in (None, d.camera):
                tag_id = remap.new_id
        if tag_id != d.tag_id:
            d = Detection(d.camera, d.t, tag_id, d.corners, d.corner_cov, d.hamming, d.margin)
        key = (d.camera, d.t, d.tag_id)
        if key in found:  # at most one can be right, and nothing says which
            dropped["id seen twice in a frame"] += 2 if found[key] is not None else 1
            found[key] = None
        else:
            found[key] = d
    return [d for d in found.values() if d is not None]


def _new_tag(tag_id: int, layout: TagLayout) -> BodyTag | None:
    body = layout.body(layout.default_body) if layout.default_body is not None else None
    if body is None or tag_id in body.ignored_tags:
        return None
    if body.default_tag_size is None:
        raise InputError(f"tag {tag_id} falls to default_body '{body.name}', which has no default_tag_size")
    return BodyTag(tag_id, body.default_tag_size, None)


def _undistorted(cameras: Sequence[Camera], camera: Ints, pixels: Array) -> tuple[Array, Array]:
    """Normalised corners, and d pixel / d normalised. (d, 4, 2), (d, 4, 2, 2)."""
    seen, slope = np.full(pixels.shape, np.nan), np.full((*pixels.shape, 2), np.nan)
    for c, model in enumerate(cameras):
        own = camera == c
        if own.any():
            seen[own] = model.undistort(pixels[own])
            _, J = model.distort(np.concatenate([seen[own], np.ones((own.sum(), 4, 1))], axis=-1))
            slope[own] = J[..., :2]
    return seen, slope


def time_steps(t: Array, camera: Ints) -> tuple[Ints, Array]:
    """Time step of each sighting (sorted by time), and the steps' times.

    Frames of several cameras within `SAME_STEP` of the fastest camera's period are one step; a camera has one
    frame in a step, and the first of them gives its time. Cameras need not be synchronous, nor of one rate: a
    step may be one camera's alone.
    """
    gaps = []
    for c in np.unique(camera):
        steps = np.diff(np.unique(t[camera == c]))
        if len(steps):
            gaps.append(float(np.median(steps)))
    window = SAME_STEP * min(gaps) if gaps else 0.0
    step = np.zeros(len(t), dtype=np.int64)
    first, index = t[0], 0
    at: dict[int, float] = {}
    for i in range(len(t)):
        here = int(camera[i])
        if t[i] - first > window or at.get(here, t[i]) != t[i]:
            first, index, at = t[i], index + 1, {}
        at[here] = t[i]
        step[i] = index
    # the first camera's time, as TagSLAM has it
    order = np.lexsort((camera, step))
    return step, t[order][np.searchsorted(step[order], np.arange(index + 1))]


def swapped(scene: Scene, a: int, c: int) -> Scene:
    """The scene if what is said to be seen by camera a was seen by camera c, and the other way round."""
    index = np.arange(len(scene.cameras))
    index[[a, c]] = [c, a]
    camera = index[scene.camera]
    rows = np.flatnonzero(camera != scene.camera)
    seen, to_pixels = scene.seen.copy(), scene.to_pixels.copy()
    whiten, grow, T_cam_tag = scene.whiten.copy(), scene.grow.copy(), scene.T_cam_tag.copy()
    seen[rows], to_pixels[rows] = _undistorted(scene.cameras, camera[rows], scene.pixels[rows])
    whiten[rows] = scene.whiten[rows] @ np.linalg.inv(scene.to_pixels[rows]) @ to_pixels[rows]
    grow[rows] = _normalised(to_pixels[rows], grown(scene.pixels[rows]))
    T_cam_tag[rows] = tag_poses(seen[rows], scene.half[rows])
    return replace(scene, camera=camera, seen=seen, to_pixels=to_pixels, whiten=whiten, grow=grow, T_cam_tag=T_cam_tag)


def words(reasons: Counter[str]) -> str:
    """Reasons and their counts, for a message."""
    return ", ".join(f"{reason}: {count}" for reason, count in reasons.most_common()) or "none dropped"
