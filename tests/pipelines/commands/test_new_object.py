"""`tossid new-object`: the object is the box, and the detector finds what is printed, in true size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.cli import app
from pipelines.config.compose import load
from pipelines.config.schemas import SynthesizeConfig
from tests.pipelines.conftest import members, one_line
from tossid.objects import corner_positions, load_object
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.detection.detect import TagFinder

BRICK = ["new-object", "name=brick", "box=[0.2,0.1,0.06]", "mass=0.8", "com=[0.01,0,0]", "first_id=10"]
DPI = 200


def test_the_object_is_the_box(project: Path, answer: Any) -> None:
    named, made = answer(*BRICK), answer(*BRICK, "out=mine")
    assert named["key"] == "object=brick"
    assert (project / "conf/object/brick.yaml").read_text().splitlines()[2] == "path: conf/object/brick.xml"
    assert "brick" in members("object")
    models = [load_object(load("synthesize", SynthesizeConfig, each["key"].split()).object) for each in (named, made)]
    model = models[1]
    assert models[0].width == model.width == 0.2
    assert np.ptp(corner_positions(model, np.array([0, 0, 0, 1, 0, 0, 0.0])), axis=0) == pytest.approx([0.2, 0.1, 0.06])
    assert model.mass[0] == pytest.approx(0.8)
    assert model.com[0] == pytest.approx([0.01, 0, 0])
    assert {tag.id: tag.size for tag in model.tags} == pytest.approx(
        {int(tag_id): size for tag_id, size in made["tag_sizes_m"].items()}
    )
    assert sorted(tag.id for tag in model.tags) == [10, 11, 12, 13, 14, 15]


def test_the_printed_tags_are_found_and_of_true_size(project: Path, answer: Any) -> None:
    pdfium = pytest.importorskip("pypdfium2", reason="pypdfium2 (extra dev) turns the PDF into pictures")
    made = answer(*BRICK, "out=mine")
    pages = pdfium.PdfDocument(made["sheet"])
    assert len(pages) == made["pages"]
    found: dict[int, np.ndarray] = {}
    for page in pages:
        assert page.get_size() == pytest.approx((210 / 25.4 * 72, 297 / 25.4 * 72), abs=0.05)
        picture = page.render(scale=DPI / 72, grayscale=True).to_numpy().squeeze()
        finder = TagFinder(Camera("paper", picture.shape[::-1], np.array([2e3, 2e3, 800, 1100])), None)
        for detection in finder.find(Frame("paper", 0.0, np.ascontiguousarray(picture))):
            assert detection.hamming == 0
            found[detection.tag_id] = detection.corners / DPI * 25.4
    sizes = {int(tag_id): 1e3 * size for tag_id, size in made["tag_sizes_m"].items()}
    assert sorted(found) == sorted(sizes)
    for tag_id, corners in found.items():
        sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
        assert sides == pytest.approx(sizes[tag_id], abs=0.15)  # a pixel is 0.127 mm
        left_bottom, right_bottom, right_top, _ = corners
        assert right_bottom[0] - left_bottom[0] == pytest.approx(sizes[tag_id], abs=0.15)  # upright on the page
        assert right_bottom[1] - right_top[1] == pytest.approx(sizes[tag_id], abs=0.15)


def test_an_object_that_is_there_is_kept_and_what_a_killed_command_left_is_completed(
    project: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert app.run([*BRICK, "out=mine", "--quiet"]) == 0
    assert app.run([*BRICK, "out=mine", "--quiet"]) == 2
    assert "mine/object/brick.xml: is there already" in one_line(capfd.readouterr().err)
    (project / "mine/object/brick.yaml").unlink()
    (project / "mine/tags/brick.pdf").unlink()
    assert app.run([*BRICK, "out=mine", "--quiet"]) == 0
    assert (project / "mine/tags/brick.pdf").exists()
    (project / "mine/object/brick.yaml").unlink()
    (project / "mine/object/brick.xml").write_text("<mujoco/>")  # someone's own
    assert app.run([*BRICK, "out=mine"]) == 2
    assert "mine/object/brick.xml: is there already" in one_line(capfd.readouterr().err)
