"""The track of one object among cameras of known pose."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tossid.errors import ObjectError
from tossid.objects import ObjectModel
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection, PoseTrack
from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.report import TrackReport
from tossid.vision.pose_graph.track import DEFAULT, track_scene
from tossid.vision.setup.layout import Body, TagLayout, articulated, body_tags


def track(
    detections: Iterable[Detection],
    cameras: Sequence[Camera],
    model: ObjectModel,
    *,
    settings: TrackSettings = DEFAULT,
    name: str = "track",
) -> tuple[PoseTrack, TrackReport]:
    """The track of one object whose tags are where its model says, among cameras of known pose, and a report.

    Args:
        detections: In any order.
        cameras: Those that detections are of, with their poses in the world.
        model: The object, with tags; its joints are hinges.
        settings: When poses are accepted.
        name: Of the track.

    Raises:
        ObjectError: The object has no tags, or a joint that slides.
        InputError: A detection of an unknown camera, or too few to make a track.
    """
    if not model.tags:
        raise ObjectError(f"object '{model.name}' has no tags to track")
    rigs = {camera.rig_body: camera for camera in cameras}
    bodies = [Body(rig, True, camera.T_world_rig) for rig, camera in rigs.items()]
    own = [Body(name, False, tags=body_tags(model, b)) for b, name in enumerate(model.body_names)]
    layout = articulated(TagLayout((*bodies, *own)), model)
    tracked = track_scene(list(detections), cameras, layout, settings=settings, name=name)
    return tracked.tracks[model.body_names[0]], tracked.report
