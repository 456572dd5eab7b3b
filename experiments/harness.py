"""What studies share: options, cases that run once each and are kept one JSON line a case, and Markdown tables."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipelines.cli.console import Console
from pipelines.config.schemas import ProcessesLauncher
from pipelines.execution.workers import submitting
from tossid.errors import TossidError
from tossid.parallel import as_done

Case = Mapping[str, Any]
"""What tells a case from others, as plain values."""
Line = dict[str, Any]
"""A case with what was measured of it, or with `failed`, the error that it ended in."""


def options(text: str, arguments: Sequence[str] | None = None, **known: Any) -> argparse.Namespace:
    """What a study is asked for on the command line.

    Args:
        text: The module's docstring.
        arguments: Words; None for those of the process.
        **known: A type for what has to be given (as `out=Path`), or the default of an option. A tuple takes several
            values, and False is a switch.
    """
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in known.items():
        flag = f"--{name.replace('_', '-')}"
        if isinstance(default, type):
            parser.add_argument(name, type=default)
        elif default is False:
            parser.add_argument(flag, action="store_true")
        elif isinstance(default, tuple):
            parser.add_argument(flag, nargs="*", type=type(default[0]), default=default)
        else:
            parser.add_argument(flag, type=type(default), default=default)
    return parser.parse_args(arguments)


def measured(out: Path, cases: Iterable[Case], measure: Callable[[Case], Line], *, processes: int = 1) -> list[Line]:
    """A line for each case, in their order. Cases that a file has are not run again, so that a study goes on.

    Args:
        out: The file of lines, which new ones are added to as they are done.
        cases: Which lines are wanted.
        measure: What is found of a case. With several processes it has to be a function of a module.
        processes: How many cases are computed at once.
    """
    wanted: list[Case] = [json.loads(json.dumps(case)) for case in cases]
    lines = read_lines(out)
    missing = [case for case in wanted if not any(_is_of(line, case) for line in lines)]
    out.parent.mkdir(parents=True, exist_ok=True)
    console = Console()
    with (
        submitting(ProcessesLauncher("processes"), processes, len(missing)) as submit,
        console.progress(out.stem, len(missing), unit="cases") as bar,
    ):
        for case, found in as_done(measure, missing, submit):
            line = {**case, **({"failed": str(found)} if isinstance(found, TossidError) else found)}
            text = json.dumps(line, default=float)
            with out.open("a", encoding="utf-8") as file:
                file.write(text + "\n")
            lines.append(json.loads(text))
            bar.advance(1, note=" ".join(map(str, case.values())))
    return [next(line for line in lines if _is_of(line, case)) for case in wanted]


def read_lines(path: Path) -> list[Line]:
    """The lines of a file; none if it is not there yet."""
    return [json.loads(text) for text in path.read_text().splitlines()] if path.is_file() else []


def _is_of(line: Line, case: Case) -> bool:
    return all(line.get(key) == value for key, value in case.items())


def markdown(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in (heads, ["---"] * len(heads), *rows))


def succeeded(lines: Iterable[Line]) -> Iterator[Line]:
    """The lines of cases that did not fail; the others are printed."""
    for line in lines:
        if "failed" in line:
            print(line)
        else:
            yield line
