"""Hypotheses fitted to tosses, and judged by what they predict of tosses that took no part in the fit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.engine_discrepancy import Engine
from tossid.diagnosis.likelihood.evidence import Evidence, Hypothesis
from tossid.diagnosis.likelihood.fitting import Fitted, fit, perturbed
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.diagnosis.selection.significance import part_p_value
from tossid.errors import InputError
from tossid.motion.resting import rest_scatter
from tossid.objects import ObjectModel
from tossid.parallel import in_threads
from tossid.physics.effects import Effect
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.types import Phase, Toss

Array = NDArray[np.float64]
Item = TypeVar("Item")
Made = TypeVar("Made")


@dataclass(frozen=True)
class Candidate:
    """A hypothesis that was fitted and cross-validated.

    Attributes:
        effect: The effect that joined last, None for none.
        fitted: The hypothesis at its values.
        log_likelihood: (W,) of every window, at values fitted to the other folds.
        gain: (W,) of every window's log-likelihood, over the hypothesis before.
        toss_gains: (G, n) weighted gain of every toss, but for what a fit to nothing would lose: in all windows, in
            those with an impact, and in the others with contact, if there are both.
        judged: (W, L, K) whitened residuals of every toss under what was chosen and fitted without it; None while
            nothing was judged (`selection.nested`).
    """

    effect: Effect | None
    fitted: Fitted
    log_likelihood: Array
    gain: Array
    toss_gains: Array
    judged: Array | None = None

    @property
    def evidence(self) -> Evidence:
        """At first states that suit the hypothesis."""
        return self.fitted.evidence

    @property
    def hypothesis(self) -> Hypothesis:
        """At the fitted values."""
        return self.fitted.hypothesis

    @property
    def total(self) -> float:
        """Gain of log-likelihood; of an effect that acts in flight, contact counts as little as in its fit."""
        windows = self.evidence.windows
        flies = self.effect is not None and Phase.FLIGHT in self.effect.phases
        return float(self.gain @ windows.weights) / (windows.settings.windows.flight_weight if flies else 1.0)

    @property
    def p_value(self) -> float:
        """One-sided p-value of the null hypothesis that the effect gains nothing."""
        return part_p_value(self.toss_gains)

    @property
    def name(self) -> str:
        """Name of the effect that joined last."""
        return "" if self.effect is None else self.effect.name


def draw_folds(n: int, rng: np.random.Generator, count: int = 8) -> tuple[NDArray[np.bool_], ...]:
    """Folds of n tosses, (n,) each: the tosses that are held out.

    Args:
        n: How many tosses.
        rng: For the draw.
        count: How many folds, at most n.
    """
    place = rng.permutation(n)
    return tuple(place % count == k for k in range(min(count, n)))


@dataclass(frozen=True)
class CrossValidator:
    """Fits hypotheses to the windows of n tosses, and judges them on held-out tosses.

    Attributes:
        windows: Of all tosses.
        n: How many tosses.
        folds: (n,) each, the tosses that are held out in turn.
        n_threads: Of simulators, and how many hypotheses are fitted at once.
        engine: The other engine.
        held: Names of effects whose values are not fitted again with each hypothesis, but for a value of which flight
            has determined only the ratio to one that the hypothesis changes.
        settings: Of the diagnosis.
    """

    windows: Windows
    n: int
    folds: tuple[NDArray[np.bool_], ...]
    n_threads: int = 1
    engine: Engine = field(default_factory=Engine)
    held: frozenset[str] = frozenset()
    settings: DiagnoseSettings = field(default_factory=DiagnoseSettings)

    @staticmethod
    def of(
        tosses: Sequence[Toss],
        model: ObjectModel,
        *,
        seed: int,
        n_threads: int = 1,
        engine: Engine | None = None,
        over_order: bool = False,
        settings: DiagnoseSettings = DiagnoseSettings(),
    ) -> CrossValidator:
        """The cross-validator of all windows of some tosses.

        Args:
            tosses: Of one object.
            model: The object.
            seed: Of the folds.
            n_threads: Of simulators.
            engine: The other engine; near-rigid MuJoCo if None.
            over_order: As of `rest_scatter`: what changes over the order of the tosses is then no tracker's slow error.
            settings: Of the diagnosis.

        Raises:
            InputError: No stretch of frames is long enough.
        """
        n = len(tosses)
        folds = draw_folds(n, np.random.default_rng(seed), settings.cross_validation.folds)
        scatter = rest_scatter(tosses, model, over_order=over_order)
        windows = make_windows(tosses, model, settings=settings.likelihood, scatter=scatter)
        if not len(windows.q):
            cut = settings.likelihood.windows
            raise InputError(
                f"none of {n} tosses has a stretch of {cut.length // 2} time steps of {1e3 * windows.dt:.3g} ms in "
                f"which times are even and at most {cut.most_missing} frames in a row are missing: a diagnosis "
                "compares motions over such stretches"
            )
        return CrossValidator(windows, n, folds, n_threads, engine or Engine(), settings=settings)

    @property
    def screening(self) -> NDArray[np.bool_]:
        """(n,) tosses with which values far from a hypothesis are tried first."""
        return np.asarray(np.any(self.folds[: self.settings.selection.screening_folds], axis=0))

    def map(self, made: Callable[[Item], Made], items: Iterable[Item]) -> list[Made]:
        """made(item) of all items in order, several at once; one by one within such an item.

        Args:
            made: What is done with an item.
            items: The items.
        """
        return list(self.each(made, items))

    def each(
        self, made: Callable[[Item], Made], items: Iterable[Item], no_longer_wanted: Callable[[], None] = lambda: None
    ) -> Iterator[Made]:
        """As `map`, each as soon as it and those before it are made.

        Args:
            made: What is done with an item.
            items: The items.
            no_longer_wanted: Called when no more are asked for, before those that are being made are waited for.
        """
        return in_threads(made, items, self.n_threads, no_longer_wanted)

    def together(self, one: Callable[[], Item], other: Callable[[], Made]) -> tuple[Item, Made]:
        """Both results of two independent computations, made at the same time.

        Args:
            one: The first.
            other: The second.
        """
        asked: tuple[Callable[[], Any], ...] = (one, other)
        made = self.map(lambda ask: ask(), asked)
        return made[0], made[1]

    def evaluate(self, hypothesis: Hypothesis, near: Candidate | None = None) -> Candidate:
        """A hypothesis at its values, with nothing fitted but the windows' first states.

        Args:
            hypothesis: At its values.
            near: A hypothesis from whose first states those of this one are not far.
        """
        world = hypothesis.world()
        if near is None:
            restarts = self.settings.cross_validation.restarts
            evidence = Evidence.linearised(self.windows, world, refine=6, restarts=restarts, n_threads=self.n_threads)
            evidence = self.with_engine_difference(evidence, hypothesis, restarts=0)
        else:
            evidence = near.evidence.relinearised(world, refine=4)
        evidence = self.with_engine_difference(evidence, hypothesis, restarts=1)
        residuals = evidence.residuals(world)
        scales = evidence.scales(residuals)
        size = len(hypothesis.flat())
        no_sums = np.zeros((self.n, size, size)), np.zeros((self.n, size))
        log_likelihood = evidence.log_likelihood(residuals, scales)
        fitted = Fitted(hypothesis, evidence, residuals, scales, *no_sums)
        return Candidate(None, fitted, log_likelihood, np.zeros(len(log_likelihood)), np.zeros((1, self.n)))

    def with_engine_difference(
        self, evidence: Evidence, hypothesis: Hypothesis, restarts: int | None = None
    ) -> Evidence:
        """Evidence that allows for the difference to the other engine, at first states that allow for it too.

        Args:
            evidence: Near the hypothesis.
            hypothesis: The hypothesis.
            restarts: Of windows that fit poorly; the settings' if None.
        """
        world = hypothesis.world()
        other = self.engine.difference(evidence.windows, world, evidence.difference, n_threads=self.n_threads)
        restarts = self.settings.cross_validation.restarts if restarts is None else restarts
        return replace(evidence, difference=other).relinearised(world, refine=2, restarts=restarts)

    def cross_validate(
        self,
        present: Candidate,
        effect: Effect | None,
        start: Hypothesis,
        iterations: int = 8,
        near: Evidence | None = None,
    ) -> Candidate:
        """A hypothesis fitted to all tosses, and compared with the present one on held-out tosses.

        Args:
            present: With what it is compared.
            effect: What it has more, if anything.
            start: The hypothesis at values to begin with.
            iterations: Most iterations of the fit.
            near: Evidence around `start`, where that is far from the present hypothesis.
        """
        begin = present.evidence if near is None else near
        changing = {*present.hypothesis.names, *start.names}
        held = self.held - {each.name for each in start.effects if each.in_flight_over in changing}
        fitted = self._restarted(fit(begin, start, n_tosses=self.n, iterations=iterations, held=held))
        log_likelihood = self.held_out_log_likelihood(fitted)
        made = Candidate(effect, fitted, log_likelihood, np.zeros(len(log_likelihood)), np.zeros((1, self.n)))
        gain = self.gain_over(
            self._at_best_states(made, present.evidence), self._at_best_states(present, made.evidence)
        )
        gains = self.by_part(gain) if effect is None else self.gains_of(effect.name, fitted, gain)
        return replace(made, gain=gain, toss_gains=gains)

    def refit(self, evidence: Evidence, hypothesis: Hypothesis, rounds: int | None = None) -> Fitted:
        """All parameters of a hypothesis fitted together, and again from perturbed values while that gains.

        Windows that fit poorly are restarted before each fit.

        Args:
            evidence: Near the hypothesis.
            hypothesis: At values to begin with.
            rounds: Most fits; the settings' if None.
        """
        settings = self.settings.cross_validation
        fitted = fit(self.with_engine_difference(evidence, hypothesis), hypothesis, n_tosses=self.n)
        for _ in range((settings.refits if rounds is None else rounds) - 1):
            if not len(hypothesis.flat()):
                break
            near, moved = perturbed(fitted)
            again = fit(self.with_engine_difference(near, moved), moved, n_tosses=self.n)
            before, after = (each.evidence.log_likelihood(each.residuals, fitted.scales) for each in (fitted, again))
            gain = evidence.weighted_gain(after, before)
            if gain > 0:
                fitted = again
            if gain < settings.least_refit_gain:
                break
        return fitted

    def _restarted(self, fitted: Fitted) -> Fitted:
        """With windows that fit poorly under this hypothesis restarted."""
        evidence = self.with_engine_difference(fitted.evidence, fitted.hypothesis, restarts=1)
        residuals = evidence.residuals(fitted.hypothesis.world())
        return replace(fitted, evidence=evidence, residuals=residuals, scales=evidence.scales(residuals))

    def _at_best_states(self, one: Candidate, evidence: Evidence) -> Candidate:
        """A hypothesis with each window's log-likelihood at its own first states or at another's, whichever is larger.

        Contact is rough: better first states that were found for one hypothesis must not count for that one alone.
        """
        there = evidence.relinearised(one.hypothesis.world(), refine=2)
        other = self.held_out_log_likelihood(one.fitted, there)
        return replace(one, log_likelihood=np.maximum(one.log_likelihood, other))

    def held_out_log_likelihood(self, fitted: Fitted, evidence: Evidence | None = None) -> Array:
        """(W,) log-likelihood of each window at values fitted to the other folds, with scales of these.

        Args:
            fitted: The hypothesis.
            evidence: At which first states; at the hypothesis's own if None.
        """
        evidence = fitted.evidence if evidence is None else evidence
        out = np.zeros(len(evidence.windows.toss))
        for held in self.folds:
            own = held[evidence.windows.toss]
            if own.any():
                scales = evidence.scales(fitted.residuals, among=~own)
                rows = np.flatnonzero(own)
                out[own] = evidence.log_likelihood_of(fitted.of_part(~held).world(), scales, rows)
        return out

    def gain_over(self, one: Candidate, other: Candidate) -> Array:
        """(W,) robust gains of one hypothesis's log-likelihoods over another's.

        Each is judged at first states of its own, whose uncertainty differs between rigid and compliant contact. Flight
        does not count where the hypotheses differ only in effects that do not act in it: its windows have so much
        weight that how well their first states were found would decide.

        Args:
            one: A hypothesis.
            other: Another.
        """
        gain = one.evidence.gains(one.log_likelihood, other.log_likelihood)
        flying = [{e.name for e in each.hypothesis.effects if Phase.FLIGHT in e.phases} for each in (one, other)]
        if flying[0] == flying[1]:
            gain = np.where(one.evidence.windows.free, 0.0, gain)
        return gain

    def by_toss(self, gain: Array) -> Array:
        """(n,) weighted sums over each toss's windows.

        Args:
            gain: (W,).
        """
        weighted = gain * self.windows.weights
        return np.bincount(self.windows.toss, weights=weighted, minlength=self.n).astype(float)

    def by_part(self, gain: Array) -> Array:
        """(G, n) weighted sums of all windows, of those with an impact, and of others with contact, if there are both.

        Args:
            gain: (W,).
        """
        w = self.windows
        impact = (w.inside & (w.phase == Phase.IMPACT)).any(axis=1) & ~w.free
        other = ~impact & ~w.free
        parts = (impact, other) if impact.any() and other.any() else ()
        return np.stack([self.by_toss(gain), *(self.by_toss(np.where(part, gain, 0.0)) for part in parts)])

    def p_value_over(self, one: Candidate, other: Candidate) -> float:
        """p-value that one hypothesis predicts the tosses no better than another; 1 if on the whole it does not.

        Args:
            one: A hypothesis.
            other: Another.
        """
        gain = self.by_part(self.gain_over(one, other))
        return part_p_value(gain) if gain[0].sum() > 0 else 1.0

    def gains_of(self, name: str, fitted: Fitted, gain: Array) -> Array:
        """(G, n) gains by part of an effect, of which the first, of all windows, gets back what a fit to noise loses.

        Args:
            name: Of the effect.
            fitted: The hypothesis with it.
            gain: (W,) of each window, over the hypothesis without it.
        """
        out = self.by_part(gain)
        out[0] += fitted.loss_by_noise(name, self.folds)
        return out
