"""What the text of a model may ask for, checked before MuJoCo reads it: other files, and elements.

An MJCF or URDF may include other files, name meshes and textures, and have elements copied a million times. MuJoCo
obeys while it parses. A model from outside (of a dataset, a checkpoint or a recording) may name regular files in its
own folder and no others. A user's own model may name any regular file. Each model stays within
`tossid.settings.limits.ReadLimits`.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath
from urllib.parse import unquote
from xml.parsers import expat

from tossid import budget
from tossid.errors import FileError, ObjectError, brief

_MODELS = frozenset({"include", "model"})
"""Elements whose file is a model itself."""
_CODE = frozenset({"plugin", "extension"})
"""Elements that have MuJoCo load libraries."""
_COPIES = frozenset({"attach", "composite", "flexcomp"})
"""Elements that add many others, by rules that only MuJoCo knows; no rigid object needs one."""
_FOLDERS = frozenset({"meshdir", "texturedir", "assetdir"})
_PACKAGE, _FILE = re.compile("(?:package|model)://([^/]+)/(.+)"), re.compile("file:/(?:/[^/]*)?(/.+)")
"""How URDF names a file of a package of ROS (or a model of Gazebo), and a file by its address."""
_UNITS = {"k": 2**10, "m": 2**20, "g": 2**30, "t": 2**40, "p": 2**50, "e": 2**60}
_MEMORY = 1 << 28
"""Bytes that `<size memory>` may ask for."""
_ROWS = frozenset({"njmax", "nconmax", "nstack"})
"""Older ways to ask for memory: in rows of it."""
_ROW, _NUMBER, _HEIGHT = 128, 8, 16
"""Bytes that MuJoCo takes for a row (of a contact, with its Jacobian), a number and a height, with its copies; a pixel
takes one for each of its colours."""
_PNG = b"\x89PNG\r\n\x1a\n"
_DEPTH = 64
"""Elements inside one another."""


@dataclass
class _Claims:
    """What a text asks for: files by element and name, folders, elements with all copies, and amounts by kind."""

    files: list[tuple[str, str]] = field(default_factory=list)
    folders: set[str] = field(default_factory=set)
    elements: float = 0
    amounts: dict[str, float] = field(default_factory=dict)


def check_alone(text: str) -> None:
    """Refuse the text of a model from outside that names other files, or asks for too much.

    Args:
        text: MJCF, as datasets and checkpoints hold it.

    Raises:
        ObjectError: It does.
    """
    claims = _claims(text, outside=True)
    if claims.files or claims.folders:
        name = claims.files[0][1] if claims.files else min(claims.folders)
        raise ObjectError(f"it names another file or folder ({brief(name)}), expected a model that stands alone")


def stands_alone(text: str) -> bool:
    """Whether `check_alone` passes."""
    try:
        check_alone(text)
    except ObjectError:
        return False
    return True


def inside(folder: Path, name: str) -> Path:
    """The file in a folder that a file from outside names.

    Args:
        folder: Where the file that names it lies.
        name: A relative path.

    Returns:
        The file's path, which may not exist.

    Raises:
        ObjectError: It lies elsewhere, by its name or by a link, or is no regular file.
    """
    parts = PurePosixPath(name).parts
    windows = PureWindowsPath(name)
    if name.startswith("/") or ".." in parts or windows.drive or "\\" in name or ":" in name or "\0" in name:
        raise ObjectError(f"it names {brief(name)}, expected a file in its own folder")
    path = folder / name
    try:
        linked = not path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError) as error:  # links in a circle, names too long
        raise ObjectError(f"it names {brief(name)}, which cannot be found: {error}") from error
    if linked:
        raise ObjectError(f"it names {brief(name)}, which links to a place outside its own folder")
    if path.exists() and not path.is_file():
        raise ObjectError(f"it names {brief(name)}, which is not a regular file")
    return path


def check_model_file(path: Path, *, own_folder: Path | None = None) -> list[str]:
    """Refuse a model's file that asks for too much, or names files that it may not.

    Args:
        path: MJCF or URDF.
        own_folder: The folder that its files must lie in, of a model from outside; None for a user's own model, whose
            files may lie anywhere.

    Returns:
        Its text, and the texts of the models that it includes.

    Raises:
        FileError: It does, or it is no regular file, or cannot be read.
    """
    folders: set[str] = {""}
    waiting, seen, elements = [path], set[Path](), 0.0
    data: list[tuple[Path, str]] = []
    texts: list[str] = []
    while waiting:
        file = waiting.pop()
        real = Path(os.path.realpath(file))
        if real in seen:
            continue
        seen.add(real)
        budget.check_claim(file, "bytes of a model", budget.regular_size(file), budget.limits().model_text)
        try:
            texts.append(file.read_text(encoding="utf-8"))
            claims = _claims(texts[-1], outside=own_folder is not None)
            elements += claims.elements
            folders |= claims.folders
            budget.check_claim(path, "elements", elements, budget.limits().elements)
            for kind, name in claims.files:
                if kind in _MODELS:
                    waiting += _existing(name, {""}, {path.parent, file.parent}, own_folder)
                else:
                    data.append((file.parent, name))
        except ObjectError as error:
            raise FileError(file, str(error)) from error
        except UnicodeDecodeError as error:
            raise FileError(file, "holds letters that are not UTF-8, expected MJCF or URDF") from error
        except OSError as error:
            raise FileError(file, f"cannot be read: {error.strerror}") from error
    try:
        for parent, name in data:
            for found in _existing(name, folders, {path.parent, parent}, own_folder):
                check_data(found)
    except ObjectError as error:
        raise FileError(path, str(error)) from error
    return texts


def _existing(name: str, folders: set[str], parents: set[Path], own_folder: Path | None) -> list[Path]:
    """The files that a name may mean to MuJoCo, of those that are there."""
    names = {str(PurePosixPath(folder) / spelled) for folder in folders for spelled in (name, PurePosixPath(name).name)}
    found = []
    for parent in sorted(parents):
        for each in sorted(names):
            path = parent / each
            if own_folder is not None:
                inside(parent, each)
                if not path.resolve().is_relative_to(own_folder.resolve()):
                    raise ObjectError(f"it names {brief(each)}, which lies outside its own folder")
            if path.exists():
                found.append(path)
    return found


def located(model: Path, name: str, folder: str = "", *, bare: bool = False) -> Path:
    """The file that a user's model means by a name.

    A file of a package is sought in the package's folder: one of that name among the folders that the model lies in, or
    in one of these. A folder with a package.xml of that name is the package's, whatever it is called.

    Args:
        model: The model's file.
        name: A path, or `package://PACKAGE/PATH`, `model://MODEL/PATH` or `file:///PATH`.
        folder: Where the model says that its meshes lie.
        bare: Whether it says that folders in names do not count.

    Returns:
        The file's path, which may not exist where the name is a path.

    Raises:
        FileError: There is no such file in a package of that name.
    """
    spelled = name.replace("\\", "/")
    if bare:
        return model.parent / folder / PurePosixPath(spelled).name
    if address := _FILE.fullmatch(name):
        return Path(unquote(address[1]))
    package = _PACKAGE.fullmatch(name)
    if package is None:
        return model.parent / folder / spelled
    for above in model.absolute().parents:
        itself = above.name == package[1] or _package_name(above) == package[1]
        for each in (above, above / package[1]) if itself else (above / package[1],):
            if (each / package[2]).is_file():
                return each / package[2]
    raise FileError(
        model,
        f"names {brief(name)}, and no folder '{brief(package[1])[1:-1]}' with that file is among the folders that it "
        "lies in, or in one of them; put the package's folder there, or name the mesh by its path",
    )


def _package_name(folder: Path) -> str | None:
    """The name that a folder's package.xml states; None without one."""
    file = folder / "package.xml"
    if not file.is_file() or budget.regular_size(file) > budget.limits().model_text:
        return None
    named = re.search(r"<name>\s*([^<]*?)\s*</name>", file.read_text(encoding="utf-8", errors="replace"))
    return named[1] if named else None


