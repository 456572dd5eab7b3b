"""Where things lie in a project folder, and what is newest there.

All of it is relative to the folder that a command is run in, like MLflow's own
store. What ships with tossid (`conf/`) is found from anywhere.
"""

from __future__ import annotations

from pathlib import Path

from pipelines.config.places import SAMPLE
from tossid.errors import ConfigError, FileError

RECORDINGS = Path("data/raw")
DATASETS = Path("data/datasets")
DATASET_SUFFIXES = (".h5", ".hdf5")


def newest_recording(folder: Path = RECORDINGS) -> Path:
    """The recording folder (one with cameras.yaml) that changed last.

    Raises:
        FileError: there is none.
    """
    sample = f"; a sample lies in {SAMPLE}" if SAMPLE.is_dir() else ""
    advice = f"no recording here; make one with 'tossid synthesize', or give source.path=FOLDER{sample}"
    return _newest(folder, [path.parent for path in folder.glob("*/cameras.yaml")], advice)


def newest_dataset(folder: Path = DATASETS) -> Path:
    """The dataset that was written last: what `ingest` left.

    Raises:
        FileError: there is none.
    """
    advice = "no dataset here; make one with 'tossid ingest', or give data=FILE.h5"
    return _newest(folder, list(folder.glob("*.h5")), advice)


def _newest(folder: Path, paths: list[Path], advice: str) -> Path:
    found = [path for path in paths if not path.name.startswith(".")]
    if not found:
        raise FileError(folder, advice)
    return max(found, key=lambda path: (path.stat().st_mtime_ns, path.name))


def dataset_path(path: Path | None) -> Path:
    """The dataset that a key names: the file, the one in a folder that `synthesize` wrote, or the newest for None."""
    if path is None:
        return newest_dataset()
    if path.is_dir() and (path / "tosses.h5").is_file():
        return path / "tosses.h5"
    if path.is_dir():
        raise FileError(path, f"is a folder, and no dataset (.h5); {_made_by_ingest(path)}")
    if not path.is_file():
        raise FileError(path, "no such dataset; expected a .h5 file")
    return path


def _made_by_ingest(folder: Path) -> str:
    """How a dataset is made of what a folder holds."""
    inside = sorted(path.suffix for path in folder.iterdir())
    sources = {".txt": "tum", ".pt": "contactnets"}
    poses = next((sources[suffix] for suffix in inside if suffix in sources), None)
    if poses is not None and not (folder / "cameras.yaml").exists():
        return f"'tossid ingest source={poses} source.path={folder}' makes one of the poses in it"
    return f"'tossid ingest source.path={folder}' makes one of a recording"


def named(key: str, path: Path, *suffixes: str) -> Path:
    """The path of a file to write, which must end in one of some suffixes.

    Raises:
        ConfigError: It does not; names the key.
    """
    if path.suffix not in suffixes:
        suggestion = str(path.with_suffix(suffixes[0]))
        raise ConfigError(key, f"'{path}' does not end in {suffixes[0]}.", suggestion=suggestion)
    return path
