"""The verb, from a dataset and a simulator to a report, without a command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.diagnose import MOST, diagnose, prepare, searched
from tossid.diagnosis.under_way import UnderWay
from tossid.errors import ConfigError, InputError
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import Dataset
from tossid.types import RecordingOrder, Session, Toss

KEPT = ("friction", "gravity")
WITHOUT = tuple(effect.name for effect in LIBRARY if effect.name not in KEPT)


@pytest.fixture(scope="module")
def dataset(cube: ObjectModel) -> Dataset:
    """Ten tosses with friction 0.3, where 0.18 is stated; three are of the test split, one is too short."""
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 10, seed=3)
    short = {name: getattr(tosses[-1], name)[:5] for name in ("t", "q", "v", "q_cov", "v_cov", "phase")}
    tosses[-1] = replace(tosses[-1], **short)
    splits = ["test"] * 3 + ["train"] * 7
    tosses = [replace(toss, split=split) for toss, split in zip(tosses, splits, strict=True)]
    return Dataset(cube, tuple(tosses), 148.0, "made", {})


def test_friction_is_found_judged_and_its_report_saved(cube: ObjectModel, tmp_path: Path) -> None:
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 15, seed=3, frames=70)
    tosses[0] = replace(tosses[0], **{n: getattr(tosses[0], n)[:5] for n in ("t", "q", "v", "q_cov", "v_cov", "phase")})
    tosses = [replace(toss, split="test" if i > 12 else "train") for i, toss in enumerate(tosses)]
    dataset = Dataset(cube, tuple(tosses), 148.0, "made", {})
    reported: list[float] = []
    news: list[str] = []
    task = prepare(
        dataset, World(cube), settings=DiagnoseSettings(without=WITHOUT, threads=1, split="train", repeats=3)
    )
    gap = task.run(UnderWay(lambda text, share: reported.append(share), news.append))
    assert gap.verdict == "explained"
    assert gap.named == ("friction",)
    found = gap.findings[0]
    assert (found.verdict, found.frequency, gap.draws) == ("identified", 1.0, 600)
    mu = found.parameters["mu"]
    assert mu.low - 0.002 < 0.3 < mu.high + 0.002
    (change,) = gap.change
    assert (change.name, change.parameter, change.stated) == ("friction", "mu", cube.friction)
    assert change.value == mu
    assert gap.gap_closed.value > 0.8
    assert found.gap_closed.value > 0.8
    before, after = gap.brings.position_pct()
    assert (gap.brings.engine, gap.brings.n) == ("tossid", 12)
    assert after.value < 0.2 * before.value
    # the test split is looked at once
    assert gap.unseen is not None
    assert gap.unseen.n_tosses == 2
    assert gap.unseen.gap_closed.value > 0.5
    assert gap.gap.by_phase["slide"].value > 0.4
    assert gap.remarks[0] == "Tosses left out: 1 of 13 are shorter than 11 frames."
    assert gap.patch is not None
    assert gap.patch["keys"]["object.friction"]["before"] == cube.friction
    assert gap.next_toss is not None
    assert gap.next_toss["release"] is None
    others = {f.name: f for f in gap.findings[1:]}
    assert others["gravity"].verdict == "not_supported"
    assert 0 < others["gravity"].detectable["g_ms2"] < 0.5
    assert reported == sorted(reported)
    assert reported[-1] == 1.0
    assert "takes about" in news[1]
    kept = json.loads((gap.save(tmp_path / "gap") / "gap.json").read_text())
    assert kept["explanation"]["effects"] == ["friction"]
    assert kept["data"] == {"object": "cube"}


def test_where_nothing_is_repeated_nothing_is_said_of_how_sure_it_is(dataset: Dataset, cube: ObjectModel) -> None:
    gap = diagnose(dataset, World(cube), without=WITHOUT, threads=1, repeats=0)
    assert gap.named == ("friction",)
    assert (gap.folds, gap.draws, gap.probability_none) == (0, 0, None)
    assert gap.findings[0].frequency is None
    assert not gap.brings.unseen


def test_many_tosses_are_drawn_from(dataset: Dataset) -> None:
    many = tuple(replace(dataset.tosses[i % 9], name=str(i)) for i in range(MOST + 5))
    some, (remark,) = searched(many, DiagnoseSettings())
    assert len(some) == MOST
    assert [int(toss.name) for toss in some] == sorted(int(toss.name) for toss in some)
    assert remark.startswith(f"{MOST} of {MOST + 5} tosses take part")
    assert searched(many, DiagnoseSettings(tosses=MOST + 5)) == (many, ())


def test_tosses_are_chosen_by_settings(dataset: Dataset) -> None:
    def names(**keys: Any) -> tuple[list[str], list[str]]:
        task = prepare(dataset, settings=DiagnoseSettings(threads=1, **keys))
        return [toss.name for toss in task.problem.tosses], [toss.name for toss in task.problem.unseen]

    assert names() == ([str(i) for i in range(9)], [])
    assert names(split="train") == ([str(i) for i in range(3, 9)], ["0", "1", "2"])
    assert names(skip=1, tosses=6) == ([str(i) for i in range(1, 7)], [])
    task = prepare(dataset, settings=DiagnoseSettings(split="train", threads=1), name="mine.h5")
    assert task.about["tosses_of"] == "mine.h5, train split"


def test_a_copy_is_no_toss_of_its_own(dataset: Dataset) -> None:
    """One copy is of a toss that is searched, the other is an unseen one's, turned about the vertical."""
    turned = [_turned(dataset.tosses[i], 0.7, name) for i, name in ((4, "again"), (5, "unseen again"))]
    turned[1] = replace(turned[1], split="test")
    held = replace(dataset, tosses=(*dataset.tosses, *turned))
    task = prepare(held, settings=DiagnoseSettings(split="train", threads=1))
    alone = prepare(dataset, settings=DiagnoseSettings(split="train", threads=1))
    assert [toss.name for toss in task.problem.tosses] == [toss.name for toss in alone.problem.tosses]
    assert [toss.name for toss in task.problem.unseen] == [toss.name for toss in alone.problem.unseen]
    assert task.about["remarks"][0].startswith(
        "Tosses left out: 1 of 8 are shorter than 11 frames, 1 of 8 are copies of others."
    )
    assert task.about["remarks"][1] == "1 of 4 unseen tosses left out: they are copies of others."
    three = replace(dataset, tosses=(*dataset.tosses[3:5], turned[0]))
    with pytest.raises(InputError, match="1 of 3 are copies of others"):
        prepare(three, settings=DiagnoseSettings(threads=1))


