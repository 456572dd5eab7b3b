"""Models of an object's motion: a protocol, one file a kind, variants by name, and trained models in files.

A new variant is a `ModelSettings` with other values. A new kind is a module that calls `register_model`; the built-in
ones are imported here.
"""

from tossid.models import contactnets, e2e
from tossid.models.protocol import DynamicsModel, Mechanics, Objective, StagePlan
from tossid.models.registry import build_model, register_model, variant
from tossid.models.trained import EpochRecord, TrainedModel
from tossid.settings.training import VARIANTS, ModelSettings

__all__ = [
    "VARIANTS",
    "DynamicsModel",
    "EpochRecord",
    "Mechanics",
    "ModelSettings",
    "Objective",
    "StagePlan",
    "TrainedModel",
    "build_model",
    "contactnets",
    "e2e",
    "register_model",
    "variant",
]
