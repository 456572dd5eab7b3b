"""Poses that are imported, before they become tosses."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import numpy as np
import pytest

import tossid
from tests.models.made import tosses
from tests.vision.tosses import thrown
from tossid.errors import ConfigError, FileError, InputError
from tossid.ingestion.progress import Progress
from tossid.motion.links import body_tracks
from tossid.objects import ObjectModel, corner_heights
from tossid.rotations import quat_rotate
from tossid.settings.objects import UnknownObjectSettings
from tossid.settings.training import TrainSettings
from tossid.store import read_dataset, write_tum
from tossid.training.api import prepare
from tossid.types import Phase, PoseTrack

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
    assert fit.unknown is not None


def test_a_hinge_that_is_none_is_refused(ingested: Path, tmp_path: Path) -> None:
    copy = tmp_path / "bad.h5"
    copy.write_bytes(ingested.read_bytes())
    with h5py.File(copy, "a") as file:
        file["object/hinge"][10:] = 0.0
    with pytest.raises(FileError, match="/object/hinge is no hinge"):
        read_dataset(copy)


def test_a_source_with_one_body_is_refused(links: list[list[PoseTrack]], tmp_path: Path) -> None:
    write_tum(tmp_path, links[0])
    with pytest.raises(FileError, match=r"0\.link_2\.txt: is missing"):
        tossid.ingest(tmp_path, source="tum", object=LINKS)
    with pytest.raises(ConfigError, match="source=pll does not give the poses of a second link; expected source=tum"):
        tossid.ingest(tmp_path, source="pll", object=LINKS)


def _written(
    folder: Path,
    cube: ObjectModel,
    *,
    up: float = 0.0,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    header: str | None = None,
    count: int = 5,
) -> Path:
    """Tosses of a cube as TUM files, of a point beside its middle; with a header, their quaternions are w first."""
    rng = np.random.default_rng(4)
    for i in range(count):
        toss = thrown(cube, rng, name=str(i))
        q = toss.q.copy()
        q[:, :3] += rng.normal(size=(len(q), 3)) * 2e-4
        q[:, :3] += quat_rotate(q[:, 3:7], np.array(offset)) + np.array([0.0, 0.0, up])
        write_tum(folder, [PoseTrack(str(i), toss.t, q)])
        if header is not None:
            rows = np.column_stack([toss.t, q])
            np.savetxt(folder / f"{i}.txt", rows, header=header, comments="")
    return folder


def test_a_frame_that_is_off_is_no_height_of_the_ground(cube: ObjectModel, tmp_path: Path) -> None:
    """It raises one face and lowers another by as much, here more tosses than not."""
    folder = _written(tmp_path, cube, offset=(0.016, -0.016, -0.016), count=24)
    raised, lowered = list[Path](), list[Path]()
    for path in folder.iterdir():
        (raised if np.loadtxt(path)[-5:, 3].mean() > 0.5 * cube.width else lowered).append(path)
    for path in (*raised[7:], *lowered[4:]):
        path.unlink()
    dataset = tossid.ingest(folder, source="tum", object="cube", progress=lambda progress: None)
    assert len(dataset.tosses) == 11
    assert "ground_height_m" not in dataset.provenance


@pytest.mark.parametrize("up", [-0.3, 0.04])
def test_the_ground_is_where_tosses_rest(cube: ObjectModel, tmp_path: Path, up: float) -> None:
    said = list[str]()

    def hear(progress: Progress) -> None:
        said.extend([progress.message] * progress.is_problem)

    dataset = tossid.ingest(_written(tmp_path, cube, up=up), source="tum", object="cube", progress=hear)
    low = [corner_heights(cube, toss.q[-5:]).min() for toss in dataset.tosses]
    assert low == pytest.approx(np.zeros(5), abs=2e-3)
    assert all(Phase.REST in toss.phase for toss in dataset.tosses)
    assert dataset.provenance["ground_height_m"] == pytest.approx(up, abs=2e-3)
    way = "above" if up > 0 else "below"
    assert any(f"mm {way} z = 0 (median), as 5 of 5 agree; the world is shifted" in line for line in said)
    if abs(up) > 0.1:
        with pytest.raises(InputError, match=f"m {way} the ground"):
            tossid.ingest(tmp_path, source="tum", object="cube", level="never", progress=hear)
        with pytest.raises(FileError, match=rf"the tracked point 0\.\d+ m {way} z = 0; an object of unknown shape"):
            tossid.ingest(tmp_path, source="tum", object="unknown", progress=hear)


def test_an_order_of_quaternions_that_rests_refute_is_named(cube: ObjectModel, tmp_path: Path) -> None:
    said = list[str]()

    def hear(progress: Progress) -> None:
        said.extend([progress.message] * progress.is_problem)

    for name, header in (("bare", ""), ("wrong", "# timestamp tx ty tz qx qy qz qw"), ("right", "t x y z qw qx qy qz")):
        _written(tmp_path / name, cube, header=header)
    look = r"quaternions look like qw qx qy qz: read so, 5 of 5 tosses come to rest on a face, and \d as they were read"
    remedy = r"source\.columns='timestamp tx ty tz qw qx qy qz', or a first line '# timestamp tx ty tz qw qx qy qz'"
    with pytest.raises(FileError, match=rf"{look}; {remedy}, says so"):
        tossid.ingest(tmp_path / "bare", source="tum", object="cube", progress=hear)
    assert not said
    tossid.ingest(tmp_path / "right", source="tum", object="cube", progress=hear)
    columns = "timestamp tx ty tz qw qx qy qz"
    tossid.ingest(tmp_path / "wrong", source="tum", object="cube", columns=columns, progress=hear)
    assert not any("look like" in line for line in said)
    tossid.ingest(tmp_path / "wrong", source="tum", object="cube", progress=hear)
    assert any(re.search(look + "; they are kept in the order that the source states", line) for line in said)
