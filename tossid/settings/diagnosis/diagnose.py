"""Settings of `tossid.diagnose`: which tosses, and every number that the search for effects depends on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from tossid.settings.diagnosis.likelihood import LikelihoodSettings
from tossid.settings.diagnosis.order import OrderSettings
from tossid.settings.diagnosis.patch import PatchSettings
from tossid.settings.diagnosis.report import ReportSettings
from tossid.settings.kinds import Bounds, Count, Fraction, NonNegative, Positive, Seed, Span, advanced_part


@dataclass(frozen=True, kw_only=True)
class CrossValidationSettings:
    """How a hypothesis is judged on tosses that took no part in its fit."""

    folds: Annotated[int, Bounds(low=2)] = 8
    """parts of the tosses, each of which is left out of a fit in turn"""
    judging_folds: Annotated[int, Bounds(low=2)] = 4
    """parts of the tosses, each of which judges what was chosen and fitted without it at the end"""
    refits: Count = 2
    """fits of all effects together, each from a perturbed last one"""
    least_refit_gain: Positive = 1.0
    """gain of log-likelihood of a refit below which no other follows"""
    restarts: Annotated[int, Bounds(low=0)] = 1
    """how often windows that fit poorly are restarted whenever the hypothesis has changed"""


@dataclass(frozen=True, kw_only=True)
class SelectionSettings:
    """How effects are screened, selected one by one, pruned, and compared with those that could stand in for them."""

    level: Fraction = 0.05
    """family-wise significance level of a round, over the library (Bonferroni)"""
    least_closed: Fraction = 0.004
    """share of the deviance that an effect must close to be named"""
    most_effects: Count = 9
    """most effects of a hypothesis"""
    most_rounds: Count = 12
    """most rounds of forward selection"""
    most_joint_refits: Count = 3
    """most refits of all effects together, each of which rounds may follow"""
    clearly_needed: Positive = 150.0
    """Wald's statistic of an effect from which it is not tried without it after every round, only at the end"""
    candidates: Count = 6
    """effects that are fitted in full in a round"""
    least_screening_gain: Positive = 3.0
    """gain of log-likelihood by one step from which an effect is fitted in full"""
    second_choice: Fraction = 0.1
    """share of the best screening gain below which an effect is fitted only if none above it is significant"""
    screening_folds: Count = 3
    """folds whose tosses screen starts that are far from the present hypothesis"""
    step_shares: tuple[Positive, ...] = (1.0, 0.3, 0.1, 0.03)
    """parts of a screening step that are tried: impacts are far from linear"""
    class_level: Fraction = 0.05
    """level at which an effect that is worse than the best leaves its confusable class, ..."""
    class_closed: Fraction = 0.8
    """... if it also closes less than this share of what the best closes"""
    hopeless: Positive = 1000.0
    """loss of log-likelihood from which a start is given up before windows that fit poorly are restarted"""
    class_gain: Fraction = 0.4
    """share of the best's gain of log-likelihood that an effect needs to be in its class"""
    general_level: Fraction = 0.2
    """level at which an effect that contains the best must be better to be in its class"""
    largest_class: Count = 3
    """most effects of a confusable class"""
    most_replacements: Annotated[int, Bounds(low=0)] = 4
    """how often an effect may be replaced by another of its class once all effects are in"""
    coulomb_gain: Fraction = 0.3
    """share of the relaxed law's lead that an effect must gain by one step under Coulomb's law to be fitted there"""
    scatter_over_noise: Positive = 4.0
    """scatter of an effect's value from toss to toss over noise (squared) above which it may be unsteady; errors of
    real trackers make 2 to 5"""
    scatter_over_effect: Positive = 0.1
    """the same over the effect itself (squared), above which it is; errors of real trackers make up to 0.05"""
    least_other_power: Positive = 0.5
    """difference of a force's fitted power of its state to its law's, from which the law is another"""