def _turned(toss: Toss, yaw: float, name: str) -> Toss:
    """A toss turned about the vertical, under another name."""
    turn = quat_exp(np.array([0.0, 0.0, yaw]))
    q = toss.q.copy()
    q[:, :3] = q[:, :3] @ quat_to_matrix(turn).T
    q[:, 3:7] = quat_mul(turn, q[:, 3:7])
    return replace(toss, q=q, name=name)


def test_two_recordings_in_one_dataset_are_said(dataset: Dataset) -> None:
    names, n = dataset.names, len(dataset)
    worlds = (
        Session(names[0], names[3], 4, (0.04, 0.0), (0.002, 0.002)),
        Session(names[4], names[-1], n - 4, (0.0, 0.0), (0.002, 0.002)),
    )
    turn, session_of = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), (np.arange(n) >= 4).astype(np.int64)
    order = RecordingOrder(
        worlds, "names", names, (), np.zeros((n, 0)), np.zeros((n, 2)), turn, np.zeros(n), session_of
    )
    task = prepare(replace(dataset, order=order), settings=DiagnoseSettings(threads=1))
    said = f"Two recordings: tosses {names[0]} to {names[3]} stand in a world tilted by 2.29°"
    assert task.about["remarks"][-1].startswith(said)
    assert not any(
        "recordings" in remark for remark in prepare(dataset, settings=DiagnoseSettings(threads=1)).about["remarks"]
    )


def test_too_little_is_refused(dataset: Dataset) -> None:
    with pytest.raises(InputError, match="from number 1: has 2 tosses; a diagnosis needs at least 3"):
        prepare(dataset, settings=DiagnoseSettings(tosses=2, threads=1))
    still = [replace(toss, q=np.repeat(toss.q[:1], len(toss), axis=0)) for toss in dataset.tosses[:8]]
    with pytest.raises(InputError, match="in 8 of 8 nothing moves"):
        prepare(replace(dataset, tosses=tuple(still)), settings=DiagnoseSettings(threads=1))


def test_too_few_for_a_name_have_a_gap_and_say_how_many_a_name_needs(dataset: Dataset, cube: ObjectModel) -> None:
    gap = diagnose(dataset, World(cube), without=WITHOUT, threads=1, tosses=5, repeats=0)
    assert gap.named == ()
    assert gap.verdict == "unexplained"
    slide = gap.gap.by_phase["slide"].value
    assert slide > 0.3
    assert any("5 tosses are too few" in remark and "twelve" in remark for remark in gap.remarks)


def test_a_misspelt_name_is_corrected(dataset: Dataset) -> None:
    with pytest.raises(ConfigError, match=r"'fricton'.*friction"):
        diagnose(dataset, without=("fricton",))
    with pytest.raises(ConfigError, match="sed"):
        diagnose(dataset, sed=3)


def test_what_is_known_is_kept_when_it_is_interrupted(dataset: Dataset, cube: ObjectModel, tmp_path: Path) -> None:
    task = prepare(dataset, World(cube), settings=DiagnoseSettings(without=WITHOUT, threads=1, repeats=3))
    under_way = UnderWay(progress=_stop_at("the search repeated"))
    with pytest.raises(KeyboardInterrupt):
        task.run(under_way)
    known = task.known_so_far(under_way)
    assert (known.verdict, known.named, known.candidates) == ("incomplete", (), ("friction",))
    assert known.tosses_of == task.about["tosses_of"]
    kept = json.loads((known.save(tmp_path / "gap") / "gap.json").read_text())
    assert kept["complete"] is False
    assert kept["interrupted"]["during"].startswith("the search repeated")
    assert kept["change"][0]["name"] == "friction"


def _stop_at(stage: str) -> Callable[[str, float], None]:
    def stop(what: str, share: float) -> None:
        if what.startswith(stage):
            raise KeyboardInterrupt

    return stop
