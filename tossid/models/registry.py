"""Kinds of models by name: how each is built from its settings."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

from tossid.code_digest import note_registered
from tossid.errors import ConfigError
from tossid.models.protocol import DynamicsModel
from tossid.motion import MeasurementModel
from tossid.objects import ObjectModel
from tossid.settings.kinds import from_plain
from tossid.settings.training import VARIANTS, ModelSettings


class Build(Protocol):
    """Makes the untrained model of a kind."""

    def __call__(
        self, settings: Any, given: ObjectModel, *, seed: int, measurement: MeasurementModel | None
    ) -> DynamicsModel:
        """The untrained model.

        Args:
            settings: Of the kind's own settings class.
            given: The object as it is stated.
            seed: Of everything that is drawn.
            measurement: How recorded motion relates to true motion; None for exact.
        """


@dataclass(frozen=True)
class _Kind:
    settings: type[ModelSettings]
    build: Build


_KINDS: dict[str, _Kind] = {}
_BUILT_IN = {"contactnets": "tossid.models.contactnets", "e2e": "tossid.models.e2e"}
"""The library's own kinds, and the module that registers each when it is first needed."""


def register_model(kind: str, settings: type[ModelSettings], build: Build) -> None:
    """Make a kind of model known, so that `tossid.train` builds it and checkpoints of it open.

    Args:
        kind: Its name, as in `ModelSettings.kind`.
        settings: Its settings: `ModelSettings`, or a subclass with further fields.
        build: Makes the untrained model.

    Raises:
        ConfigError: Another model has that name.
    """
    known = _KINDS.get(kind)
    taken = build.__module__ != _BUILT_IN.get(kind, build.__module__)
    if taken or (known is not None and known.build is not build):
        raise ConfigError("kind", f"'{kind}' is already registered.")
    note_registered(settings, build)
    _KINDS[kind] = _Kind(settings, build)


def build_model(
    settings: ModelSettings, given: ObjectModel, *, seed: int = 0, measurement: MeasurementModel | None = None
) -> DynamicsModel:
    """The untrained model that the settings name.

    Args:
        settings: What is learned and what is given.
        given: The object as it is stated.
        seed: Of everything that is drawn.
        measurement: How recorded motion relates to true motion; None for exact.

    Raises:
        ConfigError: There is no such kind.
    """
    return _kind(settings.kind).build(settings, given, seed=seed, measurement=measurement)


def variant(name: str) -> ModelSettings:
    """The settings of a named variant.

    Args:
        name: One of `tossid.settings.training.VARIANTS`.

    Raises:
        ConfigError: There is no such variant.
    """
    if name not in VARIANTS:
        raise ConfigError("model", f"there is no '{name}'; there are {', '.join(VARIANTS)}, and ModelSettings(...).")
    return VARIANTS[name]


def settings_from(values: Mapping[str, Any]) -> ModelSettings:
    """Settings of a model from plain values, as checkpoints hold them.

    Args:
        values: What `tossid.settings.kinds.to_plain` gave. What an earlier version did not know is taken from the
            variant of that name, but for `impact_parts`: impacts happened where steps end.

    Raises:
        ConfigError: There is no such kind.
    """
    start = VARIANTS.get(values["name"])
    if start is None or start.kind != values.get("kind", start.kind):
        start = _kind(values["kind"]).settings()
    return from_plain(replace(start, impact_parts=values.get("impact_parts", 1)), values)


def _kind(name: str) -> _Kind:
    if name in _BUILT_IN:
        importlib.import_module(_BUILT_IN[name])
    if name not in _KINDS:
        known = ", ".join({**_BUILT_IN, **_KINDS})
        raise ConfigError("kind", f"there is no kind of model '{name}'; there are {known}.")
    return _KINDS[name]
