"""Which effect: forward selection by held-out likelihood, with what cannot be told apart, and what cannot be seen.

One round: every effect of the library is screened by the gain of one step (a score test, but measured), the
promising ones are fitted, each around states refined under itself, and judged by the
log-likelihood of the half of the tosses that took no part. The best joins if the gain is significant over tosses
(paired t-test, Bonferroni over the library) and matters; the next round starts from there. Effects whose gain is not
significantly below the best's are its confusable class; a simpler effect that an effect contains is preferred to it.
At the end, effects that the others have made superfluous leave.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from tossid.diagnosis.findings import Diagnosis, Finding, Interval, Verdict
from tossid.diagnosis.fitting import Evidence, Fitted, Hypothesis, derivatives, fit, toss_sums
from tossid.diagnosis.gap import Floor, deviance, measure_gap, noise_floor, rollout_errors, share_left
from tossid.diagnosis.windows import Windows, linearise, make_windows
from tossid.physics.effects import LIBRARY, Effect, World
from tossid.types import Phase, Toss

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

LEVEL = 0.05
"""Family-wise level of naming an effect in a round."""
MATTERS = 0.004
"""Share of the gap that an effect must close to be named."""
MOST_EFFECTS = 7
CANDIDATES = 6
"""Effects fitted in full in a round."""
CLASS_LEVEL = 0.05
"""An effect whose gain is below the best's at this level (one-sided) is out of its class."""
CLASS_SHARE = 0.8
"""And so is one that gains less than this share of what the best gains."""
LARGEST_CLASS = 3
STEP_SHARES = (1.0, 0.3, 0.1, 0.03)
"""Parts of a screening step that are tried: impacts are far from linear."""

STARTS: dict[str, tuple[dict[str, float], ...]] = {
    "restitution": ({"e": 0.15}, {"e": 0.4}, {"e": 0.65}),
    "compliance": (
        {"stiffness_npm": 6e4, "damping_nspm": 60.0},
        {"stiffness_npm": 2e4, "damping_nspm": 40.0},
        {"stiffness_npm": 2e4, "damping_nspm": 10.0},
        {"stiffness_npm": 5e3, "damping_nspm": 30.0},
        {"stiffness_npm": 5e3, "damping_nspm": 8.0},
        {"stiffness_npm": 1.5e3, "damping_nspm": 10.0},
    ),
    "position_force": ({"k_npm": 0.5, "x_m": 0.0, "y_m": 0.0, "z_m": 0.0},),
    "velocity_friction": (
        {"static_mu": 0.3, "sliding_mu": 0.15, "speed_ms": 0.2},
        {"static_mu": 0.1, "sliding_mu": 0.25, "speed_ms": 0.4},
    ),
    "wind": ({"x_ms": 0.0, "y_ms": 0.0, "c_nspm": 0.02},),
}
"""Values from which an effect is also looked for, where what it does is far from linear."""

CONTAINS: dict[str, tuple[str, ...]] = {
    "velocity_friction": ("friction",),
    "anisotropic_friction": ("friction",),
    "wind": ("linear_drag",),
    "position_force": ("uniform_force", "gravity"),
    "uniform_force": ("gravity",),
    "body_frame_offset": (),
}
"""Effects that are special cases of an effect."""


@dataclass(frozen=True)
class Candidate:
    """A hypothesis with one effect more, fitted and judged. gain (n,): held-out log-likelihood over the present."""

    effect: Effect
    fitted: Fitted
    evidence: Evidence
    log_likelihood: Array
    gain: Array

    @property
    def total(self) -> float:
        return float(self.gain.sum())

    @property
    def p_value(self) -> float:
        """One-sided, of a mean gain of zero."""
        return one_sided(self.gain)


def one_sided(values: Array) -> float:
    """p-value of a positive mean (paired t-test); 1 for fewer than three values."""
    n = len(values)
    if n < 3:
        return 1.0
    spread = values.std(ddof=1)
    if not spread > 0:
        return 1.0 if not values.mean() > 0 else 0.0
    return float(student.sf(values.mean() / (spread / np.sqrt(n)), n - 1))


