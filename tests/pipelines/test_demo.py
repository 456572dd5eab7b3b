"""The demo seals what is wrong, and measures poses against the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipelines.demo import KINDS, Sealed, opened, pose_errors
from tests.models.made import tosses
from tossid.objects import ObjectModel
from tossid.store import Dataset


def test_frames_are_compared_with_the_toss_of_the_same_time(cube: ObjectModel) -> None:
    first, second = tosses(cube, 2, seed=1, frames=20)
    second = replace(second, t=second.t + 1.0)
    truth = Dataset(cube, (first, second), 148.0, "made")
    q = second.q[5:15].copy()
    q[:, 0] += 1e-3
    part = replace(
        second, t=second.t[5:15], q=q, v=second.v[5:15], q_cov=second.q_cov[5:15], v_cov=second.v_cov[5:15],
        phase=second.phase[5:15],
    )  # fmt: skip
    distance, angle = pose_errors(truth, Dataset(cube, (part,), 148.0, "seen"))
    assert len(distance) == 10
    assert distance == pytest.approx(np.ones(10))
    assert angle == pytest.approx(np.zeros(10), abs=1e-6)


def test_what_is_sealed_is_drawn_from_all_kinds_and_cannot_be_guessed_from_its_hash() -> None:
    drawn = [Sealed.drawn(seed) for seed in range(200)]
    assert {each.effect for each in drawn} == set(KINDS)
    for each in drawn:
        parameter, ranges = KINDS[each.effect]
        assert each.parameter == parameter
        assert any(low <= each.value <= high for low, high in ranges)
    assert len({each.sha256 for each in drawn}) == 200
    assert Sealed.drawn(7) == Sealed.drawn(7)
    known = replace(drawn[0], salt="another")
    assert known.sha256 != drawn[0].sha256


def test_the_seal_stands_beside_what_was_found() -> None:
    sealed = Sealed("friction", "mu", 0.31, "salt")
    mu = {"value": 0.3098, "ci95": [0.308, 0.312]}
    friction = {"name": "friction", "verdict": "identified", "stated": {"mu": 0.18}, "parameters": {"mu": mu}}
    gap = {"effects": [friction], "explanation": {"effects": ["friction"]}}
    assert opened(sealed, gap) == ["friction mu", "0.18", "0.31", "0.3098 (0.308 to 0.312), identified"]
    inertia = replace(sealed, effect="inertia", parameter="scale_rel", value=1.3)
    assert opened(inertia, gap)[-1] == "not found; friction instead"
