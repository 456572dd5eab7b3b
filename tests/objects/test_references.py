"""Files and elements that the text of a model may ask for."""

from __future__ import annotations

from pathlib import Path

import pytest

from tossid.errors import FileError, ObjectError
from tossid.objects.references import check_alone, check_model_file, inside, stands_alone

BODY = '<worldbody><body><geom type="box" size="1 1 1"/></body></worldbody>'


def model(head: str = "", body: str = BODY) -> str:
    return f"<mujoco>{head}{body}</mujoco>"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (model('<include file="other.xml"/>'), "names another file or folder"),
        (model('<compiler meshdir="/etc"/>'), "names another file or folder"),
        (model('<extension><plugin plugin="x"/></extension>'), "models from outside may not have"),
        (model(body='<replicate count="1000000">' + BODY + "</replicate>"), "elements"),
        (model('<asset><texture name="t" builtin="flat" width="100000" height="100000"/></asset>'), "pixels"),
        (model('<size memory="1T"/>'), "MuJoCo's memory"),
        ("<!DOCTYPE x>" + model(), "document type"),
        ("<mujoco>", "not valid XML"),
        (model(body="<body>" * 70 + "</body>" * 70), "inside one another"),
    ],
)
def test_a_model_from_outside_stands_alone(text: str, says: str) -> None:
    with pytest.raises(ObjectError, match=says):
        check_alone(text)
    assert not stands_alone(text)
    assert stands_alone(model())


def test_a_file_from_outside_names_files_in_its_own_folder(tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    (own / "mesh.obj").touch()
    (tmp_path / "secret").touch()
    (own / "link").symlink_to(tmp_path / "secret")
    assert inside(own, "mesh.obj") == own / "mesh.obj"
    for name in ("../secret", "/etc/passwd", "link", "C:\\x", "a\0b"):
        with pytest.raises(ObjectError, match="it names"):
            inside(own, name)


def test_files_that_a_users_model_names_may_lie_anywhere(tmp_path: Path) -> None:
    (tmp_path / "shared").mkdir()
    (tmp_path / "mine").mkdir()
    (tmp_path / "shared" / "part.xml").write_text(model())
    path = tmp_path / "mine" / "model.xml"
    path.write_text(model('<include file="../shared/part.xml"/>'))
    check_model_file(path)
    with pytest.raises(FileError, match="it names"):
        check_model_file(path, own_folder=path.parent)


def test_a_mesh_must_be_a_regular_file(tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(model('<asset><mesh name="m" file="mesh"/></asset>'))
    check_model_file(path)
    (tmp_path / "mesh").mkdir()
    with pytest.raises(FileError, match="not a regular file"):
        check_model_file(path)
