"""Evidence: how likely tosses are under a hypothesis. A function of both alone, whatever was computed before.

Each window starts from a state that is a nuisance parameter (`likelihood.windows`). Its posterior mode is sought by one
fixed procedure that begins at the recording. Around the mode the state is marginalised in closed form: the residuals
are whitened row by row, as a Kalman filter's innovations are. What is left is compared by Student's density, since one
chaotic impact must not decide:

    l_w = log det L_w^-1 - sum over entries of [(nu + 1) / 2 log(1 + (e / s)^2 / nu) + log s],
    e = L_w^-1 (y - f(x_w)),

where s >= 1 is the robust size of whitened residuals in the row's phase of motion.

`collect` is the full procedure, and everything that is reported comes from it. `Evidence.relinearised` follows a small
change of the hypothesis by few Gauss-Newton steps. It ranks candidates and moves fits along.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.likelihood.density import log_density, student_deviance, student_scales
from tossid.diagnosis.likelihood.engine_discrepancy import EngineDifference
from tossid.diagnosis.likelihood.whitening import Whitening, linearise, relinearise
from tossid.diagnosis.likelihood.windows import Windows
from tossid.settings.diagnosis.likelihood import DensitySettings
from tossid.types import Phase

Array = NDArray[np.float64]
Index = NDArray[np.int64]

N_PHASES = 6
"""Phases of motion (`types.Phase`)."""
FREE = 0
"""Number of free flight's windows among the phases."""
STATE_STEPS = 6
"""Most Gauss-Newton steps from the recorded first state; windows that need more are restarted."""
RESTARTS = 2
"""From the first frames of a window, then from a perturbed state. Further restarts gain little for their cost."""


