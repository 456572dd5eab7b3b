"""What the commands that measure recorded tosses by hand are given: a dataset, its splits, and a world with effects."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from tossid.audit.strengths import world_with
from tossid.physics.effects import World
from tossid.store import Dataset, read_dataset
from tossid.types import Toss


def arguments(about: str | None, split: Sequence[str] = ("train",)) -> argparse.ArgumentParser:
    """A parser of `FILE.h5 [--split ...] [--effects JSON]`.

    Args:
        about: The command's description.
        split: Splits whose tosses are measured if none is named.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", nargs="*", default=list(split))
    parser.add_argument("--effects", default="{}", help="values by effect and parameter, as JSON")
    return parser


def asked(given: argparse.Namespace) -> tuple[Dataset, list[Toss], World]:
    """The dataset, its tosses of the named splits, and the stated world with the effects.

    Args:
        given: As parsed by `arguments`.
    """
    dataset = read_dataset(given.data)
    tosses = [toss for split in given.split for toss in dataset.of_split(split)]
    return dataset, tosses, world_with(World(dataset.object), json.loads(given.effects))
