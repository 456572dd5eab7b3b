"""Tosses with effects: what is written moves as the effect says, and only the truth says which it was."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import tossid
from tossid.errors import ConfigError
from tossid.objects import corner_positions, load_object
from tossid.physics.effects import Effect, NotExpressible, Strength, effects_for
from tossid.settings.synthesis import LcpEngine, MujocoEngine, ReleaseSettings, SynthesizeSettings
from tossid.synthesis.tosses import make_tosses, world_of
from tossid.types import Phase

CUBE = load_object("cube")
SMALL = {"tosses": 3, "seconds": 0.6}
QUICK = ("com_offset", "wind", "compliance", "torsional_friction", "joint_damping")
"""Effects that are tried in MuJoCo, too, in the quick tests."""


def text_of(path: Path) -> str:
    """Every attribute of an HDF5 file."""
    found: list[str] = []
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.extend([name, *(f"{k}={v}" for k, v in item.attrs.items())]))
        found.extend(f"{k}={v}" for k, v in file.attrs.items())
    return "\n".join(found)


@pytest.mark.parametrize("engine", ["lcp", "mujoco"])
def test_only_the_truth_says_what_it_was(tmp_path: Path, engine: str) -> None:
    """Nor do phases: over ground 3 cm up the nominal simulator sees flight only."""
    effects = {"linear_drag": {"c_nspm": 0.217}, "com_offset": {"z_m": 0.013}, "ground_height": {"z_m": 0.03}}
    made = tossid.synthesize("cube", **SMALL, engine=engine, effects=effects, out=tmp_path / "o")
    tossid.synthesize("cube", **SMALL, engine=engine, out=tmp_path / "plain")
    truth = text_of(tmp_path / "o/truth.h5")
    assert all(word in truth for word in ("linear_drag", "c_nspm", "0.013"))
    seen, plain = text_of(tmp_path / "o/tosses.h5"), text_of(tmp_path / "plain/tosses.h5")
    assert not any(word in seen for word in ("linear_drag", "com_offset", "0.217", "0.013"))
    # the object is the nominal one, and nothing but the data's own length differs
    assert made.object.com[0].tolist() == [0.0, 0.0, 0.0]
    one, other = (
        [x for x in text.splitlines() if "tosses/" not in x and "n_frames" not in x] for text in (seen, plain)
    )
    assert one == other
    assert any((toss.phase != Phase.FLIGHT).any() for toss in made.truth.tosses)
    assert all((toss.phase == Phase.FLIGHT).all() for toss in made.tosses)


@pytest.mark.parametrize("engine", [LcpEngine(), MujocoEngine()], ids=lambda engine: engine.name)
def test_the_motion_written_is_the_recorded_one(engine: Any) -> None:
    """Flight in a recording of wrong scale, clock and tilt, under a gravity of its own, with a wrong ground."""
    effects = {
        "length_scale": {"scale_rel": 1.1}, "time_base": {"rate_rel": 0.9}, "gravity": {"g_ms2": 8.0},
        "ground_height": {"z_m": 0.04}, "world_tilt": {"x_rad": 0.1},
    }  # fmt: skip
    release = ReleaseSettings(height=(0.3, 0.4))
    settings = SynthesizeSettings(engine=engine, tosses=6, seconds=0.8, release=release, effects=effects)
    tosses, _ = make_tosses(settings, CUBE, np.random.default_rng(0))
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
        corners = corner_positions(CUBE.with_changes(corner_pos=1.1 * CUBE.corner_pos), toss.q) @ up
        assert corners.min() == pytest.approx(0.044, abs=5e-4)


def strong(effect: Effect) -> dict[str, float]:
    """Values at which an effect shows."""
    if not isinstance(effect.strength, Strength):  # too small for an audit
        return {"delay_s": 0.01}
    return effect.strength.values(effect.strength.high, np.full(8, 0.7))


def tossed(effect: Effect, engine: str, effects: Mapping[str, Mapping[str, float]]) -> np.ndarray:
    """Configurations of two tosses from near the ground, of the elbow for effects of joints."""
    settings = SynthesizeSettings(
        tosses=2,
        seconds=0.7,
        release=ReleaseSettings(height=(0.05, 0.1), spin=(6.0, 8.0)),
        effects=effects,
        engine=LcpEngine(substeps=4) if engine == "lcp" else MujocoEngine(),
    )
    made, _ = make_tosses(
        settings, load_object("elbow") if effect.needs_joints else CUBE, np.random.default_rng(1)
    )  # fmt: skip
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
    ("effects", "says"),
    [
        ({"frictoin": {"mu": 0.5}}, "effects.frictoin: there is no such effect.*'friction'"),
        ({"friction": {"muu": 0.5}}, "effects.friction.muu: is no parameter of friction, which has mu.*'mu'"),
        ({"friction": {"mu": -1.0}}, "effects.friction.mu: -1 is out of range"),
        ({"joint_damping": {}}, "effects.joint_damping: 'cube' has no joints"),
        ({"adhesion": {"force_n": 0.3}}, "engine=mujoco cannot express it; engine=lcp can"),
    ],
)
def test_an_effect_that_cannot_be_is_said(effects: dict[str, dict[str, float]], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        world_of(SynthesizeSettings(engine=MujocoEngine(), effects=effects), CUBE)