@dataclass(frozen=True)
class Evidence:
    """Windows of tosses under a hypothesis, at first states that suit it.

    Attributes:
        hypothesis: What predicts.
        windows: W of them, with L rows of K channels.
        whitening: Of their residuals.
        raw: (W, L, K) measured minus predicted poses [m, rad].
        residuals: (W, L, K) the same, whitened.
        scales: (N_PHASES,) robust size of whitened residuals in each phase.
        log_likelihood: (W,) of each window.
        difference: To another engine's predictions of the same rigid contact, a nuisance of the whitening.
        n_threads: Of the simulator.
    """

    hypothesis: Hypothesis
    windows: Windows
    whitening: Whitening
    raw: Array
    residuals: Array
    scales: Array
    log_likelihood: Array
    difference: EngineDifference | None
    n_threads: int
    _last: list[tuple[Hypothesis, Array]] = field(default_factory=list, init=False, compare=False, repr=False)

    @staticmethod
    def at(
        hypothesis: Hypothesis,
        windows: Windows,
        whitening: Whitening,
        raw: Array,
        difference: EngineDifference | None,
        n_threads: int,
    ) -> Evidence:
        """The evidence at given first states.

        Args:
            hypothesis: What predicts.
            windows: At these first states.
            whitening: There.
            raw: (W, L, K) residuals there.
            difference: To another engine, there.
            n_threads: Of the simulator.
        """
        residuals = whitening(raw)
        scales = phase_scales(windows, residuals)
        log_likelihood = _log_likelihood(windows, whitening, residuals, scales)
        return Evidence(hypothesis, windows, whitening, raw, residuals, scales, log_likelihood, difference, n_threads)

    @property
    def density(self) -> DensitySettings:
        """Of whitened residuals."""
        return self.windows.settings.density

    def relinearised(self, hypothesis: Hypothesis, *, steps: int = 1) -> Evidence:
        """The evidence of a hypothesis near by, whose first states follow by few Gauss-Newton steps.

        Args:
            hypothesis: The other hypothesis.
            steps: Most steps of each window's first state.
        """
        world = hypothesis.world()
        windows, whitening, raw = relinearise(
            self.windows,
            world,
            self.whitening,
            steps=steps,
            residuals=self.raw_residuals(hypothesis),
            moving=self.windows.feels(world, self.hypothesis.world()),
            difference=self.difference,
            n_threads=self.n_threads,
        )
        return Evidence.at(hypothesis, windows, whitening, raw, self.difference, self.n_threads)

    def raw_residuals(self, hypothesis: Hypothesis) -> Array:
        """(W, L, K) residuals of another hypothesis from these first states, not whitened.

        Windows that cannot feel where both differ are not simulated. Of the difference to another engine each law
        expects another multiple in the residuals. That of the other law takes the place of our own here.

        Args:
            hypothesis: The other hypothesis.
        """
        if self._last and self._last[0][0] is hypothesis:
            return self._last[0][1]
        world, own = hypothesis.world(), self.hypothesis.world()
        out = self.raw.copy()
        felt = np.zeros(0, int) if world is own else np.flatnonzero(self.windows.feels(world, own))
        if len(felt):
            predicted = self.windows.predicted(world, index=felt, n_threads=self.n_threads)
            out[felt] = self.windows.residuals(predicted, felt)
        engine = hypothesis.law.engine
        if self.difference is not None and engine.patched is not self.hypothesis.law.engine.patched:
            other = engine.difference(self.windows, hypothesis, n_threads=self.n_threads)
            out += self.difference.expected * self.difference.values - other.expected * other.values
        self._last[:] = [(hypothesis, out)]
        return out

    def residuals_of(self, hypothesis: Hypothesis) -> Array:
        """(W, L, K) whitened residuals of another hypothesis from these first states.

        Args:
            hypothesis: The other hypothesis.
        """
        return self.whitening(self.raw_residuals(hypothesis))

    def log_likelihood_of(self, hypothesis: Hypothesis, scales: Array) -> Array:
        """(W,) log-likelihoods of another hypothesis from these first states.

        Args:
            hypothesis: The other hypothesis.
            scales: (N_PHASES,) of the phases.
        """
        return _log_likelihood(self.windows, self.whitening, self.residuals_of(hypothesis), scales)

    def of_tosses(self, chosen: Index) -> Evidence:
        """The evidence of some tosses, which are renumbered in the order given.

        Args:
            chosen: (n,) their numbers.
        """
        number = np.full(max(self.windows.toss.max(initial=0), chosen.max(initial=0)) + 1, -1)
        number[chosen] = np.arange(len(chosen))
        rows = np.flatnonzero(number[self.windows.toss] >= 0)
        some = self.rows(rows)
        return replace(some, windows=replace(some.windows, toss=number[some.windows.toss]))

    def rows(self, rows: Index) -> Evidence:
        """The evidence of some windows.

        Args:
            rows: (m,) their numbers.
        """
        difference = None if self.difference is None else self.difference.rows(rows)
        windows, whitening = self.windows.rows(rows), self.whitening.rows(rows)
        return Evidence.at(self.hypothesis, windows, whitening, self.raw[rows], difference, self.n_threads)

    def with_rows(self, index: Index, other: Evidence) -> Evidence:
        """The evidence of another hypothesis, which some windows feel; the others are as they are here.

        Args:
            index: (m,) numbers of these windows.
            other: Evidence of them under the other hypothesis.
        """

        def replaced(values: Array, new: Array) -> Array:
            out = values.copy()
            out[index] = new
            return out

        w, difference = self.windows, self.difference
        names = [each.name for each in fields(Whitening)]
        whitening = Whitening(
            *(replaced(getattr(self.whitening, name), getattr(other.whitening, name)) for name in names)
        )
        if difference is not None and other.difference is not None:
            difference = replace(difference, values=replaced(difference.values, other.difference.values))
        windows = replace(w, at_q=replaced(w.at_q, other.windows.at_q), at_v=replaced(w.at_v, other.windows.at_v))
        raw = replaced(self.raw, other.raw)
        return Evidence.at(other.hypothesis, windows, whitening, raw, difference, self.n_threads)

    def deviances(self) -> Array:
        """(W,) Student's deviance of windows."""
        deviance = student_deviance(self.residuals, self.density)
        out: Array = np.where(self.windows.inside[..., None], deviance, 0.0).sum((1, 2))
        return out

    def entry_scales(self) -> Array:
        """(W, L, 1) the scale of each row."""
        return _entry_scales(self.windows, self.scales)[..., None]