def check_data(path: Path) -> None:
    """Refuse a mesh or texture that is no regular file, or too large.

    Raises:
        FileError: It is.
    """
    budget.check_claim(path, "bytes of a mesh or texture", budget.regular_size(path), budget.limits().model_file)
    with path.open("rb") as file:
        head = file.read(24)
    if head.startswith(_PNG) and len(head) == 24:
        budget.check_pixels(path, int.from_bytes(head[16:20]), int.from_bytes(head[20:24]))


def _claims(text: str, *, outside: bool) -> _Claims:
    """What a text asks for.

    Raises:
        ObjectError: It is no XML, or asks for too much.
    """
    limits = budget.limits()
    size = len(text.encode("utf-8", "surrogatepass"))
    if size > limits.model_text:
        raise ObjectError(f"it holds {size} bytes, expected at most {limits.model_text}")
    claims, copies = _Claims(), [1.0]

    def start(element: str, attributes: dict[str, str]) -> None:
        name, given = element.lower(), {key.lower(): value for key, value in attributes.items()}
        if outside and name in _CODE | _COPIES:
            raise ObjectError(f"it has an element <{brief(element)[1:-1]}>, which models from outside may not have")
        copied = name in _COPIES | {"replicate"}
        copies.append(copies[-1] * (_product(given.get("count", "1")) if copied else 1.0))
        claims.elements += copies[-1]
        if claims.elements > limits.elements or len(copies) > _DEPTH:
            claimed = f"{claims.elements:.3g} elements, {len(copies) - 1} inside one another"
            raise ObjectError(f"it claims {claimed}; expected at most {limits.elements}, {_DEPTH} deep")
        for what, amount, limit in _amounts(name, given):
            total = claims.amounts[what] = claims.amounts.get(what, 0.0) + amount
            if not total <= limit:
                raise ObjectError(f"it claims {total:.10g} {what}, expected at most {limit:.10g}")
        for key, value in given.items():
            if key in _FOLDERS:
                claims.folders.add(value)
            elif key.startswith("file"):
                claims.files.append((name, value))

    def doctype(*_: object) -> None:
        raise ObjectError("it declares a document type, which no model needs")

    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler, parser.StartDoctypeDeclHandler = start, doctype
    parser.EndElementHandler = lambda _: copies.pop()
    # a person's comments may hold "--", which XML forbids and MuJoCo reads
    spelled = text if outside else re.sub("<!--.*?-->", "", text, flags=re.DOTALL)
    try:
        parser.Parse(spelled.encode("utf-8", "surrogatepass"), True)
    except (expat.ExpatError, ValueError) as error:
        if outside:
            raise ObjectError(f"it is not valid XML: {error}") from error
    return claims


