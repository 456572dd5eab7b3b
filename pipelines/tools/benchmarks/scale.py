"""`make scale`: time and memory of the commands against tosses, minutes of film, and workers. Hours, by default.

Every command runs in a process of its own; what it and its children took is what the system says at their end. The
film is two filmed tosses over and over, its images linked under later time stamps.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from pipelines.drawing.figures import write_figures
from tossid.outputs import output_file

TOSSES = (10, 100, 1000, 10000)
MINUTES = (1, 5, 20, 60)
WORKERS = (1, 2)
MOST_DIAGNOSED = 1000
"""Tosses that a diagnosis is asked about at most: it takes 8 MiB of memory for each."""
STUDIED = 100
"""Tosses of the study that workers share."""
TOSSED = ("frames=false", "engine=lcp", "noise.position=1.5e-4", "noise.rotation=1.5e-3", "seconds=0.7")
FILM = (
    "tosses=2",
    "seed=3",
    "rate_hz=60",
    "camera.count=2",
    "camera.width=640",
    "camera.height=512",
    "camera.samples=4",
)
TRAIN = ("model=cnrpi", "epochs=4")
STUDY = (
    "--sweep",
    "gravity",
    "sweep.models=[cn,cnrp]",
    "sweep.values=[0,4.905,9.81]",
    "sweep.seeds=[0,1,2,3]",
    "sweep.train=['epochs=60']",
)
OUT = Path("outputs/scale")
MEASURE = """
import json, resource, subprocess, sys, time
started = time.monotonic()
status = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
elapsed, used = time.monotonic() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([status, elapsed, used.ru_utime + used.ru_stime, used.ru_maxrss]))
"""
"""Runs a command from a small process: Linux counts what a process's parent held as the process's own."""
PAUSE_NS = 500_000_000
"""Between the end of a film and its next time."""


class Took(NamedTuple):
    """What a command took: elapsed and CPU seconds, and the most memory of one of its processes [GiB]."""

    what: str
    size: float
    elapsed: float
    cpu: float
    memory: float


def main(tosses: Sequence[int] = TOSSES, minutes: Sequence[float] = MINUTES) -> None:
    """Measure, print and draw; figures and numbers lie in `OUT`, each number as soon as it is there."""
    from tossid.evaluation.figures import costs_of_size

    console, rows = Console(), list[Took]()
    with tempfile.TemporaryDirectory() as name:
        for took in _all(Path(name), tosses, minutes, console):
            rows.append(took)
            with output_file(OUT / "scale.json") as temporary:
                temporary.write_text(json.dumps([row._asdict() for row in rows], indent=1))
    heads = ["command", "size", "elapsed s", "CPU s", "memory GiB"]
    table = [[r.what, f"{r.size:g}", f"{r.elapsed:.1f}", f"{r.cpu:.1f}", f"{r.memory:.2f}"] for r in rows]
    console.table(heads, table, title="Tosses; minutes of film (two cameras of 640 by 512 px at 60 Hz); workers")
    for path in write_figures({"scale": costs_of_size(_panels(rows))}, OUT):
        console.say(f"figure: {path}")


def _all(folder: Path, tosses: Sequence[int], minutes: Sequence[float], console: Console) -> Iterator[Took]:
    for n in tosses:
        yield from _tosses(folder, n, console)
    for n in WORKERS:
        # each anew: what is computed is not computed again
        (folder / f"workers-{n}").mkdir()
        keys = [*STUDY, f"data=../tosses-{STUDIED}"]
        yield _taken("study", n, folder / f"workers-{n}", console, ["evaluate", *keys, f"sweep.workers={n}"])
        (folder / f"cluster-{n}").mkdir()
        with _cluster(folder / f"cluster-{n}", n) as address:
            there = ["launcher=dask", f"launcher.address={address}", "launcher.wait_s=60"]
            yield _taken("study by Dask", n, folder / f"cluster-{n}", console, ["evaluate", *keys, *there])
    yield from _film(folder, minutes, console)


@contextmanager
def _cluster(folder: Path, workers: int) -> Iterator[str]:
    """The address of a Dask scheduler with so many workers of one thread, each a process of this machine."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with ExitStack() as ends, (folder / "cluster.log").open("ab") as log:
        address = f"tcp://127.0.0.1:{port}"
        scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
        worker = ["worker", address, "--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)]
        for args in (scheduler, *[worker] * workers):
            command = [sys.executable, "-m", f"distributed.cli.dask_{args[0]}", *args[1:]]
            process = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)
            ends.callback(process.wait)
            ends.callback(process.terminate)
        yield address