@dataclass(frozen=True, kw_only=True)
class RefinementSettings:
    """How the selected hypothesis is refined where contact makes the likelihood rough."""

    largest_move: Fraction = 0.4
    """share of an effect by which a line search moves it at first"""
    smallest_move: Fraction = 0.04
    """share at which the line search ends"""
    least_gain: Positive = 3.0
    """gain of log-likelihood that a move must bring"""
    hopeless: Positive = 1000.0
    """loss of log-likelihood at the present first states from which a move is given up"""
    shifts: tuple[Fraction, ...] = (0.25, 0.5, 0.75)
    """parts of a window's length by which windows are shifted for further fits"""
    perturbation: NonNegative = 0.1
    """perturbation of the starts of these fits, over what a parameter differs from its nominal value"""
    flight_perturbation: NonNegative = 2.0
    """the same of parameters that act in flight [standard errors]"""
    level: Fraction = 0.05
    """level of Wald's test by which an effect whose value is not clearly other than nominal is pruned"""


@dataclass(frozen=True, kw_only=True)
class LocalisationSettings:
    """How the gap is divided by phase, channel, length of prediction and corner."""

    other_lengths: tuple[Count, ...] = (5, 10, 40)
    """further lengths of windows for which the gap is measured [frames]"""
    resamples: Count = 500
    """bootstrap resamples of tosses"""
    least_left: Fraction = 0.15
    """share of the first gap that must be left in a phase for it to be reported as unexplained"""
    corner_height: Positive = 2e-3
    """height over the lowest corner up to which another touches too [m]: noise, and unevenness of a resting face"""
    corner_level: Fraction = 0.005
    """share of resamples in which a corner that is clearly above the noise floor may be below it"""


@dataclass(frozen=True, kw_only=True)
class WrenchSettings:
    """How the residual wrench is estimated and related to the state of the motion."""

    difference: Positive = 0.01
    """step of finite differences, in weights [N] and weights times half a width [N m]"""
    prior: Positive = 1.0
    """standard deviation of the wrench's prior, in the same units"""
    known: Fraction = 0.15
    """share of the prior's standard deviation below which a window determines a component"""
    least_speed: Positive = 0.05
    """horizontal speed below which it has no direction [m/s]"""
    least_spin: Positive = 0.5
    """spin below which it has no axis [rad/s]"""
    folds: Annotated[int, Bounds(low=2)] = 5
    """folds of the curves' cross-validation"""
    fewest: Count = 6
    """windows, and tosses, from which a relation is sought"""
    curved: Count = 30
    """windows from which a curve is quadratic instead of straight"""
    range: Positive = 2.5
    """standard deviations of a state beyond which a curve is level: few windows are there"""
    outlier: Positive = 6.0
    """robust standard deviations to which a component is limited"""
    sign_flips: Count = 499
    """draws of signs by toss for the distribution of the best relation by chance"""
    level: Fraction = 0.01
    """level of a clear relation"""
    resamples: Count = 300
    """bootstrap resamples of tosses"""


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
class VerdictSettings:
    """What makes a gap none, explained, partly explained or unexplained."""

    no_gap: Positive = 1.25
    """gap over the noise floor below which there is none, if nothing is found"""
    floor_reached: Positive = 1.03
    """gap over the noise floor below which nothing is left to explain"""
    partly_closed: Fraction = 0.5
    """share of the gap that effects must close to explain it in part"""
    all_closed: Fraction = 0.9
    """share of the gap that effects must close to explain it, where no phase has clearly something left"""
    matters_position_pct: NonNegative = 0.5
    """change of whole tosses from which an effect is a headline, mean over frames [% of the width], ..."""
    matters_rotation_deg: NonNegative = 0.5
    """... or this change [deg], ..."""
    matters_closed: Fraction = 0.02
    """... or this share of the gap"""
    refused_level: Fraction = 0.05
    """level at which whole tosses must be predicted worse for what was found to be refused (signed ranks over tosses,
    beyond the first two of these tolerances; of single effects over their number, by Bonferroni)"""
    fewest_judges: Count = 20
    """unseen tosses from which these alone judge that; with fewer the searched ones do too, each by what was chosen and
    fitted without it"""
    detectable: Positive = 4.0
    """size of an effect that these tosses would have revealed [standard errors]"""
    detectable_range: Fraction = 0.5
    """share of a parameter's plausible range; an effect that would be revealed only beyond is not identifiable"""


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
class StabilitySettings:
    """How the search is repeated to see how often each effect is named."""

    lengths: tuple[Positive, ...] = (0.75, 1.0, 1.25)
    """factors of the windows' length, of which a repeat draws one"""
    shortlist: Count = 8
    """effects that gain most by a step, without effects and beside those found, among which a repeat chooses"""
    most_joint_refits: Count = 1
    """most refits of all effects together in a repeat"""
    most_replacements: Annotated[int, Bounds(low=0)] = 1
    """how often a repeat may replace an effect by another of its class"""
    least_frequency: Fraction = 0.9
    """share of the repeats that must name an effect, or one of its class, for it to be more than a candidate"""
    fewest_values: Annotated[int, Bounds(low=2)] = 5
    """repeats that must name an effect for the scatter of its values to widen its intervals"""


