"""Where things lie in a project folder, and what is newest there.

All of it is relative to the folder that a command is run in, like MLflow's own
store. What ships with tossid (`conf/`) is found from anywhere.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.keys import CONF
from pipelines.schemas import ObjectConfig
from tossid.errors import ConfigError, FileError

if TYPE_CHECKING:
    from tossid.objects import ObjectModel

RECORDINGS = Path("data/raw")
DATASETS = Path("data/datasets")
FIGURES = Path("outputs/figures")


def newest_recording(folder: Path = RECORDINGS) -> Path:
    """The recording folder (one with cameras.yaml) that changed last.

    Raises:
        FileError: there is none.
    """
    found = [path.parent for path in folder.glob("*/cameras.yaml") if not path.parent.name.startswith(".")]
    if not found:
        raise FileError(folder, "no recording here; make one with 'tossid synthesize', or give source.path=FOLDER")
    return max(found, key=lambda path: (path.stat().st_mtime_ns, path.name))


def newest_dataset(folder: Path = DATASETS) -> Path:
    """The dataset that was written last: what `ingest` left.

    Raises:
        FileError: there is none.
    """
    found = [path for path in folder.glob("*.h5") if not path.name.startswith(".")]
    if not found:
        raise FileError(folder, "no dataset here; make one with 'tossid ingest', or give data=FILE.h5")
    return max(found, key=lambda path: (path.stat().st_mtime_ns, path.name))


def dataset_path(path: Path | None) -> Path:
    """The dataset that a key names: the file, the one in a folder that `synthesize` wrote, or the newest for None."""
    if path is None:
        return newest_dataset()
    if path.is_dir() and (path / "tosses.h5").is_file():
        return path / "tosses.h5"
    if not path.is_file():
        raise FileError(path, "no such dataset; expected a .h5 file")
    return path


def shipped(path: Path) -> Path:
    """A path as it is, or, where nothing is there, below tossid's own folder ("conf/object/cube.xml")."""
    if not path.is_absolute() and not path.exists() and (CONF.parent / path).exists():
        return CONF.parent / path
    return path


def absolute_object(config: ObjectConfig) -> ObjectConfig:
    """The same with whole paths, for workers that may be in another folder."""
    tags = None if config.tags is None else shipped(config.tags).resolve()
    return replace(config, path=shipped(config.path).resolve(), tags=tags)


def load_object(config: ObjectConfig) -> ObjectModel:
    """The object that a config describes, with its tags.

    Raises:
        FileError: a file is missing or cannot be read.
        ObjectError: it is no object that tossid can handle.
    """
    from tossid import objects

    model = objects.load_object(
        shipped(config.path),
        name=config.name,
        friction=config.friction,
        restitution=config.restitution,
        width=config.width,
    )
    if config.tags is None:
        return model
    from tossid.vision.layout import object_tags
    from tossid.vision.tagslam import read_tagslam

    return replace(model, tags=object_tags(read_tagslam(shipped(config.tags)), model.body_names))


def object_named(name: str) -> ObjectConfig:
    """The object `conf/object/NAME.yaml`."""
    import yaml

    from pipelines.keys import convert

    path = CONF / "object" / f"{name}.yaml"
    if not path.is_file():
        raise ConfigError("object", f"there is no '{name}' in conf/object.")
    config = convert(ObjectConfig, yaml.safe_load(path.read_text()), key="object")
    assert isinstance(config, ObjectConfig)
    return config


def write_object(config: ObjectConfig, folder: Path) -> None:
    """Leave the object beside a recording: its model as object.xml, its keys in object.yaml."""
    import yaml

    values = {name: str(value) if isinstance(value, Path) else value for name, value in asdict(config).items()}
    values["path"] = "object" + shipped(config.path).suffix
    values["tags"] = "tagslam.yaml" if config.tags is not None else None
    (folder / values["path"]).write_bytes(shipped(config.path).read_bytes())
    (folder / "object.yaml").write_text(yaml.safe_dump(values, sort_keys=False))


def recorded_object(folder: Path) -> ObjectConfig | None:
    """The object that `write_object` left in a recording, None if it left none."""
    from dataclasses import replace

    from pipelines.keys import convert
    from tossid.yaml_files import read_yaml

    path = folder / "object.yaml"
    if not path.is_file():
        return None
    try:
        config = convert(ObjectConfig, read_yaml(path), key="object")
    except ConfigError as error:
        raise FileError(path, f"does not describe an object: {' '.join(str(error).split())}") from error
    tags = folder / config.tags if config.tags is not None else None
    return replace(config, path=folder / config.path, tags=tags)


def check_dataset_name(key: str, path: Path) -> Path:
    """A dataset to write must be named as one."""
    if path.suffix not in (".h5", ".hdf5"):
        raise ConfigError(
            key, f"'{path}' does not end in .h5; a dataset does.", suggestion=f"{path.with_suffix('.h5')}"
        )
    return path
