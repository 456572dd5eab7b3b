"""A model's file as MuJoCo's editable model: checked, and its meshes found.

MuJoCo reads no URI of ROS and no STL in words. So what a file names is resolved here (ADR 41).
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import NamedTuple

import mujoco

from tossid.errors import FileError
from tossid.objects.files.mesh import read_mesh
from tossid.objects.references import check_data, check_model_file, located


class ModelFile(NamedTuple):
    """A model as its file has it.

    Attributes:
        path: The file.
        spec: MuJoCo's editable model.
        texts: The file's text, and those of the models that it includes.
        has_mesh_files: Whether it names meshes that lie in files of their own.
    """

    path: Path
    spec: mujoco.MjSpec
    texts: list[str]
    has_mesh_files: bool

    def compiled(self) -> mujoco.MjModel:
        """The compiled model.

        Raises:
            FileError: MuJoCo cannot compile it.
        """
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="obj_decoder")  # of textures, which nothing here shows
                return self.spec.compile()
        except UnicodeDecodeError as error:
            raise FileError(self.path, "holds letters that are not UTF-8, its own or an included file's") from error
        except (ValueError, mujoco.FatalError) as error:
            raise FileError(self.path, f"MuJoCo cannot compile it: {first_line(error)}") from error


def first_line(error: BaseException) -> str:
    """What MuJoCo says of an error, without the lines that follow."""
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


def read_model_file(path: Path) -> ModelFile:
    """Read a user's MJCF or URDF, with what it names.

    Raises:
        FileError: The file is missing, asks for too much, names a package that is not there, or MuJoCo cannot parse it.
    """
    if not path.exists():
        raise FileError(path, "no such object file; expected MJCF or URDF")
    texts = check_model_file(path)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise FileError(path, f"MuJoCo cannot parse it: {first_line(error)}") from error
    named = [mesh for mesh in spec.meshes if mesh.file]
    for mesh in named:
        file = located(path, mesh.file, spec.meshdir, bare=spec.strippath)
        if not file.exists():  # MuJoCo says so
            continue
        check_data(file)
        read = read_mesh(file)
        if read is not None:
            mesh.file, mesh.uservert, mesh.userface = "", read[0].ravel(), read[1].ravel()
        elif ":/" in mesh.file and not spec.strippath:
            mesh.file = str(file.absolute())
    return ModelFile(path, spec, texts, bool(named))
