"""Models of an object's motion: a protocol, one file a kind, variants by name, and trained models in files.

A new variant is a `ModelSettings` with other values. A new kind is a module that calls `register_model`. Names are
imported when they are first used, since most need torch, and a rollout of a simulator does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tossid.first_use import imported_at_first_use

if TYPE_CHECKING:
    from tossid.models.protocol import DynamicsModel, Mechanics, Objective, StagePlan
    from tossid.models.registry import build_model, register_model, variant
    from tossid.models.trained import EpochRecord, TrainedModel
    from tossid.settings.training import VARIANTS, ModelSettings
else:
    __all__, __getattr__, __dir__ = imported_at_first_use(__name__)
