"""Hashes of sources, splits by toss, the registry of formats, and what a dataset says of the call that made it."""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.store.makers import make_toss
from tossid.errors import FileError, InputError
from tossid.settings.synthesis import SynthesizeSettings
from tossid.store import draw_splits, drawn_splits, file_sha256, source_sha256
from tossid.store.provenance import provenance_of
from tossid.types import Toss

# ---------------------------------------------------------------- hashes


def test_a_files_hash_is_sha256(tmp_path: Path) -> None:
    content = os.urandom(3_000_000)
    (tmp_path / "a").write_bytes(content)
    assert file_sha256(tmp_path / "a") == source_sha256(tmp_path / "a") == hashlib.sha256(content).hexdigest()
    for missing in (file_sha256, source_sha256):
        with pytest.raises(FileError, match="nowhere"):
            missing(tmp_path / "nowhere")


def test_a_folders_hash_is_of_names_and_contents_in_sorted_order(tmp_path: Path) -> None:
    names = ["a/z", "a.x", "a-", "ab", "a/b/c", "a/b.d", "a/b/-", ".hidden/x", "Z", "é/1", "é0", "b/a", "a0"]
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    (tmp_path / "link").symlink_to(tmp_path / "Z")
    (tmp_path / "elsewhere").symlink_to(tmp_path / "a")
    digest = hashlib.sha256()
    for name in sorted([*names, "link"]):  # what lies behind a linked folder is not the source's own
        digest.update(f"{file_sha256(tmp_path / name)}  {name}\n".encode())
    assert source_sha256(tmp_path) == digest.hexdigest()


# ---------------------------------------------------------------- splits


def tosses(n: int) -> list[Toss]:
    rng = np.random.default_rng(0)
    return [make_toss(str(i), 2, rng) for i in range(n)]


MANY = tosses(500)


@given(n=st.integers(3, 200), seed=st.integers(0, 2**32))
def test_every_split_is_there_and_its_share_right(n: int, seed: int) -> None:
    count = Counter(toss.split for toss in draw_splits(MANY[:n], seed=seed))
    assert sum(count.values()) == n
    for name, share in (("train", 0.5), ("validation", 0.3), ("test", 0.2)):
        assert count[name] >= 1
        assert abs(count[name] - share * n) <= 1.5


def test_the_seed_decides_not_the_order() -> None:
    first, turned, other = (
        {toss.name: toss.split for toss in draw_splits(each, seed=seed)}
        for each, seed in ((MANY, 3), (MANY[::-1], 3), (MANY, 4))
    )
    assert first == turned != other
    assert list(first) == [toss.name for toss in MANY]


@pytest.mark.parametrize("fractions", [(0.5, 0.5), (0.5, 0.5, 0.5), (1.5, -0.5, 0.0), (float("nan"), 0.5, 0.5)])
def test_fractions_and_names_that_will_not_do_are_refused(fractions: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="fractions"):
        draw_splits(MANY, fractions=fractions, seed=0)
    with pytest.raises(InputError, match="'0'"):
        draw_splits([MANY[0], MANY[0]], seed=0)


def test_a_copy_goes_to_the_split_of_its_first_and_all_others_stay() -> None:
    names = [toss.name for toss in MANY[:200]]
    alone = drawn_splits(names, seed=3)
    copies = {"40": "7", "41": "7", "150": "99"}
    together = drawn_splits(names, seed=3, copies=copies)
    assert any(alone[name] != alone[first] for name, first in copies.items())
    assert together == {name: alone[copies.get(name, name)] for name in names}
    # the first of the copies stands for an original that is not drawn
    fewer = [name for name in names if name != "7"]
    split = drawn_splits(fewer, seed=3, copies=copies)
    assert split["41"] == split["40"] == drawn_splits(fewer, seed=3)["40"]


# ---------------------------------------------------------------- formats and provenance


def test_the_settings_of_a_call_can_be_read_back() -> None:
    settings = SynthesizeSettings(tosses=3, effects={"wind": {"x_ms": 1.0}})
    made = provenance_of("tossid.synthesize", settings, object="cube")
    config = yaml.safe_load(str(made["config"]))
    assert made["command"] == "tossid.synthesize"
    assert json.loads(str(made["versions"]))["numpy"] == np.__version__
    assert (config["object"], config["tosses"], config["effects"]) == ("cube", 3, {"wind": {"x_ms": 1.0}})
    assert config["splits"] == [0.5, 0.3, 0.2]