def _amounts(name: str, given: dict[str, str]) -> Iterator[tuple[str, float, float]]:
    """What MuJoCo would make room for: kind, amount, and limit of all elements together."""
    pixels = float(budget.limits().pixels)

    def largest(key: str) -> float:
        return max([0.0, *_numbers(given.get(key, "0"))])

    if name == "texture":
        yield "pixels of textures", largest("width") * max(largest("height"), 6.0 * largest("width")), pixels
    elif name == "hfield":
        yield "heights", largest("nrow") * largest("ncol"), pixels / _HEIGHT
    elif name == "numeric":
        yield "numbers", largest("size"), pixels / _NUMBER
    elif name == "user":
        yield "numbers of sensors", largest("dim"), pixels / _NUMBER
    elif name == "mesh" and "builtin" in given:
        yield "parts of built-in meshes", _product(given.get("params", "0")), float(budget.limits().corners)
    elif name == "size":
        yield "bytes of MuJoCo's memory", largest("memory"), float(_MEMORY)
        for key in sorted(given.keys() - {"memory"}):
            rows = ("rows of MuJoCo's memory", _MEMORY / _ROW)
            what, limit = rows if key in _ROWS else (f"'{key}'", float(budget.limits().elements))
            yield what, largest(key), limit


def _product(text: str) -> float:
    """Product of the numbers in an attribute that are more than one."""
    return math.prod(max(1.0, number) for number in _numbers(text))


def _numbers(text: str) -> Iterator[float]:
    """The numbers in an attribute, with the units of memory ("10M")."""
    for digits, unit in re.findall(r"([-+0-9.]+(?:[eE][-+]?\d+)?)\s*([kKmMgGtTpPeE]?)", text):
        try:
            yield float(digits) * _UNITS.get(unit.lower(), 1)
        except ValueError:
            continue
