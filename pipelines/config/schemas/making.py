"""Keys of new-object."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tossid.settings.kinds import Bounds, Positive
from tossid.settings.limits import Friction, Length, Mass, Restitution


@dataclass(frozen=True)
class NewObjectConfig:
    """An object made of a box with a tag on each face, and a sheet to print its tags from."""

    name: str
    """what it is called"""
    box: tuple[Length, Length, Length]
    """its edges along x, y and z [m]"""
    mass: Mass
    """its mass [kg]"""
    com: tuple[float, float, float]
    """its centre of mass, from the box's centre [m]"""
    friction: Friction
    """Coulomb friction of object and ground, as far as you know it"""
    restitution: Restitution
    """Newton's restitution, 0 for none"""
    tag_size: Positive | None
    """edge of the tags' black border [m]; null: three quarters of what each face has room for"""
    first_id: Annotated[int, Bounds(low=0, high=581)]
    """id of the first tag (36h11); six are used, on +x, -x, +y, -y, +z, -z"""
    paper: Literal["a4", "letter"]
    """what the sheet is printed on"""
    out: Path | None
    """folder that gets object/NAME.xml, object/NAME.yaml, tags/NAME.yaml and tags/NAME.pdf; null: conf, where
    object=NAME finds it"""
