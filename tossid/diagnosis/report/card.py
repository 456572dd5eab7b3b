"""The card of a diagnosis: what a person sees first on the page, on the console and in a notebook."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from tossid.diagnosis.findings import FELT_DEG, FELT_PCT, FEWEST_TOSSES, Finding
from tossid.diagnosis.report.units import in_units, listed, parameter, percent, short
from tossid.diagnosis.report.words import PHASES, estimates, over_order_words, release_words, stated_words
from tossid.diagnosis.result import Diagnosis
from tossid.physics.effects import effect_named

ENGINES = {"mujoco": "MuJoCo", "python": "your simulator", "tossid": "tossid's simulator"}
VERDICTS = {
    "no_gap": "No gap beyond the measurement noise",
    "explained": "The gap is explained",
    "partly_explained": "The gap is partly explained",
    "unexplained": "The gap is not explained",
    "within_solver_disagreement": "The gap is within what rigid-body solvers disagree on",
    "incomplete": "Interrupted before the gap was explained",
}
PARTS = {2: "half", 3: "a third", 4: "a quarter", 5: "a fifth"}


@dataclass(frozen=True)
class Card:
    """The card.

    Attributes:
        verdict: What is said of the whole gap.
        headline: The verdict in a line, with the names of what is found.
        rows: Lines under labels, in the order in which they are read.
    """

    verdict: str
    headline: str
    rows: dict[str, list[str]]

    def __str__(self) -> str:
        """The card as lines of text."""
        width, out = max(map(len, self.rows), default=0), [self.headline]
        for label, lines in self.rows.items():
            out += [f"  {label if i == 0 else '':<{width}}  {line}" for i, line in enumerate(lines)]
        return "\n".join(out)


def card_of(diagnosis: Diagnosis) -> Card:
    """What to change, what that brings, how sure it is, what cannot be told apart, what is left, and what to do.

    Args:
        diagnosis: What was found.
    """
    verdict = headline = VERDICTS[diagnosis.verdict]
    if diagnosis.named:
        headline += f": {listed([_or_alike(finding) for finding in _of(diagnosis, diagnosis.named)])}"
    if diagnosis.candidates:
        headline += f"; not sure: {listed([_or_alike(finding) for finding in _of(diagnosis, diagnosis.candidates)])}"
    rows = {
        "Change": _change(diagnosis),
        "It brings": _brings(diagnosis),
        "How sure": _how_sure(diagnosis),
        "Alternatives": _alternatives(diagnosis),
        "Left": _left(diagnosis),
        "Do next": _next(diagnosis),
    }
    return Card(verdict, headline, {label: lines for label, lines in rows.items() if lines})


def _change(diagnosis: Diagnosis) -> list[str]:
    """A line for each effect, in the order in which they matter."""
    changed = dict.fromkeys(change.name for change in diagnosis.change)
    over_order = [f.name for f in diagnosis.found if f.over_order is not None and f.verdict != "candidate"]
    return [_one_change(diagnosis, name) for name in dict.fromkeys((*changed, *over_order))]


def _one_change(diagnosis: Diagnosis, name: str) -> str:
    finding = diagnosis.finding(name)
    if finding is not None and finding.over_order is not None:
        return over_order_words(finding)
    changes = [each for each in diagnosis.change if each.name == name]
    clear = [each for each in changes if not each.value.low <= each.stated <= each.value.high] or changes
    parts = []
    for each in clear:
        # what rounding leaves of zero is zero
        stated = 0.0 if abs(each.stated) < 1e-6 * abs(each.value.value) else each.stated
        was = stated_words(name, each.parameter, stated).split(" ")[0]
        now = in_units(each.parameter, each.value, level="95 %: ")
        parts.append(f"{parameter(each.parameter)} {f'{was} → ' if was else ''}{now}")
    stay = listed([parameter(each.parameter) for each in changes if each not in clear])
    recording = " (of the recording)" if effect_named(name).family == "measurement" else ""
    more = (f"; {stay} may stay" if stay else "") + ("; not sure" if name in diagnosis.candidates else "")
    return f"{name}{recording}: {', '.join(parts)}{more}"


def _brings(diagnosis: Diagnosis) -> list[str]:
    """Whole tosses before and after."""
    brings = diagnosis.brings
    if not diagnosis.change or not len(brings.before):
        return []
    if not brings.n:
        return [f"Not known: every whole toss diverged in {ENGINES[brings.engine]}."]
    mm, pct, deg = (
        f"{short(before.value, 2)} → {short(after.value, 2)}"
        for before, after in (brings.position_mm(), brings.position_pct(), brings.rotation_deg())
    )
    lost = len(brings.before) - brings.n
    tosses = "One whole toss" if brings.n == 1 else f"Means of {brings.n} whole tosses"
    how = "each predicted by what was found without it" if brings.unseen else "to which the changes were fitted"
    return [
        f"Position error {mm} mm ({pct} % of the width), rotation error {deg} deg.",
        f"{tosses} in {ENGINES[brings.engine]}, {how}." + (f" {lost} more diverged." if lost else ""),
    ]


def _how_sure(diagnosis: Diagnosis) -> list[str]:
    """How often resampled searches name what was found, and how that was computed."""
    draws, folds, none = diagnosis.draws, diagnosis.folds, diagnosis.probability_none
    if not draws or not folds:
        return ["Not judged: the search was not repeated, so these names may be chance."] if diagnosis.found else []
    named = [
        f"{_or_alike(finding)} {percent(finding.frequency)}"
        for finding in _of(diagnosis, (*diagnosis.named, *diagnosis.candidates))
        if finding.frequency is not None
    ]
    if none is not None and (none >= 0.005 or not named):
        named.append(f"nothing {percent(none)}")
    return [
        f"Named in {draws} resampled searches: {listed(named)}.",
        f"These are {folds} searches, each without {PARTS.get(folds, f'one part in {folds}')} of the tosses, and "
        f"{draws // folds} draws of the tosses of each.",
    ]


def _alternatives(diagnosis: Diagnosis) -> list[str]:
    """Effects that may be the cause in place of another, and the toss that would decide."""
    lines = []
    for finding in diagnosis.found:
        others = [", ".join([each.name, *estimates(each)]) for each in _of(diagnosis, finding.confusable_with)]
        if others:
            lines.append(f"Instead of {finding.name} it may be {listed(others, 'or')}.")
    if lines and diagnosis.next_toss is not None:
        release = diagnosis.next_toss.get("release")
        lines.append(
            f"No toss is proposed: {diagnosis.next_toss.get('reason', 'none was looked for')}."
            if release is None
            else f"This toss would tell: {release_words(release)}."
        )
    if diagnosis.plane is not None:
        lines.append("All motion lies in one plane; the details have what that cannot show.")
    return lines


def _left(diagnosis: Diagnosis) -> list[str]:
    """What is left and where, and what is too small to feel."""
    lines = [_of_whole_tosses(diagnosis), _of_windows(diagnosis)]
    if diagnosis.minor:
        small = [", ".join([each.name, *estimates(each)]) for each in _of(diagnosis, diagnosis.minor)]
        lines.append(f"Too small to feel: {'; '.join(small)}.")
    if diagnosis.changes_left:
        starts = listed([change.before for change in diagnosis.changes_left])
        lines.append(f"Something changes from toss {starts} on, which no effect explains.")
    if diagnosis.gap.odd:
        lines.append(f"Inspect toss {listed(diagnosis.gap.odd)}: its errors are far larger than all others'.")
    return [line for line in lines if line]


def _of_whole_tosses(diagnosis: Diagnosis) -> str:
    """What whole tosses still feel, if the card does not have it already."""
    brings = diagnosis.brings
    if not brings.n or (diagnosis.change and diagnosis.verdict != "explained"):
        return ""
    felt = brings.left
    half = f"Half of the whole tosses are off by at most {short(felt.position_pct, 2)} % of the width and "
    half += f"{short(felt.rotation_deg, 2)} deg"
    if diagnosis.verdict != "explained":
        return f"{half}."
    noise = f"{half}, no more than noise of the first states makes."
    return noise if felt.is_over() else f"{half}: less than a person notices ({FELT_PCT} % and {FELT_DEG} deg)."


def _of_windows(diagnosis: Diagnosis) -> str:
    """What is left in short windows, unless nobody feels it."""
    left, other = diagnosis.left, diagnosis.disagreement
    sizes = f"{short(left.position_mm, 2)} mm and {short(left.rotation_deg, 2)} deg"
    if diagnosis.verdict == "explained":
        return ""
    if diagnosis.verdict == "no_gap":
        return f"Short windows are off by {sizes}, which noise makes."
    if diagnosis.verdict == "within_solver_disagreement" and other is not None:
        limit = f"{short(other.position_mm, 2)} mm and {short(other.rotation_deg, 2)} deg"
        return f"Short windows are off by {sizes}. Another exact solver differs by up to {limit} in contact."
    shares = diagnosis.unexplained or ({} if diagnosis.found else diagnosis.gap.by_phase)
    largest = sorted((name for name in shares if shares[name].value > 0), key=lambda name: -shares[name].value)[:2]
    where = listed([f"{PHASES[name]} ({percent(shares[name].value)} of the gap)" for name in largest])
    return f"Short windows are off by {sizes}" + (f", mostly {where}." if where else ".")


def _next(diagnosis: Diagnosis) -> list[str]:
    """What a person does next."""
    lines = []
    if diagnosis.interruption is not None:
        lines.append(f"Run it to the end. It was interrupted in this stage: {diagnosis.interruption.stage}.")
        suspects = [name for name, _ in diagnosis.interruption.suspects[:3]]
        return lines + ([f"Suspected, but not fitted yet: {listed(suspects)}."] if suspects else [])
    if diagnosis.verdict == "no_gap":
        lines.append("Nothing. The table of effects has the smallest change that these tosses would reveal.")
    elif diagnosis.verdict == "within_solver_disagreement":
        lines.append("Nothing: tosses cannot tell which solver is right where several corners touch at once.")
    elif diagnosis.change:
        patch = diagnosis.patch or {}
        lines.append(
            "Use patched.xml, which has the changes." if patch.get("mjcf") else "Make the changes in your simulator."
        )
        run = (patch.get("rerun") or {}).get("position_error_pct")
        if run and diagnosis.brings.engine != "mujoco":
            was, now = (short(run[when]["value"], 2) for when in ("before", "after"))
            lines.append(f"In MuJoCo, whole tosses are off by {now} % of the width with the patch, {was} % without.")
    else:
        lines.append("See where the gap is, and check the recording there. Is it right, add an effect of your own.")
    if diagnosis.n_tosses < FEWEST_TOSSES and diagnosis.verdict != "explained":
        lines.append(f"Record at least {FEWEST_TOSSES} tosses: fewer cannot name an effect of contact.")
    return lines


def _of(diagnosis: Diagnosis, names: Iterable[str]) -> list[Finding]:
    return [finding for name in names if (finding := diagnosis.finding(name)) is not None]


def _or_alike(finding: Finding) -> str:
    """An effect, or those that may be there in its place: "friction or cohesion"."""
    form = {"drift": ", which drifts", "steps": ", which changes"}
    how = form[finding.over_order.form] if finding.over_order is not None else ""
    return listed([finding.name, *finding.confusable_with], "or") + how
