"""The digest of the code: an edit changes it, and so does what is registered from outside."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.copied import Copy
from tossid import code_digest as digests
from tossid.code_digest import code_digest, note_registered
from tossid.kernels import kernel
from tossid.versions import computing_versions

DIGESTS = """
from tossid.code_digest import code_digest
print(code_digest(), code_digest("tossid", "pipelines"))
"""


def test_an_edit_changes_the_digest_of_its_package(tmp_path: Path) -> None:
    copy = Copy(tmp_path)
    found = [copy.python(DIGESTS).split()]
    for path in ("pipelines/cli/console.py", "tossid/physics/forces.py"):
        copy.edit(path, r"\Z", "\nSPARE = 1\n")
        found.append(copy.python(DIGESTS).split())
    (before, both), (of_tossid, edited), (last, twice) = found
    assert before == of_tossid
    assert len({before, last}) == 2
    assert len({both, edited, twice}) == 3


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(digests, "_outside", {})
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path / "of_a_user.py"
    sys.modules.pop("of_a_user", None)


def test_what_a_user_registers_counts(plugin: Path) -> None:
    before = code_digest()
    found = []
    for factor in (2, 3):
        plugin.write_text(f"def scaled(x):\n    return {factor} * x\n")
        spec = importlib.util.spec_from_file_location("of_a_user", plugin)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        note_registered(module.scaled)
        found.append(code_digest())
    assert len({before, *found}) == 3


def test_versions_of_what_computes_count(monkeypatch: pytest.MonkeyPatch) -> None:
    before = code_digest()
    for name in ("numpy", "scipy", "numba", "llvmlite", "torch", "mujoco", "python"):
        other = {**computing_versions(), name: "0.1"}
        monkeypatch.setattr(digests, "computing_versions", lambda other=other: other)
        assert code_digest() != before, name


@dataclass(frozen=True)
class Held:
    functions: tuple[Any, ...]


def test_functions_are_found_in_what_holds_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(digests, "_outside", {})
    note_registered(Held((partial(written, 1), kernel(compiled))), dataclass, note_registered)
    assert set(digests._outside) == {
        f"{__name__}.Held",
        f"{__name__}.written",
        f"{__name__}.compiled",
        "dataclasses.dataclass",
    }


def written(x: int) -> int:
    return x


def compiled(x: float) -> float:
    return x
