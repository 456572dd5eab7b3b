"""An object from nothing: a solid box."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

from tossid.errors import ConfigError
from tossid.objects.mjcf import object_from_mjcf
from tossid.objects.model import ObjectModel

_MJCF = """<mujoco model="{name}">
  <worldbody>
    <body name="{name}">
      <freejoint/>
      <inertial pos="{com}" mass="{mass!r}" diaginertia="{inertia}"/>
      <geom type="box" size="{half}"/>
    </body>
  </worldbody>
</mujoco>
"""


def box(
    name: str, edges: Sequence[float], mass: float, *, com: Sequence[float] = (0.0, 0.0, 0.0), **stated: Any
) -> ObjectModel:
    """A box with the inertia that it has if its mass is spread evenly.

    Args:
        name: Letters, digits, "_" and "-"; the first is a letter.
        edges: Its edges along x, y and z [m].
        mass: Its mass [kg].
        com: Its centre of mass, from the box's centre [m].
        **stated: Friction, restitution, tags and what else `tossid.objects.mjcf.Stated` names.

    Raises:
        ConfigError: The name will not do, or the centre of mass lies outside the box.
    """
    if not re.fullmatch(r"[A-Za-z][\w-]*", name, re.ASCII):
        raise ConfigError("name", f"'{name}' will not do; expected letters, digits, '_' and '-'.")
    if any(abs(c) >= edge / 2 for c, edge in zip(com, edges, strict=True)):
        raise ConfigError("com", f"{list(com)} lies outside the box; expected metres from its centre.")
    x, y, z = edges
    inertia = (mass / 12 * s for s in (y * y + z * z, x * x + z * z, x * x + y * y))
    half = (edge / 2 for edge in edges)
    text = _MJCF.format(name=name, mass=float(mass), com=_row(com), inertia=_row(inertia), half=_row(half))
    return object_from_mjcf(text, **{"width": max(edges), **stated})


def _row(values: Iterable[float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
