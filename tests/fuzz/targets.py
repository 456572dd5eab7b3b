"""What is fuzzed: every file that comes from outside, each with a valid one to begin with and what reads it.

A reader may return or raise `TossidError`. Anything else is a finding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from rosbags.rosbag2 import StoragePlugin

from tests.store.makers import contactnets_rows, make_dataset, pll_rows, spinning
from tests.vision.bags import CAMERAS, write_bag
from tossid.models import TrainedModel, build_model, variant
from tossid.objects import OBJECT_FILES, ObjectModel, load_object, recorded_object, to_urdf, write_object
from tossid.settings.training import TrainSettings
from tossid.store import read_contactnets, read_dataset, read_pll, read_tum, write_dataset, write_tum
from tossid.types import Detection, PoseTrack
from tossid.vision.recordings.bag_contents import read_bag_detections
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.recordings.npz import read_detections, read_tracks, write_detections, write_tracks
from tossid.vision.recordings.recording import read_image
from tossid.vision.recordings.rosbag import Bag
from tossid.vision.setup.calibration import read_cameras, write_cameras
from tossid.vision.setup.faces import default_tags
from tossid.vision.setup.layout import layout_of
from tossid.vision.setup.tagslam import read_tagslam, write_tagslam


@dataclass(frozen=True)
class Target:
    """make(folder): writes valid input, and returns the file in it that is fuzzed. read(file): reads it all."""

    make: Callable[[Path], Path]
    read: Callable[[Path], object]


def _cube() -> ObjectModel:
    cube = load_object(OBJECT_FILES / "cube.xml")
    return cube.with_changes(tags=default_tags(cube))


def _track() -> PoseTrack:
    t, q, v = spinning(6, np.random.default_rng(0))
    return PoseTrack("toss", t, q, np.tile(1e-6 * np.eye(6), (6, 1, 1)), v)


def _tensor(rows: Callable[[int, np.random.Generator], np.ndarray]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / "0.pt"
        torch.save(torch.from_numpy(rows(8, np.random.default_rng(0)).copy()), path)
        return path

    return make


def _tum(folder: Path) -> Path:
    write_tum(folder, [_track()])
    return next(folder.glob("*.txt"))


def _dataset(folder: Path) -> Path:
    write_dataset(make_dataset(_cube(), tosses=1), folder / "tosses.h5")
    return folder / "tosses.h5"


def _detections(folder: Path) -> Path:
    one = Detection("left", 0.5, 3, np.arange(8.0).reshape(4, 2), np.tile(np.eye(2), (4, 1, 1)), 0, 50.0)
    write_detections([one, one], folder / "detections.npz")
    return folder / "detections.npz"


def _tracks(folder: Path) -> Path:
    write_tracks([_track()], folder / "tracks.npz")
    return folder / "tracks.npz"


def _copy(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes((OBJECT_FILES / name).read_bytes())
        return folder / name

    return make


def _urdf(folder: Path) -> Path:
    text, meshes = to_urdf(load_object(OBJECT_FILES / "elbow.xml"), meshes="elbow")
    for name, content in meshes.items():
        (folder / name).write_text(content)
    (folder / "elbow.urdf").write_text(text)
    return folder / "elbow.urdf"


def _recorded(folder: Path) -> Path:
    write_object(load_object("cube"), load_object("cube").mjcf, folder)
    write_tagslam(layout_of(_cube()), folder / "tagslam.yaml")
    return folder / "object.yaml"


def _read_recorded(file: Path) -> None:
    config = recorded_object(file.parent)
    assert config is not None
    load_object(config)


def _layout(folder: Path) -> Path:
    write_tagslam(layout_of(_cube()), folder / "tagslam.yaml")
    return folder / "tagslam.yaml"


def _cameras(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        write_cameras(CAMERAS, folder)
        return folder / name

    return make


def _bag(version: int, plugin: StoragePlugin, name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = write_bag(folder, version, plugin=plugin, frames=range(2))
        return path if path.is_file() else next(path.glob(name))

    return make


def _read_bag(file: Path) -> None:
    path = file if file.suffix == ".bag" else file.parent
    read_bag_detections(path, CAMERAS, sigma=0.5)
    with Bag(path) as bag:
        for _ in bag.messages(list(bag.types)):
            pass


def _image(suffix: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        image = np.random.default_rng(0).integers(0, 255, (24, 32), dtype=np.uint8)
        (folder / f"1.{suffix}").write_bytes(cv2.imencode(f".{suffix}", image)[1].tobytes())
        return folder / f"1.{suffix}"

    return make


def _times(folder: Path) -> Path:
    _layout(folder)
    write_cameras(CAMERAS, folder)
    for camera in CAMERAS:
        own = folder / "frames" / camera.name
        own.mkdir(parents=True)
        for i in range(3):
            (own / f"{i}.png").write_bytes(b"")
        (own / "times.csv").write_text("".join(f"{i / 10} {i}.png\n" for i in range(3)))
    return folder / "frames" / "left" / "times.csv"


def _checkpoint(folder: Path) -> Path:
    settings = TrainSettings(model=replace(variant("cnrp"), hidden=4))
    model = build_model(settings.model, _cube())
    trained = TrainedModel(model, settings, model.parameters_report(), sha256="0" * 64)
    return trained.save(folder / "model.pt")


TARGETS = {
    "contactnets": Target(_tensor(contactnets_rows), lambda file: read_contactnets(file.parent)),
    "pll": Target(_tensor(pll_rows), lambda file: read_pll(file.parent, n_joints=1)),
    "tum": Target(_tum, lambda file: read_tum(file.parent, n_joints=0)),
    "dataset": Target(_dataset, read_dataset),
    "detections": Target(_detections, read_detections),
    "tracks": Target(_tracks, read_tracks),
    "mjcf": Target(_copy("elbow.xml"), load_object),
    "urdf": Target(_urdf, load_object),
    "object": Target(_recorded, _read_recorded),
    "tagslam": Target(_layout, read_tagslam),
    "cameras": Target(_cameras("cameras.yaml"), lambda file: read_cameras(file.parent)),
    "camera_poses": Target(_cameras("camera_poses.yaml"), lambda file: read_cameras(file.parent)),
    "times": Target(_times, lambda file: read_recording(file.parents[2])),
    "png": Target(_image("png"), read_image),
    "jpeg": Target(_image("jpg"), read_image),
    "bag1": Target(_bag(1, StoragePlugin.SQLITE3, ""), _read_bag),
    "bag2_mcap": Target(_bag(2, StoragePlugin.MCAP, "*.mcap"), _read_bag),
    "bag2_sqlite": Target(_bag(2, StoragePlugin.SQLITE3, "*.db3"), _read_bag),
    "bag2_metadata": Target(_bag(2, StoragePlugin.MCAP, "metadata.yaml"), _read_bag),
    "checkpoint": Target(_checkpoint, TrainedModel.load),
}
