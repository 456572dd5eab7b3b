"""Values become what a setting asks for, or are refused in words; settings as plain values, and back."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest

from tossid.errors import ConfigError, InputError
from tossid.settings.changed import changed
from tossid.settings.kinds import (
    ADVANCED,
    Bounds,
    Count,
    Except,
    Positive,
    Range,
    convert,
    describe,
    from_plain,
    to_plain,
)
from tossid.settings.objects import PRESETS, ObjectSettings, UnknownObjectSettings
from tossid.settings.rendering import RenderSettings
from tossid.settings.synthesis import SynthesizeSettings
from tossid.settings.tracking import StreamSettings, TrackSettings
from tossid.settings.training import ModelSettings, TrainSettings

OBJECT = ObjectSettings | UnknownObjectSettings


@pytest.mark.parametrize(
    ("hint", "value", "expected"),
    [
        (float, 3, 3.0),
        (int, np.int64(3), 3),
        (tuple[float, ...], np.arange(2), (0.0, 1.0)),
        (tuple[float, int], [1, 2], (1.0, 2)),
        (tuple[int, ...], range(2), (0, 1)),
        (str, 3, "3"),
        (Path, "a" * 255, Path("a" * 255)),
        pytest.param(float, 10**300, 1e300, id="large"),
        (Count | None, None, None),
        (dict[str, float], {"a": 1}, {"a": 1.0}),
        (tuple[Literal["effect", "null"], ...], ["effect", None], ("effect", "null")),
        (OBJECT, {"name": "unknown", "mass": 2}, UnknownObjectSettings(mass=2.0)),
        (OBJECT, {"name": "x", "path": "x.xml"}, ObjectSettings("x", Path("x.xml"))),
        (OBJECT, PRESETS["cube"], PRESETS["cube"]),
    ],
)
def test_what_a_value_becomes(hint: Any, value: Any, expected: Any) -> None:
    found = convert(hint, value, key="x")
    assert (found, type(found)) == (expected, type(expected))


@pytest.mark.parametrize(
    ("hint", "value", "says"),
    [
        (int, 2.5, "x: 2.5 will not do; expected a whole number"),
        (Count, "5", "x: '5' will not do; expected a whole number"),
        (int, True, "x: True will not do"),
        (bool, 1, "x: 1 will not do; expected true or false"),
        (Count, 0, "x: 0 is out of range; expected a whole number of at least 1"),
        (Positive | None, -1, "x: -1 is out of range; expected a number above 0"),
        (float, float("nan"), "x: nan will not do"),
        pytest.param(float, 1 << 20_000, "x: .* will not do", id="long float"),
        pytest.param(str, 1 << 20_000, "x: .* will not do", id="long text"),
        (Literal["cone", "pyramid"], "con", r"expected one of cone, pyramid\. Did you mean 'cone'"),
        (Literal["a", "b"], None, "None will not do; expected one of a, b"),
        (tuple[str, str], "ab", "x: 'ab' will not do; expected a list of 2 values"),
        (tuple[int, int], [1], r"x: has 1 values; expected a list of 2 values, each a whole number"),
        (Range, [2, 1], "limits in the wrong order"),
        (Annotated[str, Except("unknown")], "unknown", "a meaning of its own"),
        (int | bool, "a", "expected a whole number or true or false"),
        *((Path, text, "x: .* will not do; expected a path") for text in ("~nobodyatall/x", "ü" * 128, "a/\0", "")),
        (Path, "\ud800.h5", "x: .* will not do; expected a path"),
        (OBJECT, {"name": "x"}, r"x\.path: is needed; expected a path"),
        (OBJECT, {"name": "unknown", "pth": 1}, r"x\.pth: there is no such key"),
        (OBJECT, 3, "is no part with keys of its own"),
    ],
)
def test_what_will_not_do_is_refused(hint: Any, value: Any, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        convert(hint, value, key="x")


def test_types_in_words() -> None:
    assert describe(Annotated[int, Bounds(low=1)]) == "a whole number of at least 1"
    assert describe(Path | None) == "a path or null"
    assert describe(dict[str, tuple[float, ...]]) == "{name: value}, each a list [a,b,…], each a number"


def test_settings_check_themselves() -> None:
    with pytest.raises(ConfigError, match="mass: 'heavy' will not do; expected a number"):
        UnknownObjectSettings(mass="heavy")  # type: ignore[arg-type]
    assert UnknownObjectSettings(mass=2).mass == 2.0


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


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"gravity": 0, "seed": 3}, Outer(seed=3, model=Inner(gravity=0.0))),
        ({"model.rate": 5.0}, Outer(model=Inner(rate=5.0))),
        ({"model__rate": 5.0}, Outer(model=Inner(rate=5.0))),
        ({"model": Inner(rate=5.0)}, Outer(model=Inner(rate=5.0))),
        ({"model": {"rate": 5.0}}, Outer(model=Inner(rate=5.0))),
    ],
)
def test_fields_change_by_name(keys: dict[str, Any], expected: Outer) -> None:
    assert changed(Outer(), keys) == expected


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"rate": 5.0}, r"model\.rate.*noise\.rate"),
        ({"gravty": 5.0}, "gravity"),
        ({"seed": 2.5}, "seed: 2.5 will not do; expected a whole number"),
        ({"model": 3}, "model: 3 is no part"),
    ],
)
def test_a_change_that_will_not_do_is_refused(keys: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        changed(Outer(), keys)


def test_an_advanced_part_changes_by_name_and_is_marked() -> None:
    settings = changed(TrackSettings(), {"stream.stretches": 10, "clocks": False})
    assert (settings.stream, settings.clocks) == (StreamSettings(stretches=10), False)
    marked = {name for name, each in TrackSettings.__dataclass_fields__.items() if each.metadata.get(ADVANCED)}
    assert "stream" in marked
    assert "clocks" not in marked
    with pytest.raises(ConfigError, match="stream: there is no such key"):
        convert(TrackSettings, {"stream": {"stretches": 10}}, key="", advanced=False)
    assert "stream" not in to_plain(settings, advanced=False)


@pytest.mark.parametrize(
    "own",
    [
        TrainSettings(seed=3, tosses=5, object=UnknownObjectSettings(mass=0.2), model=ModelSettings(horizons=(5, 10))),
        SynthesizeSettings(tosses=3, effects={"wind": {"x_ms": 1.0}}),
        PRESETS["cube"],
    ],
)
def test_what_was_plain_comes_back(own: Any) -> None:
    assert from_plain(own, json.loads(json.dumps(to_plain(own)))) == own


def test_what_an_older_file_lacks_is_the_default() -> None:
    expected = replace(TrainSettings(), seed=2, model=replace(TrainSettings().model, hidden=3))
    assert from_plain(TrainSettings(), {"seed": 2, "model": {"hidden": 3}}) == expected
    gone = {"seed": 2, "speed": 1.0, "model": {"hidden": 3, "pace": {"slow": 1}}}
    assert from_plain(TrainSettings(), gone) == expected
    with pytest.raises(ConfigError, match=r"model\.hidden: 'x' will not do"):
        from_plain(TrainSettings(), {"model": {"hidden": "x"}})


# ---------------------------------------------------------------- settings of the library


@pytest.mark.parametrize(
    "wrong", [{"samples": 0}, {"noise": -1.0}, {"ambient": 1.1}, {"glare": -0.1}, {"focus_m": -1.0}]
)
def test_what_no_image_can_have_is_refused(wrong: dict[str, float]) -> None:
    (name,) = wrong
    with pytest.raises(InputError, match=name):
        RenderSettings(**wrong)


def test_the_lens_is_a_radius_and_a_distance() -> None:
    assert RenderSettings(aperture_m=0.01, focus_m=2.0).lens == (0.005, 2.0)
