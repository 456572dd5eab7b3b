"""Text from outside: a plain file of bounded size, in UTF-8 or, with a byte order mark, UTF-16."""

from __future__ import annotations

import codecs
from pathlib import Path

from tossid import budget
from tossid.errors import FileError


def read_text(path: Path, *, most: int, expected: str) -> str:
    """The text of a file. A byte order mark, as Windows writes it, is no part of it.

    Args:
        path: The file.
        most: Its largest size [bytes].
        expected: What the file should hold, for the error.

    Returns:
        The text, decoded.

    Raises:
        FileError: The file is missing, too large, or no text.
    """
    try:
        if budget.regular_size(path) > most:
            raise FileError(path, f"is larger than {most >> 20} MiB, expected {expected}")
        content = path.read_bytes()
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
    is_utf16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if is_utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(path, f"is not text in UTF-8, or UTF-16 with a byte order mark, expected {expected}") from error
    if "\0" in text:
        raise FileError(path, f"is not text in UTF-8, or UTF-16 with a byte order mark, expected {expected}")
    return text