def halves(n: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(n,) a random half of the tosses."""
    out = np.zeros(n, dtype=bool)
    out[rng.permutation(n)[: n // 2]] = True
    return out


def diagnose(
    tosses: Sequence[Toss],
    world: World,
    *,
    library: Sequence[Effect] = LIBRARY,
    n_threads: int = 1,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Where the world's predictions miss the tosses, which effects of the library explain it, and how far.

    Args:
        tosses: recorded motions of a single body; poses' covariances are what noise is.
        world: the simulator that is asked about.
        library: effects to choose from.
        seed: of the halves and of the simulated noise floor.
        progress: told what is under way, and which share is done.
    """
    started = time.perf_counter()
    tell = progress or (lambda text, share: None)
    rng = np.random.default_rng(seed)
    n = len(tosses)
    half = halves(n, rng)
    windows = make_windows(tosses)
    tell("the gap", 0.02)
    search = _Search(windows, n, half, n_threads)
    present = search.start(Hypothesis(world))
    first = present
    history = [present]
    classes: dict[str, tuple[Candidate, ...]] = {}
    judged: dict[str, Candidate] = {}
    for turn in range(MOST_EFFECTS):
        tell(f"round {turn + 1}: screening {len(library)} effects", 0.05 + 0.12 * turn)
        tried = search.round(present, library, partial(_tell_of_round, tell, turn))
        if turn == 0:
            judged = {each.effect.name: each for each in tried}
        before = float(deviance(present.evidence, present.fitted.residual).sum())
        good = [each for each in tried if each.p_value < LEVEL / len(library) and each.total > 0]
        good = [each for each in good if _closes(first, before, each) > MATTERS]
        if not good:
            break
        best = _simplest(good)
        alike = [each for each in good if each is not best and _alike(best, each)]
        alike.sort(key=lambda each: -each.total)
        classes[best.effect.name] = tuple(alike[: LARGEST_CLASS - 1])
        present = best
        history.append(present)
        judged.setdefault(best.effect.name, best)
        pruned = search.pruned(present, len(library))
        if pruned is not present:
            present = pruned
            history.append(present)
    if present is not first:
        tell("all effects together", 0.9)
        present = search.polished(present)
        history[-1] = present
    tell("what is left", 0.95)
    return _report(tosses, world, library, search, first, present, history, classes, judged, started, seed)


def _tell_of_round(tell: Progress, turn: int, text: str) -> None:
    tell(f"round {turn + 1}: {text}", 0.1 + 0.12 * turn)


def _closes(first: Candidate, before: float, each: Candidate) -> float:
    """Share of the first deviance that an effect closes."""
    whole = float(deviance(first.evidence, first.fitted.residual).sum())
    return (before - float(deviance(each.evidence, each.fitted.residual).sum())) / max(whole, 1e-9)


def _simplest(good: Sequence[Candidate]) -> Candidate:
    """The best, or a special case of it that is as good."""
    best = max(good, key=lambda each: each.total)
    while True:
        inner = [each for each in good if each.effect.name in CONTAINS.get(best.effect.name, ()) and _alike(best, each)]
        if not inner:
            return best
        best = max(inner, key=lambda each: each.total)


def _alike(best: Candidate, other: Candidate) -> bool:
    """Whether the tosses cannot tell `other` from `best`."""
    if best.effect.name in CONTAINS.get(other.effect.name, ()):
        # a more general effect must be clearly better to be another explanation
        return False
    close = other.total > CLASS_SHARE * best.total
    return close or one_sided(best.gain - other.gain) > CLASS_LEVEL


class _Search:
    """The tosses' windows, and the fits and judgements made with them."""

    def __init__(self, windows: Windows, n: int, half: NDArray[np.bool_], n_threads: int) -> None:
        self.windows, self.n, self.half, self.n_threads = windows, n, half, n_threads

    def around(self, hypothesis: Hypothesis, windows: Windows | None = None, *, refine: int = 2) -> Evidence:
        """Evidence with states refined under the hypothesis."""
        base = self.windows
        if windows is not None:
            base = replace(self.windows, at_q=windows.at_q, at_v=windows.at_v)
        kept, whitening = linearise(base, hypothesis.world(), refine=refine, n_threads=self.n_threads)
        return Evidence(kept, whitening, self.n_threads)

    def start(self, hypothesis: Hypothesis) -> Candidate:
        """The present state of the search, for a hypothesis that is not fitted."""
        evidence = self.around(hypothesis, refine=3)
        residual = evidence.residual(hypothesis.world())
        scales = evidence.scales(residual)
        size = len(hypothesis.flat())
        empty = Fitted(hypothesis, residual, scales, np.zeros((self.n, size, size)), np.zeros((self.n, size)))
        ll = evidence.log_likelihood(residual, scales, self.n)
        none = Effect("nothing", "", (), (), "", lambda w, p: w)
        return Candidate(none, empty, evidence, ll, np.zeros(self.n))

    def round(self, present: Candidate, library: Sequence[Effect], tell: Callable[[str], None]) -> list[Candidate]:
        """The promising effects, fitted and judged."""
        inside = {effect.name for effect in present.fitted.hypothesis.effects}
        scored: list[tuple[float, Effect, Hypothesis]] = []
        for effect in library:
            if effect.name in inside:
                continue
            scored.append(self._screened(present, effect))
        scored.sort(key=lambda each: -each[0])
        promising = [each for each in scored if each[0] > 3.0][:CANDIDATES]
        out = []
        for _, effect, start in promising:
            tell(effect.name)
            out.append(self.judged(present, effect, start))
        return out

    def _screened(self, present: Candidate, effect: Effect) -> tuple[float, Effect, Hypothesis]:
        """Gain of a step of Gauss-Newton or a part of it, from the best start, and the values there."""
        e, now = present.evidence, present.fitted
        best = (0.0, effect, now.hypothesis.plus(effect))
        world = now.hypothesis.world()
        here = dict(zip([p.name for p in effect.parameters], effect.nominal(world), strict=True))
        starts = [here, *({**here, **start} for start in STARTS.get(effect.name, ()))]
        base = e.log_likelihood(now.residual, now.scales, self.n)
        for start in starts:
            hypothesis = now.hypothesis.plus(effect, np.array([start[p.name] for p in effect.parameters]))
            moved = start is not here
            residual = e.residual(hypothesis.world()) if moved else now.residual
            shift = e.log_likelihood(residual, now.scales, self.n) - base if moved else np.zeros(self.n)
            size = len(hypothesis.flat())
            own = range(size - len(effect.parameters), size)
            J = derivatives(e, hypothesis, residual, own)[..., list(own)]
            H, g = toss_sums(e, residual, J, now.scales, self.n)
            if float(shift.sum()) > best[0]:
                best = (float(shift.sum()), effect, hypothesis)
            total = H.sum(0)
            delta = np.zeros(size)
            delta[list(own)] = -np.linalg.pinv(total + 1e-9 * np.trace(total) * np.eye(len(own))) @ g.sum(0)
            low, high = hypothesis.bounds
            for share in STEP_SHARES:
                x = np.clip(hypothesis.flat() + share * delta * hypothesis.steps, low, high)
                there = e.residual(hypothesis.at(x).world())
                gain = float((e.log_likelihood(there, now.scales, self.n) - base).sum())
                if gain > best[0]:
                    best = (gain, effect, hypothesis.at(x))
                elif gain > 0:
                    break
        return best

    def judged(self, present: Candidate, effect: Effect, start: Hypothesis) -> Candidate:
        """The effect fitted to all tosses, around states refined under it, and judged across the halves."""
        fitted, evidence = self._converged(start, present.evidence.windows)
        held = self.held_out(evidence, fitted)
        return Candidate(effect, fitted, evidence, held, held - present.log_likelihood)

    def _converged(self, start: Hypothesis, windows: Windows, rounds: int = 3) -> tuple[Fitted, Evidence]:
        hypothesis, best = start, None
        evidence = self.around(hypothesis, windows, refine=1)
        for _ in range(rounds):
            fitted = fit(evidence, hypothesis, n_tosses=self.n, iterations=5)
            ll = evidence.log_likelihood(fitted.residual, fitted.scales, self.n).sum()
            moved = np.abs(fitted.hypothesis.flat() - hypothesis.flat()) / hypothesis.steps
            if best is None or ll > best[2]:
                best = (fitted, evidence, ll)
            hypothesis = fitted.hypothesis
            if moved.max(initial=0.0) < 0.2:
                break
            evidence = self.around(hypothesis, evidence.windows, refine=1)
        done = fit(evidence, hypothesis, n_tosses=self.n, iterations=2)
        ll = evidence.log_likelihood(done.residual, done.scales, self.n).sum()
        assert best is not None
        return (done, evidence) if ll >= best[2] else (best[0], best[1])

    def held_out(self, evidence: Evidence, fitted: Fitted) -> Array:
        """(n,) log-likelihood of each toss at values and scales fitted to the other half."""
        out = np.zeros(self.n)
        for part in (self.half, ~self.half):
            other = ~part
            judge, learn = evidence.of_tosses(other), evidence.of_tosses(part)
            residual = judge.residual(fitted.of_part(part).world())
            scales = learn.scales(fitted.residual[part[evidence.windows.toss]])
            out[other] = judge.log_likelihood(residual, scales, self.n)[other]
        return out

    def polished(self, present: Candidate) -> Candidate:
        """Fitted again until the states refined under it stay as they are."""
        fitted, evidence = self._converged(present.fitted.hypothesis, present.evidence.windows, rounds=6)
        return Candidate(present.effect, fitted, evidence, self.held_out(evidence, fitted), present.gain)

    def pruned(self, present: Candidate, n_library: int) -> Candidate:
        """Without the effects that the others have made superfluous."""
        effects = present.fitted.hypothesis.effects
        if len(effects) < 2:
            return present
        for effect in effects[:-1]:
            less = present.fitted.hypothesis.minus(effect.name)
            fitted, evidence = self._converged(less, present.evidence.windows, rounds=2)
            held = self.held_out(evidence, fitted)
            if one_sided(present.log_likelihood - held) > LEVEL / n_library:
                return Candidate(present.effect, fitted, evidence, held, present.gain)
        return present


def intervals(fitted: Fitted, n: int) -> dict[str, dict[str, Interval]]:
    """95 % intervals of every effect's parameters (sandwich over tosses, Student's quantile)."""
    out: dict[str, dict[str, Interval]] = {}
    if not fitted.hypothesis.effects:
        return out
    cov = fitted.covariance()
    error = np.sqrt(np.maximum(np.diag(cov), 0.0))
    quantile = float(student.ppf(0.975, max(1, n - len(error))))
    low, high = fitted.hypothesis.bounds
    k = 0
    for effect, values in zip(fitted.hypothesis.effects, fitted.hypothesis.values, strict=True):
        named = {}
        for parameter, value in zip(effect.parameters, values, strict=True):
            value = float(np.clip(value, low[k], high[k]))
            named[parameter.name] = Interval(value, value - quantile * error[k], value + quantile * error[k])
            k += 1
        out[effect.name] = named
    return out


def _report(
    tosses: Sequence[Toss],
    world: World,
    library: Sequence[Effect],
    search: _Search,
    first: Candidate,
    present: Candidate,
    history: Sequence[Candidate],
    classes: dict[str, tuple[Candidate, ...]],
    judged: dict[str, Candidate],
    started: float,
    seed: int,
) -> Diagnosis:
    n = len(tosses)
    floor = noise_floor(present, present.fitted.hypothesis.world(), search, seed=seed)
    gap = measure_gap(tosses, first, world, search, floor)
    left = measure_gap(tosses, present, present.fitted.hypothesis.world(), search, floor)
    named = tuple(effect.name for effect in present.fitted.hypothesis.effects)
    known = intervals(present.fitted, n)
    closed, unexplained = share_left(first, present, search, floor)
    verdict: Verdict
    if not named:
        verdict = (
            "no_gap" if gap.total.value < 1.15 * gap.noise_floor or gap.total.low < gap.noise_floor else "unexplained"
        )
    elif closed.value > 0.9 and not unexplained:
        verdict = "explained"
    else:
        verdict = "partly_explained" if closed.value > 0.5 else "unexplained"
    findings = _findings(library, search, first, present, classes, judged, known, floor)
    steps = tuple(rollout_errors(tosses, each, search) for each in history)
    swapped = []
    for name, others in classes.items():
        if name in named:
            swapped += [
                present.fitted.hypothesis.minus(name).plus(o.effect, o.fitted.hypothesis.values[-1]) for o in others
            ]
    return Diagnosis(
        verdict=verdict,
        gap=gap,
        left=left,
        findings=findings,
        named=named,
        gap_closed=closed,
        unexplained=unexplained,
        steps=steps,
        hypothesis=present.fitted.hypothesis,
        n_tosses=n,
        seconds=time.perf_counter() - started,
        alternatives=tuple(swapped),
    )


def _findings(
    library: Sequence[Effect],
    search: _Search,
    first: Candidate,
    present: Candidate,
    classes: dict[str, tuple[Candidate, ...]],
    judged: dict[str, Candidate],
    known: dict[str, dict[str, Interval]],
    floor: Floor,
) -> tuple[Finding, ...]:
    n = search.n
    order = {effect.name: i for i, effect in enumerate(present.fitted.hypothesis.effects)}
    other_of = {each.effect.name: (name, each) for name, group in classes.items() if name in order for each in group}
    out = []
    for effect in library:
        tried = judged.get(effect.name)
        evidence = {"gain": 0.0, "p_value": 1.0, "n_tosses": float(n)}
        closes = Interval(0.0, 0.0, 0.0)
        if tried is not None:
            evidence = {"gain": tried.total, "p_value": tried.p_value, "n_tosses": float(n)}
            closes = share_left(first, tried, search, floor)[0]
        detectable, seen = _detectable(search, present, effect)
        if effect.name in order:
            group = tuple(each.effect.name for each in classes.get(effect.name, ()))
            verdict = "confusable" if group else "identified"
            parameters = known[effect.name]
        elif effect.name in other_of:
            name, each = other_of[effect.name]
            group = (name, *(o.effect.name for o in classes[name] if o.effect.name != effect.name))
            verdict, parameters = "confusable", intervals(each.fitted, n)[effect.name]
            evidence = {"gain": each.total, "p_value": each.p_value, "n_tosses": float(n)}
            closes = share_left(first, each, search, floor)[0]
        else:
            group, parameters = (), {}
            verdict = "not_supported" if seen else "not_identifiable"
        phases = tuple(Phase(phase).name.lower() for phase in effect.phases)
        out.append(
            Finding(effect.name, verdict, effect.says, phases, parameters, evidence, closes, group, detectable)  # type: ignore[arg-type]
        )
    rank = {"identified": 0, "confusable": 0, "not_supported": 2, "not_identifiable": 3}

    def place(finding: Finding) -> tuple[float, float, bool, float]:
        stands_for = other_of[finding.name][0] if finding.name in other_of else finding.name
        found = order.get(stands_for, len(library))
        return rank[finding.verdict], found, finding.name not in order, -finding.evidence["gain"]

    out.sort(key=place)
    return tuple(out)


def _detectable(search: _Search, present: Candidate, effect: Effect) -> tuple[dict[str, float], bool]:
    """Smallest size of each parameter that would have shown, and whether any of it lies within the plausible range."""
    if effect.name in {e.name for e in present.fitted.hypothesis.effects}:
        hypothesis = present.fitted.hypothesis
        start = 0
        for other in hypothesis.effects:
            if other.name == effect.name:
                break
            start += len(other.parameters)
    else:
        hypothesis = present.fitted.hypothesis.plus(effect)
        start = len(hypothesis.flat()) - len(effect.parameters)
    own = range(start, start + len(effect.parameters))
    e, now = present.evidence, present.fitted
    residual = now.residual
    J = derivatives(e, hypothesis, residual, own)[..., list(own)]
    H, _ = toss_sums(e, residual, J, now.scales, search.n)
    total = H.sum(0)
    sizes, seen = {}, False
    for i, parameter in enumerate(effect.parameters):
        error = parameter.step / np.sqrt(total[i, i]) if total[i, i] > 0 else np.inf
        size = 4.0 * float(error)
        sizes[parameter.name] = size
        seen = seen or size < 0.5 * (parameter.high - parameter.low)
    return {k: v for k, v in sizes.items() if np.isfinite(v)}, seen
