"""Poses that are imported, before they become tosses."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

import tossid
from tests.models.made import tosses
from tossid.errors import ConfigError, FileError, InputError
from tossid.motion.links import body_tracks
from tossid.objects import ObjectModel, unstated_object
from tossid.rotations import quat_exp, quat_mul
from tossid.settings.ingestion import IngestSettings
from tossid.settings.objects import UnknownObjectSettings
from tossid.settings.training import TrainSettings
from tossid.store import read_dataset, write_tum
from tossid.training.api import prepare
from tossid.types import PoseTrack
from tossid.vision.imported import lost_frames
from tossid.vision.progress import Reporter

LINKS = UnknownObjectSettings(links=2)


@pytest.fixture(scope="module")
def links(elbow: ObjectModel) -> list[list[PoseTrack]]:
    """Both links' tracks; their own frames are those of the elbow."""
    return body_tracks(elbow, tosses(elbow, 8, seed=2, frames=80))


@pytest.fixture(scope="module")
def ingested(links: list[list[PoseTrack]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("links")
    write_tum(folder / "tum", links[0], second=links[1])
    out = folder / "links.h5"
    tossid.ingest(folder / "tum", object=LINKS, level="never", out=out, progress=lambda _: None)
    return out


def test_two_links_become_a_dataset_that_states_their_hinge_alone(
    ingested: Path, links: list[list[PoseTrack]], elbow: ObjectModel
) -> None:
    dataset = read_dataset(ingested)
    assert not dataset.object.is_stated
    assert dataset.object.n_joints == 1
    assert abs(dataset.object.joint_axis[1] @ elbow.joint_axis[1]) == pytest.approx(1, abs=1e-9)
    assert dataset.provenance["hinge_tilt_rad"] < 1e-6
    again = body_tracks(dataset.object, dataset.tosses)
    for track, known in zip(again[1], links[1], strict=True):
        assert track.q[:, :3] == pytest.approx(known.q[: len(track.t), :3], abs=2e-3)
    fit = prepare(dataset, TrainSettings())  # (trains without being told again that nothing is stated)
    assert fit.settings.object == LINKS
    assert fit.shown is not None


def test_a_hinge_that_is_none_is_refused(ingested: Path, tmp_path: Path) -> None:
    copy = tmp_path / "bad.h5"
    copy.write_bytes(ingested.read_bytes())
    with h5py.File(copy, "a") as file:
        file["object/hinge"][10:] = 0.0
    with pytest.raises(FileError, match="/object/hinge is no hinge"):
        read_dataset(copy)


def test_links_that_are_fixed_to_each_other_are_refused(links: list[list[PoseTrack]], tmp_path: Path) -> None:
    turn = quat_exp(np.array([0.1, 0.2, 0.3]))
    stiff = [
        PoseTrack(track.name, track.t, np.concatenate([track.q[:, :3], quat_mul(track.q[:, 3:7], turn)], axis=1))
        for track in links[0]
    ]
    write_tum(tmp_path, links[0], second=stiff)
    with pytest.raises(InputError, match="the joint hardly moves"):
        tossid.ingest(tmp_path, source="tum", object=LINKS)


def test_a_source_with_one_body_is_refused(links: list[list[PoseTrack]], tmp_path: Path) -> None:
    write_tum(tmp_path, links[0])
    with pytest.raises(FileError, match=r"0\.link_2\.txt: is missing"):
        tossid.ingest(tmp_path, source="tum", object=LINKS)
    with pytest.raises(ConfigError, match="source=pll does not give the poses of a second link; expected source=tum"):
        tossid.ingest(tmp_path, source="pll", object=LINKS)


def test_lost_frames_are_not_looked_for_where_flight_is_not_that_of_one_stated_body(elbow: ObjectModel) -> None:
    poses = [PoseTrack("still", 0.01 * np.arange(30), np.tile([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0], (30, 1)))]
    assert lost_frames(poses, elbow, Path("elbow"), IngestSettings(), Reporter()) is None
    assert lost_frames(poses, unstated_object(), Path("unknown"), IngestSettings(), Reporter()) is None
