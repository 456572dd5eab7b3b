"""The verb, from a dataset and a simulator to a report, without a command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.by_hand import diagnosis
from tests.diagnosis.tossed import seen
from tests.motion.turned import as_published, thrown_along_x
from tossid.diagnosis.diagnose import diagnose, prepare
from tossid.diagnosis.explain import begin
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.report.text import sentences
from tossid.diagnosis.selection.stability import Repeat, Stability
from tossid.diagnosis.under_way import UnderWay
from tossid.errors import ConfigError, InputError
from tossid.motion.tosses import tosses_from_tracks
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import Dataset
from tossid.types import PoseTrack, RecordingOrder, Session, Toss

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


@pytest.mark.slow
def test_friction_is_found_and_its_report_saved(dataset: Dataset, cube: ObjectModel, tmp_path: Path) -> None:
    reported: list[float] = []
    gap = diagnose(
        dataset, World(cube), without=WITHOUT, threads=1, repeats=0, progress=lambda text, share: reported.append(share)
    )
    assert gap.named == ("friction",)
    assert gap.findings[0].verdict == "identified"
    mu = gap.findings[0].parameters["mu"]
    assert mu.low - 0.002 < 0.3 < mu.high + 0.002
    assert gap.gap_closed.value > 0.8
    assert next(share for share in gap.gap.by_phase if share.name == "slide").share.value > 0.4
    assert gap.remarks[0] == "Tosses left out: 1 of 10 are shorter than 11 frames."
    few = f"{len(gap.tosses)} tosses are too few for a change of an effect over their order to be seen; it takes "
    assert any(remark.startswith(few) for remark in gap.remarks)
    assert gap.patch is not None
    assert gap.patch["keys"]["object.friction"]["before"] == cube.friction
    assert gap.next_toss is not None
    assert gap.next_toss["release"] is None
    assert reported[-1] == 1.0
    kept = json.loads((gap.save(tmp_path / "gap") / "gap.json").read_text())
    assert kept["explanation"]["effects"] == ["friction"]
    assert kept["data"] == {"object": "cube"}


def test_tosses_are_chosen_by_settings(dataset: Dataset) -> None:
    def names(**keys: Any) -> tuple[list[str], list[str]]:
        task = prepare(dataset, settings=DiagnoseSettings(threads=1, **keys))
        return [toss.name for toss in task.tosses], [toss.name for toss in task.unseen]

    assert names() == ([str(i) for i in range(9)], [])
    assert names(split="train") == ([str(i) for i in range(3, 9)], ["0", "1", "2"])
    assert names(skip=1, tosses=6) == ([str(i) for i in range(1, 7)], [])
    task = prepare(dataset, settings=DiagnoseSettings(split="train", threads=1), name="mine.h5")
    assert task.tosses_of == "mine.h5, train split"


def test_a_copy_is_no_toss_of_its_own(dataset: Dataset) -> None:
    """One copy is of a toss that is searched, the other is an unseen one's, turned about the vertical."""
    turned = [_turned(dataset.tosses[i], 0.7, name) for i, name in ((4, "again"), (5, "unseen again"))]
    turned[1] = replace(turned[1], split="test")
    held = replace(dataset, tosses=(*dataset.tosses, *turned))
    task = prepare(held, settings=DiagnoseSettings(split="train", threads=1))
    alone = prepare(dataset, settings=DiagnoseSettings(split="train", threads=1))
    assert [toss.name for toss in task.tosses] == [toss.name for toss in alone.tosses]
    assert [toss.name for toss in task.unseen] == [toss.name for toss in alone.unseen]
    assert task.remarks[0].startswith(
        "Tosses left out: 1 of 8 are shorter than 11 frames, 1 of 8 are copies of others."
    )
    assert task.remarks[1] == "1 of 4 unseen tosses left out: they are copies of others."
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
    assert task.remarks[-1].startswith(said)
    assert not any("recordings" in remark for remark in prepare(dataset, settings=DiagnoseSettings(threads=1)).remarks)


def test_recordings_that_were_turned_are_said(cube: ObjectModel) -> None:
    thrown = thrown_along_x(cube, 45)

    def remarks(tracks: list[PoseTrack]) -> tuple[str, ...]:
        dataset = Dataset(cube, tuple(tosses_from_tracks(tracks, cube)), 148.0, "made", {})
        return prepare(dataset, settings=DiagnoseSettings(threads=1)).remarks

    (said,) = [remark for remark in remarks(as_published(thrown)) if "turned about the vertical" in remark]
    assert "resting faces lean by 0." in said
    assert "turned=undo" in said
    assert not any("turned" in remark for remark in remarks(thrown))


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
    slide = next(share.share.value for share in gap.gap.by_phase if share.name == "slide")
    assert slide > 0.3
    kept = gap.as_json()
    # two effects and three tests: 6 / 2^n < 0.05 from seven on
    assert (kept["tosses_needed"]["n_tosses"], kept["tosses_needed"]["for_a_name"]) == (5, 7)
    assert not kept["tosses_needed"]["enough"]
    assert "5 tosses are too few to name every effect, 7 are needed" in repr(gap)


def test_a_misspelt_name_is_corrected(dataset: Dataset) -> None:
    with pytest.raises(ConfigError, match=r"'fricton'.*friction"):
        diagnose(dataset, without=("fricton",))
    with pytest.raises(ConfigError, match="sed"):
        diagnose(dataset, sed=3)


def test_what_an_ended_search_says_is_kept_when_its_repeats_are_interrupted(
    dataset: Dataset, cube: ObjectModel, tmp_path: Path
) -> None:
    task = prepare(dataset, World(cube), settings=DiagnoseSettings(without=WITHOUT, threads=1, repeats=3))
    under_way = UnderWay()
    begin(Problem(task.tosses, World(cube), library=task.library, under_way=under_way))
    assert task.known_so_far(under_way).verdict == "incomplete"
    under_way.repeats = 3
    under_way.answered(replace(diagnosis(cube), stability=Stability((Repeat(("friction",), 0.9),))))
    known = task.known_so_far(under_way)
    assert (known.verdict, known.named) == ("explained", ("friction",))
    assert known.tosses_of == task.tosses_of
    assert "interrupted (1 of 3 repeats of the search made)" in sentences(known)[0]
    kept = json.loads((known.save(tmp_path / "gap") / "gap.json").read_text())
    assert kept["complete"] is False
    assert kept["interrupted"]["during"] == "1 of 3 repeats of the search made"
