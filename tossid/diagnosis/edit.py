"""A MuJoCo model under change, and the list of what has changed in it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from tossid.errors import ObjectError


@dataclass(frozen=True)
class Change:
    """One attribute of the MJCF. exact: MuJoCo's law is the effect's own."""

    effect: str
    where: str
    attribute: str
    before: str
    after: str
    exact: bool = True
    note: str = ""

    def as_json(self) -> dict[str, Any]:
        """As in gap.json."""
        return dict(vars(self))


@dataclass
class Edit:
    """A MuJoCo model under change."""

    spec: mujoco.MjSpec
    effect: str = ""
    changes: list[Change] = field(default_factory=list)
    recording: dict[str, str] = field(default_factory=dict)
    cannot: dict[str, str] = field(default_factory=dict)

    def compiled(self) -> mujoco.MjModel:
        try:
            return self.spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise ObjectError(f"MuJoCo cannot compile the patched model: {str(error).splitlines()[0]}") from error

    @property
    def body(self) -> mujoco.MjsBody:
        return self.spec.worldbody.bodies[0]

    @property
    def own(self) -> list[mujoco.MjsGeom]:
        """Geoms of the object that touch."""
        bodies = self.spec.bodies[1:]  # the first is the world
        return [g for body in bodies for g in body.geoms if g.contype or g.conaffinity]

    @property
    def joints(self) -> list[mujoco.MjsJoint]:
        """Those of links, in the order of the links."""
        return [joint for joint in self.spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]

    @property
    def grounds(self) -> list[mujoco.MjsGeom]:
        """What the object lands on."""
        return [g for g in self.spec.worldbody.geoms if g.contype or g.conaffinity]

    def set(self, element: Any, attribute: str, value: Any, where: str, *, exact: bool = True, note: str = "") -> None:
        """Set an attribute, and note it."""
        before = _text(getattr(element, attribute))
        setattr(element, attribute, value)
        after = _text(getattr(element, attribute))
        if before != after:
            self.changed(where, attribute, before, after, exact=exact, note=note)

    def changed(
        self, where: str, attribute: str, before: Any, after: Any, *, exact: bool = True, note: str = ""
    ) -> None:
        """Note what has changed; numbers are written out."""
        self.changes.append(Change(self.effect, where, attribute, _text(before), _text(after), exact, note))


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    numbers = np.atleast_1d(np.asarray(value, dtype=float)).round(12) + 0.0
    return " ".join(f"{x:.6g}" for x in numbers)
