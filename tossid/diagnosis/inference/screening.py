"""Screening: what each effect of a library would gain beside a hypothesis, in closed form, and how surely.

At the hypothesis, every effect has columns: slopes by its parameters where it does nothing, and secants to its declared
starts, where what it does is far from linear. A toss's gain is that of the joint step which the other tosses determine
(leave-one-out cross-validation), so an effect that only fits noise gains nothing.

Significance is by sign flips. Under the null hypothesis, tosses' effective scores have mean zero, and flipping all
signs of a toss changes no distribution (Hemerik, Goeman and Finos, JRSS B 2020). The same flips are used for all
effects, and the smallest p-value over the library in each flip is the distribution with which p-values are compared
(Westfall and Young 1993): a round names something by chance at the stated level, however alike effects are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.columns import LONGEST_SECANT, Columns, slopes, sums
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.hypothesis import ContactLaw, Hypothesis
from tossid.physics.effects import Effect

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FLIPS = 9999
"""Draws of signs, beside the observed ones; a tenth of these will do for a level ten times as high."""


@dataclass(frozen=True)
class Start:
    """A hypothesis with a candidate in it, and the columns that lead there.

    Attributes:
        hypothesis: With the candidate's parameters at values that change nothing, or at declared ones.
        columns: Numbers of its columns.
        secant: Whether they are the change to the declared values.
    """

    hypothesis: Hypothesis
    columns: Index
    secant: bool


@dataclass(frozen=True, eq=False)
class Candidate:
    """A change of a hypothesis: one more effect, or another law of contact.

    Attributes:
        name: The effect's or the law's name.
        effect: The effect; None for a law.
        gain: (n,) of each toss's log-likelihood, by the step that the others determine.
        start: The hypothesis from which its fit begins.
        starts: All its starts, with their columns.
        p_value: That tosses show it by chance, adjusted for the whole library.
    """

    name: str
    effect: Effect | None
    gain: Array
    start: Hypothesis
    starts: tuple[Start, ...]
    p_value: float

    @property
    def total(self) -> float:
        """Sum of the gains."""
        return float(self.gain.sum())


@dataclass(frozen=True)
class Screening:
    """Columns of a hypothesis and of all candidates beside it.

    Attributes:
        columns: Of all.
        active: Numbers of the columns of the hypothesis's own free parameters.
        candidates: By decreasing gain.
    """

    columns: Columns
    active: Index
    candidates: tuple[Candidate, ...]

    def together(self, most: int, least_gain: float) -> list[tuple[Effect, Array]]:
        """Effects that gain beside each other, by greedy selection in closed form, each at the values of its start.

        Args:
            most: How many at most.
            least_gain: Of log-likelihood, that each has to bring beside those before it.
        """
        chosen: list[tuple[Effect, Array]] = []
        active, taken = self.active, set[str]()
        while len(chosen) < most:
            best: tuple[float, Effect, Start] | None = None
            for c in self.candidates:
                if c.effect is None or c.name in taken or taken & {*c.effect.contains}:
                    continue
                for start in c.starts:
                    gain = float(_gain(self.columns, start, active).sum())
                    if gain > (least_gain if best is None else best[0]):
                        best = gain, c.effect, start
            if best is None:
                break
            _, joined, start = best
            h = start.hypothesis if start.secant else _fit_start(self.columns, start, self.active)
            chosen.append((joined, h.values_of(joined.name)))
            taken |= {joined.name, *joined.contains}
            active = np.concatenate([active, start.columns])
        return chosen

    def replacements(self, own: Sequence[int], away: Array) -> list[tuple[float, Candidate]]:
        """Candidates by the share of an effect's gain that they would bring in its place, in closed form.

        Args:
            own: Numbers of the effect's active columns.
            away: (len(own),) its values minus those that change nothing, in declared steps.
        """
        kept = [k for k in self.active.tolist() if k not in own]
        lost = -self.columns.gain_of_step(own, -away, kept)
        out = []
        for c in self.candidates:
            gains = [
                self.columns.gain_of_step(own, -away, [*kept, *start.columns.tolist()])
                for start in c.starts
                if c.effect is not None
            ]
            if gains and lost > 0:
                out.append((1 + max(gains) / lost, c))
        return sorted(out, key=lambda each: -each[0])

    def standard_errors(self, candidate: Candidate) -> dict[str, float]:
        """Standard errors that an effect's parameters would have beside the hypothesis, where it does nothing.

        Args:
            candidate: One of the candidates.

        Returns:
            By a parameter's name; those that move nothing are left out.
        """
        if candidate.effect is None:
            return {}
        start = min(candidate.starts, key=lambda each: each.secant)
        h, (_, inner) = start.hypothesis, self.columns.scores(start.columns, self.active)
        largest = float(np.diagonal(self.columns.H.sum(0)).max(initial=0.0))
        size = np.sqrt(np.maximum(np.diag(inner), 0.0))
        moves = size > 1e-6 * np.sqrt(max(largest, 1e-300))
        if not moves.any():
            return {}
        scaled = inner[np.ix_(moves, moves)] / np.outer(size[moves], size[moves])
        errors = np.full(len(size), np.inf)
        errors[moves] = np.sqrt(np.diag(np.linalg.pinv(scaled, rcond=1e-9, hermitian=True))) / size[moves]
        if start.secant:  # one column: the multiple of the whole change to the declared values
            change = np.abs(h.values_of(candidate.name) - h.nominal_of(candidate.name))
            steps = change * errors[0]
        else:
            steps = h.steps[h.place_of(candidate.name)] * errors
        pairs = zip(candidate.effect.parameters, steps, strict=True)
        return {p.name: float(error) for p, error in pairs if np.isfinite(error) and error > 0}


def screen(
    evidence: Evidence,
    library: Sequence[Effect],
    *,
    n: int,
    free: Sequence[int] = (),
    laws: Sequence[ContactLaw] = (),
    rng: np.random.Generator,
    flips: int = FLIPS,
) -> Screening:
    """Every effect of a library, and every law, beside a hypothesis.

    Args:
        evidence: Of the hypothesis.
        library: The effects.
        n: How many tosses there are.
        free: Numbers of the hypothesis's parameters that are fitted beside a candidate.
        laws: Of contact.
        rng: Of the flips.
        flips: How many.
    """
    present = evidence.hypothesis
    blocks = [slopes(evidence, present, free)]
    place = len(free)
    starts: list[tuple[str, Effect | None, list[Start]]] = []

    def added(J: Array) -> Index:
        nonlocal place
        blocks.append(J)
        place += J.shape[-1]
        return np.arange(place - J.shape[-1], place)

    for effect in library:
        if effect.name in present.names:
            continue
        made = []
        for hypothesis, is_start in _starts(present, effect):
            own = hypothesis.place_of(effect.name)
            if is_start:
                change = evidence.residuals_of(hypothesis) - evidence.residuals
                made.append(Start(hypothesis, added(change[..., None]), True))
            else:
                made.append(Start(hypothesis, added(slopes(evidence, hypothesis, range(own.start, own.stop))), False))
        starts.append((effect.name, effect, made))
    for law in laws:
        if law.name != present.law.name:
            hypothesis = replace(present, law=law)
            change = evidence.residuals_of(hypothesis) - evidence.residuals
            starts.append((law.name, None, [Start(hypothesis, added(change[..., None]), True)]))
    columns = sums(evidence, np.concatenate(blocks, axis=-1), n)
    active = np.arange(len(free))
    p_values = adjusted_p_values(
        [[_score(columns, each, active) for each in made] for _, _, made in starts], rng, flips
    )
    candidates = []
    for (name, of_effect, made), p_value in zip(starts, p_values, strict=True):
        gains = [_gain(columns, each, active) for each in made]
        best = int(np.argmax([gain.sum() for gain in gains]))
        whole = set(present.names) <= set(made[best].hypothesis.names)  # nothing has made room
        fit_start = _fit_start(columns, made[best], active, free if whole else ())
        candidates.append(Candidate(name, of_effect, gains[best], fit_start, tuple(made), p_value))
    candidates.sort(key=lambda each: -each.total)
    return Screening(columns, active, tuple(candidates))


def _starts(present: Hypothesis, effect: Effect) -> Iterator[tuple[Hypothesis, bool]]:
    """A hypothesis with an effect where it does nothing, then at its starts.

    An effect of the hypothesis that is a special case of it makes room, where its value is one of the new effect's.
    """
    world, without = present.world(), present
    if any(p.nominal is None for p in effect.parameters):
        without = present.without(*(name for name in present.names if name in effect.contains))
    nominal = effect.nominal(world)
    if not (effect.near_nothing and effect.starts):
        yield without.plus(effect, nominal), False
    for start in effect.starts:
        values = effect.values_with(world, start)
        if not np.allclose(values, nominal):
            yield without.plus(effect, values), True


def _joint_step(start: Start, active: Index, steps: Array) -> Array:
    """Steps (..., A + C) of the active and a candidate's columns, kept within what its parameters allow."""
    steps = steps.copy()
    own = slice(len(active), None)
    if start.secant:
        steps[..., own] = np.clip(steps[..., own], 0.0, LONGEST_SECANT)
    else:
        h = start.hypothesis
        place = h.place_of(h.names[-1])
        low, high = ((bound - h.flat())[place] / h.steps[place] for bound in h.bounds)
        steps[..., own] = np.clip(steps[..., own], low, high)
    return steps


