"""What a simulator may lack: worlds, and the library of effects that change them. One file a family."""

from tossid.physics.effects.effect import (
    OTHER_POWER,
    Effect,
    InMujoco,
    MjcfEdit,
    NotExpressible,
    Parameter,
    RecordingCorrection,
)
from tossid.physics.effects.registry import (
    BUILT_IN,
    JOINT_EFFECTS,
    LIBRARY,
    all_effects,
    effect_named,
    effects_for,
    register_effect,
    unregister_effect,
)
from tossid.physics.effects.strength import Strength
from tossid.physics.effects.world import Forces, Law, RecordingErrors, World

__all__ = [
    "BUILT_IN",
    "JOINT_EFFECTS",
    "LIBRARY",
    "OTHER_POWER",
    "Effect",
    "Forces",
    "InMujoco",
    "Law",
    "MjcfEdit",
    "NotExpressible",
    "Parameter",
    "RecordingCorrection",
    "RecordingErrors",
    "Strength",
    "World",
    "all_effects",
    "effect_named",
    "effects_for",
    "register_effect",
    "unregister_effect",
]
