"""The card of a diagnosis: what a person sees first on the page, on the console and in a notebook."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from tossid.diagnosis.findings import FELT_DEG, FELT_PCT, FOUND, Finding, Interval, Share
from tossid.diagnosis.report.units import in_units, listed, parameter, percent, quantity, short
from tossid.diagnosis.report.words import PHASES, estimates, over_order_words, release_words
from tossid.diagnosis.result import Diagnosis
from tossid.physics.effects import LIBRARY

ENGINES = {"mujoco": "MuJoCo", "python": "your simulator", "tossid": "tossid's simulator"}
VERDICTS = {
    "no_gap": "No gap beyond the measurement noise",
    "explained": "The gap is explained",
    "partly_explained": "The gap is partly explained",
    "unexplained": "The gap is not explained",
    "within_solver_disagreement": "The gap is no larger than what exact rigid-body solvers disagree on",
    "incomplete": "Interrupted before the diagnosis was complete",
}
_PARTS = {2: "half", 3: "a third", 4: "a quarter", 5: "a fifth"}
_FEW_TOSSES = 12
"""Tosses with which a test over the whole library can name an effect of contact: its p-value is at least 2^(1 - n)."""


@dataclass(frozen=True)
class Row:
    """A row of the card.

    Attributes:
        label: What it is about.
        lines: What there is to say.
    """

    label: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Card:
    """The card.

    Attributes:
        headline: The verdict in a line.
        rows: In the order in which they are read.
    """

    headline: str
    rows: tuple[Row, ...]

    def __str__(self) -> str:
        """The card as lines of text."""
        width = max((len(row.label) for row in self.rows), default=0)
        lines = [self.headline]
        for row in self.rows:
            labels = [row.label, *[""] * (len(row.lines) - 1)]
            lines += [f"  {label:<{width}}  {line}" for label, line in zip(labels, row.lines, strict=True)]
        return "\n".join(lines)


def card_of(diagnosis: Diagnosis) -> Card:
    """What to change, what that brings, how sure it is, what cannot be told apart, what is left, and what to do.

    Args:
        diagnosis: What was found.
    """
    rows = {
        "Change": _change(diagnosis),
        "It brings": _brings(diagnosis),
        "How sure": _how_sure(diagnosis),
        "Not told apart": _not_told_apart(diagnosis),
        "Left": _left(diagnosis),
        "Do next": _next(diagnosis),
    }
    return Card(headline(diagnosis), tuple(Row(label, tuple(lines)) for label, lines in rows.items() if lines))


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in a line, with the names that are sure and those that are not.

    Args:
        diagnosis: What was found.
    """
    line = VERDICTS[diagnosis.verdict]
    if diagnosis.named:
        line += f": {listed([_or_alike(finding) for finding in _of(diagnosis, diagnosis.named)])}"
    return line + (f"; not sure: {listed(diagnosis.candidates)}" if diagnosis.candidates else "")


def _change(diagnosis: Diagnosis) -> list[str]:
    """A line for each effect, in the order in which they matter."""
    changed = dict.fromkeys(change.name for change in diagnosis.change)
    over_order = [f.name for f in diagnosis.findings if f.over_order is not None and f.verdict in FOUND]
    return [_one_change(diagnosis, name) for name in (*changed, *(x for x in over_order if x not in changed))]


def _one_change(diagnosis: Diagnosis, name: str) -> str:
    finding = diagnosis.finding(name)
    if finding is not None and finding.over_order is not None:
        return over_order_words(finding)
    parts = [
        f"{parameter(each.parameter)} {_stated(each.parameter, each.stated, each.value)} → "
        f"{in_units(each.parameter, each.value, level='95 %: ')}"
        for each in diagnosis.change
        if each.name == name
    ]
    return f"{name}: {', '.join(parts)}" + (", in the recording" if name in _OF_RECORDING else "")


_OF_RECORDING = {effect.name for effect in LIBRARY if effect.family == "measurement"}