def _gain(columns: Columns, start: Start, active: Index) -> Array:
    """(n,) gain of a candidate over the active columns alone, each toss by the step of the others."""
    joint = columns.part(np.concatenate([active, start.columns]))
    steps = _joint_step(start, active, joint.left_out())
    gain = joint.gains(steps)
    if len(active):
        alone = columns.part(active)
        gain = gain - alone.gains(alone.left_out())
    return gain


def _fit_start(columns: Columns, start: Start, active: Index, following: Sequence[int] = ()) -> Hypothesis:
    """The hypothesis from which a fit begins: a declared start itself, or where the joint step leads.

    following: numbers of the active parameters in the start's hypothesis, where these follow; else they keep values.
    """
    h = start.hypothesis
    if start.secant:
        return h
    joint = columns.part(np.concatenate([active, start.columns]))
    step = _joint_step(start, active, joint.step())
    move = np.zeros(len(h.flat()))
    if len(following):
        move[list(following)] = step[: len(active)]
    move[h.place_of(h.names[-1])] = step[len(active) :]
    return h.at(h.flat() + np.clip(move, -100, 100) * h.steps)


@dataclass(frozen=True)
class Score:
    """The effective score of a candidate's start, by which it is tested.

    Attributes:
        scores: (n, C) of each toss.
        information: (C, C) of all tosses, but for what the active columns take.
        forward: Whether only steps forward count.
    """

    scores: Array
    information: Array
    forward: bool


