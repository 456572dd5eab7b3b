"""What is said of a gap: whether effects explain it, and which names stand although much of it stays."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from tossid.diagnosis.findings import Gap, Interval, Share
from tossid.diagnosis.localisation.gap import cross_fitted, limited_rms, share_left
from tossid.diagnosis.localisation.noise import Floor
from tossid.diagnosis.localisation.refusal import RolloutCheck
from tossid.diagnosis.result import Verdict
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.settings.diagnosis.diagnose import VerdictSettings

CENTRE_IN_FRAME = frozenset({"com_offset", "body_frame_offset"})
"""Flight shows where the centre of mass is in the recorded frame. It is one of these that is off, or both."""


def gap_verdict(
    gap: Gap,
    left: Gap,
    closed: Interval,
    unnamed: Collection[str],
    unexplained: Sequence[Share],
    *,
    any_named: bool,
    settings: VerdictSettings = VerdictSettings(),
) -> Verdict:
    """What the named effects make of a gap.

    To be near the floor is not enough where the gap was small: more than half of it has to be closed too.

    Args:
        gap: Without effects.
        left: With effects.
        closed: Share of the gap that the named effects close.
        unnamed: Effects that stand in for something without a name.
        unexplained: Phases in which clearly something is left.
        any_named: Whether there are named effects.
        settings: The limits.
    """
    if not any_named:
        return "no_gap" if is_at_floor(gap, settings) and not unnamed else "unexplained"
    if closed.value <= settings.partly_closed:
        return "unexplained"
    reached = left.total.value < settings.floor_reached * left.noise_floor
    if not unnamed and (reached or (closed.value > settings.all_closed and not unexplained)):
        return "explained"
    return "partly_explained"


def is_at_floor(gap: Gap, settings: VerdictSettings) -> bool:
    """Whether a gap is no larger than its noise floor.

    Args:
        gap: The gap.
        settings: The limits.
    """
    return gap.total.value < settings.no_gap * gap.noise_floor or gap.total.low < gap.noise_floor


def verdict_by_rollouts(verdict: Verdict, check: RolloutCheck | None, names: Sequence[str]) -> Verdict:
    """A gap's verdict, which explains nothing by effects that make predictions of whole tosses worse.

    Args:
        verdict: By what is left of short windows.
        check: What the effects do to whole tosses.
        names: Of the effects that explain the gap.
    """
    if check is None or verdict not in ("explained", "partly_explained"):
        return verdict
    if not set(names) - set(check.refused):
        return "unexplained"
    return "partly_explained" if set(names) & set(check.refused) else verdict


def names_that_stand(
    verdict: Verdict,
    mattering: Collection[str],
    found: SearchResult,
    validator: CrossValidator,
    floor: Floor,
    *,
    within_disagreement: bool,
) -> tuple[Verdict, frozenset[str]]:
    """The effects whose part of the gap is explained, and the verdict that follows.

    Flight and contact are judged apart, since a large effect in one of them closes most of the whole gap, and says
    nothing of the other:

    - **Forces that flight reveals stand if they leave nothing there.** The model of flight is right but for the effects
      that are sought, and a force does in contact what it does in flight. So a wrong law of contact says nothing
      against it. Effects that also move the body's points, or change lengths and times, contact could contradict. They
      stand where a force may be the cause in their place, or as a class that has all possible causes.
    - **Effects of contact stand if they close much of the gap that those of flight leave,** or if what is left is not
      clearly more than exact solvers of the same rigid body disagree on. No effect could close that.

    Args:
        verdict: By the whole gap.
        mattering: Names of the effects that whole tosses notice.
        found: What the search found.
        validator: Of all windows.
        floor: The noise floor.
        within_disagreement: Whether a part of the gap is surely closed, and what is left is not clearly more than
            solvers disagree on.

    Returns:
        The verdict, and the names that stand. A gap that is not all explained is partly explained if one of those that
        matter stands.
    """
    names = frozenset(found.present.hypothesis.names)
    if verdict not in ("unexplained", "partly_explained"):
        return verdict, names
    if not within_disagreement:
        names = _standing_apart(verdict, found, validator, floor)
    return ("unexplained" if names.isdisjoint(mattering) else "partly_explained"), names


def _standing_apart(verdict: Verdict, found: SearchResult, validator: CrossValidator, floor: Floor) -> frozenset[str]:
    """The names that stand where flight and contact are judged apart."""
    names, n_flight = found.present.hypothesis.names, found.n_flight
    if verdict == "unexplained":
        return _certain_in_flight(found, validator, floor)
    if 0 < n_flight < len(names):
        closed, _ = share_left(found.history[n_flight], found.present, validator, floor)
        if closed.value <= validator.settings.verdict.partly_closed:
            return frozenset(names[:n_flight])
    return frozenset(names)


def _certain_in_flight(found: SearchResult, validator: CrossValidator, floor: Floor) -> frozenset[str]:
    """What flight makes certain whatever contact says; nothing where the gap in free flight is above the floor."""
    present, windows = found.present, found.present.evidence.windows
    left = cross_fitted(present, validator)[windows.inside & windows.free[:, None]]
    reached = validator.settings.verdict.floor_reached * floor.rms
    if not left.size or not limited_rms(present.evidence, left) < reached:
        return frozenset()
    names = set()
    for effect in present.hypothesis.effects[: found.n_flight]:
        group = (effect, *found.stand_ins(effect.name))
        complete = {each.name for each in group} >= CENTRE_IN_FRAME
        if effect.name not in found.unnamed and (complete or any(each.is_force for each in group)):
            names.add(effect.name)
    return frozenset(names)