def _stated(key: str, stated: float, value: Interval) -> str:
    """The simulator's own value without its unit; what rounding leaves of zero is zero."""
    rounded = 0.0 if abs(stated) < 1e-6 * abs(value.value) else stated
    return quantity(key, rounded).split(" ")[0]


def _brings(diagnosis: Diagnosis) -> list[str]:
    """Whole tosses before and after."""
    brings = diagnosis.brings
    if not diagnosis.change or not len(brings.before):
        return []
    if not brings.n:
        return [f"Not known: no whole toss could be predicted in {ENGINES[brings.engine]}."]
    (mm, mm_after), (pct, pct_after), (deg, deg_after) = (
        (short(before.value, 2), short(after.value, 2))
        for before, after in (brings.position_mm(), brings.position_pct(), brings.rotation_deg())
    )
    tosses = "1 whole toss" if brings.n == 1 else f"Means of {brings.n} whole tosses"
    how = (
        "that took no part: each is predicted by changes that were found without it"
        if brings.unseen
        else "to which the changes were fitted"
    )
    lost = len(brings.before) - brings.n
    return [
        f"position error {mm} → {mm_after} mm ({pct} → {pct_after} % of the width), "
        f"rotation error {deg} → {deg_after} deg",
        f"{tosses} in {ENGINES[brings.engine]} {how}." + (f" {lost} more diverged." if lost else ""),
    ]


def _how_sure(diagnosis: Diagnosis) -> list[str]:
    """How often resampled searches name what was found, and how that was computed."""
    draws, folds = diagnosis.draws, diagnosis.folds
    if not diagnosis.found and not draws:
        return []
    if not folds or not draws:
        return ["Not judged: no search was repeated without a part of the tosses, so names may be chance."]
    named = [
        f"{finding.name} in {percent(finding.frequency)}"
        for finding in _of(diagnosis, (*diagnosis.named, *diagnosis.candidates))
        if finding.frequency is not None
    ]
    text = f"named {listed(named)} of {draws} resampled searches" if named else f"{draws} resampled searches"
    none = diagnosis.probability_none
    if none is not None and (none >= 0.005 or not named):
        text += f"; {percent(none)} of them name nothing"
    part = _PARTS.get(folds, f"one part in {folds}")
    return [f"{text[0].upper()}{text[1:]}.", f"The search was repeated without {part} of the tosses each, and its "
            "tosses were drawn anew."]  # fmt: skip


def _not_told_apart(diagnosis: Diagnosis) -> list[str]:
    """Effects that may be the cause in place of another, and the toss that would decide."""
    groups = {frozenset((f.name, *f.confusable_with)): f for f in diagnosis.found if f.confusable_with}
    lines = [f"These tosses do not tell {f.name} from {listed(f.confusable_with, 'or')}." for f in groups.values()]
    if lines and diagnosis.next_toss is not None:
        release = diagnosis.next_toss.get("release")
        lines.append(
            f"No toss is proposed: {diagnosis.next_toss.get('reason', 'none was looked for')}."
            if release is None
            else f"This toss would tell: {release_words(release)}."
        )
    if diagnosis.plane is not None:
        lines.append("All motion lies in one plane. What that cannot show is listed under details.")
    return lines


def _left(diagnosis: Diagnosis) -> list[str]:
    """What is left and where, what is not sure, and what is too small to feel."""
    lines = [_of_gap(diagnosis)]
    if diagnosis.candidates:
        lines.append(f"not sure: {'; '.join(_values(f) for f in _of(diagnosis, diagnosis.candidates))}")
    if diagnosis.minor:
        lines.append(f"too small to feel: {'; '.join(_values(f) for f in _of(diagnosis, diagnosis.minor))}")
    if diagnosis.changes_left:
        starts = listed([change.before for change in diagnosis.changes_left])
        lines.append(f"something changes from toss {starts} on, which no effect explains")
    if diagnosis.gap.odd:
        lines.append(f"far larger errors than in all other tosses: {listed(diagnosis.gap.odd)}")
    return [line for line in lines if line]


