"""`make experiments`: the named studies, on published recordings and on simulated tosses whose truth is known.

What is done already is not done again.
"""

from __future__ import annotations

import sys
from pathlib import Path

from pipelines.cli.call import call_with_keys
from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from tossid.errors import FileError

FOLDER = Path("data/datasets")

RECORDED = {
    "contactnets_cube": ("source=contactnets", "object=cube"),
    "pll_elbow": ("source=pll", "object=elbow", "defects=set_aside"),
}
"""Dataset, which is also its folder in DATA: keys of ingest."""

SIMULATED = {
    "simulated_cube": (
        "engine=lcp", "frames=false", "tosses=200", "seed=1",
        "noise.position=0.00005", "noise.rotation=0.0005", "noise.velocity=0.005", "noise.spin=0.05",
    ),
    "mujoco_elbow": ("object=elbow", "engine=mujoco", "frames=false", "tosses=256", "seed=5"),
    "simulated_elbow": (
        "object=elbow", "engine=lcp", "frames=false", "tosses=80", "seed=1", "splits=[0.6,0.2,0.2]",
        "noise.position=0.00005", "noise.rotation=0.0005", "noise.velocity=0.005", "noise.spin=0.05",
        "noise.joint=0.0005", "noise.joint_rate=0.05",
    ),
}  # fmt: skip
"""Dataset: keys of synthesize. The noise is that of the real cube, as its flights show it, and somewhat more; MuJoCo's
elbow has none, as in the paper."""

STUDIES = (
    ("contactnets_cube", "gravity_full"),
    ("contactnets_cube", "e2e"),
    ("contactnets_cube", "baselines"),
    ("contactnets_cube", "data_efficiency"),
    ("simulated_cube", "inertia"),
    ("simulated_cube", "gravity"),
    ("mujoco_elbow", "elbow"),
    ("simulated_elbow", "inertia"),
    ("pll_elbow", "elbow_real"),
)
"""Dataset and study (conf/sweep), in order."""


def main(folder: Path) -> None:
    """Ingest or simulate what is missing, then run every study."""
    console = Console()
    data = {name: _dataset(name, folder, console) for name in dict.fromkeys(name for name, _ in STUDIES)}
    for name, study in STUDIES:
        _say_and_call(console, "evaluate", [f"sweep={study}", f"data={data[name]}"])


def _dataset(name: str, folder: Path, console: Console) -> Path:
    """Where a dataset lies; made if it is not there."""
    simulated = name in SIMULATED
    path = FOLDER / name / "tosses.h5" if simulated else FOLDER / f"{name}.h5"
    if path.is_file():
        console.say(f"{path}: taken as it is; remove it to have it made anew")
    elif simulated:
        _say_and_call(console, "synthesize", [*SIMULATED[name], f"out={path.parent}"])
    else:
        if not (folder / name).is_dir():
            raise FileError(folder, f"has no folder {name}; name the recordings' folder with DATA=FOLDER")
        _say_and_call(console, "ingest", [*RECORDED[name], f"source.path={folder / name}", f"out={path}"])
    return path


def _say_and_call(console: Console, command: str, keys: list[str]) -> None:
    console.say(f"\n$ tossid {command} {' '.join(keys)}")
    call_with_keys(command, keys, json=False, quiet=False)


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1])), "experiments"))
