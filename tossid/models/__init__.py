"""Models of an object's motion: a protocol, one file a kind, variants by name, and trained models in files.

A new variant is a `ModelSettings` with other values. A new kind is a module that calls `register_model`. Names are
imported when they are first used, since most need torch, and a rollout of a simulator does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tossid.first_use import imported_at_first_use

if TYPE_CHECKING:
    from tossid.models.protocol import DynamicsModel as DynamicsModel
    from tossid.models.protocol import Mechanics as Mechanics
    from tossid.models.protocol import Objective as Objective
    from tossid.models.protocol import StagePlan as StagePlan
    from tossid.models.registry import build_model as build_model
    from tossid.models.registry import register_model as register_model
    from tossid.models.registry import variant as variant
    from tossid.models.trained import EpochRecord as EpochRecord
    from tossid.models.trained import TrainedModel as TrainedModel
    from tossid.settings.training import VARIANTS as VARIANTS
    from tossid.settings.training import ModelSettings as ModelSettings

_HOMES = {
    "VARIANTS": "tossid.settings.training",
    "DynamicsModel": "tossid.models.protocol",
    "EpochRecord": "tossid.models.trained",
    "Mechanics": "tossid.models.protocol",
    "ModelSettings": "tossid.settings.training",
    "Objective": "tossid.models.protocol",
    "StagePlan": "tossid.models.protocol",
    "TrainedModel": "tossid.models.trained",
    "build_model": "tossid.models.registry",
    "register_model": "tossid.models.registry",
    "variant": "tossid.models.registry",
}
"""The names of this room, and the module that defines each."""

__all__ = [*_HOMES]

if not TYPE_CHECKING:
    __getattr__ = imported_at_first_use(__name__, _HOMES)