def _of_gap(diagnosis: Diagnosis) -> str:
    """What is left of the gap, in millimetres and degrees."""
    left, brings = diagnosis.left, diagnosis.brings
    windows = f"{short(left.position_mm, 2)} mm and {short(left.rotation_deg, 2)} deg in short windows"
    if diagnosis.verdict == "no_gap":
        return f"{windows}, which noise makes"
    if diagnosis.verdict == "within_solver_disagreement" and (other := diagnosis.disagreement) is not None:
        solvers = f"{short(other.position_mm, 2)} mm and {short(other.rotation_deg, 2)} deg"
        return f"{windows}; in contact, another exact solver differs by up to {solvers} (95 % of windows)"
    if diagnosis.verdict == "explained" and brings.n:
        felt = brings.left
        half = f"half of the tosses are off by less than {short(felt.position_pct, 2)} % and "
        half += f"{short(felt.rotation_deg, 2)} deg"
        why = (
            "no more than noise makes" if felt.is_over() else f"nobody feels less than {FELT_PCT} % and {FELT_DEG} deg"
        )
        return f"{half}; {why}"
    share = percent(max(0.0, 1.0 - diagnosis.gap_closed.value)) if diagnosis.found else "all"
    where = [f"{PHASES[s.name]} ({percent(s.share.value)})" for s in _largest(diagnosis.unexplained)]
    return f"{windows}, {share} of the gap" + (f", most of it {listed(where)}" if where else "")


def _largest(shares: Iterable[Share]) -> list[Share]:
    return sorted(shares, key=lambda share: -share.share.value)[:2]


def _next(diagnosis: Diagnosis) -> list[str]:
    """What a person does next."""
    few = diagnosis.n_tosses < _FEW_TOSSES
    more = [f"Record at least {_FEW_TOSSES} tosses: fewer cannot name an effect of contact."] if few else []
    if diagnosis.interruption is not None:
        suspects = listed([name for name, _ in diagnosis.interruption.suspects[:3]], "or")
        guess = f" Suspected next: {suspects}." if suspects else ""
        return [f"Let it run to the end; it was interrupted while: {diagnosis.interruption.stage}.{guess}"]
    if diagnosis.verdict == "no_gap":
        return ["Nothing. The table of effects has the smallest change that these tosses would reveal.", *more]
    if diagnosis.verdict == "within_solver_disagreement":
        return ["Nothing: tosses cannot tell which solver is right where several corners touch at once."]
    if diagnosis.change:
        patched = bool((diagnosis.patch or {}).get("mjcf"))
        apply = "Use patched.xml, which has these changes." if patched else "Make these changes in your simulator."
        return [apply] + (more if diagnosis.candidates or diagnosis.verdict != "explained" else [])
    if diagnosis.candidates:
        return ["Record more tosses: these do not show an effect surely enough to change it.", *more]
    return ["Look where the gap is, and check the recording there. If it is right, add an effect of your own.", *more]


def _of(diagnosis: Diagnosis, names: Iterable[str]) -> list[Finding]:
    return [finding for name in names if (finding := diagnosis.finding(name)) is not None]


def _or_alike(finding: Finding) -> str:
    """An effect, or those that may be there in its place: "friction or cohesion"."""
    form = {"drift": ", which drifts", "steps": ", which changes"}
    how = form[finding.over_order.form] if finding.over_order is not None else ""
    return listed([finding.name, *finding.confusable_with], "or") + how


def _values(finding: Finding) -> str:
    """An effect with its values, and how whole tosses change by it."""
    text = f"{finding.name} ({', '.join(estimates(finding))})" if finding.parameters else finding.name
    if finding.frequency is not None and finding.verdict == "candidate":
        return f"{text}, named in {percent(finding.frequency)}"
    return text
