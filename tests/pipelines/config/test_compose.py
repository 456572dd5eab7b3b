"""Keys are checked against the schema: what is unknown, mistyped or out of range is refused by name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipelines.config import places
from pipelines.config.compose import as_plain, flatten, load
from pipelines.config.schemas import IngestConfig
from tossid.errors import ConfigError
from tossid.settings.kinds import Bounds
from tossid.settings.tracking import TrackSettings


@dataclass(frozen=True)
class Gentle:
    """A gentle engine."""

    name: Literal["gentle"]
    """gentle"""
    steps: Annotated[int, Bounds(low=1)]
    """steps"""


@dataclass(frozen=True)
class Rough:
    """A rough engine."""

    name: Literal["rough"]
    """rough"""
    grip: float
    """grip [1]"""


@dataclass(frozen=True)
class Part:
    """Keys of its own."""

    speed: Annotated[float, Bounds(above=0)]
    """speed [m/s]"""
    label: str
    """any text"""


@dataclass(frozen=True)
class Everything:
    """One field of each kind."""

    engine: Gentle | Rough
    """engine"""
    extra: Gentle | None
    """optional group"""
    part: Part
    """a part"""
    flag: bool
    """a flag"""
    count: int
    """a count"""
    where: Path | None
    """a place"""
    pair: tuple[float, float]
    """two numbers"""
    several: tuple[int, ...]
    """several"""
    mode: Literal["fast", "exact"]
    """mode"""
    table: dict[str, float]
    """names and numbers"""


@pytest.fixture
def conf(tmp_path: Path) -> Path:
    """A folder of values for `Everything`."""
    folder = tmp_path / "conf"
    for group in ("engine", "extra"):
        (folder / group).mkdir(parents=True)
        (folder / group / "gentle.yaml").write_text("name: gentle\nsteps: 4\n")
    (folder / "engine" / "rough.yaml").write_text("name: rough\ngrip: ???\n")
    (folder / "everything.yaml").write_text(
        "defaults:\n  - engine: gentle\n  - extra: null\n  - _self_\n"
        "part: {speed: 1.5, label: a b}\nflag: false\ncount: 3\nwhere: null\npair: [0.0, 1.0]\n"
        "several: []\nmode: fast\ntable: {}\n"
    )
    return folder


@pytest.fixture(scope="module")
def part_conf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of values for `Part`."""
    folder = tmp_path_factory.mktemp("conf")
    (folder / "part.yaml").write_text("speed: 1.0\nlabel: x\n")
    return folder


def read(conf: Path, *overrides: str) -> Everything:
    with values_in(conf):
        return load("everything", Everything, overrides)


def values_in(conf: Path) -> Any:
    """Values come from another folder, and from no other, while the block lasts."""
    return patch.multiple(places, CONF=conf, OWN_CONF=conf)


@pytest.mark.parametrize(
    ("overrides", "changes"),
    [
        ([], {}),
        (["engine=rough", "engine.grip=2"], {"engine": Rough("rough", 2.0)}),
        (["extra=gentle", "extra.steps=9"], {"extra": Gentle("gentle", 9)}),
        (["part.speed=1e-3"], {"part": Part(1e-3, "a b")}),
        (["flag=true", "count=-7"], {"flag": True, "count": -7}),
        (["pair=[1,2.5]", "several=[3,1,2]"], {"pair": (1.0, 2.5), "several": (3, 1, 2)}),
        (["mode=exact", "table={a: 1, b: 2.5}"], {"mode": "exact", "table": {"a": 1.0, "b": 2.5}}),
    ],
)
def test_values_come_from_conf_and_every_kind_of_key_can_be_set(
    conf: Path, overrides: list[str], changes: dict[str, Any]
) -> None:
    in_conf = Everything(
        engine=Gentle("gentle", 4), extra=None, part=Part(1.5, "a b"), flag=False, count=3, where=None,
        pair=(0.0, 1.0), several=(), mode="fast", table={},
    )  # fmt: skip
    assert read(conf, *overrides) == replace(in_conf, **changes)


