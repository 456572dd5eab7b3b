"""Groups of tosses hold what they say, and are compared by what differs."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.evaluation.groups import NONE, compare_groups, toss_groups
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.store import Dataset
from tossid.types import RecordingOrder, Session, Toss

N, FRAMES = 24, 12


@pytest.fixture(scope="module")
def dataset(elbow: ObjectModel) -> Dataset:
    """Elbows that end at four places; every other one lies still at its end, on its side."""
    t, tosses = np.arange(FRAMES) / 148, []
    cov, phase = np.tile(1e-9 * np.eye(7), (FRAMES, 1, 1)), np.zeros(FRAMES, dtype=np.uint8)
    for k in range(N):
        q, v = np.zeros((FRAMES, 8)), np.zeros((FRAMES, 7))
        q[:, 0], q[:, 1], q[:, 2] = k % 2, k // 2 % 2, 0.025 + 0.01 * k
        q[:, 3:7] = quat_exp(np.array([0.0, np.pi / 2, 0.0]) * (k % 2))
        q[:, 7] = 2 * np.pi + np.deg2rad(k)
        v[:, 3] = k
        if k % 3 == 0:
            q[:, 0] += 0.01 * np.arange(FRAMES)
        tosses.append(Toss(str(k), t, q, v, cov, cov, phase))
    names, session_of = tuple(toss.name for toss in tosses), (np.arange(N) >= 10).astype(np.int64)
    places, turn = np.array([toss.q[-1, :2] for toss in tosses]), np.tile([1.0, 0.0, 0.0, 0.0], (N, 1))
    sessions, nothing = (Session("0", "9", 10), Session("10", "23", 14)), np.zeros((N, 0))
    # recorded the other way round
    back = slice(None, None, -1)
    order = RecordingOrder(
        sessions, "times", names[back], (), nothing, places[back], turn, np.zeros(N), session_of[back]
    )
    return Dataset(elbow, tuple(tosses), 148.0, "made", order=order)


def test_every_toss_belongs_to_the_group_that_it_is_of(dataset: Dataset) -> None:
    groups = toss_groups(dataset)
    assert {name: len(labels) for name, labels in groups.items()} == dict.fromkeys(groups, N)
    assert groups["session"] == ("0 to 9",) * 10 + ("10 to 23",) * 14
    assert groups["release face"] == ("-z", "+x") * (N // 2)
    assert groups["resting faces"][:3:2] == (NONE, "-z, -z")
    assert groups["resting faces"][1].startswith("+x, ")
    assert groups["release spin"] == ("0 to 7.67 rad/s",) * 8 + ("7.67 to 15.3 rad/s",) * 8 + ("15.3 to 23 rad/s",) * 8
    assert groups["release joint"][0] == "0 to 7.67 deg"  # whole turns do not count
    assert len(set(groups["place"])) == 4


def test_groups_that_differ_are_told_from_those_that_do_not() -> None:
    rng = np.random.default_rng(0)
    labels = ["0 to 9"] * 40 + ["10 to 19"] * 40
    scores = rng.normal(size=80)
    same, other = compare_groups(scores, labels), compare_groups(scores + np.repeat([0.0, 2.0], 40), labels)
    assert [group.name for group in other.groups] == ["0 to 9", "10 to 19"]
    assert same.p > 0.05
    assert other.p < 1e-6
    assert other.groups[1].mean == pytest.approx(scores[40:].mean() + 2)
    assert other.groups[1].ci95[0] < other.groups[1].mean < other.groups[1].ci95[1]


def test_missing_scores_and_single_groups_are_no_failure() -> None:
    scores = np.array([1.0, np.nan, 3.0, np.nan])
    found = compare_groups(scores, ["a", "a", "a", "b"])
    assert [(group.name, group.n, group.mean) for group in found.groups] == [("a", 2, 2.0)]
    assert np.isnan(found.p)
    assert np.isnan(compare_groups(np.ones(4), ["a", "a", "b", "b"]).p)


def test_a_dataset_without_order_is_refused(dataset: Dataset) -> None:
    with pytest.raises(InputError, match="order of recording was not looked at"):
        toss_groups(Dataset(dataset.object, dataset.tosses, 148.0, "made"))
