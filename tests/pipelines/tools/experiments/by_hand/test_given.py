"""Commands by hand take a dataset's tosses of the named splits, and the world with the named effects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pipelines.tools.experiments.by_hand.given import arguments, asked
from tests.diagnosis.tossed import seen
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.store import Dataset, write_dataset


def test_splits_and_effects_are_as_given(cube: ObjectModel, tmp_path: Path) -> None:
    made = seen(World(cube), cube, 3, seed=1, frames=20)
    tosses = tuple(replace(toss, split=split) for toss, split in zip(made, ("train", "test", "train"), strict=True))
    file = str(tmp_path / "tosses.h5")
    write_dataset(Dataset(cube, tosses, 148.0, "made", {}), tmp_path / "tosses.h5")
    parser = arguments("about")
    _, found, world = asked(parser.parse_args([file, "--effects", '{"restitution": {"e": 0.5}}']))
    assert [toss.name for toss in found] == ["0", "2"]
    assert world.object.restitution == 0.5
    _, found, world = asked(parser.parse_args([file, "--split", "test", "train"]))
    assert [toss.name for toss in found] == ["1", "0", "2"]
    assert world.object.restitution == 0
    assert asked(arguments("about", split=()).parse_args([file]))[1] == []
