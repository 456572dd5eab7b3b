"""Settings as plain values, and back."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from tossid.settings.plain import from_plain, to_plain
from tossid.settings.training import RolloutSettings, TrainSettings


def test_what_was_plain_comes_back() -> None:
    own = TrainSettings(seed=3, tosses=5, rollouts=RolloutSettings(huber=0.2, dampings=(0.1, 1.0)))
    plain = json.loads(json.dumps(to_plain(own)))
    assert from_plain(TrainSettings(), plain) == own


def test_what_an_older_file_lacks_is_the_default() -> None:
    assert from_plain(TrainSettings(), {"seed": 2, "rollouts": {"trials": 3}}) == replace(
        TrainSettings(), seed=2, rollouts=RolloutSettings(trials=3)
    )


def test_a_value_of_no_field_is_refused() -> None:
    with pytest.raises(TypeError, match="speed"):
        from_plain(TrainSettings(), {"speed": 1.0})
