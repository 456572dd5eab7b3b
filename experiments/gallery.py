"""`make figures`: the commands on tosses made here, and the gallery of what they drew (docs/gallery.md)."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from pipelines.cli.call import call_with_keys
from pipelines.cli.failures import guarded
from pipelines.execution.code_version import ROOT

PAGE, FOLDER = "docs/gallery.md", "docs/gallery"
DATA = "data=tosses"
TOSSED = ("frames=false", "engine=lcp", "tosses=20", "noise.position=1.5e-4", "noise.rotation=1.5e-3")
STEPS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("", "synthesize", (*TOSSED, "effects={com_offset:{x_m:0.006}}", "out=tosses")),
    ("A training", "train", ("model=cnrpi", DATA)),
    ("The model on tosses that it has not seen", "evaluate", ()),
    (
        "A study: which models repair a wrong gravity?",
        "evaluate",
        ("sweep=gravity", "sweep.values=[0,9.81,19.62]", DATA),
    ),
    ("Why is my simulator wrong?", "diagnose", (DATA,)),
    (
        "An object that nobody has measured",
        "train",
        ("model=cnrpi", "object=unknown", "object.mass=0.37", DATA),
    ),
)
FILM = "hull_over_tosses.gif"
"""The film that the gallery shows beside the figures."""
HEAD = """# Gallery

What the commands draw: made by `make figures` from twenty simulated tosses of the cube, its centre of mass 6 mm off.
"""


def main(steps: tuple[tuple[str, str, tuple[str, ...]], ...] = STEPS, root: Path = ROOT) -> list[Path]:
    """Run the steps in a folder of their own; returns the figures in docs."""
    made: list[Path] = []
    text = HEAD
    here = Path.cwd()
    pictures = root / FOLDER
    with tempfile.TemporaryDirectory(prefix="tossid-gallery-") as folder:
        os.chdir(folder)
        os.environ.pop("MLFLOW_TRACKING_URI", None)
        try:
            results = [(step, call_with_keys(step[1], step[2], json=False, quiet=True)) for step in steps]
            shutil.rmtree(pictures, ignore_errors=True)
            pictures.mkdir(parents=True)
            for (title, command, keys), result in results:
                if not title:
                    continue
                text += f"\n## {title}\n\n    {_shown(command, keys)}\n"
                for path in _figures(result):
                    target = _unused(pictures / f"{command}-{path.name}")
                    shutil.copyfile(path, target)
                    made.append(target)
                    text += f"\n![{path.stem.replace('_', ' ')}](gallery/{target.name})\n"
        finally:
            os.chdir(here)
    (root / PAGE).write_text(text)
    return made


def _shown(command: str, keys: tuple[str, ...]) -> str:
    """The call as one types it."""
    words = [f"--sweep {key.partition('=')[2]}" if key.startswith("sweep=") else key for key in keys]
    return " ".join(["tossid", command, *(f'"{word}"' if "'" in word else word for word in words)])


def _figures(result: dict[str, Any]) -> list[Path]:
    paths = map(Path, result.get("figures", []))
    return [path for path in paths if path.suffix == ".png" or path.name == FILM]


def _unused(path: Path) -> Path:
    """A path at which nothing is: the same, or with a number."""
    names = [path, *(path.with_stem(f"{path.stem}_{k}") for k in range(2, 10))]
    return next(name for name in names if not name.exists())


if __name__ == "__main__":
    sys.exit(guarded(main, "figures"))