def _score(columns: Columns, start: Start, active: Index) -> Score:
    """The effective score of a candidate beside the active columns."""
    return Score(*columns.scores(start.columns, active), start.secant)


def adjusted_p_values(scores: Sequence[Sequence[Score]], rng: np.random.Generator, flips: int = FLIPS) -> list[float]:
    """P-values of candidates by sign flips, adjusted for all of them.

    Args:
        scores: Of the starts of each candidate.
        rng: Of the flips.
        flips: How many.
    """
    n = next((len(each.scores) for group in scores for each in group), 0)
    if n == 0:
        return [1.0] * len(scores)
    signs = np.concatenate([np.ones((1, n)), rng.choice([-1.0, 1.0], size=(flips, n))])
    # of one candidate the starts are several tests, and of the library the candidates
    least = np.stack([np.min([_ranked(_statistic(signs, each)) for each in group], axis=0) for group in scores])
    smallest = least.min(0)
    return [float((smallest <= own).mean()) for own in least[:, 0]]


def _statistic(signs: Array, score: Score) -> Array:
    """(F,) of each flip: twice the gain of log-likelihood by a Gauss-Newton step, S^T H^-1 S of the summed scores S.

    The information H is that of the likelihood, not of the scores' spread: directions that no toss determines would
    count as much as those that all do.
    """
    total, H = signs @ score.scores, score.information
    if score.forward:
        return np.maximum(-total[:, 0], 0.0) ** 2 / max(H[0, 0], 1e-300)
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    inverse = np.linalg.pinv(H / np.outer(size, size), rcond=1e-9, hermitian=True)
    scaled = total / size
    return np.asarray(np.einsum("fi,ij,fj->f", scaled, inverse, scaled))


def _ranked(statistic: Array) -> Array:
    """(F,) p-value of each flip among all."""
    order = np.sort(statistic * (1 - 1e-9))
    return 1.0 - np.searchsorted(order, statistic * (1 - 2e-9), side="left") / len(statistic)
