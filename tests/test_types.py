"""Types that pass between rooms refuse what is no motion, and say which row."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tossid.errors import MotionError
from tossid.types import OnDemand, PoseTrack, Toss, check_motion, frame_time

N = 5


def arrays(n_joints: int = 0) -> dict[str, np.ndarray]:
    nv = 6 + n_joints
    q = np.zeros((N, 7 + n_joints))
    q[:, 3] = 1.0
    return {
        "t": np.arange(N) / 148.0,
        "q": q,
        "v": np.zeros((N, nv)),
        "q_cov": np.tile(np.eye(nv), (N, 1, 1)),
        "v_cov": np.tile(np.eye(nv), (N, 1, 1)),
        "phase": np.ones(N, dtype=np.uint8),
    }


def spoil(name: str, index: tuple[int, ...], value: float) -> dict[str, np.ndarray]:
    out = arrays()
    out[name][index] = value
    return out


@pytest.mark.parametrize(
    ("name", "index", "value", "row", "says"),
    [
        ("t", (2,), np.nan, 2, "finite"),
        ("t", (3,), 0.0, 3, "increase"),
        ("t", (4,), 1e300, None, r"time is 1e\+300, expected at most 1e\+12"),
        ("t", (4,), 1e11, None, r"time spans 1e\+11 s, expected at most 1e\+07 s"),
        ("q", (1, 0), np.inf, 1, "finite"),
        ("q", (4, 3), 1.01, 4, "norm"),
        ("q", (3, 0), 1e300, 3, r"q is 1e\+300, expected at most 10000"),
        ("v", (0, 5), np.nan, 0, "finite"),
        ("v", (3, 0), 1e300, 3, r"v is 1e\+300, expected at most 1e\+06"),
        ("q_cov", (2, 1, 1), -1.0, 2, "negative"),
        ("q_cov", (2, 0, 0), 1e300, 2, r"q_cov is larger than 1e\+20"),
        ("v_cov", (3, 0, 1), np.nan, 3, "finite"),
    ],
)
def test_a_bad_row_is_named(name: str, index: tuple[int, ...], value: float, row: int | None, says: str) -> None:
    for n_joints in (0, 1, 3):
        assert len(Toss(name="a", **arrays(n_joints))) == N
    with pytest.raises(MotionError, match=says) as caught:
        Toss(name="a", **spoil(name, index, value))
    assert row is None or caught.value.row == row


@pytest.mark.parametrize("name", ["t", "q", "v", "q_cov", "v_cov", "phase"])
def test_a_wrong_shape_is_refused(name: str) -> None:
    bad = arrays()
    bad[name] = bad[name][:-1]
    with pytest.raises(MotionError, match="shape"):
        Toss(name="a", **bad)


def test_what_is_no_track_is_refused() -> None:
    good = arrays()
    with pytest.raises(MotionError, match="train, validation, test"):
        Toss(name="a", split="holdout", **good)
    PoseTrack(name="a", t=good["t"], q=good["q"])
    with pytest.raises(MotionError, match="q_cov"):
        PoseTrack(name="a", t=good["t"], q=good["q"], q_cov=good["q_cov"][:, :3])
    with pytest.raises(MotionError, match="v has shape"):
        PoseTrack(name="a", t=good["t"], q=good["q"], v=good["v"][:, :5])
    with pytest.raises(MotionError, match="n >= 2"):
        check_motion(np.zeros(1), np.array([[0, 0, 0, 1, 0, 0, 0.0]]))


@given(st.integers(0, 2**31))
@example(833)  # half of the steps are single ones: their median lies between one and two
def test_the_time_between_frames_is_that_of_the_clock_whichever_frames_are_missing(seed: int) -> None:
    rng, dt = np.random.default_rng(seed), 1 / 360
    steps = rng.choice([1, 2, 3], p=[0.43, 0.40, 0.17], size=200)
    t = np.concatenate([[0], np.cumsum(steps)]) * dt + rng.normal(0, 0.02 * dt, 201)
    q, cov = np.tile([0, 0, 0, 1.0, 0, 0, 0], (201, 1)), np.tile(np.eye(6), (201, 1, 1))
    toss = Toss("a", t, q, np.zeros((201, 6)), cov, cov, np.ones(201, dtype=np.uint8))
    assert frame_time([toss]) == pytest.approx(dt, rel=0.01)
    np.testing.assert_array_equal(toss.ticks(dt), np.concatenate([[0], np.cumsum(steps)]))


def test_uneven_times_have_their_median() -> None:
    t = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 100))
    q, cov = np.tile([0, 0, 0, 1.0, 0, 0, 0], (100, 1)), np.tile(np.eye(6), (100, 1, 1))
    toss = Toss("a", t, q, np.zeros((100, 6)), cov, cov, np.ones(100, dtype=np.uint8))
    assert frame_time([toss]) == float(np.median(np.diff(t)))


def test_items_on_demand_are_read_when_asked_for_and_the_last_few_kept() -> None:
    read: list[int] = []

    def item(i: int) -> int:
        read.append(i)
        return 10 * i

    items = OnDemand(item, 5, kept=2)
    assert (len(items), read) == (5, [])
    assert items[3] == items[-2] == 30
    assert items[1:4] == (10, 20, 30)
    assert read == [3, 1, 2, 3]  # 3 had gone when 2 came
    assert items[2] + items[3] == 50
    assert read == [3, 1, 2, 3]
    assert list(items) == [0, 10, 20, 30, 40]
    assert read == [3, 1, 2, 3, 0, 1, 2, 3, 4]
    with pytest.raises(IndexError):
        items[5]
