"""`make profile`: where a diagnosis's time goes, by stage, on one thread.

    python -m benchmarks.profile FILE.h5 [KEY=VALUE ...]

Keys are those of `tossid diagnose` (`tosses=40`, `split=train`, `likelihood.simulation.substeps=4`). Without a file
twelve tosses are made. CPU time and simulated frames count for the innermost stage that is under way.
"""

from __future__ import annotations

import functools
import importlib
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from pipelines.cli.console import Console

STAGES: tuple[tuple[str, str], ...] = (
    ("windows", "tossid.diagnosis.likelihood.windows:make_windows"),
    ("evidence from the recording", "tossid.diagnosis.inference.evidence:collect"),
    ("screening", "tossid.diagnosis.inference.screening:screen"),
    ("fits", "tossid.diagnosis.inference.fitting:fit"),
    ("changes over the order", "tossid.diagnosis.inference.order:over_order"),
    ("gap", "tossid.diagnosis.localisation.gap:measure_gap"),
    ("whole tosses", "tossid.diagnosis.inference.brings:whole_tosses"),
    ("tosses without each effect", "tossid.diagnosis.inference.brings:worsen"),
    ("limit by noise", "tossid.diagnosis.inference.brings:noise_limit"),
    ("solver disagreement", "tossid.diagnosis.localisation.disagreement:solver_disagreement"),
    ("place", "tossid.diagnosis.localisation.corners:place_of"),
    ("witnesses", "tossid.diagnosis.localisation.witnesses:witnesses"),
    ("next toss", "tossid.diagnosis.next_toss:next_toss"),
    ("patch and rerun", "tossid.diagnosis.diagnose:_patch"),
)
"""What a stage is called, and its function."""
WORK: tuple[tuple[str, str], ...] = (
    ("tossid's simulator", "tossid.physics.stepping:simulate"),
    ("MuJoCo", "tossid.diagnosis.likelihood.engine_discrepancy:MujocoWorld.roll_out"),
    ("first states and whitening", "tossid.diagnosis.likelihood.whitening:linearised"),
    ("residuals", "tossid.diagnosis.likelihood.residuals:mean_residuals"),
)
"""What is done in a stage, and its function."""


@dataclass
class Ledger:
    """CPU seconds of each name's innermost calls, calls, and simulated motions and frames."""

    names: list[str] = field(default_factory=lambda: ["the rest"])
    since: float = field(default_factory=time.process_time)
    seconds: dict[str, float] = field(default_factory=dict)
    calls: dict[str, int] = field(default_factory=dict)
    motions: dict[str, int] = field(default_factory=dict)
    frames: dict[str, int] = field(default_factory=dict)

    @contextmanager
    def under(self, name: str) -> Iterator[None]:
        """Time goes to this name until the block ends, but for names inside it."""
        self._charge()
        self.names.append(name)
        self.calls[name] = self.calls.get(name, 0) + 1
        try:
            yield
        finally:
            self._charge()
            self.names.pop()

    def switch(self, name: str) -> None:
        """Time goes to this name from now on."""
        self._charge()
        self.names[-1] = name

    def simulated(self, motions: int, frames: int) -> None:
        """Count motions for what is under way."""
        name = self.names[-1]
        self.motions[name] = self.motions.get(name, 0) + motions
        self.frames[name] = self.frames.get(name, 0) + frames

    def _charge(self) -> None:
        now = time.process_time()
        self.seconds[self.names[-1]] = self.seconds.get(self.names[-1], 0.0) + now - self.since
        self.since = now

    def rows(self) -> list[list[str]]:
        """A table's rows: name, CPU seconds, share, calls, motions, frames; the longest first."""
        self._charge()
        whole = sum(self.seconds.values())
        order = sorted(self.seconds, key=lambda name: -self.seconds[name])
        return [
            [
                name,
                f"{self.seconds[name]:.2f}",
                f"{100 * self.seconds[name] / whole:.1f} %",
                f"{self.calls.get(name, 0):,}",
                f"{self.motions.get(name, 0):,}",
                f"{self.frames.get(name, 0):,}",
            ]
            for name in order
        ]


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
    keys = {name: yaml.safe_load(value) for name, value in keys.items()}
    with tempfile.TemporaryDirectory() as folder:
        dataset = read_dataset(Path(paths[0]) if paths else made(Path(folder)))
    settings = changed(DiagnoseSettings(threads=1), keys)
    prepare(dataset, settings=settings)  # loads or compiles kernels
    stages, work, phases = Ledger(), Ledger(), Ledger()
    observe(STAGES, stages)
    observe(WORK, work, count=stages)
    began, wall = time.process_time(), time.perf_counter()

    def progress(text: str, share: float) -> None:
        phases.switch(text)

    found = prepare(dataset, settings=settings).run(UnderWay(progress))
    seconds, wall = time.process_time() - began, time.perf_counter() - wall
    heads = ["", "CPU s", "share", "calls", "motions", "frames"]
    console.table(heads, stages.rows(), title="By stage")
    console.table(heads[:4], [row[:4] for row in work.rows()], title="By what is done")
    console.table(heads[:3], [row[:3] for row in phases.rows()], title="By what the command reports as under way")
    named = ", ".join(found.named) or "nothing"
    console.say(f"{found.n_tosses} tosses, one thread: {seconds:.1f} s of CPU, {wall:.1f} s. {found.verdict}: {named}.")


def made(folder: Path) -> Path:
    """Twelve tosses of a cube as MuJoCo has them, with noise; friction is 0.3, where 0.18 is stated."""
    from pipelines.cli.call import call_with_keys

    keys = [
        "object=cube",
        "effects={friction: {mu: 0.3}}",
        "engine=mujoco",
        "tosses=12",
        "seed=0",
        f"out={folder}/made",
    ]
    keys += ["frames=false", "noise.position=0.00015", "noise.rotation=0.0015"]
    call_with_keys("synthesize", keys, json=False, quiet=True)
    return folder / "made" / "tosses.h5"


def observe(functions: tuple[tuple[str, str], ...], ledger: Ledger, count: Ledger | None = None) -> None:
    """Charge calls of functions to a ledger, wherever tossid has them; count motions of simulators in another."""
    for name, where in functions:
        module_name, _, path = where.partition(":")
        owner: Any = importlib.import_module(module_name)
        *outer, attribute = path.split(".")
        for part in outer:
            owner = getattr(owner, part)
        original = getattr(owner, attribute)
        observed = _observed(name, original, ledger, count)
        setattr(owner, attribute, observed)
        for loaded in [each for key, each in sys.modules.items() if key.startswith("tossid.")]:
            if getattr(loaded, attribute, None) is original:
                setattr(loaded, attribute, observed)


def _observed(name: str, function: Callable[..., Any], ledger: Ledger, count: Ledger | None) -> Callable[..., Any]:
    @functools.wraps(function)
    def observed(*args: Any, **kwargs: Any) -> Any:
        if count is not None and "n_steps" in kwargs:
            import numpy as np

            steps = kwargs["n_steps"]
            count.simulated(len(args[1]), int(np.broadcast_to(steps, len(args[1])).sum()))
        with ledger.under(name):
            return function(*args, **kwargs)

    return observed


if __name__ == "__main__":
    from pipelines.cli.failures import guarded

    sys.exit(guarded(main, "profile"))
