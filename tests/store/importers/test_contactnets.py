"""ContactNets' tensors: columns, units, and every published toss."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.store.folders import scaled
from tests.store.makers import HALF
from tossid.errors import FileError, InputError
from tossid.store import read_contactnets


def test_contactnets_columns_and_units(cube_folder: Path) -> None:
    tracks = read_contactnets(cube_folder)
    assert [track.name for track in tracks] == ["1", "2", "10"]
    for track in tracks:
        rows = torch.load(cube_folder / f"{track.name}.pt", weights_only=True).reshape(-1, 19).numpy()
        np.testing.assert_allclose(track.q[:, :3], rows[:, :3] * HALF)
        np.testing.assert_allclose(track.q[:, 3:], rows[:, 3:7])
        assert track.v is not None
        np.testing.assert_allclose(track.v[:, :3], rows[:, 7:10] * HALF)
        np.testing.assert_allclose(track.v[:, 3:], rows[:, 10:13])
        np.testing.assert_allclose(np.diff(track.t), 1 / 148)
        # the velocities are those of the poses
        np.testing.assert_allclose(np.diff(track.q[:, :3], axis=0) * 148, track.v[1:, :3], atol=1e-9)


def test_every_published_cube_toss_imports(shared_data: Path) -> None:
    folder = shared_data / "contactnets_cube"
    tracks = read_contactnets(folder)
    assert len(tracks) == len(list(folder.glob("*.pt")))
    assert max(len(track.t) for track in tracks) == 442
    assert [int(track.name) for track in tracks] == sorted(int(track.name) for track in tracks)
    # what the format says of them: at rest on a face, about half a width above the ground
    rest = np.median([track.q[-1, 2] for track in tracks])
    assert rest == pytest.approx(HALF, abs=0.002)


def test_lengths_in_metres_are_noticed(cube_folder: Path) -> None:
    scaled(cube_folder, slice(0, 3), HALF)
    scaled(cube_folder, slice(7, 10), HALF)
    with pytest.raises(FileError, match="half widths"):
        read_contactnets(cube_folder)


@pytest.mark.parametrize("rate", [0.0, -148.0, float("nan")])
def test_rates_and_widths_must_be_positive(cube_folder: Path, rate: float) -> None:
    with pytest.raises(InputError, match="rate"):
        read_contactnets(cube_folder, rate_hz=rate)
    with pytest.raises(InputError, match="half width"):
        read_contactnets(cube_folder, half_width=rate)