@dataclass(frozen=True, kw_only=True)
class EnoughSettings:
    """How many tosses take part where `tosses` is null and there are many."""

    first: Count = 40
    """tosses that are searched first; where there are not twice as many, all take part"""
    judges: Count = 80
    """tosses that judge the answer at most, or as many as were searched"""
    tolerance: Positive = 1.5
    """difference of two fits, over the half widths of their 95 % intervals, up to which they agree: some three
    standard errors, as several values are compared"""


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Which tosses and simulators are refused."""

    fewest_tosses: Count = 3
    """tosses below which a gap has no interval. A name needs more: as many as the level, the tests and the effects
    require (`selection.significance`)"""
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
    """how many tosses; null: as many of those that follow as the answer needs"""
    seed: Seed = 0
    """seed of the draws: which tosses fit and which judge, resampling"""
    without: tuple[str, ...] = ()
    """effects of the library that are not considered"""
    threads: Count | None = None
    """threads of the simulator; null: one a core"""
    repeats: Annotated[int, Bounds(low=0)] = 10
    """how often the search is repeated over resampled tosses and other windows, which says how often each effect is
    named; 0: never, then nothing is said of it"""
    likelihood: LikelihoodSettings = advanced_part(LikelihoodSettings)
    """how likely tosses are under a simulator"""
    cross_validation: CrossValidationSettings = advanced_part(CrossValidationSettings)
    """how hypotheses are judged"""
    selection: SelectionSettings = advanced_part(SelectionSettings)
    """how effects are selected"""
    release: ReleaseSettings = advanced_part(ReleaseSettings)
    """which first frames are left out"""
    plane: PlaneSettings = advanced_part(PlaneSettings)
    """how planes of motion are recognised"""
    stability: StabilitySettings = advanced_part(StabilitySettings)
    """how the search is repeated"""
    refinement: RefinementSettings = advanced_part(RefinementSettings)
    """how the selected hypothesis is refined"""
    localisation: LocalisationSettings = advanced_part(LocalisationSettings)
    """how the gap is divided"""
    wrench: WrenchSettings = advanced_part(WrenchSettings)
    """how the residual wrench is estimated"""
    witnesses: WitnessSettings = advanced_part(WitnessSettings)
    """which impacts and slides are measured without a simulator"""
    learned: LearnedSettings = advanced_part(LearnedSettings)
    """how a learned acceleration is compared with effects"""
    order: OrderSettings = advanced_part(OrderSettings)
    """when an effect is not the same in all tosses"""
    next_toss: NextTossSettings = advanced_part(NextTossSettings)
    """how the next toss is sought"""
    verdict: VerdictSettings = advanced_part(VerdictSettings)
    """what makes a verdict"""
    patch: PatchSettings = advanced_part(PatchSettings)
    """how a patch is written and run"""
    report: ReportSettings = advanced_part(ReportSettings)
    """what the figures of the report draw"""
    enough: EnoughSettings = advanced_part(EnoughSettings)
    """how many tosses take part where there are many"""
    checks: CheckSettings = advanced_part(CheckSettings)
    """what is refused"""
