"""Between the command line and a command's `run`: standard output guarded, the result as JSON."""

from __future__ import annotations

import importlib
import json as jsonlib
import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import Any

from pipelines.cli.console import Console
from pipelines.tracking.addresses import redacted
from tossid.plain_json import jsonable


def call_with_keys(command: str, keys: Sequence[str], *, json: bool, quiet: bool) -> Any:
    """Compose the config of `command` from `conf/` and `keys`, then `call` it; returns its result."""
    from pipelines.config.compose import load
    from pipelines.config.schemas import COMMANDS

    config: object = load(command, COMMANDS[command], keys)
    return call(command, config, json=json, quiet=quiet)


def call(command: str, argument: Any, *, json: bool, quiet: bool) -> Any:
    """Run `pipelines.COMMAND.run(argument, console)`, print its result if `json`, and return it."""
    console = Console(quiet=quiet)
    with guarded_stdout(), logged(console):
        result = _runner(command)(argument, console)
    if json:
        print(jsonlib.dumps(_redacted(jsonable(result)), indent=2, allow_nan=False), flush=True)  # noqa: T201
    return result


def _redacted(value: Any) -> Any:
    """Plain values without the passwords of addresses."""
    if isinstance(value, str):
        return redacted(value)
    if isinstance(value, dict):
        return {name: _redacted(one) for name, one in value.items()}
    return [_redacted(one) for one in value] if isinstance(value, list) else value


def _runner(command: str) -> Callable[[Any, Console], Any]:
    """`run` of the command's module, imported only now."""
    run: Callable[[Any, Console], Any] = importlib.import_module(f"pipelines.commands.{command.replace('-', '_')}").run
    return run


@contextmanager
def guarded_stdout() -> Iterator[None]:
    """Send everything printed on standard output, by C libraries too, to standard error."""
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


@contextmanager
def logged(console: Console) -> Iterator[None]:
    """Show what the library logs, each line once, while the block lasts.

    Args:
        console: What a person sees.
    """
    logger, handler = logging.getLogger("tossid"), _Lines(console)
    level, propagates = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = propagates


class _Lines(logging.Handler):
    """Log records as lines of a console."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console, self._said = console, set[str]()

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if text not in self._said:
            self._said.add(text)
            (self._console.say if record.levelno < logging.WARNING else self._console.warn)(text)