@pytest.mark.parametrize(
    ("override", "key", "suggestion"),
    [
        ("count=1 count=2", "count", None),
        ("cuont=3", "cuont", "count"),
        ("speed=3", "speed", "part.speed"),
        ("part.sped=3", "part.sped", "part.speed"),
        ("engine.stepps=3", "engine.stepps", "engine.steps"),
        ("engine=gentel", "engine", "gentle"),
        ("mode=exakt", "mode", "exact"),
        ("gentle", "gentle", "engine=gentle"),
        ("count", "count", "count=…"),
        ("+count=3", "+count=3", None),
        ("~count", "~count", None),
        ("part=3", "part", None),
        ("engine.name=rough", "engine.name", None),
        ("engine=null", "engine", None),
        ("hydra.run.dir=x", "hydra.run.dir", None),
        ("engine@part=gentle", "engine@part", None),
        ("count=abc", "count", None),
        ("count=1,2", "count", None),
        ("count=[1", "count", None),
        ("pair=[1,x]", "pair[1]", None),
        ("table={a: x}", "table.a", None),
        ("engine=rough", "engine.grip", None),
        ("=3", "=3", None),
    ],
)
def test_refused(conf: Path, override: str, key: str, suggestion: str | None) -> None:
    with pytest.raises(ConfigError) as caught:
        read(conf, *(override.split() if override.startswith("count=1 ") else [override]))
    assert caught.value.key == key
    assert caught.value.suggestion == suggestion
    assert "\n" not in str(caught.value)


TEXTS = [
    "a b",
    "it's (here), a=b",
    'say "x"',
    "[1,2]",
    "{a: 1}",
    "1,2",
    "range(3)",
    "back\\slash\\",
    "ü/ö",
    "12",
    "+x",
    "~x",
]


@pytest.mark.parametrize("text", TEXTS)
def test_text_is_taken_as_typed(conf: Path, text: str) -> None:
    config = read(conf, f"part.label={text}", f"where=/tmp/{text}")
    assert config.part.label == text
    assert config.where == Path(f"/tmp/{text}")


@settings(max_examples=25, deadline=None)
@given(st.text(st.characters(exclude_categories=["C", "Z"], exclude_characters="$'\""), min_size=1, max_size=20))
def test_any_text_survives(part_conf: Path, text: str) -> None:
    if text in ("null", "None"):
        return
    with values_in(part_conf):
        assert load("part", Part, [f"label={text}"]).label == text


@given(st.text(max_size=30))
@settings(max_examples=30, deadline=None)
def test_no_override_escapes_as_another_error(part_conf: Path, text: str) -> None:
    for override in (text, f"speed={text}", f"{text}=1"):
        try:
            with values_in(part_conf):
                config = load("part", Part, [override])
        except ConfigError as error:
            assert "\n" not in str(error)
        else:
            assert isinstance(config.speed, float)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("part: {speed: 1.5, label: a, sped: 2}", "sped"),
        ("part: {speed: fast, label: a}", "part.speed"),
        ("part: [", "everything.yaml"),
        ("part: {speed: ${nowhere}, label: a}", "nowhere"),
        ("- 1", "everything.yaml"),
    ],
)
def test_wrong_values_in_conf_are_named(conf: Path, content: str, message: str) -> None:
    path = conf / "everything.yaml"
    kept = [line for line in path.read_text().splitlines() if not line.startswith("part")]
    path.write_text(content if content.startswith("-") else "\n".join([*kept, content]))
    with pytest.raises(ConfigError, match=message):
        read(conf)


def test_what_only_python_changes_is_no_key_and_keeps_its_default() -> None:
    config = load("ingest", IngestConfig)
    assert config.track.stream == TrackSettings().stream
    assert not any(name.startswith("track.stream") for name in flatten(as_plain(config)))
    with pytest.raises(ConfigError, match=r"track\.stream"):
        load("ingest", IngestConfig, ["track.stream.window=10"])
