"""Settings of rendered camera images (`tossid.vision.rendering`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from tossid.errors import InputError
from tossid.settings.kinds import Bounds, Count, Fraction, NonNegative, Positive, advanced_part


@dataclass(frozen=True, kw_only=True)
class HandSettings:
    """A hand that holds the object, or reaches through a camera's view."""

    skin: NonNegative = 150.0
    """grey level of the hand at full light"""
    sleeve: NonNegative = 70.0
    """grey level of the forearm at full light"""
    approach_time: Positive = 0.2
    """time that the hand takes to come or go [s]"""
    acceleration: Positive = 12.0
    """acceleration with which it leaves the object, upward [m/s²]"""
    sweep_distance: Positive = 0.22
    """distance from the object at which it passes through a view [m]"""
    sweep_speed: Positive = 2.2
    """speed with which it passes [m/s]"""


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """How images look."""

    samples: Count = 16
    """rays a pixel, spread over its area and the exposure"""
    noise: NonNegative = 1.5
    """standard deviation of the sensor's noise [grey levels]"""
    blur: NonNegative = 0.5
    """standard deviation of the lens's blur [px]"""
    light: tuple[float, float, float] = (0.3, 0.2, 1.0)
    """direction that light comes from, world frame; its length does not matter"""
    ambient: Fraction = 0.55
    """share of the light that has no direction"""
    white: Annotated[float, Bounds(low=0, high=255)] = 225.0
    """grey level of paper at full light"""
    black: Annotated[float, Bounds(low=0, high=255)] = 18.0
    """grey level of ink at full light"""
    ground: Annotated[float, Bounds(low=0, high=255)] = 110.0
    """grey level of the ground at full light"""
    glare: NonNegative = 0.0
    """brightness of the lamp's mirror image in faces with tags, over that of white paper"""
    gloss: Positive = 300.0
    """sharpness of that image: the exponent of Phong 1975"""
    lamp: Positive = 2.0
    """distance of the lamp from the origin [m]"""
    aperture: NonNegative = 0.0
    """diameter of the lens's opening [m]; 0: everything is in focus"""
    focus: Positive = 1.4
    """distance in focus [m]"""
    texture: NonNegative = 0.0
    """contrast of the ground's pattern [grey levels]"""
    litter: tuple[Any, ...] = ()
    """prints that lie on the ground (`tossid.vision.rendering.backdrop.Litter`)"""
    hand: HandSettings = advanced_part(HandSettings)
    """how a hand looks, where there is one"""

    def __post_init__(self) -> None:
        """Refuse values that no image can have."""
        if self.samples < 1 or self.noise < 0 or self.blur < 0 or not 0 <= self.ambient <= 1:
            raise InputError("render settings: samples >= 1, noise >= 0, blur >= 0 and 0 <= ambient <= 1 are needed")
        if min(self.glare, self.aperture, self.texture) < 0 or min(self.gloss, self.lamp, self.focus) <= 0:
            raise InputError("render settings: glare, aperture, texture >= 0 and gloss, lamp, focus > 0 are needed")

    @property
    def lens(self) -> tuple[float, float]:
        """Radius of the lens's opening and distance in focus [m]."""
        return 0.5 * self.aperture, self.focus
