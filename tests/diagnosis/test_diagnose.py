"""From tosses and a simulator to a diagnosis: what it names, says, keeps and refuses, without a command line."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import recorded, seen, with_effect
from tests.models.made import DT, thrown
from tests.physics.effects.toy import registered
from tossid.diagnosis.conclude import explain, known_so_far, report_gap
from tossid.diagnosis.diagnose import MOST, diagnose, prepare, searched
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.result import Diagnosis
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

BUT_CONTACT = tuple(effect.name for effect in LIBRARY if effect.name not in (*KEPT, "restitution"))


@pytest.fixture(scope="module")
def dataset(cube: ObjectModel) -> Dataset:
    """Ten tosses with friction 0.3, where 0.18 is stated; three are of the test split, one is too short."""
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 10, seed=3)
    tosses[-1] = tosses[-1].frames(slice(5))
    splits = ["test"] * 3 + ["train"] * 7
    tosses = [replace(toss, split=split) for toss, split in zip(tosses, splits, strict=True)]
    return Dataset(cube, tuple(tosses), 148.0, "made", {})


def test_friction_is_found_judged_and_its_report_saved(cube: ObjectModel, tmp_path: Path) -> None:
    """And what is known when the search is repeated, which an interruption would leave."""
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 15, seed=3, frames=70)
    tosses[0] = tosses[0].frames(slice(5))
    tosses = [replace(toss, split="test" if i > 12 else "train") for i, toss in enumerate(tosses)]
    dataset = Dataset(cube, tuple(tosses), 148.0, "made", {})
    reported, news, known = list[float](), list[str](), list[Diagnosis]()
    settings = DiagnoseSettings(without=WITHOUT, threads=1, split="train", repeats=2)
    task = prepare(dataset, World(cube), settings=settings)

    def progress(what: str, share: float) -> None:
        reported.append(share)
        if what.startswith("the search repeated") and not known:
            known.append(task.known_so_far(under_way))

    under_way = UnderWay(progress, news.append)
    gap = task.run(under_way)
    assert gap.verdict == "explained"
    assert gap.named == ("friction",)
    found = gap.findings[0]
    assert (found.verdict, found.frequency, gap.draws) == ("identified", 1.0, 400)
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
    assert gap.unseen.n_tosses == 2
    assert gap.unseen.gap_closed.value > 0.5
    assert gap.gap.by_phase["slide"].value > 0.4
    assert gap.remarks[0] == "Tosses left out: 1 of 13 are shorter than 11 frames."
    assert gap.patch["keys"]["object.friction"]["before"] == cube.friction
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
    (early,) = known
    assert (early.verdict, early.named, early.candidates) == ("incomplete", (), ("friction",))
    assert "next suspect: friction" in news
    assert any(line.startswith("found so far: friction (mu 0.") for line in news)
    assert early.left.total.value < 0.7 * early.gap.total.value
    before, after = early.brings.position_pct()
    assert after.value < 0.5 * before.value
    kept = json.loads((early.save(tmp_path / "early") / "gap.json").read_text())
    assert (kept["complete"], kept["brings"]["took_no_part"]) == (False, False)
    assert kept["interrupted"]["during"].startswith("the search repeated")
    assert (kept["change"][0]["name"], kept["change"][0]["from"]) == ("friction", pytest.approx(0.18))


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


def test_recordings_that_were_joined_are_said(dataset: Dataset) -> None:
    def remarks(made: Dataset) -> tuple[str, ...]:
        return prepare(made, settings=DiagnoseSettings(threads=1)).about["remarks"]

    names, n = dataset.names, len(dataset)
    worlds = (
        Session(names[0], names[3], 4, (0.04, 0.0), (0.002, 0.002)),
        Session(names[4], names[-1], n - 4, (0.0, 0.0), (0.002, 0.002)),
    )
    turn, session_of = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), (np.arange(n) >= 4).astype(np.int64)
    none = np.zeros((n, 0)), np.zeros((n, 2)), turn, np.zeros(n)
    joined = replace(dataset, order=RecordingOrder(worlds, "names", names, (), *none, session_of))
    said = f"Two recordings: tosses {names[0]} to {names[3]} stand in a world tilted by 2.29°"
    assert remarks(joined)[-1].startswith(said)
    assert not any("recordings" in remark for remark in remarks(dataset))


@pytest.mark.parametrize(
    ("keys", "says"),
    [({"sed": 3}, "sed"), ({"simulator": 3.0}, r"'nominal', a trained model, .* or a function")],
)
def test_what_python_alone_can_ask_is_refused(dataset: Dataset, keys: dict[str, Any], says: str) -> None:
    """`tests/pipelines/test_refusals.py` has what files and keys can."""
    with pytest.raises((InputError, ConfigError), match=says):
        diagnose(dataset, threads=1, **keys)


def test_too_few_for_a_name_have_a_gap_and_say_how_many_a_name_needs(dataset: Dataset, cube: ObjectModel) -> None:
    gap = diagnose(dataset, World(cube), without=WITHOUT, threads=1, tosses=5, repeats=0)
    assert (gap.named, gap.verdict) == ((), "unexplained")
    assert gap.gap.by_phase["slide"].value > 0.3
    assert any("5 tosses are too few" in remark and "twelve" in remark for remark in gap.remarks)
    # nothing was repeated, and nothing is said of how sure it is
    assert (gap.folds, gap.draws, gap.probability_none, gap.brings.unseen) == (0, 0, None, False)


# ---------------------------------------------------------------- what is concluded


COUNT = 12

HEAVIER = 10.3
"""Of gravity [m/s²]."""


def concluded(cube: ObjectModel, truth: World, names: tuple[str, ...], *, repeats: int = 2) -> Diagnosis:
    tosses = seen(truth, cube, COUNT, seed=5, frames=70)
    library = tuple(EFFECTS[name] for name in names)
    settings = DiagnoseSettings(repeats=repeats)
    return explain(Problem(tosses, Hypothesis(World(cube)), library=library, settings=settings))[0]


@pytest.fixture(scope="module")
def heavier(cube: ObjectModel) -> Diagnosis:
    """Of tosses in another gravity, which a clock explains as well."""
    return concluded(cube, with_effect(cube, "gravity", [HEAVIER]), ("gravity", "time_base", "friction"))


def test_what_does_the_same_is_confusable_and_named_as_a_class(heavier: Diagnosis) -> None:
    (found,) = heavier.found
    (other,) = found.confusable_with
    assert {found.name, other} == {"gravity", "time_base"}
    assert found.verdict == "confusable"
    assert found.frequency == pytest.approx(1.0, abs=0.02)
    instead = heavier.finding(other)
    assert instead.verdict == "confusable"
    assert instead.confusable_with == (found.name,)
    gravity, clock = (heavier.finding(name) for name in ("gravity", "time_base"))
    assert gravity.parameters["g_ms2"].low < HEAVIER < gravity.parameters["g_ms2"].high
    assert clock.parameters["rate_rel"].value == pytest.approx(np.sqrt(9.81 / HEAVIER), abs=2e-3)
    (alternative,) = heavier.alternatives
    assert alternative.names == (other,)
    # the rest of the library would have been seen
    friction = heavier.finding("friction")
    assert friction.verdict == "not_supported"
    assert 0 < friction.detectable["mu"] < 0.05
    assert (heavier.verdict, heavier.gap_closed.value > 0.5) == ("explained", True)


def test_what_the_library_lacks_leaves_a_gap_without_a_name(cube: ObjectModel) -> None:
    """A bounce that neither gravity nor friction explains."""
    left = concluded(cube, with_effect(cube, "restitution", [0.4]), ("gravity",), repeats=0)
    assert left.verdict == "unexplained"
    assert left.named == ()
    assert left.gap.after_impacts.value > 0.5
    assert left.unexplained.keys() & {"impact", "flight", "slide", "roll", "rest"}


def test_before_anything_joined_the_gap_is_known_and_news_are_said_once(cube: ObjectModel) -> None:
    news: list[str] = []
    under_way = UnderWay(news=news.append)
    tosses = seen(with_effect(cube, "friction", [0.3]), cube, 6, seed=1, frames=70)
    report_gap(Problem(tosses, Hypothesis(World(cube)), under_way=under_way))
    early = known_so_far(under_way)
    assert (early.verdict, early.findings, early.as_json()["complete"]) == ("incomplete", (), False)
    assert 0.0 < early.seconds < 600.0
    assert early.gap.total.low > 1.5
    assert "standard deviations" in news[0]
    assert "takes about" in news[1]
    under_way.suspects = (("gravity", 3.0),)
    assert known_so_far(under_way).as_json()["interrupted"]["suspects"] == [{"name": "gravity", "gain": 3.0}]
    for _ in range(2):
        under_way.say("the same")
    assert news.count("the same") == 1


# ---------------------------------------------------------------- a simulator of the user's


@pytest.fixture(scope="module")
def engine() -> Callable[..., Any]:
    """A cube in MuJoCo with its default soft contact, which tossid does not have."""
    simulate: Callable[..., Any] = runpy.run_path(str(ROOT / "examples" / "diagnose_mujoco.py"))["simulate"]
    return simulate


def made_by(simulate: Callable[..., Any], cube: ObjectModel, count: int, *, seed: int, **changed: float) -> Dataset:
    rng = np.random.default_rng(seed)
    run, _ = simulate(*thrown(rng, count), 60, DT, **changed)
    return Dataset(cube, tuple(recorded(run, cube, rng)), 148.0, "made", {})


@pytest.mark.slow
def test_one_changed_parameter_is_named(engine: Callable[..., Any], cube: ObjectModel) -> None:
    dataset = made_by(engine, cube, 10, seed=5, gravity=9.2)
    found = diagnose(dataset, engine, without=BUT_CONTACT, threads=1, repeats=0)
    assert found.named[:1] == ("gravity",)
    assert not {"friction", "restitution"} & {f.name for f in found.found}
    assert found.contact == "own"
    g = found.findings[0].parameters["g_ms2"]
    assert g.value == pytest.approx(9.2, abs=0.03)
    assert found.simulator.kind == "python"


def test_the_engine_itself_has_no_gap_to_its_own_tosses(engine: Callable[..., Any], cube: ObjectModel) -> None:
    found = diagnose(made_by(engine, cube, 5, seed=6), engine, without=BUT_CONTACT, threads=1, repeats=0)
    assert found.named == ()
    assert found.verdict == "no_gap"
    assert found.gap.total.value < 1.25


def test_a_simulator_that_fails_is_refused_before_the_search(engine: Callable[..., Any], cube: ObjectModel) -> None:
    dataset = made_by(engine, cube, 4, seed=7)

    def broken(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> Any:
        q, v = engine(q0, v0, n_steps, dt)
        return q * np.nan, v

    with pytest.raises(InputError, match=r"the simulator .*broken: returns q that is not finite in 4 of 4 motions"):
        prepare(dataset, broken, settings=DiagnoseSettings(threads=1))

    def coarse(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> Any:
        steps = int(dt / 0.01)  # of its own, of which a frame holds none
        q = [q0 + np.pad(v0[:, :3] * k * steps * 0.01, ((0, 0), (0, 4))) for k in range(n_steps + 1)]
        return np.stack(q, axis=1), np.repeat(v0[:, None], n_steps + 1, axis=1)

    with pytest.raises(InputError, match=r"coarse: in one frame of dt = 0\.00676 s it moves the object 0 times as far"):
        prepare(dataset, coarse, settings=DiagnoseSettings(threads=1))
    # a partial function serves too
    assert prepare(dataset, partial(engine, mu=0.2)).simulator.about.startswith("the simulator")


def test_a_simulator_that_does_not_go_on_from_a_state_is_told_of(engine: Callable[..., Any], cube: ObjectModel) -> None:
    dataset = made_by(engine, cube, 4, seed=8)

    def other_velocities(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> Any:
        q, _ = engine(q0, v0, n_steps, dt)
        return q, np.repeat(v0[:, None], n_steps + 1, axis=1)

    said = [
        remark
        for remark in prepare(dataset, other_velocities).about["remarks"]
        if "does not go on from a state" in remark
    ]
    assert len(said) == 1
    assert not any("does not go on" in remark for remark in prepare(dataset, engine).about["remarks"])


@pytest.mark.slow
def test_a_registered_effect_is_named(cube: ObjectModel) -> None:
    with registered() as effect:
        true = effect.at(World(cube), np.array([2.0]))
        dataset = Dataset(cube, tuple(seen(true, cube, 10, seed=5)), 148.0, "made", {})
        without = tuple(other.name for other in LIBRARY if other.name not in (*KEPT, "uniform_force"))
        gap = diagnose(dataset, World(cube), without=without, threads=1, repeats=0)
    assert gap.named == ("height_pull",)
    found = next(finding for finding in gap.findings if finding.name == "height_pull").parameters["k_npm"]
    assert found.low - 0.05 < 2.0 < found.high + 0.05
    assert gap.patch["keys"]["forces.HeightPull.k_npm"]["before"] is None
    assert gap.patch["not_expressed"] == {"height_pull": "MJCF has no force that depends on height"}
