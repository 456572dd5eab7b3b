"""Models and recordings from outside name regular files in their own folder and no others, through the command line."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch

from pipelines.cli import app
from tests.pipelines.conftest import one_line
from tests.store.makers import make_dataset
from tests.vision.bags import CAMERAS
from tests.vision.written import write_recording
from tossid.objects import load_object, write_object
from tossid.store import write_dataset
from tossid.vision.setup.faces import default_tags
from tossid.vision.setup.layout import layout_of

BOX = """<mujoco><body name="base"><freejoint/><geom type="box" size="0.05 0.05 0.05"/></body></mujoco>"""
OBJECT = "name: box\npath: object.xml\nfriction: 0.2\nrestitution: 0.0\nwidth: null\ntags: null\n"
MODEL = """<mujoco>{head}<worldbody><body name="base"><freejoint/><geom type="box" size="0.05 0.05 0.05"/></body>
</worldbody></mujoco>"""


@pytest.fixture
def refused(project: Path, capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a command that has to end in one line with exit code 2; returns the line."""

    def run(*words: str) -> str:
        code = app.run([*words, "--quiet"])
        said = one_line(capfd.readouterr().err)
        assert code == 2, said
        return said

    return run


@pytest.fixture
def recording(project: Path) -> Path:
    """A recording of nothing with an object beside it, in `rec`; a secret model lies outside."""
    cube = load_object("cube")
    layout = layout_of(cube.with_changes(tags=default_tags(cube)))
    write_recording("rec", CAMERAS[:1], layout, ())
    folder = project / "rec"
    (folder / "frames" / "left" / "1.png").write_bytes(b"")
    write_object(cube, cube.mjcf, folder)
    (project / "secret.xml").write_text(MODEL.format(head=""))
    return folder


def link_outside(folder: Path) -> None:
    (folder / "object.yaml").write_text(OBJECT)
    (folder / "object.xml").unlink()
    (folder / "object.xml").symlink_to(folder.parent / "secret.xml")


def pipe(folder: Path) -> None:
    (folder / "object.yaml").write_text(OBJECT)
    (folder / "object.xml").unlink()
    os.mkfifo(folder / "object.xml")


def named(path: str) -> Callable[[Path], None]:
    return lambda folder: (folder / "object.yaml").write_text(OBJECT.replace("object.xml", path)) and None


def holding(head: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / "object.yaml").write_text(OBJECT)
        (folder / "object.xml").write_text(MODEL.format(head=head.format(outside=folder.parent)))
        os.mkfifo(folder / "pipe.stl")
        (folder / "link.stl").symlink_to(folder.parent / "secret.xml")

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            named("/etc/hostname"),
            "does not describe an object: path: it names '/etc/hostname', expected a file in its own folder",
        ),
        (named("../secret.xml"), "expected a file in its own folder"),
        (link_outside, "which links to a place outside its own folder"),
        (pipe, "which is not a regular file"),
        (holding('<include file="{outside}/secret.xml"/>'), "secret.xml', expected a file in its own folder"),
        (holding('<INCLUDE file="../secret.xml"/>'), "'../secret.xml', expected a file in its own folder"),
        (holding('<asset><mesh file="/dev/zero"/></asset>'), "'/dev/zero', expected a file in its own folder"),
        (holding('<compiler meshdir="/dev"/><asset><mesh file="zero"/></asset>'), "'/dev/zero', expected a file"),
        (holding('<asset><texture type="2d" fileup="../a.png"/></asset>'), "'../a.png', expected a file"),
        (holding('<asset><mesh file="pipe.stl"/></asset>'), "'pipe.stl', which is not a regular file"),
        (holding('<asset><mesh file="link.stl"/></asset>'), "which links to a place outside its own folder"),
        (holding('<extension><plugin plugin="mujoco.sdf"/></extension>'), "element <extension>"),
    ],
)
def test_a_recording_names_no_file_outside_its_folder(
    recording: Path, refused: Callable[..., str], change: Callable[[Path], None], says: str
) -> None:
    change(recording)
    said = refused("info", "rec")
    assert says in said
    assert "rec/object." in said
    assert says in refused("detect", "recording=rec")


def test_a_recording_may_name_files_of_its_own(recording: Path, answer: Any) -> None:
    (recording / "parts").mkdir()
    (recording / "parts" / "more.xml").write_text('<mujoco><option gravity="0 0 -9"/></mujoco>')
    (recording / "object.yaml").write_text(OBJECT)
    (recording / "object.xml").write_text(MODEL.format(head='<include file="parts/more.xml"/>'))
    assert answer("info", "rec")["object"] == "box"


@pytest.mark.parametrize("name", ["cameras.yaml", "tagslam.yaml", "camera_poses.yaml"])
def test_a_pipe_is_never_opened(recording: Path, refused: Callable[..., str], name: str) -> None:
    (recording / name).unlink()
    os.mkfifo(recording / name)
    assert f"rec/{name}" in refused("detect", "recording=rec")


REACHES = MODEL.format(head='<include file="{outside}/secret.xml"/>')


def test_a_dataset_and_a_checkpoint_stand_alone(made: Path, project: Path, refused: Callable[..., str]) -> None:
    (project / "secret.xml").write_text('<mujoco><option gravity="0 0 -9"/></mujoco>')
    text = REACHES.format(outside=project)
    cube = load_object("cube")
    write_dataset(make_dataset(cube), "a.h5")
    with h5py.File("a.h5", "a") as file:
        del file["object/mjcf"]
        file["object/mjcf"] = np.frombuffer(text.encode(), dtype="|u1")
    shutil.copytree(next((made / "outputs" / "train").glob("*/checkpoint.pt")).parent, "run")
    content = torch.load("run/checkpoint.pt", weights_only=True)
    content["object"]["mjcf"] = text
    torch.save(content, "run/checkpoint.pt")
    assert "a.h5: /object: it names another file or folder" in refused("train", "data=a.h5")
    write_dataset(make_dataset(cube), "b.h5")
    said = refused("evaluate", "run=run", "data=b.h5")
    assert "checkpoint.pt: a checkpoint that cannot be used: it names another file or folder" in said


def test_a_users_own_object_may_lie_anywhere(project: Path, answer: Any) -> None:
    """It may include files of other folders, too, and hold comments that MuJoCo alone reads."""
    (project / "elsewhere").mkdir()
    (project / "elsewhere" / "more.xml").write_text('<mujoco><option gravity="0 0 -9"/></mujoco>')
    (project / "mine").mkdir()
    head = '<!-- ---- parts ---- --><include file="../elsewhere/more.xml"/>'
    (project / "mine" / "object.xml").write_text(MODEL.format(head=head))
    keys = ["object=custom", "object.name=mine", f"object.path={project}/mine/object.xml", "frames=false", "tosses=1"]
    assert answer("synthesize", *keys, "engine=lcp", "out=one")["n_tosses"] == 1
