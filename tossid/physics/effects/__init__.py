"""What a simulator may lack: worlds, and the library of effects that change them."""

from tossid.physics.effects.effect import Effect, Parameter
from tossid.physics.effects.joints import JOINT_EFFECTS, library_for
from tossid.physics.effects.library import LIBRARY, NEVER_NOTHING, OTHER_LAWS, POWER
from tossid.physics.effects.world import Forces, Law, Recording, World

__all__ = [
    "JOINT_EFFECTS",
    "LIBRARY",
    "NEVER_NOTHING",
    "OTHER_LAWS",
    "POWER",
    "Effect",
    "Forces",
    "Law",
    "Parameter",
    "Recording",
    "World",
    "library_for",
]
