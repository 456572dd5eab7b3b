"""Keys are checked against the schema: what is unknown, mistyped or out of range is refused by name."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipelines.config import places
from pipelines.config.compose import as_plain, flatten, load
from pipelines.config.places import CONF
from pipelines.config.schemas import COMMANDS, IngestConfig, NewObjectConfig
from tossid.errors import ConfigError
from tossid.settings.tracking import TrackSettings

BOX = ["name=a", "box=[1,1,1]", "mass=1"]


def read(command: str, *overrides: str) -> dict[str, Any]:
    """The values of a command by dotted key."""
    return flatten(as_plain(load(command, COMMANDS[command], overrides)))


@pytest.mark.parametrize(
    ("command", "overrides", "values"),
    [
        ("train", [], {"model.name": "cnrpi", "model.learn_k_res": True, "object": None, "restart": False, "seed": 0}),
        ("train", ["model=cn", "model.gravity=1e-3"], {"model.name": "cn", "model.gravity": 1e-3}),
        ("train", ["restart=true", "seed=7", "optimizer=adam"], {"restart": True, "seed": 7, "optimizer": "adam"}),
        ("train", ["object=unknown", "object.mass=2"], {"object.name": "unknown", "object.mass": 2.0}),
        ("synthesize", ["engine=lcp", "release.speed=[1,2.5]"], {"engine.name": "lcp", "release.speed": [1.0, 2.5]}),
        ("synthesize", ["effects={com_offset: {x_m: 1e-3}}"], {"effects.com_offset.x_m": 1e-3}),
        ("evaluate", ["sweep=gravity", "sweep.seeds=[3,1,2]"], {"sweep.name": "gravity", "sweep.seeds": [3, 1, 2]}),
        ("ingest", ["source=tum", "source.path=a b"], {"source.name": "tum", "source.path": "a b", "out": None}),
    ],
)
def test_values_come_from_conf_and_every_kind_of_key_can_be_set(
    command: str, overrides: list[str], values: dict[str, Any]
) -> None:
    found = read(command, *overrides)
    assert {name: found[name] for name in values} == values


@pytest.mark.parametrize(
    ("call", "key", "suggestion"),
    [
        ("train seed=1 seed=2", "seed", None),
        ("train sede=3", "sede", "seed"),
        ("train gravity=3", "gravity", "model.gravity"),
        ("train model.gravty=3", "model.gravty", "model.gravity"),
        ("train model=diffsym", "model", "diffsim"),
        ("train optimizer=adan", "optimizer", "adam"),
        ("train cnrp", "cnrp", "model=cnrp"),
        ("train seed", "seed", "seed=…"),
        ("train +seed=3", "+seed=3", None),
        ("train ~seed", "~seed", None),
        ("synthesize engine.name=lcp", "engine.name", None),
        ("train model=null", "model", None),
        ("train object.mass=1", "object.mass", None),
        ("train hydra.run.dir=x", "hydra.run.dir", None),
        ("train model@object=cn", "model@object", None),
        ("train seed=abc", "seed", None),
        ("train seed=1,2", "seed", None),
        ("train seed=[1", "seed", None),
        ("train =3", "=3", None),
        ("synthesize release=3", "release", None),
        ("synthesize release.speed=[1,x]", "release.speed[1]", None),
        ("synthesize effects={com_offset:{x_m:a}}", "effects.com_offset.x_m", None),
        ("ingest source=tum", "source.path", None),
    ],
)
def test_refused(call: str, key: str, suggestion: str | None) -> None:
    with pytest.raises(ConfigError) as caught:
        read(*call.split())
    assert (caught.value.key, caught.value.suggestion) == (key, suggestion)
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
def test_text_is_taken_as_typed(text: str) -> None:
    config = load("new-object", NewObjectConfig, [*BOX[1:], f"name={text}", f"out=made/{text}"])
    assert (config.name, config.out) == (text, Path(f"made/{text}"))


@settings(max_examples=15, deadline=None)
@given(st.text(st.characters(exclude_categories=["C", "Z"], exclude_characters="$'\""), min_size=1, max_size=20))
def test_any_text_survives(text: str) -> None:
    if text not in ("null", "None"):
        assert load("new-object", NewObjectConfig, [*BOX[1:], f"name={text}"]).name == text


@given(st.text(max_size=30))
@settings(max_examples=15, deadline=None)
def test_no_override_escapes_as_another_error(text: str) -> None:
    for override in (text, f"friction={text}", f"{text}=1"):
        try:
            config = load("new-object", NewObjectConfig, [*BOX, override])
        except ConfigError as error:
            assert "\n" not in str(error)
        else:
            assert isinstance(config.friction, float)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("detect: {threds: 2}", "threds"),
        ("threads: fast", "threads"),
        ("detect: [", "detect.yaml"),
        ("recordings: ${nowhere}", "nowhere"),
        ("- 1", "detect.yaml"),
    ],
)
def test_wrong_values_in_conf_are_named(tmp_path: Path, content: str, message: str) -> None:
    shutil.copytree(CONF, tmp_path / "conf")
    path = tmp_path / "conf" / "detect.yaml"
    path.write_text(content if content.startswith("-") else f"{path.read_text()}\n{content}")
    with patch.multiple(places, CONF=path.parent, OWN_CONF=path.parent), pytest.raises(ConfigError, match=message):
        read("detect")


def test_what_only_python_changes_is_no_key_and_keeps_its_default() -> None:
    config = load("ingest", IngestConfig)
    assert config.track.stream == TrackSettings().stream
    assert not any(name.startswith("track.stream") for name in flatten(as_plain(config)))
    with pytest.raises(ConfigError, match=r"track\.stream"):
        load("ingest", IngestConfig, ["track.stream.stretches=10"])