def collect(windows: Windows, hypothesis: Hypothesis, *, known: Evidence | None = None, n_threads: int = 1) -> Evidence:
    """The evidence of tosses under a hypothesis, by the full procedure, which begins at the recorded first states.

    Args:
        windows: Of the tosses.
        hypothesis: What predicts.
        known: Evidence of the same windows by this procedure, under a hypothesis of the same law of contact. Windows
            that cannot feel where both differ have the same first states, and keep them.
        n_threads: Of the simulator.
    """
    world, engine = hypothesis.world(), hypothesis.law.engine
    if known is not None:
        felt = np.flatnonzero(windows.feels(world, known.hypothesis.world()))
        return known.with_rows(felt, collect(windows.rows(felt), hypothesis, n_threads=n_threads))
    begin = replace(windows, at_q=windows.q, at_v=windows.v)
    kept, whitening, raw = linearise(begin, world, steps=STATE_STEPS, restarts=RESTARTS, n_threads=n_threads)
    difference = None
    if not engine.none:
        difference = engine.difference(kept, hypothesis, n_threads=n_threads)
        kept, whitening, raw = relinearise(
            kept, world, whitening, steps=2, residuals=raw, difference=difference, n_threads=n_threads
        )
    return Evidence.at(hypothesis, kept, whitening, raw, difference, n_threads)


def log_likelihood_ratio(one: Evidence, other: Evidence) -> Array:
    """(W,) robust logarithms of how much likelier windows are under one hypothesis than under another.

    Contact is rough. First states that were found for one of both must not count for that one alone, so each
    hypothesis is evaluated at both, and the better counts. A window's ratio is linear up to `large_gain` and
    logarithmic beyond: what explains much explains many windows.

    Args:
        one: Evidence of some windows.
        other: Evidence of the same windows.
    """
    mine = np.maximum(one.log_likelihood, other.log_likelihood_of(one.hypothesis, one.scales))
    theirs = np.maximum(other.log_likelihood, one.log_likelihood_of(other.hypothesis, other.scales))
    return bounded(mine - theirs, one.density)


def bounded(gains: Array, density: DensitySettings) -> Array:
    """Differences of log-likelihood of windows, of which none decides alone.

    Args:
        gains: Of any shape.
        density: How much counts in full.
    """
    large = density.large_gain
    out: Array = large * np.arcsinh(gains / large)
    return out


def phase_scales(windows: Windows, residuals: Array) -> Array:
    """(N_PHASES,) robust size of whitened residuals in each phase, at least 1; `FREE` is that of free flight.

    Args:
        windows: W windows.
        residuals: (W, L, K) whitened.
    """
    known = np.where(windows.phase == Phase.UNKNOWN, -1, windows.phase.astype(np.int64))
    group = np.where(windows.inside, np.where(windows.free[:, None], FREE, known), -1)
    return student_scales(residuals, group, N_PHASES, windows.settings.density)


def _entry_scales(windows: Windows, scales: Array) -> Array:
    """(W, L) the scale of each row."""
    out: Array = scales[np.where(windows.free[:, None], FREE, windows.phase)]
    return out


def _log_likelihood(windows: Windows, whitening: Whitening, residuals: Array, scales: Array) -> Array:
    """(W,) Student's log density, but for constants."""
    scale = _entry_scales(windows, scales)
    return whitening.log_det + log_density(residuals, windows.inside, scale, windows.settings.density)