def _tosses(folder: Path, n: int, console: Console) -> Iterator[Took]:
    """The commands on so many tosses, which come through TUM files."""
    data = f"tosses-{n}"
    keys = [*TOSSED, f"tosses={n}", f"out={data}"]
    yield _taken("synthesize", n, folder, console, ["synthesize", *keys])
    _as_tum(folder / data, folder / f"tum-{n}")
    keys = ["source=tum", f"source.path=tum-{n}", "object=cube", f"out={data}.h5"]
    yield _taken("ingest", n, folder, console, ["ingest", *keys])
    yield _taken("train", n, folder, console, ["train", *TRAIN, f"data={data}"])
    yield _taken("evaluate", n, folder, console, ["evaluate", f"data={data}"])
    if n <= MOST_DIAGNOSED:
        yield _taken("diagnose", n, folder, console, ["diagnose", f"data={data}"])


def _as_tum(data: Path, out: Path) -> None:
    from tossid.store import open_dataset, write_tum

    with open_dataset(data / "tosses.h5") as dataset:
        write_tum(out, dataset.tosses)


def _film(folder: Path, minutes: Sequence[float], console: Console) -> Iterator[Took]:
    """`ingest` of the same tosses, filmed over and over."""
    _taken("film", 1, folder, console, ["synthesize", *FILM, "out=film"])
    for length in minutes:
        _repeated(folder / "film", folder / "long", 60.0 * length)
        yield _taken("ingest film", length, folder, console, ["ingest", "source.path=long", "out=long.h5"])


def _repeated(film: Path, out: Path, seconds: float) -> None:
    """Link a recording's images as often as fills so many seconds; what is in `out` already stays."""
    cameras = sorted(path for path in (film / "frames").iterdir())
    stamps = [int(path.stem) for path in cameras[0].iterdir()]
    length = max(stamps) - min(stamps) + PAUSE_NS
    for camera in cameras:
        own = out / "frames" / camera.name
        own.mkdir(parents=True, exist_ok=True)
        for turn in range(max(1, round(seconds * 1e9 / length))):
            for path in camera.iterdir():
                link = own / f"{int(path.stem) + turn * length:015d}{path.suffix}"
                if not link.exists():
                    os.link(path, link)
    for path in film.iterdir():
        if path.is_file() and not path.name.startswith("truth"):
            (out / path.name).write_bytes(path.read_bytes())


def _taken(what: str, size: float, folder: Path, console: Console, args: Sequence[str]) -> Took:
    """Run a command in the folder to its end.

    Raises:
        subprocess.CalledProcessError: it failed; its own words are on standard error.
    """
    console.say(f"$ tossid {' '.join(args)}")
    command = [sys.executable, "-m", "pipelines.cli.app", *args, "--quiet"]
    measured = subprocess.run([sys.executable, "-c", MEASURE, *command], cwd=folder, stdout=subprocess.PIPE, check=True)
    status, elapsed, cpu, memory = json.loads(measured.stdout)
    if status:
        raise subprocess.CalledProcessError(status, command)
    return Took(what, size, elapsed, cpu, memory / 2**20)


def _panels(rows: Sequence[Took]) -> dict[str, dict[str, list[tuple[float, float, float]]]]:
    """Costs by what counts as size, and by command."""
    by_size = {
        "tosses [count]": ("synthesize", "ingest", "train", "evaluate", "diagnose"),
        "film [min]": ("ingest film",),
    }
    return {
        size: {name: [(r.size, r.cpu, r.memory) for r in rows if r.what == name] for name in names}
        for size, names in by_size.items()
    }


if __name__ == "__main__":
    sys.exit(guarded(main, "scale"))
