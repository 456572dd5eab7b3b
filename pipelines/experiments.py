"""`make experiments`: the named studies on published recordings. What is done already is not done again."""

from __future__ import annotations

import sys
from pathlib import Path

from pipelines.calling import call_with_keys
from pipelines.console import Console
from pipelines.failures import guarded
from tossid.errors import FileError

DATASETS = {"cube": ("contactnets", "contactnets_cube", "cube")}
"""Dataset: its importer, its folder in DATA, its object."""

STUDIES = (
    ("cube", "gravity_full"),
    ("cube", "data_efficiency"),
)
"""Dataset and study (conf/sweep), in order."""


def main(folder: Path) -> None:
    """Ingest what is missing, run every study; the figures' places are said by each."""
    console = Console()
    for name, study in STUDIES:
        importer, source, object_name = DATASETS[name]
        data = Path("data/datasets") / f"{source}.h5"
        if data.is_file():
            console.say(f"{data}: taken as it is; remove it to have it ingested anew")
        else:
            if not (folder / source).is_dir():
                raise FileError(folder, f"has no folder {source}; name the recordings' folder with DATA=FOLDER")
            keys = [f"source={importer}", f"source.path={folder / source}", f"object={object_name}", f"out={data}"]
            _say_and_call(console, "ingest", keys)
        _say_and_call(console, "evaluate", [f"sweep={study}", f"data={data}"])


def _say_and_call(console: Console, command: str, keys: list[str]) -> None:
    console.say(f"\n$ tossid {command} {' '.join(keys)}")
    call_with_keys(command, keys, json=False, quiet=False)


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1])), "experiments"))
