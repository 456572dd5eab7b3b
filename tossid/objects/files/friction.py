"""The friction of object and ground: what an object's file states of it, and what MuJoCo makes of two geoms."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from typing import NamedTuple
from xml.parsers import expat

import mujoco
import numpy as np

from tossid.errors import ObjectError

GUESS = 0.18
"""Friction of an object where neither its file nor the caller states one: that of the published cube."""
_MUJOCOS = 1.0
"""Sliding friction of a geom of which the file states none."""
_URDF = ("drake:mu_dynamic", "drake:mu_static", "contact_coefficients", "lateral_friction", "mu", "mu1", "mu2")
"""Elements in which URDF states friction, as Drake, ROS, PyBullet and Gazebo read it; MuJoCo reads none."""
_log = logging.getLogger(__name__)


class Friction(NamedTuple):
    """The friction that an object has, and where it comes from.

    Attributes:
        value: Coulomb's coefficient of object and ground.
        words: Where it comes from; nothing where caller and file agree, or the file states none and the caller one.
        is_guess: Whether neither states one.
    """

    value: float
    words: str = ""
    is_guess: bool = False

    def say(self) -> None:
        """Log where it comes from."""
        if self.words:
            _log.log(logging.WARNING if self.is_guess else logging.INFO, self.words)


def friction_of(m: mujoco.MjModel, texts: Sequence[str], given: float | None, *, file: str) -> Friction:
    """The friction that an object has: as given, else as its file states it, else a guess.

    Args:
        m: The compiled model.
        texts: The text of its file, and of those that it includes.
        given: What the caller states; None for nothing.
        file: The file in words.

    Raises:
        ObjectError: Nothing is given, and the file states several.
    """
    found = _stated(m, texts)
    words = " and ".join(f"{value:g}" for value in found)
    if given is not None:
        return Friction(
            given, "" if found in ([], [given]) else f"{file} states friction {words}; {given:g} holds instead"
        )
    if len(found) > 1:
        raise ObjectError(f"states friction {words} for parts of one object, expected one; object.friction says which")
    if found:
        return Friction(found[0], f"{file} states friction {words}, which holds (object.friction would state another)")
    return Friction(
        GUESS, f"{file} states no friction; {GUESS:g} is a guess (object.friction states it)", is_guess=True
    )


def contact_friction(m: mujoco.MjModel, ground: int, own: int) -> float:
    """Sliding friction of two geoms as MuJoCo combines it: of their pair, of the one with priority, or the larger."""
    pair = _pair(m, ground, own)
    if pair is not None:
        return float(m.pair_friction[pair, 0])
    order = int(m.geom_priority[own]) - int(m.geom_priority[ground])
    one, other = float(m.geom_friction[own, 0]), float(m.geom_friction[ground, 0])
    return one if order > 0 else other if order < 0 else max(one, other)


def combined_words(m: mujoco.MjModel, ground: int, own: int) -> str:
    """What MuJoCo makes of the frictions that two geoms state, in words."""
    made = contact_friction(m, ground, own)
    one, other = (f"{float(m.geom_friction[geom, 0]):g}" for geom in (own, ground))
    if _pair(m, ground, own) is not None:
        how = f"their pair states it; the object states {one}, the ground {other}"
    elif m.geom_priority[own] != m.geom_priority[ground]:
        how = f"the object states {one}, the ground {other}, and the geom with the higher priority decides"
    elif one == other:
        how = "both geoms have it"
    else:
        how = f"the object states {one}, the ground {other}, and MuJoCo takes the larger"
    return f"friction of object and ground is {made:g} ({how})"


def colliding_geoms(m: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """Geoms that touch others: those of the world, and those of bodies."""
    touch = [g for g in range(m.ngeom) if m.geom_contype[g] or m.geom_conaffinity[g]]
    return [g for g in touch if m.geom_bodyid[g] == 0], [g for g in touch if m.geom_bodyid[g] != 0]


def _pair(m: mujoco.MjModel, one: int, other: int) -> int | None:
    """The pair of two geoms that the model lists, if it does."""
    pairs = zip(m.pair_geom1.tolist(), m.pair_geom2.tolist(), strict=True)
    return next((k for k, pair in enumerate(pairs) if set(pair) == {one, other}), None)


def _stated(m: mujoco.MjModel, texts: Sequence[str]) -> list[float]:
    """The frictions that a file states: none, one, or several of different parts."""
    in_geoms, in_urdf = _in_texts(texts)
    if in_urdf:
        return sorted(in_urdf)
    # a compiled geom has MuJoCo's own friction where the file states none
    unstated = None if _MUJOCOS in in_geoms else _MUJOCOS
    grounds, own = colliding_geoms(m)
    found = set[float | None]()
    for geom in own:
        both = [geom, *grounds] if len(grounds) == 1 else [geom]
        first = max(int(m.geom_priority[g]) for g in both)
        decide = [float(m.geom_friction[g, 0]) for g in both if m.geom_priority[g] == first]
        said = [value for value in decide if value != unstated]
        paired = len(both) == 2 and _pair(m, *both) is not None
        found.add(contact_friction(m, both[1], geom) if paired else max(said, default=None))
    return [] if found == {None} else sorted(_MUJOCOS if value is None else value for value in found)


def _in_texts(texts: Sequence[str]) -> tuple[set[float], set[float]]:
    """First frictions at elements `geom` of MJCF, and frictions that URDF's elements state."""
    in_geoms, urdf = set[float](), dict[str, set[float]]()
    for text in texts:
        inside: list[str] = []

        def start(element: str, given: dict[str, str], inside: list[str] = inside) -> None:
            inside.append(element)
            if element == "geom":
                in_geoms.update(_first(given.get("friction", "")))
            elif element in _URDF:
                urdf.setdefault(element, set()).update(_first(given.get("value", given.get("mu", ""))))

        def content(words: str, inside: list[str] = inside) -> None:
            if inside[-1:] and inside[-1] in _URDF:
                urdf[inside[-1]].update(_first(words))

        parser = expat.ParserCreate("utf-8")
        parser.buffer_text = True
        parser.StartElementHandler, parser.CharacterDataHandler = start, content
        parser.EndElementHandler = lambda _, inside=inside: inside.pop()
        try:
            parser.Parse(re.sub("<!--.*?-->", "", text, flags=re.DOTALL).encode("utf-8", "surrogatepass"), True)
        except expat.ExpatError:  # MuJoCo has read it; what stands before is known
            continue
    if urdf.get("drake:mu_dynamic"):
        urdf.pop("drake:mu_static", None)
    return in_geoms, set[float]().union(*urdf.values())


def _first(words: str) -> list[float]:
    """The first number of an attribute or a text, if there is one."""
    try:
        value = float(words.split()[0])
    except (IndexError, ValueError):
        return []
    return [value] if np.isfinite(value) else []
