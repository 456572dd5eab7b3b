from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from tossid.errors import ConfigError
from tossid.settings.changed import changed


@dataclass(frozen=True)
class Inner:
    gravity: float = 9.81
    rate: float = 1.0


@dataclass(frozen=True)
class Other:
    rate: float = 2.0


@dataclass(frozen=True)
class Outer:
    seed: int = 0
    model: Inner = field(default_factory=Inner)
    noise: Other = field(default_factory=Other)


def test_a_field_of_a_part_is_found_by_its_bare_name() -> None:
    before = Outer()
    after = changed(before, {"gravity": 0.0, "seed": 3})
    assert (after.model.gravity, after.seed, after.noise) == (0.0, 3, before.noise)
    assert before == Outer()


@pytest.mark.parametrize("key", ["model.rate", "model__rate"])
def test_the_part_can_be_said(key: str) -> None:
    after = changed(Outer(), {key: 5.0})
    assert (after.model.rate, after.noise.rate) == (5.0, 2.0)


def test_a_name_of_two_parts_is_refused_with_both() -> None:
    with pytest.raises(ConfigError, match=r"model\.rate.*noise\.rate"):
        changed(Outer(), {"rate": 5.0})


def test_an_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="gravity"):
        changed(Outer(), {"gravty": 5.0})
