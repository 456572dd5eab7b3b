"""`make profile`: where a diagnosis's time goes, on one thread.

    python -m benchmarks.profile FILE.h5 [KEY=VALUE ...]

Keys are those of `tossid diagnose` (`tosses=40`, `split=train`). Without a file twelve tosses are made. The times are
of Python's own profiler, which slows Python down more than compiled kernels.
"""

from __future__ import annotations

import cProfile
import pstats
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import yaml

from pipelines.cli.console import Console

SHOWN = 40
"""Functions of tossid in the table: those in which, with what they call, the most time is spent."""
HEADS = ("function", "CPU s with what it calls", "share", "of its own", "calls")


def main() -> None:
    """Diagnose a dataset's tosses on one thread, and print where the time went."""
    from tossid.diagnosis.diagnose import prepare
    from tossid.diagnosis.under_way import UnderWay
    from tossid.settings.changed import changed
    from tossid.settings.diagnosis.diagnose import DiagnoseSettings
    from tossid.store import read_dataset

    console = Console()
    paths = [word for word in sys.argv[1:] if "=" not in word]
    keys: dict[str, Any] = dict(word.split("=", 1) for word in sys.argv[1:] if "=" in word)
    settings = changed(DiagnoseSettings(threads=1), {name: yaml.safe_load(value) for name, value in keys.items()})
    with tempfile.TemporaryDirectory() as folder:
        dataset = read_dataset(Path(paths[0]) if paths else made(Path(folder)))
    prepare(dataset, settings=settings)  # loads or compiles kernels
    profiler, began = cProfile.Profile(time.process_time), time.process_time()
    with profiler:
        found = prepare(dataset, settings=settings).run(UnderWay())
    seconds = time.process_time() - began
    console.table(HEADS, rows(pstats.Stats(profiler), seconds), title=f"{found.n_tosses} tosses, one thread")
    console.say(f"{seconds:.1f} s of CPU. {found.verdict}: {', '.join(found.named) or 'nothing'}.")


def rows(stats: pstats.Stats, seconds: float) -> list[list[str]]:
    """The table's rows, the longest first.

    Args:
        stats: What was measured.
        seconds: Of all of it.
    """
    measured: dict[tuple[str, int, str], tuple[int, int, float, float, Any]] = stats.stats  # type: ignore[attr-defined]
    ours = [(key, value) for key, value in measured.items() if "/tossid/" in key[0]]
    table = []
    for (file, _, name), (_, calls, own, whole, _) in sorted(ours, key=lambda item: -item[1][3])[:SHOWN]:
        where = f"{file.rpartition('/tossid/')[2].removesuffix('.py').replace('/', '.')}:{name}"
        table.append([where, f"{whole:.2f}", f"{100 * whole / seconds:.0f} %", f"{own:.2f}", f"{calls:,}"])
    return table


def made(folder: Path) -> Path:
    """Twelve tosses of a cube as MuJoCo has them, with noise; friction is 0.3, where 0.18 is stated."""
    from pipelines.cli.call import call_with_keys

    keys = ["object=cube", "effects={friction: {mu: 0.3}}", "engine=mujoco", "tosses=12", f"out={folder}/made"]
    keys += ["frames=false", "noise.position=0.00015", "noise.rotation=0.0015"]
    call_with_keys("synthesize", keys, json=False, quiet=True)
    return folder / "made" / "tosses.h5"


if __name__ == "__main__":
    from pipelines.cli.failures import guarded

    sys.exit(guarded(main, "profile"))
