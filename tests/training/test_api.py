"""`tossid.train`: what it returns and refuses, and how it goes on; tests/test_docs.py has models of other kinds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

import tossid
from tests.models.made import tosses
from tossid.errors import ConfigError, InputError
from tossid.models import variant
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings
from tossid.store import Dataset
from tossid.training.api import Epoch, fingerprint, prepare, training_tosses


@pytest.fixture(scope="module")
def dataset(cube: ObjectModel) -> Dataset:
    """Eight tosses of the stated cube: five to learn from, two to stop by, one held out."""
    made = tosses(cube, 8, seed=0, frames=50)
    splits = ["train"] * 5 + ["validation"] * 2 + ["test"]
    rows = tuple(replace(toss, split=split) for toss, split in zip(made, splits, strict=True))
    return Dataset(cube, rows, 148.0, "made")


def held_out(dataset: Dataset) -> Dataset:
    return replace(dataset, tosses=dataset.of_split("test"))


QUICK = {"epochs": 2, "horizons": (20,), "hidden": 4}


def test_keys_are_settings_and_the_rest_is_the_variants(dataset: Dataset) -> None:
    trained = tossid.train(dataset, model="cnrp", gravity=9.0, seed=3, **QUICK)
    assert trained.settings.model == replace(variant("cnrp"), gravity=9.0, horizons=(20,), hidden=4)
    assert (trained.settings.seed, trained.settings.epochs) == (3, 2)
    assert trained.parameters["gravity_given_ms2"] == 9.0
    assert "friction" in trained.intervals
    assert [record.stage for record in trained.history][:2] == ["continuous", "continuous"]
    assert trained.sha256 == fingerprint(dataset.of_split("train"))


@pytest.mark.parametrize(
    ("keys", "error"),
    [
        ({"optimizer": "sgd"}, r"optimizer: 'sgd' will not do; expected one of lbfgs, adam"),
        ({"cone": "polyhedron"}, r"cone: 'polyhedron' will not do; expected one of exact, polyhedral.*polyhedral'\?"),
        ({"epochs": "5"}, r"epochs: '5' will not do; expected a whole number"),
        ({"epochs": 2.5}, r"epochs: 2.5 will not do; expected a whole number"),
        ({"gravity": -1.0}, r"gravity: -1.0 is out of range; expected a number from 0 to 1000"),
        ({"learning_rate": 0}, r"learning_rate: 0 is out of range; expected a number above 0"),
        ({"gravty": 0.0}, r"gravty: is no setting .* 'gravity'"),
        ({"model": "cnrip"}, "cnrpi"),
    ],
)
def test_a_wrong_key_or_value_is_refused_with_what_was_expected(
    dataset: Dataset, keys: dict[str, Any], error: str
) -> None:
    with pytest.raises(ConfigError, match=error):
        tossid.train(dataset, **keys)


def test_torch_has_its_threads_back(dataset: Dataset) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    tossid.train(dataset, model="cn", **QUICK)
    with pytest.raises(InputError):
        tossid.train(held_out(dataset))
    assert torch.get_num_threads() == 2
    torch.set_num_threads(before)


def test_corners_that_tosses_contradict_have_no_say_in_lag_and_inertia(cube: ObjectModel) -> None:
    """Begun with them, contact was taken for flight, and every start had a lag of its own."""
    lag, found = 0.5 / 148, []
    late = [replace(toss, v=toss.v + 9.81 * lag * np.eye(6)[2]) for toss in tosses(cube, 32, seed=3)]
    rows = tuple(replace(toss, split="train" if i < 26 else "validation") for i, toss in enumerate(late))
    for share, inertia in ((1.0, 1.0), (0.1, 0.3), (0.3, 3.0)):
        corners = cube.corner_pos.copy()
        corners[:4] *= share
        start = cube.with_changes(corner_pos=corners, inertia=inertia * cube.inertia)
        fit = prepare(Dataset(start, rows, 148.0, "made"), TrainSettings())
        found.append((fit.model.measurement.velocity_lag, fit.model.object.inertia))
    right, *wrong = found
    np.testing.assert_array_equal(right[1], cube.inertia)
    assert wrong[0][0] == wrong[1][0] == pytest.approx(right[0], rel=0.02)
    np.testing.assert_array_equal(wrong[0][1], wrong[1][1])


def test_copies_between_splits_are_noted(dataset: Dataset) -> None:
    assert "copies" not in tossid.train(dataset, model="cn", **QUICK).parameters
    copy = replace(dataset.tosses[0], name="copy", split="test")
    noted = tossid.train(replace(dataset, tosses=(*dataset.tosses, copy)), model="cn", **QUICK).parameters["copies"]
    assert "1 of 2 test tosses equal one of train or validation" in noted["warning"]


def test_rollouts_that_never_land_have_no_intervals(dataset: Dataset) -> None:
    rising = [replace(toss, v=toss.v + np.array([0, 0, 3.0, 0, 0, 0])) for toss in dataset.tosses]
    trained = tossid.train(replace(dataset, tosses=rising), model="cn", gravity=0.0, **QUICK)
    assert trained.intervals == {}


@pytest.mark.parametrize("optimizer", ["lbfgs", "adam"])
def test_an_interrupted_training_goes_on_where_it_was(dataset: Dataset, optimizer: str) -> None:
    states: list[dict[str, Any]] = []
    shares: list[float] = []
    keys = {**QUICK, "model": "cnrpi", "optimizer": optimizer}

    def keep(epoch: Epoch) -> None:
        if epoch.number in ((3, 6) if optimizer == "lbfgs" else (3,)):
            states.append(epoch.state())

    whole = tossid.train(dataset, each_epoch=keep, progress=lambda text, share: shares.append(share), **keys)
    assert shares == sorted(shares)
    assert shares[-1] <= 1.0
    for state in states:
        again = tossid.train(dataset, state=state, **keys)
        assert len(again.history) == len(whole.history) == len(shares)
        for name, value in whole.model.state_dict().items():
            torch.testing.assert_close(again.model.state_dict()[name], value, rtol=0, atol=0)


def test_fewer_tosses_are_drawn_by_the_seed(dataset: Dataset) -> None:
    def drawn(count: int, seed: int) -> list[str]:
        train, validation = training_tosses(dataset, TrainSettings(tosses=count, seed=seed))
        assert len(train) == count
        assert len(validation) == min(count, 2)
        return [toss.name for toss in train]

    assert drawn(2, 0) == drawn(4, 0)[:2]  # more tosses are further tosses
    assert len({tuple(drawn(2, seed)) for seed in range(6)}) > 1
    with pytest.raises(InputError, match="5 training tosses"):
        drawn(6, 0)
    with pytest.raises(InputError, match="no tosses in split 'train'"):
        tossid.train(held_out(dataset))
