"""One tree of errors. Each carries its evidence: the file, key or problem that failed."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

_BRIEF = reprlib.Repr()
_BRIEF.maxlevel, _BRIEF.maxstring, _BRIEF.maxother, _BRIEF.maxlong = 2, 60, 60, 60


def brief(value: Any) -> str:
    """A value from outside in an error's words, however large, deep or long it is."""
    try:
        text = _BRIEF.repr(value)
    except ValueError:  # Python prints no integer of more than some thousand digits
        text = f"a long {type(value).__name__}"
    return "".join(c if c.isprintable() else "?" for c in text)


def nearest(word: str, candidates: Iterable[str]) -> str | None:
    """The candidate whose spelling is nearest to a word, None if none is near."""
    return next(iter(get_close_matches(word, list(candidates), n=1)), None)


class TossidError(Exception):
    """Anything tossid knows how to explain in one line.

    `exit_code` is what the command line returns: 2 for a wrong call or bad
    input, 1 for a failure inside.
    """

    exit_code = 1

    def __reduce__(self) -> tuple[Any, ...]:
        # errors come back from workers pickled; arguments of their own are in their text already
        return _restored, (type(self), self.args, self.__dict__)


def _restored(kind: type[TossidError], args: tuple[Any, ...], evidence: dict[str, Any]) -> TossidError:
    """An error as it was, whatever it was made from."""
    error = kind.__new__(kind)
    error.args = args
    error.__dict__.update(evidence)
    return error


class InputError(TossidError):
    """What the caller handed over cannot be used."""

    exit_code = 2


class FileError(InputError):
    """A file that is missing, damaged, or not what it should be.

    Args:
        path: the file.
        problem: what is wrong with it, and what was expected.
        row: the row, toss or frame at fault, where there is one.
    """

    def __init__(self, path: str | Path, problem: str, *, row: int | str | None = None) -> None:
        self.path = Path(path)
        self.problem = problem
        self.row = row
        where = f"{path}" if row is None else f"{path}, row {row}" if isinstance(row, int) else f"{path}, {row}"
        super().__init__(f"{where}: {problem}")


class MotionError(InputError):
    """Time, q or v arrays that are not a motion (shape, finiteness, norm, order).

    Args:
        problem: what is wrong, and what was expected.
        row: index of the first sample at fault.
    """

    def __init__(self, problem: str, *, row: int | None = None) -> None:
        self.problem = problem
        self.row = row
        super().__init__(problem if row is None else f"row {row}: {problem}")


class ConfigError(InputError):
    """A key or value of the call or of `conf/` that is unknown or has the wrong type.

    Args:
        key: the dotted key.
        problem: what is wrong with it.
        suggestion: the nearest valid spelling, if one is near.
    """

    def __init__(self, key: str, problem: str, *, suggestion: str | None = None) -> None:
        self.key = key
        self.suggestion = suggestion
        hint = f" Did you mean '{suggestion}'?" if suggestion else ""
        super().__init__(f"{key}: {problem}{hint}")


class ObjectError(InputError):
    """An object description (MJCF, URDF) that tossid cannot simulate or learn."""


class OutputError(TossidError):
    """An output that could not be written (disk full, read-only, permissions)."""


class SolverError(TossidError):
    """A contact problem or a fit that was not solved where a solution is required.

    Args:
        problem: what failed.
        count: how many problems of `total` failed.
    """

    def __init__(self, problem: str, *, count: int = 1, total: int = 1) -> None:
        self.count = count
        self.total = total
        super().__init__(f"{problem} ({count} of {total})")


class DivergedError(TossidError):
    """A state or a loss that became non-finite; carries the state that led to it.

    Args:
        problem: what became non-finite.
        state: the last finite state, for the log.
    """

    def __init__(self, problem: str, *, state: object = None) -> None:
        self.state = state
        super().__init__(problem)
