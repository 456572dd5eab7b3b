"""A user's simulator is judged itself: of tosses that one changed parameter of it made, that parameter is named."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.diagnosis.tossed import recorded
from tests.models.made import DT, thrown
from tossid.diagnosis.diagnose import diagnose, prepare
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import Dataset

KEPT = ("friction", "gravity", "restitution")
WITHOUT = tuple(effect.name for effect in LIBRARY if effect.name not in KEPT)


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
    found = diagnose(dataset, engine, without=WITHOUT, threads=1, repeats=0)
    assert found.named[:1] == ("gravity",)
    assert not {"friction", "restitution"} & {f.name for f in found.found}
    assert found.contact == "own"
    g = found.findings[0].parameters["g_ms2"]
    assert g.value == pytest.approx(9.2, abs=0.03)
    assert found.simulator is not None
    assert found.simulator.kind == "python"


def test_the_engine_itself_has_no_gap_to_its_own_tosses(engine: Callable[..., Any], cube: ObjectModel) -> None:
    found = diagnose(made_by(engine, cube, 7, seed=6), engine, without=WITHOUT, threads=1, repeats=0)
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
    with pytest.raises(InputError, match=r"'nominal', a trained model, .* or a function"):
        prepare(dataset, 3.0)

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
