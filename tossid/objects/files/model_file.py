"""A model's file as MuJoCo's editable model: checked, its meshes found, and compiled elsewhere first.

MuJoCo reads no URI of ROS and no STL in words, and a mesh that crashes its compiler takes the process along. So what a
file names is resolved here, and a model with mesh files is compiled once in a process of its own (ADR 41).
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import warnings
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import mujoco

from tossid.errors import FileError
from tossid.objects.files.mesh import read_mesh
from tossid.objects.references import check_data, check_model_file, located

_TRIAL = "import sys; from tossid.objects.files import model_file; model_file.compile_quietly(sys.argv[1])"
"""What the process of its own runs."""


class ModelFile(NamedTuple):
    """A model as its file has it.

    Attributes:
        path: The file.
        spec: MuJoCo's editable model.
        texts: The file's text, and those of the models that it includes.
        meshes: The files of its meshes.
    """

    path: Path
    spec: mujoco.MjSpec
    texts: list[str]
    meshes: list[Path]

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


def read_model_file(path: Path) -> ModelFile:
    """Read a user's MJCF or URDF. What it names is there, and does not crash MuJoCo's compiler.

    Raises:
        FileError: The file is missing, asks for too much, names a package that is not there, or MuJoCo cannot parse it
            or crashes while it compiles it.
    """
    found = _read(path)
    if found.meshes:
        _try(path, tuple((file.name, _version(file)) for file in (path, *found.meshes)))
    return found


def compile_quietly(path: str) -> None:
    """Compile a model, and say nothing of the errors that MuJoCo raises: who reads it next raises them too."""
    with suppress(FileError):
        _read(Path(path)).compiled()


def first_line(error: BaseException) -> str:
    """What MuJoCo says of an error, without the lines that follow."""
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


def _read(path: Path) -> ModelFile:
    if not path.exists():
        raise FileError(path, "no such object file; expected MJCF or URDF")
    texts = check_model_file(path)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise FileError(path, f"MuJoCo cannot parse it: {first_line(error)}") from error
    meshes = []
    for mesh in spec.meshes:
        if not mesh.file:
            continue
        file = located(path, mesh.file, spec.meshdir, bare=spec.strippath)
        meshes.append(file)
        if not file.exists():  # MuJoCo says so
            continue
        check_data(file)
        read = read_mesh(file)
        if read is not None:
            mesh.file, mesh.uservert, mesh.userface = "", read[0].ravel(), read[1].ravel()
        elif ":/" in mesh.file and not spec.strippath:
            mesh.file = str(file.absolute())
    return ModelFile(path, spec, texts, meshes)


def _version(file: Path) -> tuple[int, int] | None:
    """What changes with a file."""
    try:
        stat = file.stat()
    except OSError:
        return None
    return stat.st_mtime_ns, stat.st_size


@lru_cache(maxsize=64)
def _try(path: Path, versions: tuple[tuple[str, tuple[int, int] | None], ...]) -> None:
    """Compile a model in a process of its own, once for each version of its files.

    Raises:
        FileError: The process crashes.
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-c", _TRIAL, str(path.absolute())],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == 0:
        return
    how = signal.Signals(-done.returncode).name if done.returncode < 0 else f"exit status {done.returncode}"
    names = ", ".join(sorted({name for name, _ in versions[1:]}))
    raise FileError(path, f"crashes MuJoCo while it compiles it ({how}); one of its meshes cannot be read: {names}")
