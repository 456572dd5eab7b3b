"""What a file from outside may cost: one budget for all readers, checked against what the file declares.

A reader says what a file claims (bytes to unpack, pixels, tags, elements) before it makes room for that. A claim beyond
the budget is one `FileError`, which names the file and the claim.
"""

from __future__ import annotations

import os
import stat
import zipfile
from pathlib import Path

from tossid.errors import FileError
from tossid.settings.limits import ReadLimits

_in_force = ReadLimits()


def limits() -> ReadLimits:
    """The limits that all readers of this process hold."""
    return _in_force


def use_limits(wanted: ReadLimits) -> None:
    """Set the limits of all readers of this process, for files that are larger than those of most people.

    Args:
        wanted: The limits, such as `ReadLimits(pixels=200_000_000)`.
    """
    global _in_force
    _in_force = wanted


def regular_size(path: Path) -> int:
    """The size of a regular file, found without opening it: a pipe would never end, a device may be endless.

    Args:
        path: The file; a link is followed.

    Returns:
        Its size [bytes].

    Raises:
        FileError: There is no such file, or it is a folder, pipe, socket or device.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError) as error:
        missing = isinstance(error, FileNotFoundError)
        raise FileError(path, "no such file" if missing else f"cannot be read: {error}") from error
    if not stat.S_ISREG(found.st_mode):
        raise FileError(path, "is not a regular file (a folder, pipe or device), expected one")
    return found.st_size


def check_claim(path: Path, what: str, claimed: float, limit: float) -> None:
    """Refuse a claim that is beyond its limit.

    Args:
        path: The file that claims it.
        what: What is claimed, in the plural with its unit, such as "pixels".
        claimed: How many.
        limit: At most so many.

    Raises:
        FileError: It claims more.
    """
    if claimed > limit:
        raise FileError(path, f"claims {_count(claimed)} {what}, expected at most {_count(limit)}")


def check_unpacked(path: Path, claimed: float, *, what: str = "bytes when unpacked") -> None:
    """Refuse a file that unpacks to more than its size makes likely.

    Args:
        path: The file.
        claimed: Bytes that it unpacks to, all of its content together.
        what: What the bytes are, for the error.

    Raises:
        FileError: They are more than `unpacked_allowance` allows.
    """
    check_claim(path, what, claimed, unpacked_allowance(regular_size(path)))


def unpacked_allowance(size: int, *, least: int | None = None) -> int:
    """Bytes that packed content may unpack to.

    Args:
        size: Packed size [bytes].
        least: What any size may unpack to; None for `ReadLimits.unpacked`.

    Returns:
        The larger of that and `ReadLimits.ratio` times the size.
    """
    return max(limits().unpacked if least is None else least, limits().ratio * size)


def check_archive(path: Path) -> None:
    """Refuse a zip archive, such as `.npz` and `.pt` files are, that unpacks to more than its size makes likely.

    Args:
        path: The file; what is no archive passes.

    Raises:
        FileError: It is no regular file, or unpacks to more than `unpacked_allowance` or `ReadLimits.pickled` allow.
    """
    regular_size(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from error
    except Exception:  # no archive, or a damaged one: whoever reads it says so
        return
    check_unpacked(path, sum(member.file_size for member in members))
    pickled = sum(member.file_size for member in members if member.filename.endswith(".pkl"))
    check_claim(path, "bytes of values beside its tensors", pickled, limits().pickled)


def check_pixels(path: Path, width: int, height: int) -> None:
    """Refuse an image of more pixels than `ReadLimits.pixels`.

    Args:
        path: The file.
        width: Declared width [px].
        height: Declared height [px].

    Raises:
        FileError: It has more, or none.
    """
    if width < 1 or height < 1:
        raise FileError(path, f"claims {width} by {height} pixels, expected at least one each way")
    check_claim(path, f"pixels ({width} by {height})", width * height, limits().pixels)


def _count(number: float) -> str:
    return f"{number:,.0f}" if number < 1e15 else f"{number:.0e}"
