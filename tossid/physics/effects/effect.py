"""What an effect is: a change of a `World` with a few parameters, and all that the project needs to know about it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics.effects.strength import Strength
from tossid.physics.effects.world import World
from tossid.physics.forces import PoweredForce
from tossid.types import Phase

if TYPE_CHECKING:
    from tossid.physics.effects.mjcf_edit import Edit

Array = NDArray[np.float64]

EVERY_PHASE = (Phase.FLIGHT, Phase.IMPACT, Phase.SLIDE, Phase.ROLL, Phase.REST)
CONTACT_PHASES = (Phase.IMPACT, Phase.SLIDE, Phase.ROLL, Phase.REST)
OTHER_POWER = "power"
"""The parameter of `Effect.other_power_law`."""


@dataclass(frozen=True)
class Parameter:
    """A number of an effect, in SI units.

    Attributes:
        name: Its name, which ends with its unit: `c_nspm` is in N s/m, `scale_rel` is a factor.
        nominal: The value that changes nothing; None for the value that the world has, which `Effect.read` returns.
        low: The least plausible value.
        high: The largest plausible value.
        step: A small change that matters, for differences and for scaling.
        limit: The largest absolute value that an object's size allows; None where size sets no limit.
        form: Whether it only says of which form the effect is, and not how large.
    """

    name: str
    nominal: float | None
    low: float
    high: float
    step: float
    limit: Callable[[ObjectModel], float] | None = None
    form: bool = False

    def bounded(self, model: ObjectModel) -> Parameter:
        """The parameter with bounds that an object's size allows."""
        if self.limit is None:
            return self
        most = self.limit(model)
        low, high = max(self.low, -most), min(self.high, most)
        return self if (low, high) == (self.low, self.high) else replace(self, low=low, high=high)


@dataclass(frozen=True)
class NotExpressible:
    """Why MuJoCo, MJCF or an audit cannot express an effect.

    Attributes:
        why: The reason, which reports quote.
        present: Whether a world has the effect. Needed where MuJoCo cannot simulate it.
    """

    why: str
    present: Callable[[World], bool] | None = None

    def __post_init__(self) -> None:
        if not self.why.strip():
            raise InputError("an effect that cannot be expressed states why")

    def write(self, edit: Edit, before: World, after: World) -> None:
        """Note in an edited MJCF model that it lacks the effect that makes one world the other."""
        edit.cannot[edit.effect] = self.why


@dataclass(frozen=True)
class InMujoco:
    """How MuJoCo simulates an effect, beyond what is built from the world's object, gravity, forces and ground.

    Attributes:
        scene: Changes MuJoCo's compiled model of a world; None if there is nothing more to change.
    """

    scene: Callable[[Any, World], None] | None = None


@dataclass(frozen=True)
class MjcfEdit:
    """How an MJCF file says an effect: by changed attributes.

    Attributes:
        edit: Changes a model from the world without the effect to the world with it.
        of_links: Why this does not hold for objects with joints; None if it does.
    """

    edit: Callable[[Edit, World, World], None]
    of_links: NotExpressible | None = None

    def write(self, edit: Edit, before: World, after: World) -> None:
        """Change an MJCF model from the world without the effect to the world with it."""
        if self.of_links is not None and after.object.n_joints:
            self.of_links.write(edit, before, after)
        else:
            self.edit(edit, before, after)


