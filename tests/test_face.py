"""`import tossid`: what it offers, and how little it costs."""

import subprocess
import sys

import pytest

import tossid

HEAVY = ("numpy", "scipy", "torch", "numba", "mujoco", "cv2", "h5py", "matplotlib", "gtsam", "yaml")


def fresh(code: str) -> str:
    """What Python code prints in a process of its own."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_importing_it_is_quick_and_imports_nothing_heavy():
    code = "import sys, time; began = time.process_time(); import tossid; took = time.process_time() - began;"
    found, took = fresh(f"{code} print([name for name in {HEAVY} if name in sys.modules], took, sep='|')").split("|")
    assert found == "[]"
    assert float(took) < 0.3


def test_a_diagnosis_imports_no_torch_and_figures_no_pyplot():
    code = "import sys, tossid.diagnosis.diagnose; found = ['torch' in sys.modules]; import tossid.evaluation.figures;"
    assert fresh(f"{code} print(*found, 'matplotlib.pyplot' in sys.modules)") == "False False"


def test_every_name_is_where_the_face_says() -> None:
    assert [name for name in tossid.__all__ if getattr(tossid, name, None) is None] == []


def test_a_name_that_is_none_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'teach'"):
        tossid.teach  # noqa: B018
