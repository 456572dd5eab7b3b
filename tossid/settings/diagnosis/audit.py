"""Settings of an audit: diagnoses of tosses whose effect is withheld."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from tossid.settings.kinds import Bounds, Count, Fraction, Ordered, Positive, Seed, Span, advanced_part

CaseKind = Literal["effect", "null", "pair", "recording", "four", "eight", "outside", "without"]
"""What is in a drawn case: an effect of the library, nothing, two effects of different families, two errors of one
recording, four or eight effects at once, a force that the library lacks, or an effect that is then taken out of the
library."""


@dataclass(frozen=True, kw_only=True)
class CaseSettings:
    """How the tosses of a case are simulated, and how the strengths of its effects are found."""

    lcp_substeps: Count = 64
    """time steps a frame of the engine lcp: far more than a diagnosis takes, whose errors the truth must not share"""
    substeps: Count = 32
    """time steps a frame of the throws by which strengths are found, and of forces outside the library"""
    impact_parts: Count = 8
    """parts of such a time step in which contact gives way, where impacts have a duration"""
    throws: Count = 16
    """throws by which strengths are found"""
    seconds: Positive = 0.9
    """length of these throws [s]"""
    rest_speed: Positive = 0.01
    """speed below which the object rests [m/s]"""
    tries: Count = 8
    """most strengths that are tried"""
    tolerance: Positive = 0.2
    """logarithm of the ratio of reached to wanted displacement at which the search ends"""


@dataclass(frozen=True, kw_only=True)
class ScoreSettings:
    """What counts as right, and what an audit is expected to reach."""

    largest_class: Count = 3
    """effects of a confusable class among which the true one may be"""
    restored: Fraction = 0.05
    """relative error up to which a spoilt parameter counts as restored"""
    closable: Fraction = 0.3
    """share of the gap that the true effects must close for the share that the diagnosis closes to be scored"""
    right_name: Fraction = 0.9
    """wanted share of right names"""
    coverage: Fraction = 0.85
    """wanted share of 95 % intervals that hold the true value"""
    closed: Fraction = 0.9
    """wanted median share of the closable gap that is closed"""
    pairs: Fraction = 0.7
    """wanted share of pairs of which both effects are named"""
    several: Fraction = 0.75
    """wanted share of four or eight effects at once that are named, with none that is not there"""
    outside: Fraction = 0.75
    """wanted share of forces outside the library for which nothing is named"""
    same_moment: Count = 3
    """tosses by which a change over the order may be found off"""
    moments: Fraction = 0.95
    """wanted share of changes over the order that are found"""
    groups: Count = 4
    """groups of equally many cases whose share of right names is drawn over the displacement"""
    shaded: Span = (5.0, 500.0)
    """displacements over the position noise that the figure shades"""


@dataclass(frozen=True, kw_only=True)
class AuditSettings:
    """Which cases an audit has, and how they are made and scored."""

    cases: Count = 20
    """how many cases; those of a smaller number are the first of them"""
    seed: Seed = 0
    """seed of the cases"""
    tosses: Annotated[int, Bounds(low=6)] = 40
    """tosses a case; of real ones so many are drawn"""
    engines: tuple[Literal["lcp", "mujoco", "drake", "bullet"], ...] = ("lcp", "mujoco")
    """what simulates, in turns; where one cannot express the effect, the next that can. drake and bullet need
    `pip install 'tossid[engines]'`"""
    repeats: Annotated[int, Bounds(low=0)] = 10
    """how often a diagnosis repeats its search (as of `diagnose`)"""
    kinds: tuple[CaseKind, ...] = ("effect",) * 5 + ("null",) * 2 + ("pair", "outside", "without")
    """what is in cases: every so many cases are these, in a drawn order"""
    filmed: bool = False
    """film the tosses with three cameras and track the tags in their images; false: poses with normal noise"""
    position_noise: Positive = 1.5e-4
    """standard deviation of recorded positions [m]"""
    rotation_noise: Positive = 1.5e-3
    """standard deviation of recorded orientations [rad]"""
    displacement: Annotated[tuple[Positive, Positive], Ordered()] = (8.0, 300.0)
    """how far an effect moves the object (median over a toss), over the position noise: drawn between these"""
    over_order: bool = False
    """make cases in which an effect changes over the order of the tosses, or nothing does; false: effects are in all"""
    making: CaseSettings = advanced_part(CaseSettings)
    """how cases are made"""
    scoring: ScoreSettings = advanced_part(ScoreSettings)
    """what counts as right"""
