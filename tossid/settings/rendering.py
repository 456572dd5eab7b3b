"""Settings of rendered camera images (`tossid.vision.rendering`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from tossid.settings.kinds import Bounds, Checked, Count, Fraction, NonNegative, Positive, advanced


@dataclass(frozen=True, kw_only=True)
class RenderSettings(Checked):
    """How images look."""

    samples: Count = 16
    """rays a pixel, spread over its area and the exposure"""
    noise: NonNegative = 1.5
    """standard deviation of the sensor's noise [grey levels]"""
    blur: NonNegative = 0.5
    """standard deviation of the lens's blur [px]"""
    ambient: Fraction = advanced(0.55)
    """share of the light that has no direction"""
    white: Annotated[float, Bounds(low=0, high=255)] = advanced(225.0)
    """grey level of paper at full light"""
    glare: NonNegative = 0.0
    """brightness of the lamp's mirror image in faces with tags; 1: as bright as white paper"""
    gloss: Positive = advanced(300.0)
    """sharpness of that image: the exponent of Phong 1975"""
    aperture_m: NonNegative = 0.0
    """diameter of the lens's opening, which blurs what is out of focus [m]; 0: all is sharp"""
    distance: Positive = 1.4
    """of the cameras from the middle of what they see [m]"""
    focus_m: Positive | None = None
    """distance in focus [m]; null: camera.distance"""
    texture: NonNegative = 0.0
    """contrast of the ground's pattern [grey levels]"""
    litter: tuple[Any, ...] = advanced(())
    """prints that lie on the ground (`tossid.vision.rendering.backdrop.Litter`)"""

    @property
    def lens(self) -> tuple[float, float]:
        """Radius of the lens's opening and distance in focus [m]."""
        return 0.5 * self.aperture_m, self.focus_m or self.distance
