"""Exports are read by MuJoCo, and move as tossid has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from pipelines.cli import app
from tests.pipelines.conftest import one_line
from tossid.objects import load_object


@pytest.mark.parametrize(("form", "suffix"), [("mjcf", ".xml"), ("urdf", ".urdf")])
def test_a_run_s_export_flies_as_tossid_has_it(beside: Path, answer: Any, form: str, suffix: str) -> None:
    found = answer("export", f"format={form}", f"out=here/cube{suffix}")
    assert found["check"]["free_flight"]["position_mm"] < 1.0
    assert found["check"]["free_flight"]["rotation_deg"] < 0.5
    assert ("with_contact" in found["check"]) == (form == "mjcf")
    assert any("k_res" in text for text in found["left_out"])
    assert any("gravity" in text for text in found["left_out"]) == (form == "urdf")
    again = load_object(beside / f"here/cube{suffix}") if form == "urdf" else None
    if again is not None:
        assert again.n_corners == 8
        assert {Path(file).name for file in found["files"]} == {"cube.urdf", "cube_cube.obj"}
    else:
        scene = mujoco.MjModel.from_xml_path(str(beside / "here/cube.xml"))
        np.testing.assert_allclose(scene.opt.gravity[2], -found["gravity_ms2"], atol=1e-4)


def test_a_name_that_is_not_the_format_s_is_refused(beside: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert app.run(["export", "format=urdf", "out=cube.xml"]) == 2
    assert "does not end in .urdf" in one_line(capfd.readouterr().err)
