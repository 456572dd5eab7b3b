"""Make the recording that ships, data/raw/sample: a cube whose friction is not what its file states.

    python -m experiments.sample [FOLDER]

A cube of friction 0.28, where the stated cube has 0.18, is tossed twenty times and filmed by two cameras. All frames
are ingested to FOLDER/tosses.h5. Then the frames after the twelfth toss are deleted, so that the folder stays below
6 MB; the truth beside them is that of all tosses.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import tossid
from pipelines.cli.call import logged
from pipelines.cli.console import Console
from tossid.settings.synthesis import CameraSettings, LcpEngine, ReleaseSettings, SynthesizeSettings
from tossid.store import read_dataset, write_dataset

WORLD = SynthesizeSettings(
    engine=LcpEngine(),
    effects={"friction": {"mu": 0.28}},
    tosses=20,
    seed=1,
    release=ReleaseSettings(height=(0.08, 0.2)),
    camera=CameraSettings(
        count=2,
        width=400,
        height=320,
        samples=8,
        noise=0.0,  # it is most of what an image takes
        quality=50,
        carry_s=(0.18, 0.22),
        pause_s=(0.15, 0.15),
    ),
)
FILMED = 12
"""Tosses whose frames are kept."""
MOST_BYTES = 6_000_000
"""Of all files."""
AFTER_S = 0.2
"""Of the film that is kept after the last of these tosses [s]."""


def main(folder: Path) -> None:
    """Make the recording and its dataset.

    Args:
        folder: Must be missing, or hold an earlier one.
    """
    console = Console()
    with logged(console), console.shares("sample") as progress:
        true = tossid.synthesize("cube", frames=True, out=folder, settings=WORLD, progress=progress)
        dataset = tossid.ingest(folder, object="cube")
    if len(dataset.tosses) != WORLD.tosses:
        raise SystemExit(f"{len(dataset.tosses)} of {WORLD.tosses} tosses were found")
    provenance = {**dataset.provenance, "command": "python -m experiments.sample"}
    write_dataset(replace(dataset, provenance=provenance), folder / "tosses.h5")
    end_ns = 1e9 * (true.tosses[FILMED - 1].t[-1] + AFTER_S)
    for frame in (folder / "frames").rglob("*.jpg"):
        if int(frame.stem) > end_ns:
            frame.unlink()
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    if size > MOST_BYTES:
        raise SystemExit(f"{folder} has {size} bytes, more than {MOST_BYTES}")
    console.say(f"{folder}: {size / 1e6:.2f} MB; {read_dataset(folder / 'tosses.h5')}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("data/raw/sample"))
