"""Detections sorted into a scene: which tag of which body was seen by which camera in which time step."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.resect import Sightings, tag_poses
from tossid.vision.setup.layout import Body, BodyTag, Measurement, TagLayout

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

ACUTE = 0.05
"""Least 1 + cos of the angle between two edges' normals: a sharper corner would move without bound as edges spread."""
STEP_PERIODS = 0.55
"""Frames of different cameras within so many periods of the fastest camera are one time step."""
STILL_PIXELS = 3.0
"""Largest motion of a static tag in a static camera's images [px]; such sightings are merged into their mean."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies, cameras and tags by number, and a row for each of d sightings, in order of time steps.

    A static camera's sightings of a static tag are one row, with their mean.

    Attributes:
        cameras: As given.
        bodies: As given.
        tags: Of all bodies, those that the layout did not list last.
        rig: Body that each camera sits on, (cameras,).
        body: Body that each tag sits on, (tags,).
        t: Times of the steps [s], (n,).
        step: (d,).
        camera: (d,).
        tag: (d,).
        delay: Time of each frame after its step's [s], (d,).
        pixels: Corners [px], (d, 4, 2).
        root: Takes their errors to unit variance, (d, 4, 2, 2).
        count: Frames that a row stands for, (d,).
        measurements: Measured lengths between tags of static bodies.
        seen: The corners in normalised coordinates, undistorted, (d, 4, 2).
        to_pixels: Takes small errors of `seen` to pixels, (d, 4, 2, 2).
        whiten: Takes the same to unit variance, (d, 4, 2, 2).
        edge_growth: How `seen` moves where all edges of the tag spread by one pixel [1/px], (d, 4, 2).
        T_cam_tag: The two poses that each tag alone allows (`tag_poses`), (d, 2, 4, 4).
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
    delay: Array
    pixels: Array
    root: Array
    count: Array
    measurements: tuple[Measurement, ...] = ()
    seen: Array = field(default_factory=lambda: np.zeros(0))
    to_pixels: Array = field(default_factory=lambda: np.zeros(0))
    whiten: Array = field(default_factory=lambda: np.zeros(0))
    edge_growth: Array = field(default_factory=lambda: np.zeros(0))
    T_cam_tag: Array = field(default_factory=lambda: np.zeros(0))

    def take(self, rows: Ints) -> Scene:
        """The scene with some of its sightings.

        Args:
            rows: Which, (k,).
        """
        arrays = "step camera tag delay pixels root seen to_pixels whiten edge_growth count T_cam_tag"
        return replace(self, **{name: getattr(self, name)[rows] for name in arrays.split()})

    def sightings(self, rows: Ints, T_cam_parent: Array, T_target_tag: Array, group: Ints) -> Sightings:
        """Some rows for a resection.

        Args:
            rows: Which, (k,).
            T_cam_parent: Of each of these, (k, 4, 4); one matrix for all may do.
            T_target_tag: Likewise.
            group: Number of the unknown pose of each, (k,).
        """
        order = np.argsort(group, kind="stable")
        A, B = (np.broadcast_to(T, (len(rows), 4, 4))[order] for T in (T_cam_parent, T_target_tag))
        rows = rows[order]
        whiten = self.whiten[rows] / np.sqrt(self.count[rows])[:, None, None, None]
        return Sightings(group[order], A, B, self.half[rows], self.seen[rows], whiten, self.T_cam_tag[rows])

    @property
    def half(self) -> Array:
        """Half of each sighting's tag's size [m], (d,)."""
        return np.array([0.5 * tag.size for tag in self.tags])[self.tag]


def observe(
    detections: Iterable[Detection],
    cameras: Sequence[Camera],
    layout: TagLayout,
    *,
    dropped: Counter[str],
) -> Scene:
    """The scene that detections show.

    Tags that the layout does not list belong to its default body, and their poses are unknown.

    Args:
        detections: In any order.
        cameras: All that detections are of.
        layout: Bodies and their tags.
        dropped: Filled with counts, by reason, of what is left out.

    Raises:
        InputError: A detection of a camera that is not calibrated, or of a rig that is no body; nothing to use.
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
    # within a step, rows are in the cameras' order, not in the order of microseconds
    order = np.lexsort((tag, camera, step))
    kept = [kept[i] for i in order]
    tag, camera, times, step = tag[order], camera[order], times[order], step[order]
    pixels = np.stack([detection.corners for detection in kept])
    cov = np.stack([detection.corner_cov for detection in kept])
    static = np.array([body.is_static for body in layout.bodies])
    still = static[[bodies[model.rig_body] for model in cameras]] & [model.wiggle is None for model in cameras]
    still_rows = still[camera] & static[[b for b, _ in tags]][tag]
    rows, pixels, cov, count = _merged(pixels, cov, still_rows, camera, tag)
    root = np.swapaxes(np.linalg.cholesky(np.linalg.inv(cov)), -1, -2)
    scene = Scene(
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
        pixels,
        root,
        count=count,
        measurements=layout.measurements,
    )
    scene = _through_lenses(scene)
    lens = np.isfinite(scene.whiten).all(axis=(1, 2, 3))
    if not lens.all():
        dropped["outside the lens model"] += int(count[~lens].sum())
    return scene.take(np.flatnonzero(lens))


