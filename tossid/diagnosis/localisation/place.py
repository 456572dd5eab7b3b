"""Where the gap is: on the object, and in the state of its motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.parts import Part

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Corner(Part):
    """What of the gap above the noise floor arises in frames in which a corner touches, of all frames with contact.

    Attributes:
        place: The corner [m], in the base's frame with all joints at zero.
        share: Its share.
        frames: In how many it touches, alone or with others.
        per_frame: Its share over its share of the frames, 1 for as much as in any contact; None if it never touches.
        link: Number of its link, 0 for the base.
    """

    place: tuple[float, float, float]
    share: Interval
    frames: int
    per_frame: float | None
    link: int = 0

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "by_corner"."""
        whole = super().as_json()
        return {
            "corner": whole.pop("place"),
            **whole,
            "share": self.share.value,
            "ci95": [self.share.low, self.share.high],
        }


@dataclass(frozen=True)
class Relation(Part):
    """The residual wrench of the windows in a phase, and the state that explains one component of it best.

    Attributes:
        phase: "flight" or "contact".
        windows: How many determine the component.
        tosses: Of how many tosses.
        component: Its name (`localisation.relations.COMPONENTS`).
        state: Name of the state (`localisation.relations.STATES`).
        r2: Share of the component's squares that a curve over the state (its mean, if no state is clear) explains on
            tosses that took no part.
        p_value: Probability that signs drawn by toss give as good a best pair.
        clear: Whether the component is clearly there.
        r2_state: As `r2`, beyond the component's mean.
        p_state: As `p_value`, beyond the component's mean.
        state_clear: Whether the component clearly depends on the state.
        means: Of all components over the windows [N], [N m].
        points: (windows, 4) state, component, its standard error, toss.
        curve: (m, 4) state, fitted component, its 95 % band.
    """

    phase: str
    windows: int
    tosses: int
    component: str
    state: str
    r2: Interval
    p_value: float
    clear: bool
    r2_state: Interval
    p_state: float
    state_clear: bool
    means: dict[str, Interval]
    points: Array
    curve: Array

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "wrench", with five points of the curve."""
        some = self.curve[np.linspace(0, len(self.curve) - 1, 5).round().astype(int)]
        curve = [{"state": x, "value": y, "ci95": [low, high]} for x, y, low, high in some.tolist()]
        whole = {**super().as_json(), "curve": curve}
        del whole["points"]
        return whole


@dataclass(frozen=True)
class Place:
    """Where in the state of the motion and on the object the gap is.

    Attributes:
        wrench: The stated simulator's residual wrenches by phase.
        corners: Shares of its excess in contact.
        wrench_left: As `wrench`, with the effects in.
        corners_left: As `corners`, with the effects in; of the same whole.
    """

    wrench: tuple[Relation, ...] = ()
    corners: tuple[Corner, ...] = ()
    wrench_left: tuple[Relation, ...] = ()
    corners_left: tuple[Corner, ...] = ()
