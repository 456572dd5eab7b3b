"""Digests of code: an edit of what a result depends on changes its digest, and nothing else does."""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.copied import Copy
from tossid import code_digest as digests
from tossid.code_digest import code_digest, imported_modules, note_registered
from tossid.kernels import kernel
from tossid.versions import computing_versions

DIGESTS = """
import json
from tossid.code_digest import code_digest
entries = {
    "training": "tossid.training.api",
    "audit": "tossid.audit.sealed_case",
    "detections": "tossid.ingestion.stages",
    "diagnosis": "tossid.diagnosis.diagnose",
}
print(json.dumps({name: code_digest(entry) for name, entry in entries.items()}))
"""
STUDY = """
from pathlib import Path
from pipelines.commands.cells import study_cells
from pipelines.config.compose import load
from pipelines.config.schemas import EvaluateConfig
sweep = load("evaluate", EvaluateConfig, ["sweep=gravity", "sweep.models=[cn]", "sweep.values=[9.81]"]).sweep
print(next(iter(study_cells(sweep, Path("x.h5"), "hash of the data"))).digest)
"""


def test_edits_change_the_digests_of_what_depends_on_them(tmp_path: Path) -> None:
    copy = Copy(tmp_path)
    last: dict[str, str] = json.loads(copy.python(DIGESTS))

    def after_edit(path: str, old: str, new: str) -> set[str]:
        nonlocal last
        copy.edit(path, old, new)
        before, last = last, json.loads(copy.python(DIGESTS))
        return {name for name in before if before[name] != last[name]}

    kernel = "tossid/physics/solvers/workspace.py"
    assert after_edit(kernel, r'^"""[^"]*"""', '"""Another docstring."""\n\n# and a comment') == set()
    # a kernel: all that steps through contact
    assert after_edit(kernel, r"^TOP = 11$", "TOP = 12") == {"training", "audit", "diagnosis"}
    # tosses that are made: of these, the audit's alone
    assert after_edit("tossid/synthesis/tosses.py", r"\Z", "\nSPARE = 1\n") == {"audit"}
    # an effect: what is diagnosed
    effect = sorted((tmp_path / "tossid/physics/effects").glob("[a-z]*.py"))[0].relative_to(tmp_path)
    assert after_edit(str(effect), r"\Z", "\nSPARE = 1\n") == {"audit", "diagnosis"}
    assert after_edit("tossid/vision/detection/corners.py", r"\Z", "\nSPARE = 1\n") >= {"detections"}


def test_a_study_depends_on_its_code_and_on_conf(tmp_path: Path) -> None:
    copy = Copy(tmp_path)
    found = [copy.python(STUDY)]
    copy.edit("conf/model/cn.yaml", r"\Z", "hidden: 17\n")
    found.append(copy.python(STUDY))
    copy.edit("tossid/physics/forces.py", r"\Z", "\nSPARE = 1\n")
    found.append(copy.python(STUDY))
    assert len(set(found)) == 3


def test_every_form_of_import_counts(tmp_path: Path) -> None:
    copy = Copy(tmp_path)
    (tmp_path / "tossid/_reader.py").write_text(
        "from typing import TYPE_CHECKING\n"
        "from tossid._a import (\n    x,  # (of two)\n    y,\n)\n"
        "import tossid._b as b, json\n"
        "if TYPE_CHECKING:\n    from tossid._never import z\n"
        "def f():\n    from . import _c\n    return 'tossid._d'\n"
    )
    for name in ("_a", "_b", "_c", "_d", "_never"):
        (tmp_path / f"tossid/{name}.py").write_text("x = y = z = 1\n")
    code = "from tossid.code_digest import imported_modules; print(sorted(imported_modules('tossid._reader')))"
    assert copy.python(code) == str([f"tossid.{name}" for name in ("_a", "_b", "_c", "_d", "_reader")])


def test_imports_inside_functions_and_through_packages_count() -> None:
    found = imported_modules("tossid.audit.run")
    assert "tossid.synthesis.tosses" in found  # imported inside a function
    found = imported_modules("tossid.training.api")
    assert "tossid.objects.model" in found  # as `from tossid.objects import ObjectModel`
    assert not {name for name in found if name.startswith(("tossid.vision", "tossid.diagnosis"))}
    with pytest.raises(KeyError):
        code_digest("tossid.there_is_no_such_module")


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(digests, "_outside", {})
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path / "of_a_user.py"
    sys.modules.pop("of_a_user", None)


def test_what_a_user_registers_counts(plugin: Path) -> None:
    before = code_digest("tossid.types")
    found = []
    for factor in (2, 3):
        plugin.write_text(f"def scaled(x):\n    return {factor} * x\n")
        spec = importlib.util.spec_from_file_location("of_a_user", plugin)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        note_registered("tossid.types", module.scaled)
        found.append(code_digest("tossid.types"))
    assert len({before, *found}) == 3


def test_versions_of_what_computes_count(monkeypatch: pytest.MonkeyPatch) -> None:
    before = code_digest("tossid.types")
    for name in ("numpy", "scipy", "numba", "llvmlite", "torch", "mujoco", "python"):
        other = {**computing_versions(), name: "0.1"}
        monkeypatch.setattr(digests, "computing_versions", lambda other=other: other)
        assert code_digest("tossid.types") != before, name


def test_what_a_registry_holds_counts_only_where_it_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(digests, "_outside", {})
    reaches, apart = "tossid.audit.sealed_case", "tossid.types"
    before = code_digest(reaches), code_digest(apart)
    note_registered("tossid.physics.effects.registry", written)
    assert code_digest(reaches) != before[0]
    assert code_digest(apart) == before[1]


@dataclass(frozen=True)
class Held:
    functions: tuple[Any, ...]


def test_functions_are_found_in_what_holds_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(digests, "_outside", {})
    note_registered("tossid.types", Held((partial(written, 1), kernel(compiled))), dataclass, imported_modules)
    assert set(digests._outside["tossid.types"]) == {
        f"{__name__}.Held",
        f"{__name__}.written",
        f"{__name__}.compiled",
        "dataclasses.dataclass",
    }


def written(x: int) -> int:
    return x


def compiled(x: float) -> float:
    return x
