"""The command line: Typer for commands and options, `pipelines.config.compose` for keys.

To add a command: a schema in `pipelines.config.schemas` (and in its `COMMANDS`), its
values in `conf/NAME.yaml`, and `run(config, console) -> dict` in
`pipelines/commands/NAME.py`. Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from pipelines.cli.help import KeyedCommand, complete_keys
from pipelines.config.schemas import COMMANDS

app = typer.Typer(
    name="tossid",
    help="Learn an object's contact and continuous dynamics from its tosses, and why a simulator is wrong about it.",
    epilog="Values are set as KEY=VALUE. 'tossid COMMAND --help' lists a command's keys.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


_QUIET = {"OPENCV_LOG_LEVEL": "OFF", "OPENCV_FFMPEG_LOGLEVEL": "-8"}
"""So that OpenCV says nothing on standard error about a damaged image or video, of which the command says it."""


Keys = Annotated[
    list[str] | None,
    typer.Argument(metavar="KEY=VALUE", help="Values to set.", show_default=False, autocompletion=complete_keys),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output, nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No tables and no progress; warnings and errors remain.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def _print_version(asked: bool) -> None:
    if asked:
        from pipelines.execution.code_version import version_line

        typer.echo(version_line())
        raise typer.Exit()


@app.callback()
def _tossid(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    pass


def _takes_keys(name: str) -> Callable[..., None]:
    """A command that takes keys and no options of its own."""

    def command(keys: Keys = None, json: Json = False, quiet: Quiet = False, debug: Debug = False) -> None:
        _run(name, keys or [], json=json, quiet=quiet)

    return command


def _evaluate(
    keys: Keys = None,
    sweep: Annotated[
        str | None,
        typer.Option("--sweep", metavar="NAME", help="Run the study in conf/sweep/NAME.yaml.", show_default=False),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    _run("evaluate", [*(keys or []), *([f"sweep={sweep}"] if sweep is not None else [])], json=json, quiet=quiet)


for _name, _schema in COMMANDS.items():
    _command = _evaluate if _name == "evaluate" else _takes_keys(_name)
    app.command(_name, help=_schema.__doc__, cls=KeyedCommand)(_command)


@app.command()
def doctor(json: Json = False, quiet: Quiet = False, debug: Debug = False) -> None:
    """Say what is installed, what is missing, and what to do about it."""
    from pipelines.cli.call import call

    call("doctor", None, json=json, quiet=quiet)


@app.command()
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Dataset, pose file or recording folder.")],
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw a dataset's tosses over order and place (.png).")
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Say what is in a dataset, a pose file or a recording."""
    from pipelines.cli.call import call
    from pipelines.commands.info import InfoRequest

    call("info", InfoRequest(file, figure), json=json, quiet=quiet)


def _run(command: str, keys: list[str], *, json: bool, quiet: bool) -> None:
    """Compose the command's config, run it, print its result."""
    from pipelines.cli.call import call_with_keys

    call_with_keys(command, keys, json=json, quiet=quiet)


def main(args: list[str] | None = None) -> None:
    """Entry point of `tossid`. Exits with 0, 2 (wrong call or bad input), 1 (failure inside) or 130 (interrupted)."""
    sys.exit(run(sys.argv[1:] if args is None else args))


def run(args: list[str]) -> int:
    """Run a command line; returns the exit code."""
    from pipelines.cli.failures import INTERRUPTED, Interrupted, report
    from pipelines.execution.process import interruptible

    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    try:
        with interruptible():
            code = app(args=args, prog_name="tossid", standalone_mode=False)
        if code == INTERRUPTED:  # Typer makes Ctrl-C a bare exit code
            return report(Interrupted(), args)
        return code if isinstance(code, int) else 0
    except (Exception, KeyboardInterrupt) as error:
        return report(error, args)


if __name__ == "__main__":
    main()
