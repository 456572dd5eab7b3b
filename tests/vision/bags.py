"""Small bags of both ROS versions, for tests."""

from __future__ import annotations

from pathlib import Path

import cv2
import lz4.frame
import numpy as np
from backports import zstd
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.rosbag import APRILTAG_MSGS, typestore

CAMERAS = tuple(
    Camera(name, (64, 48), [60, 60, 32, 24], image_topic=f"/{name}/image", tag_topic=f"/{name}/tags", clock_offset=late)
    for name, late in (("left", 0.0), ("right", 0.25))
)
STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: typestore()}
for _name, _text in APRILTAG_MSGS.items():
    STORES[1].register(get_types_from_msg(_text, _name))


def header(version: int, t_ns: int):
    types = STORES[version].types
    stamp = types["builtin_interfaces/msg/Time"](t_ns // 10**9, t_ns % 10**9)
    seq = {"seq": 0} if version == 1 else {}
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera", **seq)


def _tags(version: int, t_ns: int, corners: np.ndarray, *, rauch: bool = False):
    """One detection, in TagSLAM's message or in apriltag_ros'."""
    types = STORES[version].types
    if rauch:
        point = types["apriltag_msgs/msg/Point"]
        points = [point(*corner) for corner in corners]
        one = types["apriltag_msgs/msg/AprilTagDetection"]("36h11", 7, 1, 0.0, 55.0, points[0], points, np.zeros(9))
        return types["apriltag_msgs/msg/AprilTagDetectionArray"](header(version, t_ns), [one])
    point = types["geometry_msgs/msg/Point"]
    points = [point(*corner, 0.0) for corner in corners]
    one = types["apriltag_msgs/msg/Apriltag"](7, "36h11", 1, 1, 6, points[0], points)
    return types["apriltag_msgs/msg/ApriltagArrayStamped"](header(version, t_ns), [one])


def _image(version: int, t_ns: int, image: np.ndarray, *, packed: bool):
    types = STORES[version].types
    if packed:
        data = cv2.imencode(".png", image)[1].reshape(-1)
        return types["sensor_msgs/msg/CompressedImage"](header(version, t_ns), "png", data)
    height, width = image.shape
    data = np.repeat(image.reshape(-1), 3)
    return types["sensor_msgs/msg/Image"](header(version, t_ns), height, width, "bgr8", 0, 3 * width, data)


CORNERS = np.array([[10.0, 30.0], [30.0, 31.0], [31.0, 11.0], [11.0, 10.0]])
PICTURES = np.random.default_rng(0).integers(0, 255, (20, 48, 64), dtype=np.uint8)


PACKERS = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstd.compress}


def write_bag(
    folder: Path,
    version: int,
    *,
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
    rauch: bool = False,
    frames: range = range(20),
    compression: CompressionMode = CompressionMode.NONE,
    packed: str = "",
    chunk: int = 20,
) -> Path:
    """Frames at 10 Hz: detections of both cameras, plain images of the left and packed ones of the right.

    rauch: detections in apriltag_ros' message, not TagSLAM's. packed: the compression of an MCAP's chunks, each of
    `chunk` frames.
    """
    path, store = folder / ("bag.bag" if version == 1 else "bag"), STORES[version]
    tags = f"apriltag_msgs/msg/{'AprilTagDetectionArray' if rauch else 'ApriltagArrayStamped'}"
    images = {"left": "sensor_msgs/msg/Image", "right": "sensor_msgs/msg/CompressedImage"}
    folder.mkdir(exist_ok=True)
    writing = Writer1(path) if version == 1 else Writer2(path, version=9, storage_plugin=plugin)
    if version == 2:
        writing.set_compression(compression, CompressionFormat.ZSTD)
    with writing as writer:
        topics = {}
        for camera in CAMERAS:
            image_topic = f"/{camera.name}/image" + ("/compressed" if camera.name == "right" else "")
            for topic, kind in ((camera.tag_topic, tags), (image_topic, images[camera.name])):
                topics[camera.name, kind] = writer.add_connection(topic, kind, typestore=store)
        if plugin is StoragePlugin.MCAP:
            writer.storage.compression, writer.storage.compressor = packed, PACKERS[packed]
        for i in frames:
            for camera in CAMERAS:
                t_ns = 10**9 + i * 10**8 + round(camera.clock_offset * 1e9)
                for kind, message in (
                    (tags, _tags(version, t_ns, CORNERS + i, rauch=rauch)),
                    (images[camera.name], _image(version, t_ns, PICTURES[i], packed=camera.name == "right")),
                ):
                    raw = store.serialize_ros1(message, kind) if version == 1 else store.serialize_cdr(message, kind)
                    writer.write(topics[camera.name, kind], t_ns + 5000, raw)  # recorded a little later
            if plugin is StoragePlugin.MCAP and (i + 1) % chunk == 0:
                writer.storage.close_chunk()
    return path
