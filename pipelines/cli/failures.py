"""How a command ends when it does not succeed: one line, the right exit code, a log for bugs."""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import typer

from pipelines.execution.process import interruptible
from pipelines.tracking.addresses import redacted
from tossid.errors import TossidError

LOGS = Path("outputs/logs")
"""Where tracebacks of unexpected errors go."""

INTERRUPTED = 130

_OPTIONS = ("--json", "--quiet", "-q", "--debug")
"""Those that every command has."""


class Interrupted(Exception):
    """The user (or the system) asked the command to stop.

    Raised in place of KeyboardInterrupt once the command has cleaned up, with what it leaves, if that is anything.
    """


def guarded(work: Callable[[], object], name: str) -> int:
    """Do the work of a script as a command's is done: errors are one line; returns the exit code."""
    try:
        with interruptible():
            work()
        return 0
    except (Exception, KeyboardInterrupt) as error:
        return report(error, [name, *sys.argv[1:]])


_SQLITE = {
    "database or disk is full": "the disk is full (MLflow's store)",
    "disk I/O error": "the disk reports an input/output error (MLflow's store)",
    "readonly database": "MLflow's store is read-only",
}


def report(error: BaseException, args: list[str]) -> int:
    """Print the one line for an error on standard error; returns the exit code."""
    command = args[0] if args and not args[0].startswith("-") else ""
    if "--debug" in args and not isinstance(error, typer.TyperException):
        _print("".join(traceback.format_exception(error)).rstrip())
    line, code = _explain(error, args)
    if line:
        who = f"tossid {command}" if command.isalpha() and not isinstance(error, typer.TyperException) else "tossid"
        _print(f"{who}: {line}")
    return code


def _explain(error: BaseException, args: list[str]) -> tuple[str, int]:
    if was_interrupted(error):
        left = isinstance(error, Interrupted) and str(error)
        return (
            f"interrupted; {left or 'what was there before is unchanged, and the command can be run again'}",
            INTERRUPTED,
        )
    if isinstance(error, TossidError):
        return _one_line(error), error.exit_code
    if isinstance(error, typer.TyperException):
        return _usage(error, args), error.exit_code
    if isinstance(error, BrokenPipeError):
        return "", 1
    of_store = (cause for cause in _causes(error) if type(cause).__module__ == "sqlite3")
    for cause in (error, *of_store):  # MLflow wraps its store's errors
        problem = _disk_problem(cause)
        if problem is not None:
            name = getattr(cause, "filename", None)
            return f"{name}: {problem}" if name else problem, 1
    if isinstance(error, MemoryError):
        return "out of memory", 1
    refused = next((cause for cause in _causes(error) if type(cause).__module__ == "mlflow.exceptions"), None)
    if refused is not None:
        first = str(refused).partition("\n")[0]
        why = "is its server away, or was something deleted there meanwhile?"
        return f"MLflow's store refuses ({first}); {why} The command can be run again", 1
    what = f"{type(error).__name__}: {_one_line(error)}".rstrip(": ")
    return f"this is a bug in tossid ({what[:200]}); {_log(error, args)}", 1


def _disk_problem(error: BaseException) -> str | None:
    """What the disk refused, also where SQLite says it, in whose text alone it stands."""
    from tossid.outputs import disk_problem

    if type(error).__module__ == "sqlite3":
        return next((words for text, words in _SQLITE.items() if text in str(error)), None)
    return disk_problem(error)


def was_interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error; libraries may wrap it (Python itself does, while a class is made).

    Args:
        error: What was raised.
    """
    return any(isinstance(cause, (KeyboardInterrupt, Interrupted, typer.Abort)) for cause in _causes(error))


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """An error and what is behind it, each once: a chain may lead back to itself."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__


def _usage(error: typer.TyperException, args: list[str]) -> str:
    """Typer's own errors, which name what is near; and keys and options that stand where Typer does not look."""
    from pipelines.cli.help import command_keys, command_names
    from pipelines.config.keys import nearest

    message = _one_line(error.format_message())
    if message.startswith("No such command") and "Did you mean" not in message:
        return f"{message} There are {', '.join(command_names())}."
    option = str(getattr(error, "option_name", ""))
    if option in _OPTIONS and args[0] not in command_names():
        return f"{option}: no such option before a command. It stands after one: tossid COMMAND {option}."
    if not message.startswith("No such option") or getattr(error, "possibilities", None):
        return message
    key = nearest(option.lstrip("-").partition("=")[0], command_keys(args[0]))
    return f"{message}. Keys are given without dashes: {key}=…" if key else message


def _log(error: BaseException, args: list[str]) -> str:
    """Write the traceback to a log; returns where it lies."""
    from pipelines.execution.code_version import version_line

    name = f"{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}.log"
    lines = [version_line(), f"arguments: {args}", f"folder: {os.getcwd()}", "", *traceback.format_exception(error)]
    try:
        LOGS.mkdir(parents=True, exist_ok=True)
        (LOGS / name).write_text(redacted("\n".join(lines)))
    except OSError:
        return "--debug shows the traceback"
    return f"the traceback is in {LOGS / name}"


def _print(line: str) -> None:
    with suppress(OSError):
        print(redacted(line), file=sys.stderr, flush=True)  # noqa: T201


def _one_line(what: object) -> str:
    return " ".join(str(what).split())
