"""Plain values become what a schema asks for, or are refused in words."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pytest

from pipelines.config.keys import convert, describe
from tossid.errors import ConfigError
from tossid.settings.kinds import Bounds


def test_types_in_words() -> None:
    assert describe(Annotated[int, Bounds(low=1)]) == "a whole number of at least 1"
    assert describe(Path | None) == "a path or null"
    assert describe(Literal["a", "b"]) == "one of a, b"


@pytest.mark.parametrize("text", ["~nobodyatall/x", "a" * 256, "ü" * 128, "a/\0", "\ud800.h5", ""])
def test_a_place_that_no_file_can_have_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"out: .* will not do; expected a path"):
        convert(Path, text, key="out")


@pytest.mark.parametrize("hint", [float, str])
def test_a_number_that_nothing_can_hold_is_refused(hint: type) -> None:
    with pytest.raises(ConfigError, match=r"x: .* will not do"):
        convert(hint, 1 << 20_000, key="x")
    assert convert(float, 10**300, key="x") == 1e300
    assert convert(Path, "a" * 255, key="out") == Path("a" * 255)


def test_null_is_a_word_where_it_is_one_of_the_words() -> None:
    assert convert(tuple[Literal["effect", "null"], ...], ["effect", None], key="kinds") == ("effect", "null")
    with pytest.raises(ConfigError, match="None will not do; expected one of a, b"):
        convert(Literal["a", "b"], None, key="x")