def _through_lenses(scene: Scene) -> Scene:
    """The scene with all that follows from its corners' pixels; NaN outside the lens model."""
    d = scene.pixels.shape
    seen, to_pixels, edge_growth = np.full(d, np.nan), np.full((*d, 2), np.nan), np.full(d, np.nan)
    for c, model in enumerate(scene.cameras):
        own = np.flatnonzero(scene.camera == c)
        if not len(own):
            continue
        flat = model.undistort(scene.pixels[own])
        _, J = model.distort(np.concatenate([flat, np.ones((len(own), 4, 1))], axis=-1))
        seen[own], to_pixels[own] = flat, J[..., :2]
    inside = np.isfinite(to_pixels).all(axis=(1, 2, 3))
    growth = corner_growth(scene.pixels[inside])[..., None]
    edge_growth[inside] = np.squeeze(np.linalg.inv(to_pixels[inside]) @ growth, -1)
    return replace(
        scene,
        seen=seen,
        to_pixels=to_pixels,
        whiten=scene.root @ to_pixels,
        edge_growth=edge_growth,
        T_cam_tag=tag_poses(seen, scene.half),
    )


def corner_growth(pixels: Array) -> Array:
    """How tags' corners move where all edges spread outward by one pixel, (d, 4, 2).

    Args:
        pixels: Corners [px], (d, 4, 2).
        root: Takes their errors to unit variance, (d, 4, 2, 2).
    """
    edge = np.roll(pixels, -1, axis=1) - pixels
    outward = np.stack([edge[..., 1], -edge[..., 0]], axis=-1)
    outward /= np.maximum(np.linalg.norm(outward, axis=-1, keepdims=True), 1e-9)
    middle = pixels - pixels.mean(axis=1, keepdims=True)
    outward *= np.sign(np.sum(outward * middle, axis=-1, keepdims=True))
    before = np.roll(outward, 1, axis=1)
    # the intersection of both moved edges: √2 away at a right angle, further at an acute one
    return np.asarray((outward + before) / np.maximum(1 + np.sum(outward * before, axis=-1, keepdims=True), ACUTE))


def _merged(pixels: Array, cov: Array, still: Bools, camera: Ints, tag: Ints) -> tuple[Ints, Array, Array, Array]:
    """Rows with those of a static camera and a static tag merged into their first one.

    The mean corners of n frames, with n times the information, have the same sum of squares as the n frames but for a
    constant. A tag that did move is left as it is.

    Returns:
        The rows left (r,), their pixels (r, 4, 2) and covariances (r, 4, 2, 2), and how many each stands for (r,).
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
        near = rows[np.linalg.norm(pixels[rows] - middle, axis=-1).max(axis=1) < STILL_PIXELS]
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
    """Detections under their remapped ids, without squashed ones and those of too many corrected bits."""
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


def time_steps(t: Array, camera: Ints) -> tuple[Ints, Array]:
    """Time step of each sighting, (d,), and the steps' times [s], (n,).

    A camera has one frame in a step, and the first of the cameras gives the step its time. Cameras need not be
    synchronous, nor of one rate: a step may be one camera's alone.

    Args:
        t: Times of the sightings in order [s], (d,).
        camera: (d,).
    """
    gaps = []
    for c in np.unique(camera):
        steps = np.diff(np.unique(t[camera == c]))
        if len(steps):
            gaps.append(float(np.median(steps)))
    window = STEP_PERIODS * min(gaps) if gaps else 0.0
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


def gap(t: Array, max_gap: float) -> float:
    """Time between frames from which they tell nothing of the motion between them [s]: no slow camera's frame time.

    Args:
        t: Times of frames in order [s], (n,).
        max_gap: For fast cameras [s].
    """
    return max(max_gap, 1.5 * float(np.median(np.diff(t)))) if len(t) > 1 else max_gap


def swapped(scene: Scene, a: int, c: int) -> Scene:
    """The scene as it would be if two cameras' detections had been swapped."""
    index = np.arange(len(scene.cameras))
    index[[a, c]] = [c, a]
    return _through_lenses(replace(scene, camera=index[scene.camera]))


def words(reasons: Counter[str]) -> str:
    """Reasons with their counts, for a message."""
    return ", ".join(f"{reason}: {count}" for reason, count in reasons.most_common()) or "none dropped"
