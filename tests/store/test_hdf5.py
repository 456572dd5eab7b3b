"""HDF5 from outside: endless heaps are refused; members, arrays and attributes are checked before they are read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tossid.errors import FileError
from tossid.store.hdf5 import CheckedGroup, check_heaps, frugal

STRINGS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=30).flatmap(
    lambda text: st.sampled_from((text, text * 50, text * 400))
)


@pytest.fixture
def group(tmp_path: Path) -> Iterator[CheckedGroup]:
    with h5py.File(tmp_path / "strange.h5", "w") as made:
        made.create_group("group")
        made["data"] = np.zeros((4, 3))
        made["elsewhere"] = h5py.ExternalLink("other.h5", "/data")
        made["soft"] = h5py.SoftLink("/data")
        made.create_dataset("empty", shape=(1 << 20,), dtype="<f8", chunks=(1024,))
        made.create_dataset("outside", shape=(4,), dtype="<f8", external=[("raw.bin", 0, 32)])
        made.create_dataset("packed", data=np.zeros(64), chunks=(64,), scaleoffset=3)
        made.attrs.update({"whole": 3, "rate": 148.0, "bad": np.nan, "text": "cube", "row": np.zeros(2)})
        yield CheckedGroup(tmp_path / "strange.h5", made)


def test_what_is_as_expected_is_given(group: CheckedGroup) -> None:
    assert group.array("data", "<f8", (None, 3)).shape == (4, 3)
    assert group.group("group").members == []
    group.refuse_others({*group.members, "absent"})
    found = [group.attribute(*each) for each in (("rate", float), ("whole", float), ("whole", int), ("text", str))]
    assert [(value, type(value)) for value in found] == [(148.0, float), (3.0, float), (3, int), ("cube", str)]
    assert group.attribute("gone", float, default=0.0) == 0.0
    assert group.numbers("row", (2,)).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("take", "says"),
    [
        (lambda g: g.group("gone"), "group /gone is missing"),
        (lambda g: g.group("data"), "/data is not a group"),
        (lambda g: g.array("group", "<f8", (4, 3)), "/group is not a data set"),
        (lambda g: g.array("soft", "<f8", (4, 3)), "is a link elsewhere"),
        (lambda g: g.array("elsewhere", "<f8", (4, 3)), "is a link elsewhere"),
        (lambda g: g.array("data", "<f8", (None, 7)), r"has shape \(4, 3\), expected \(n, 7\)"),
        (lambda g: g.array("data", "u1", (4, 3)), "has type float64, expected uint8"),
        (lambda g: g.array("empty", "<f8", (None,)), "more than its 0 stored bytes can hold"),
        (lambda g: g.array("outside", "<f8", (None,)), "keeps its data in another file"),
        (lambda g: g.array("packed", "<f8", (None,)), "uses filters"),
        (lambda g: g.refuse_others({"group", "data", "soft"}), "holds 'elsewhere'"),
        (lambda g: g.attribute("gone", str), "'gone' of / is missing"),
        (lambda g: g.attribute("text", float), "is str, expected float"),
        (lambda g: g.attribute("rate", int), "is float, expected int"),
        (lambda g: g.attribute("bad", float), "is not finite"),
        (lambda g: g.numbers("row", (3,)), r"expected numbers of shape \(3,\)"),
        (lambda g: g.numbers("text", ()), "expected numbers of shape"),
    ],
)
def test_what_is_not_is_refused(group: CheckedGroup, take: Callable[[CheckedGroup], object], says: str) -> None:
    with pytest.raises(FileError, match=says):
        take(group)


def test_the_cache_of_headers_does_not_grow(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        config = frugal(file).id.get_mdc_config()
        assert config.min_size == config.max_size == 1 << 20


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rounds=st.lists(st.dictionaries(st.sampled_from("abcdefgh"), st.none() | STRINGS), min_size=1, max_size=4),
    libver=st.sampled_from((None, ("v110", "v110"), "latest")),
    user_block=st.sampled_from((0, 512)),
)
def test_heaps_that_hdf5_writes_and_edits_are_sound(
    rounds: list[dict[str, str | None]], libver: str | None, user_block: int, tmp_path: Path
) -> None:
    path = tmp_path / "any.h5"
    path.unlink(missing_ok=True)
    for number, attributes in enumerate(rounds):
        first = {} if number else {"userblock_size": user_block}
        with h5py.File(path, "a", libver=libver, **first) as file:
            for name, text in attributes.items():
                if text is None:
                    file.attrs.pop(name, None)
                else:
                    file.attrs[name] = text
            file.require_dataset(f"x{number}", shape=(5,), dtype="f8")
        check_heaps(path)


def test_a_heap_that_does_not_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.attrs["one"], file.attrs["two"] = "first", "second"
    whole = path.read_bytes()
    at = whole.index(b"second") - 16
    assert whole[at : at + 2] == b"\x02\0"
    for index, length in ((0, 0), (0, 8), (2, 2**64 - 8), (2, 2**63), (0, 10**5)):
        content = bytearray(whole)
        content[at : at + 2] = index.to_bytes(2, "little")
        content[at + 8 : at + 16] = length.to_bytes(8, "little")
        path.write_bytes(content)
        with pytest.raises(FileError, match="heap of strings at byte"):
            check_heaps(path)
    path.write_bytes(whole[: whole.index(b"GCOL") + 100])
    with pytest.raises(FileError, match="does not hold together"):
        check_heaps(path)
