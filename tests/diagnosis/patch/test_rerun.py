"""Whole tosses in MuJoCo: what the user's file and its patch do there, and what a person sees who runs them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, hypothesis
from tests.diagnosis.patch.test_make import USER
from tests.diagnosis.tossed import recorded
from tests.models.made import DT, thrown
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.rollouts import distances, first_states
from tossid.diagnosis.patch import rerun as module
from tossid.diagnosis.patch.make import make_patch
from tossid.diagnosis.patch.rerun import rerun, runs_in_mujoco
from tossid.diagnosis.simulators import read_simulator
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import toss_in_mujoco
from tossid.rotations import geodesic_angle
from tossid.types import Toss

FRAMES = 60


def sample_of(tosses: list[Toss], cube: ObjectModel) -> Sample:
    return Sample(make_windows(tosses, cube), len(tosses))


@pytest.fixture(scope="module")
def slippery(cube: ObjectModel) -> list[Toss]:
    """Tosses by MuJoCo's nearly rigid contact, of a cube with friction 0.4."""
    rng = np.random.default_rng(5)
    world = World(cube.with_changes(friction=0.4))
    run, _ = toss_in_mujoco(world, *thrown(rng, 6), FRAMES, DT, substeps=68)
    return recorded(run, cube, rng)


def errors_of(made: Hypothesis, tosses: list[Toss], path: Path | None = None) -> np.ndarray:
    runs = runs_in_mujoco(path)(made, tosses, sample_of(tosses, made.base.object))
    return distances(runs, [toss.q for toss in tosses], made.base.object.width)


def by_hand(m: mujoco.MjModel, toss: Toss, q: np.ndarray, v: np.ndarray, width: float) -> tuple[float, float]:
    """What a person computes: steps of the model's own, and between two of them a straight line."""
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:] = q, v
    far, turned, before = [], [], q.copy()
    for t, pose in zip(toss.t - toss.t[0], toss.q, strict=True):
        while d.time < t - 1e-9:
            before = d.qpos.copy()
            mujoco.mj_step(m, d)
        now = before + (d.qpos - before) * (1 - (d.time - t) / m.opt.timestep) if d.time > t else d.qpos.copy()
        far.append(np.linalg.norm(now[:3] - pose[:3]))
        turned.append(geodesic_angle(now[3:] / np.linalg.norm(now[3:]), pose[3:]))
    return 100 * float(np.mean(far)) / width, float(np.rad2deg(np.mean(turned)))


@pytest.mark.parametrize("found", [{}, {"friction": [0.4], "com_offset": [0.002, 0.0, -0.003]}])
@pytest.mark.parametrize("own", [True, False])
def test_errors_are_those_of_the_file_in_plain_mujoco(
    cube: ObjectModel, slippery: list[Toss], tmp_path: Path, found: dict[str, list[float]], own: bool
) -> None:
    path, out = tmp_path / "cube.xml", tmp_path / "patched.xml"
    path.write_text(USER)
    simulator, sample = read_simulator(path, cube), sample_of(slippery, cube)
    made = Hypothesis(simulator.world, simulator.law if own else simulator.laws[0])
    for name, values in found.items():
        made = made.plus(EFFECTS[name], np.array(values))
    errors = errors_of(made, slippery, path)
    patch = make_patch(made, mjcf=path)
    out.write_text(patch.mjcf)
    # nothing to change: the user's own file
    m = mujoco.MjModel.from_xml_path(str(out if patch.changes else path))
    q, v = first_states(slippery, made.world(), sample.windows)
    for i in (0, 3):
        # (contact amplifies rounding of the time at which a frame is)
        assert errors[i] == pytest.approx(by_hand(m, slippery[i], q[i], v[i], cube.width), rel=2e-3)


def test_the_right_patch_closes_the_gap_in_mujoco(cube: ObjectModel, slippery: list[Toss]) -> None:
    found = hypothesis(cube, friction=[0.4])
    run = rerun(found, Hypothesis(World(cube)), slippery, sample_of(slippery, cube))
    assert run["n_tosses"] == 6
    for key, least in (("position_error_pct", 1.0), ("rotation_error_deg", 0.8)):
        assert run[key]["after"]["value"] < least < run[key]["before"]["value"]


def test_a_recording_in_other_lengths_is_predicted_in_them(cube: ObjectModel, slippery: list[Toss]) -> None:
    longer = [replace(toss, q=toss.q * ([1.05] * 3 + [1] * 4), v=toss.v * ([1.05] * 3 + [1] * 3)) for toss in slippery]
    found = {"friction": [0.4]}
    plain = errors_of(hypothesis(cube, **found), slippery)
    scaled = errors_of(hypothesis(cube, **found, length_scale=[1.05]), longer)
    np.testing.assert_allclose(scaled, plain * [1.05, 1.0], atol=0.1)


def test_an_effect_that_mjcf_lacks_takes_no_part_and_is_named(cube: ObjectModel, slippery: list[Toss]) -> None:
    sample = sample_of(slippery, cube)
    found = hypothesis(cube, friction=[0.4], vortex=[2.0])
    run = rerun(found, Hypothesis(World(cube)), slippery, sample)
    assert run["not_in_it"] == ["vortex"]
    without = errors_of(hypothesis(cube, friction=[0.4]), slippery)
    np.testing.assert_array_equal(errors_of(found, slippery), without)


def test_of_many_tosses_some_are_run_and_counted(
    cube: ObjectModel, slippery: list[Toss], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_SECONDS", 2.5 * FRAMES * DT)
    sample = sample_of(slippery, cube)
    errors = errors_of(Hypothesis(World(cube)), slippery)
    assert np.isfinite(errors).all(1).sum() == 2
    assert rerun(hypothesis(cube, friction=[0.4]), Hypothesis(World(cube)), slippery, sample)["n_tosses"] == 2