@dataclass(frozen=True)
class RecordingCorrection:
    """How the recorded data are corrected where the recording is wrong, not the simulator.

    Attributes:
        text: What to do with the recorded data, of a world with the effect.
    """

    text: Callable[[World], str]

    def write(self, edit: Edit, before: World, after: World) -> None:
        """Note beside an edited model how the recorded data are corrected."""
        edit.recording[edit.effect] = self.text(after)


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One possible cause of a gap between a simulator and reality.

    Attributes:
        name: As in the settings and in reports.
        family: body, environment, fluid, field, contact, joint or measurement.
        says: What it is, in half a sentence, for the report.
        parameters: Its numbers.
        phases: Where it acts; everywhere if nothing is said.
        apply: The world with the effect, given the parameters' values by name.
        mujoco: How MuJoCo simulates it, or why it cannot.
        mjcf: How an MJCF file says it or how the recording is corrected, or why neither can be done.
        strength: How strong an audit makes it, or why no audit can contain it.
        read: The values that a world has, of parameters without a fixed nominal value.
        contains: Names of effects that are special cases of it.
        starts: Values from which it is also fitted, where what it does is far from linear.
        near_nothing: Whether its nominal values are only close to no effect, because no values are none.
        powered: The force whose other power law is tried too, and the state on which that force depends, in words.
        made_of: Names of effects that together do exactly the same.
        one_of_group: Names of a group of effects, this among them, each of which does what the others do together.
        needs_joints: Whether only objects with joints can have it.
        sharp_only: Whether only objects without round parts can have it.
        of_links: The form that it has for objects with joints; None for the same form.
    """

    name: str
    family: str
    says: str
    parameters: tuple[Parameter, ...]
    phases: tuple[Phase, ...] = EVERY_PHASE
    apply: Callable[[World, Mapping[str, float]], World]
    mujoco: InMujoco | NotExpressible
    mjcf: MjcfEdit | RecordingCorrection | NotExpressible
    strength: Strength | NotExpressible
    read: Callable[[World], Mapping[str, float]] = lambda world: {}
    contains: tuple[str, ...] = ()
    starts: tuple[Mapping[str, float], ...] = ()
    near_nothing: bool = False
    powered: tuple[PoweredForce, str] | None = None
    made_of: frozenset[str] = frozenset()
    one_of_group: frozenset[str] = frozenset()
    needs_joints: bool = False
    sharp_only: bool = False
    of_links: Effect | None = None

    def __post_init__(self) -> None:
        kinds = {
            "mujoco": (InMujoco, NotExpressible),
            "mjcf": (MjcfEdit, RecordingCorrection, NotExpressible),
            "strength": (Strength, NotExpressible),
        }
        for field, allowed in kinds.items():
            if not isinstance(getattr(self, field), allowed):
                names = " or ".join(kind.__name__ for kind in allowed)
                raise InputError(f"effect '{self.name}' states no {field}; expected {names}")
        if isinstance(self.mujoco, NotExpressible) and self.mujoco.present is None:
            raise InputError(f"effect '{self.name}' does not state which worlds have it, which MuJoCo must refuse")
        if not self.parameters:
            raise InputError(f"effect '{self.name}' has no parameters")

    @property
    def is_force(self) -> bool:
        """Whether it is a force of the air or of a field, gravity too, which changes nothing but accelerations."""
        return self.family in ("fluid", "field") or self.name == "gravity"

    def bounded(self, model: ObjectModel) -> Effect:
        """The effect with bounds that an object's size allows; itself where they are no narrower."""
        parameters = tuple(p.bounded(model) for p in self.parameters)
        if all(new is old for new, old in zip(parameters, self.parameters, strict=True)):
            return self
        ends = {p.name: (p.low, p.high) for p in parameters}
        starts = tuple({name: float(np.clip(x, *ends[name])) for name, x in start.items()} for start in self.starts)
        return replace(self, parameters=parameters, starts=starts)

    def nominal(self, world: World) -> Array:
        """Values (P,), in the order of the parameters, at which the effect changes nothing in a world."""
        here = self.read(world)
        return np.array([here[p.name] if p.nominal is None else p.nominal for p in self.parameters])

    def named(self, values: Array) -> dict[str, float]:
        """Values (P,) by the parameters' names."""
        return dict(zip((p.name for p in self.parameters), map(float, values), strict=True))

    def values_with(self, world: World, given: Mapping[str, float]) -> Array:
        """Values (P,) of which some are given by the parameters' names; the others are nominal in a world."""
        return np.array(list((self.named(self.nominal(world)) | dict(given)).values()))

    def at(self, world: World, values: Array) -> World:
        """The world with the effect, from that without it and values (P,), which are clipped to their ranges."""
        named = {p.name: float(np.clip(x, p.low, p.high)) for p, x in zip(self.parameters, values, strict=True)}
        return self.apply(world, named)

    @cached_property
    def other_power_law(self) -> Effect | None:
        """The further power with which this effect's force may grow with its state; None if it has no such force.

        It shows whether a force has the effect's law at all. It is not in the library, and is never named as a cause.
        """
        if self.powered is None:
            return None
        force, state = self.powered
        return Effect(
            name=f"{self.name}'s power",
            family="law",
            says=state,
            parameters=(Parameter(OTHER_POWER, 0.0, -2.0, 4.0, 0.1),),
            phases=(Phase.FLIGHT,),
            apply=lambda w, p: replace(w, forces=w.forces._replace(powered=float(force), power=p[OTHER_POWER])),
            mujoco=InMujoco(),
            mjcf=_NO_CAUSE,
            strength=_NO_CAUSE,
        )


_NO_CAUSE = NotExpressible("it only tests the law of another effect")
SHARED_AMONG_LINKS = NotExpressible("MJCF has no force that links share by their mass")
"""For `MjcfEdit.of_links`."""
