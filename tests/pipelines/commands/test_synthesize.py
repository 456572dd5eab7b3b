"""`tossid synthesize effects={…}`: what is written moves as the effect says, and only the truth says which it was."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pipelines.cli import app
from pipelines.config.compose import load
from pipelines.config.schemas import SynthesizeConfig
from tests.pipelines.conftest import one_line
from tossid.errors import ConfigError
from tossid.objects import corner_positions, load_object
from tossid.physics.effects import Effect, NotExpressible, Strength, effects_for
from tossid.settings.synthesis import LcpEngine, MujocoEngine, ReleaseSettings, SynthesizeSettings
from tossid.store import file_sha256, read_dataset
from tossid.synthesis.tosses import make_tosses
from tossid.types import Phase

BARE = ["synthesize", "frames=false", "tosses=3", "seconds=0.6"]


def config_of(*keys: str) -> SynthesizeConfig:
    return load("synthesize", SynthesizeConfig, keys)


def text_of(path: Path) -> str:
    """Every attribute of an HDF5 file."""
    found: list[str] = []
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.extend([name, *(f"{k}={v}" for k, v in item.attrs.items())]))
        found.extend(f"{k}={v}" for k, v in file.attrs.items())
    return "\n".join(found)


@pytest.mark.parametrize("engine", ["lcp", "mujoco"])
def test_only_the_truth_says_what_it_was(project: Path, answer: Any, engine: str) -> None:
    answer(*BARE, f"engine={engine}", "effects={linear_drag: {c_nspm: 0.217}, com_offset: {z_m: 0.013}}", "out=o")
    answer(*BARE, f"engine={engine}", "out=plain")
    truth = text_of(project / "o/truth.h5")
    assert all(word in truth for word in ("linear_drag", "c_nspm", "0.013"))
    seen, plain = text_of(project / "o/tosses.h5"), text_of(project / "plain/tosses.h5")
    assert not any(word in seen for word in ("linear_drag", "com_offset", "0.217", "0.013"))
    # the object is the nominal one, and nothing but the data's own length differs
    assert read_dataset(project / "o/tosses.h5").object.com[0].tolist() == [0.0, 0.0, 0.0]
    keep = lambda text: [line for line in text.splitlines() if "tosses/" not in line and "n_frames" not in line]  # noqa: E731
    assert keep(seen) == keep(plain)


@pytest.mark.parametrize("engine", ["lcp", "mujoco"])
def test_the_motion_written_is_the_recorded_one(engine: str) -> None:
    """Flight in a recording of wrong scale, clock and tilt, under a gravity of its own, with a wrong ground."""
    model = load_object("cube")
    config = config_of(
        f"engine={engine}",
        "tosses=6",
        "seconds=0.8",
        "release.height=[0.3,0.4]",
        "effects={length_scale: {scale_rel: 1.1}, time_base: {rate_rel: 0.9}, gravity: {g_ms2: 8.0}, "
        "ground_height: {z_m: 0.04}, world_tilt: {x_rad: 0.1}}",
    )
    tosses, _ = make_tosses(config, model, np.random.default_rng(0))
    for toss in tosses:
        flight = np.flatnonzero(toss.phase == Phase.FLIGHT)
        flight = flight[: np.argmax(np.diff(flight, append=10**6) > 1) + 1][:-2]
        assert len(flight) > 8
        fall = 8.0 * 1.1 / 0.9**2
        rate = np.polyfit(toss.t[flight], toss.v[flight, :3], 1)[0]
        np.testing.assert_allclose(rate, [0, fall * np.sin(0.1), -fall * np.cos(0.1)], atol=2e-3 * fall)
        poses = np.polyfit(toss.t[flight], toss.q[flight, :3], 2)[0] * 2
        np.testing.assert_allclose(poses, rate, atol=0.02 * fall)
        # at the end it lies on a plane 44 mm up, tilted by 0.1
        up = np.array([0, -np.sin(0.1), np.cos(0.1)])
        corners = corner_positions(model.with_changes(corner_pos=1.1 * model.corner_pos), toss.q) @ up
        assert corners.min() == pytest.approx(0.044, abs=5e-4)


def test_phases_in_the_dataset_are_those_of_the_nominal_object(project: Path, answer: Any) -> None:
    """Over ground 3 cm up the nominal simulator sees flight only; the truth knows the contact."""
    answer(*BARE, "engine=lcp", "effects={ground_height: {z_m: 0.03}}", "out=o")
    true, seen = (
        np.concatenate([toss.phase for toss in read_dataset(project / f"o/{name}.h5").tosses])
        for name in ("truth", "tosses")
    )
    assert (true != Phase.FLIGHT).any()
    assert (seen == Phase.FLIGHT).all()


def test_no_effects_are_the_plain_engine(project: Path, answer: Any) -> None:
    answer(*BARE, "engine=lcp", "out=a")
    answer(*BARE, "engine=lcp", "effects={gravity: {g_ms2: 9.81}, restitution: {e: 0}, magnus: {}}", "out=b")
    for one, two in zip(
        read_dataset(project / "a/truth.h5").tosses, read_dataset(project / "b/truth.h5").tosses, strict=True
    ):
        np.testing.assert_array_equal(one.q, two.q)


QUICK = ("com_offset", "wind", "compliance", "torsional_friction", "joint_damping")
"""Effects that are tried in MuJoCo, too, in the quick tests."""


def strong(effect: Effect) -> dict[str, float]:
    """Values at which an effect shows."""
    if not isinstance(effect.strength, Strength):  # too small for an audit
        return {"delay_s": 0.01}
    return effect.strength.values(effect.strength.high, np.full(8, 0.7))


def tossed(effect: Effect, engine: str, effects: Mapping[str, Mapping[str, float]]) -> np.ndarray:
    """Configurations of two tosses from near the ground, of the elbow for effects of joints."""
    name, ours = "elbow" if effect.needs_joints else "cube", engine == "lcp"
    release = ReleaseSettings(height=(0.05, 0.1), spin=(6.0, 8.0))
    settings = SynthesizeSettings(
        tosses=2,
        seconds=0.7,
        release=release,
        effects=effects,
        engine=LcpEngine(substeps=4) if ours else MujocoEngine(),
    )
    made, _ = make_tosses(settings, load_object(name), np.random.default_rng(1))
    return np.concatenate([toss.q[:40] for toss in made])


@pytest.mark.parametrize(
    ("effect", "engine"),
    [
        pytest.param(effect, engine, marks=[pytest.mark.slow] * (engine == "mujoco" and effect.name not in QUICK))
        for effect in effects_for(load_object("elbow"))
        for engine in ("lcp", "mujoco")
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_every_effect_moves_the_object_or_is_refused(effect: Effect, engine: str) -> None:
    values = {effect.name: strong(effect)}
    if engine == "mujoco" and isinstance(effect.mujoco, NotExpressible):
        with pytest.raises(ConfigError, match=rf"effects\.{effect.name}: engine=mujoco cannot express it; engine=lcp"):
            tossed(effect, engine, values)
    else:
        moved, plain = tossed(effect, engine, values), tossed(effect, engine, {})
        assert np.abs(moved - plain).max() > 1e-3


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("effects={com_ofset: {z_m: 0.01}}", r"effects\.com_ofset: .*Did you mean 'com_offset'"),
        ("effects={com_offset: {zm: 0.01}}", r"effects\.com_offset\.zm: .*Did you mean 'z_m'"),
        ("effects={com_offset: {z_m: 1}}", r"effects\.com_offset\.z_m: .*-0\.04 to 0\.04"),
        ("effects={com_offset: 3}", r"effects\.com_offset: "),
        ("effects={com_offset: {z_m: low}}", r"effects\.com_offset\.z_m: "),
        ("effects={joint_damping: {c_nms: 0.01}} object=cube", r"effects\.joint_damping: 'cube' has no joints"),
        ("effects={joint_dampng: {c_nms: 0.01}} object=elbow", r"effects\.joint_dampng: .*'joint_damping'"),
    ],
)
def test_what_is_no_effect_is_refused(project: Path, capfd: pytest.CaptureFixture[str], key: str, says: str) -> None:
    first, _, rest = key.partition("}} ")
    keys = [first + "}}", *rest.split()] if rest else [key]
    assert app.run([*BARE, *keys, "out=o"]) == 2
    assert re.search(says, one_line(capfd.readouterr().err))
    assert not (project / "o").exists()


@pytest.mark.parametrize("engine", ["lcp", "mujoco"])
def test_synthesize_states(project: Path, answer: Any, engine: str) -> None:
    keys = ["synthesize", "frames=false", f"engine={engine}", "tosses=6", "seed=3"]
    made = answer(*keys, "out=one")
    truth = read_dataset(project / "one" / "truth.h5")
    assert made["n_tosses"] == len(truth.tosses) == 6
    assert made["truth_sha256"] == file_sha256(project / "one" / "truth.h5")
    for toss in truth.tosses:
        flight = toss.phase == Phase.FLIGHT
        dt = np.diff(toss.t)[0]
        falls = np.flatnonzero(flight[1:-1] & flight[:-2] & flight[2:])[:5] + 1
        accelerations = (toss.v[falls + 1, 2] - toss.v[falls - 1, 2]) / (2 * dt)
        np.testing.assert_allclose(accelerations, -9.81, rtol=1e-3)
        assert corner_positions(truth.object, toss.q)[..., 2].min() > -2e-3
    splits = [toss.split for toss in read_dataset(project / "one" / "tosses.h5").tosses]
    assert set(splits) == {"train", "validation", "test"}
    again = answer(*keys, "out=two")
    assert again["truth_sha256"] == made["truth_sha256"]
    other = answer(*keys[:-1], "seed=4", "out=three")
    assert other["truth_sha256"] != made["truth_sha256"]


def test_frames_need_tags(project: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert app.run(["synthesize", "object.tags=null", "tosses=1"]) == 2
    assert "object.tags: 'cube' has no tags" in one_line(capfd.readouterr().err)
    assert list(project.iterdir()) == []


def test_synthesize_never_replaces_a_strangers_folder(project: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (project / "mine").mkdir()
    (project / "mine" / "thesis.tex").write_text("years of work")
    assert app.run(["synthesize", "frames=false", "tosses=3", "out=mine"]) == 2
    assert "mine: holds files" in one_line(capfd.readouterr().err)
    assert (project / "mine" / "thesis.tex").read_text() == "years of work"
