"""Synthetic tosses: releases, the cut at rest, noise, and what an engine does not have."""

from __future__ import annotations

import numpy as np
import pytest

from tossid import synthesize
from tossid.objects import corner_positions, load_object
from tossid.rotations import quat_boxminus
from tossid.settings.synthesis import NoiseSettings, ReleaseSettings, SynthesizeSettings
from tossid.synthesis.tosses import draw_releases, frames_until_rest

CUBE = load_object("cube")


def test_releases_are_what_the_settings_say() -> None:
    release = ReleaseSettings(height=(0.2, 0.25), speed=(0.5, 0.6), spin=(3, 4), landing=0.1)
    q, v = draw_releases(CUBE, release, 400, gravity=9.81, rng=np.random.default_rng(1))
    lowest = corner_positions(CUBE, q)[..., 2].min(axis=1)
    assert 0.2 <= lowest.min() < 0.205
    assert 0.245 < lowest.max() <= 0.25
    speed, spin = np.linalg.norm(v[:, :2], axis=1), np.linalg.norm(v[:, 3:6], axis=1)
    assert 0.5 <= speed.min() <= speed.max() <= 0.6
    assert 3 <= spin.min() <= spin.max() <= 4
    fall = (v[:, 2] + np.sqrt(v[:, 2] ** 2 + 2 * 9.81 * lowest)) / 9.81
    assert np.linalg.norm(q[:, :2] + v[:, :2] * fall[:, None], axis=1).max() <= 0.1
    heading = v[:, :2] / speed[:, None]
    assert np.linalg.norm(heading.mean(axis=0)) < 0.15  # no direction is preferred
    assert np.linalg.norm(q[:, 3:7].mean(axis=0)) < 0.15


def test_a_motion_is_cut_where_it_rests() -> None:
    n, settings = 100, SynthesizeSettings(rate_hz=100.0, rest_s=0.1)
    q = np.tile([0.0, 0.0, 0.0524, 1.0, 0.0, 0.0, 0.0], (n, 1))
    q[:40, 0] = np.linspace(-0.4, 0.0, 40)
    assert frames_until_rest(CUBE, q, settings) == 40 + 10
    assert frames_until_rest(CUBE, q[:45], settings) == 45


def test_noise_is_as_stated_and_the_truth_is_what_it_was_added_to() -> None:
    noise = NoiseSettings(position=1e-3, rotation=2e-2, velocity=0.05, spin=0.3)
    dataset = synthesize("cube", engine="lcp", tosses=20, seconds=0.5, noise=noise)
    assert {toss.split for toss in dataset.tosses} == {"train", "validation", "test"}
    pairs = list(zip(dataset.tosses, dataset.truth.tosses, strict=True))
    turn = np.concatenate([quat_boxminus(m.q[:, 3:7], t.q[:, 3:7]) for m, t in pairs])
    place, speed = (np.concatenate([getattr(m, x) - getattr(t, x) for m, t in pairs]) for x in ("q", "v"))
    for found, sigma in ((place[:, :3], 1e-3), (turn, 2e-2), (speed[:, :3], 0.05), (speed[:, 3:], 0.3)):
        assert found.std() == pytest.approx(sigma, rel=0.05)
    measured = dataset.tosses[0]
    assert np.sqrt([measured.q_cov[0, 4, 4], measured.v_cov[0, 0, 0]]) == pytest.approx([2e-2, 0.05])
