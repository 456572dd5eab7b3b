"""HDF5 from outside: endless heaps are refused, and sound ones are not. `test_datasets` has what else is refused."""

from __future__ import annotations

from pathlib import Path

import h5py
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tossid.errors import FileError
from tossid.store.hdf5 import check_heaps

STRINGS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=30).flatmap(
    lambda text: st.sampled_from((text, text * 50, text * 400))
)


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
