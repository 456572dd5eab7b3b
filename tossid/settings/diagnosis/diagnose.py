"""Settings of `tossid.diagnose`: which tosses, and how they are judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from tossid.settings.diagnosis.likelihood import LikelihoodSettings
from tossid.settings.kinds import Bounds, Count, Fraction, NonNegative, Positive, Seed, Span, advanced_part


@dataclass(frozen=True, kw_only=True)
class NextTossSettings:
    """How the release that best separates confusable hypotheses is sought."""

    candidates: Count = 200
    """releases that are drawn"""
    widened: NonNegative = 0.5
    """share by which the ranges of earlier releases are widened"""
    clearance: NonNegative = 0.02
    """least height of the lowest corner at release [m]"""
    hypotheses: Annotated[int, Bounds(low=2)] = 3
    """most hypotheses that are compared"""
    frames: Count = 100
    """most frames of a toss that are predicted"""
    earlier_tosses: Count = 20
    """most earlier tosses with which releases are compared"""
    least_separation: Positive = 3.0
    """expected separation below which no toss is proposed [standard deviations]"""


@dataclass(frozen=True, kw_only=True)
class LearnedSettings:
    """What a simulator's learned acceleration stands for (`tossid.diagnosis.learned`)."""

    states: Count = 2000
    """most states in flight at which it is compared with effects"""
    effects: Count = 3
    """most effects that it is said to stand for"""
    least_share: Fraction = 0.05
    """share of its mean square that an effect must do beyond those before it"""
    least_acceleration: Positive = 0.05
    """root mean square below which it is said to do next to nothing [m/s²]; angular accelerations count over half a
    width"""


@dataclass(frozen=True, kw_only=True)
class PlaneSettings:
    """How a motion that stays in a plane is recognised, and what it shows."""

    out_of_plane: Fraction = 0.02
    """share of velocities along the plane's normal, and of spins about other axes, up to which a motion is in the
    plane"""
    windows: Count = 60
    """windows in which it is tried what a parameter changes"""
    steps: Positive = 2.0
    """by how many steps a parameter is moved to either side"""
    least_change: Positive = 1e-5
    """change of a pose [m, rad] from which a parameter does anything in a window, ..."""
    least_windows: Fraction = 0.05
    """... which it must do in this share of the windows"""
    least_share: Fraction = 0.5
    """share of what a parameter changes that must differ in the plane between both sides for it to be shown"""


@dataclass(frozen=True, kw_only=True)
class ReleaseSettings:
    """When the first frames of all tosses are not in free flight, and are left out."""

    least_change: Positive = 0.3
    """median acceleration over that soon after, from which a first frame is not free [gravity]"""
    level: Fraction = 1e-3
    """level at which it must differ (signed ranks over tosses)"""
    fewest_tosses: Count = 6
    """tosses that must have the frame in flight"""
    most_frames: Count = 20
    """most frames that are left out"""


@dataclass(frozen=True, kw_only=True)
class WitnessSettings:
    """Which impacts and slides give a measurement without a simulator."""

    flight: Count = 6
    """frames of flight before and after an impact, from which its velocities are taken"""
    jump: Positive = 0.2
    """change of velocity between frames that is an impact at least, beyond noise [m/s]"""
    quiet: Positive = 0.04
    """change of velocity between frames that is no impact at most, beyond noise [m/s]"""
    longest_round: Count = 5
    """frames in which the velocity jumps, of an impact of a round object, which may be soft; of a corner two"""
    lone: Fraction = 0.1
    """share of the object's width by which all other corners are higher than a lone one"""
    along_edge: Fraction = 0.05
    """sine of the angle to the spin below which an edge is hit as one place, at its middle"""
    least_closing: Positive = 0.3
    """speed at which a corner hits at least [m/s]"""
    least_slip: Positive = 0.3
    """speed at which a corner slips after an impact at least, for friction to be at its limit [m/s]"""
    parabola: Count = 11
    """frames of a local parabola"""
    flat: Fraction = 0.015
    """share of the object's width within which three corners are as low, on a face"""
    uneven: Positive = 0.3
    """share by which a time step while sliding may differ from the median one"""
    slow: Span = (0.05, 0.1)
    """slow sliding [m/s]"""
    fast: Span = (0.3, 0.6)
    """fast sliding [m/s]"""
    least_spin_change: Positive = 5.0
    """change of spin by an impact from which inertia is measured [rad/s]"""
    most_spin: Positive = 0.5
    """largest spin about the vertical in sliding [rad/s]"""
    fewest_tosses: Count = 5
    """tosses that a measurement needs"""
    draws: Count = 4
    """tosses that the found simulator makes of each first state, each with other noise"""
    solver_error: Fraction = 0.05
    """share of a value within which made tosses may differ from recorded ones by how finely they are simulated"""


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Which tosses and simulators are refused."""

    fewest_tosses: Count = 3
    """tosses below which a gap has no interval"""
    still: Positive = 10.0
    """standard deviations of poses within which nothing moves in a toss"""
    simulator_seconds: Positive = 120.0
    """longest that a user's own simulator may take for a call [s]"""
    most_lost: Fraction = 0.2
    """share of the changes of velocity of a user's simulator that a stop at each frame may change; beyond it, effects
    are added to whole motions"""
    size_ratio: Annotated[float, Bounds(above=1)] = 1.6
    """ratio of the sizes of two objects beyond which one is not a wrong statement of the other"""
    most_diverged: Fraction = 0.1
    """share of tosses on which a simulator may diverge"""
    far: Positive = 1e3
    """distance from the origin beyond which a simulated toss has diverged [m]"""


@dataclass(frozen=True, kw_only=True)
class DiagnoseSettings:
    """Which tosses are diagnosed, and how."""

    split: Literal["train", "validation", "test"] | None = None
    """only the tosses of this split; null: all. Of others than the test split, rollouts of that are shown, too"""
    skip: Annotated[int, Bounds(low=0)] = 0
    """how many tosses are left out before the first"""
    tosses: Count | None = None
    """how many tosses; null: those that follow, or some drawn at random where these are many"""
    seed: Seed = 0
    """seed of the draws: which tosses judge, resampling"""
    without: tuple[str, ...] = ()
    """effects of the library that are not considered"""
    threads: Count | None = None
    """threads of the simulator; null: one a core"""
    repeats: Annotated[int, Bounds(low=0)] = 4
    """how often the search is repeated, each time without another part of the tosses, which then judge what it finds;
    0: never, then nothing is said of how sure it is"""
    likelihood: LikelihoodSettings = advanced_part(LikelihoodSettings)
    """how likely tosses are under a simulator"""
    checks: CheckSettings = advanced_part(CheckSettings)
    """what is refused"""
