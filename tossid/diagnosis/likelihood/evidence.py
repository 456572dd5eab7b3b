"""Hypotheses, which are worlds with effects in them, and the evidence by which they are judged: whitened residuals.

A hypothesis's log-likelihood is the sum over entries of Student's log density of r / s_phase, where r are the whitened
residuals of its world and s_phase >= 1 is their robust size in a phase. While an impact is badly modelled, its entries
must not outweigh what flight says.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.density import log_densities, student_deviance, student_scales
from tossid.diagnosis.likelihood.engine_discrepancy import EngineDifference
from tossid.diagnosis.likelihood.whitening import Whitening, linearised
from tossid.diagnosis.likelihood.windows import Windows
from tossid.physics.effects import Effect, World
from tossid.settings.diagnosis.likelihood import DensitySettings
from tossid.types import Phase

Array = NDArray[np.float64]

N_PHASES = 6
"""Phases of motion (`types.Phase`)."""
FREE = 0
"""Number of free flight's windows among the phases."""
_MOST_KNOWN = 8
"""Worlds of which predictions from the same first states are kept."""


@dataclass(frozen=True)
class Hypothesis:
    """A world with effects added to it.

    Attributes:
        base: The world without effects.
        effects: The effects, in the order in which they are added.
        values: The parameters of each effect, (P,) each.
    """

    base: World
    effects: tuple[Effect, ...] = ()
    values: tuple[Array, ...] = ()

    def world(self) -> World:
        """The world with all effects at their values, the same object whenever it is asked for."""
        return self._world

    @cached_property
    def _world(self) -> World:
        world = self.base
        for effect, values in self.items():
            world = effect.at(world, values)
        return world

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(effect.name for effect in self.effects)

    def items(self) -> Iterator[tuple[Effect, Array]]:
        """Its effects, each with its values."""
        return zip(self.effects, self.values, strict=True)

    def plus(self, effect: Effect, values: Array | None = None) -> Hypothesis:
        """With one more effect.

        Args:
            effect: The effect.
            values: (P,) its parameters; those that change nothing if None.
        """
        if values is None:
            values = effect.nominal(self.world())
        return Hypothesis(self.base, (*self.effects, effect), (*self.values, values))

    def minus(self, name: str) -> Hypothesis:
        """Without one effect.

        Args:
            name: Of the effect.
        """
        kept = [(e, v) for e, v in self.items() if e.name != name]
        return Hypothesis(self.base, tuple(e for e, _ in kept), tuple(v for _, v in kept))

    def values_of(self, name: str) -> Array:
        """(P,) parameters of one effect.

        Args:
            name: Of the effect.
        """
        return next(values for effect, values in self.items() if effect.name == name)

    def place_of(self, name: str) -> slice:
        """Where the parameters of one effect are in `flat`.

        Args:
            name: Of the effect.
        """
        names = self.parameter_owners
        return slice(names.index(name), names.index(name) + names.count(name))

    @property
    def parameter_owners(self) -> list[str]:
        """(P,) the name of the effect to which each parameter belongs."""
        return [effect.name for effect in self.effects for _ in effect.parameters]

    def with_instead(self, name: str, effect: Effect, values: Array) -> Hypothesis:
        """With another effect in the place of one.

        Args:
            name: Of the effect that is replaced.
            effect: The other one.
            values: (P,) its parameters.
        """
        k = self.names.index(name)
        effects, all_values = list(self.effects), list(self.values)
        effects[k], all_values[k] = effect, values
        return Hypothesis(self.base, tuple(effects), tuple(all_values))

    @property
    def steps(self) -> Array:
        """(P,) the declared step of each parameter, by which it is scaled in fits."""
        return np.array([p.step for effect in self.effects for p in effect.parameters])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """(P,) lowest and highest plausible values."""
        parameters = [p for effect in self.effects for p in effect.parameters]
        return np.array([p.low for p in parameters]), np.array([p.high for p in parameters])

    def flat(self) -> Array:
        """(P,) all parameters."""
        return np.concatenate(self.values) if self.values else np.zeros(0)

    def at(self, flat: Array) -> Hypothesis:
        """The same effects with other parameters.

        Args:
            flat: (P,) all parameters.
        """
        parts, first = [], 0
        for effect in self.effects:
            parts.append(flat[first : first + len(effect.parameters)])
            first += len(effect.parameters)
        return Hypothesis(self.base, self.effects, tuple(parts))

    def clipped(self, flat: Array) -> Hypothesis:
        """The same effects with other parameters, limited to their plausible ranges.

        Args:
            flat: (P,) all parameters.
        """
        return self.at(np.clip(flat, *self.bounds))


class Predicted(NamedTuple):
    """What a world predicts of windows.

    Attributes:
        world: The simulator.
        residuals: (W, L, K) of its predictions, not whitened.
    """

    world: World
    residuals: Array


@dataclass(frozen=True)
class Evidence:
    """Windows with their whitening, ready to judge worlds.

    Attributes:
        windows: The windows, at first states that suit a hypothesis.
        whitening: Of their residuals there.
        n_threads: Of the simulator.
        difference: To the other engine.
        at: The world under which first states were estimated last, at these; None if it is not known.
        known: What other worlds predict from these first states, of those that were asked for last.
        slopes: Derivatives of whitened residuals by an effect's parameters (W, L, K, P), by the world beside which they
            were taken, which is kept with them, and the effect's name (`fitting.effect_derivatives`).
    """

    windows: Windows
    whitening: Whitening
    n_threads: int = 1
    difference: EngineDifference | None = None
    at: Predicted | None = None
    known: dict[int, Predicted] = field(default_factory=dict, compare=False, repr=False)
    slopes: dict[tuple[int, str], tuple[World, Array]] = field(default_factory=dict, compare=False, repr=False)

    @staticmethod
    def linearised(windows: Windows, world: World, *, refine: int, restarts: int = 0, n_threads: int = 1) -> Evidence:
        """With first states and whitening as they are under a world.

        Args:
            windows: At first states from which to begin.
            world: That world.
            refine: As of `linearise`.
            restarts: As of `linearise`.
            n_threads: Of the simulator.
        """
        kept, whitening, residuals = linearised(windows, world, refine=refine, restarts=restarts, n_threads=n_threads)
        return Evidence(kept, whitening, n_threads, None, Predicted(world, residuals))

    @property
    def density(self) -> DensitySettings:
        """Of whitened residuals."""
        return self.windows.settings.density

    def residuals(self, world: World, rows: NDArray[np.int64] | None = None) -> Array:
        """(n, L, K) whitened residuals of a world.

        Args:
            world: The simulator.
            rows: (n,) in which windows; in all W if None.
        """
        return self.whitening(self.predicted(world, rows), rows)

    def predicted(self, world: World, rows: NDArray[np.int64] | None = None) -> Array:
        """(n, L, K) residuals of a world that are not whitened. A world that was asked for before is not run again.

        Windows that do not feel how a world differs from `at` have its residuals, to the bit: rough contact makes much
        of rounding errors, and no result may depend on what was asked for before.

        Args:
            world: The simulator.
            rows: (n,) in which windows; in all W if None.
        """
        if self.at is not None and self.at.world is world:
            return self.at.residuals if rows is None else self.at.residuals[rows]
        kept = self.known.get(id(world))
        if kept is not None:
            return kept.residuals if rows is None else kept.residuals[rows]
        windows = self.windows
        asked = np.arange(len(windows.steps)) if rows is None else rows
        if self.at is None:
            residuals, felt = np.zeros((len(asked), *windows.inside.shape[1:], windows.channels)), np.arange(len(asked))
        else:
            residuals, felt = self.at.residuals[asked], np.flatnonzero(windows.feels(world, self.at.world)[asked])
        if len(felt):
            predicted = windows.predicted(world, index=asked[felt], n_threads=self.n_threads)
            residuals[felt] = windows.residuals(predicted, asked[felt])
        if rows is None:
            for old in list(self.known)[: 1 - _MOST_KNOWN]:
                self.known.pop(old, None)
            self.known[id(world)] = Predicted(world, residuals)
        return residuals

    def of_tosses(self, chosen: NDArray[np.bool_]) -> Evidence:
        """The evidence of some tosses.

        Args:
            chosen: (n,) which.
        """
        return self.rows(np.flatnonzero(chosen[self.windows.toss]))

    def rows(self, rows: NDArray[np.int64]) -> Evidence:
        """The evidence of some windows.

        Args:
            rows: (m,) their numbers.
        """
        difference = None if self.difference is None else self.difference.rows(rows)
        at = None if self.at is None else Predicted(self.at.world, self.at.residuals[rows])
        return Evidence(self.windows.rows(rows), self.whitening.rows(rows), self.n_threads, difference, at)

    def relinearised(self, world: World, *, refine: int = 1, restarts: int = 0, update: bool = True) -> Evidence:
        """With first states and whitening as they are under another world near by.

        Args:
            world: That world.
            refine: As of `linearise`.
            restarts: As of `linearise`.
            update: As of `linearise`.
        """
        moving = None if self.at is None else self.windows.feels(world, self.at.world)
        windows, whitening, residuals = linearised(
            self.windows,
            world,
            refine=refine,
            restarts=restarts,
            near=self.whitening,
            update=update,
            difference=self.difference,
            known=self.predicted(world),
            moving=moving,
            n_threads=self.n_threads,
        )
        return Evidence(windows, whitening, self.n_threads, self.difference, Predicted(world, residuals))

    def scales(self, residuals: Array, among: NDArray[np.bool_] | None = None) -> Array:
        """(N_PHASES,) robust size of whitened residuals in each phase, at least 1; `FREE` is that of free flight.

        Args:
            residuals: (W, L, K) whitened.
            among: (W,) which windows count; all if None.
        """
        w = self.windows
        known = np.where(w.phase == Phase.UNKNOWN, -1, w.phase.astype(np.int64))
        group = np.where(w.inside, np.where(w.free[:, None], FREE, known), -1)
        if among is not None:
            group[~among] = -1
        return student_scales(residuals, group, N_PHASES, self.density)

    def entry_scales(self, scales: Array, rows: NDArray[np.int64] | None = None) -> Array:
        """(n, L, 1) the scale of each row.

        Args:
            scales: (N_PHASES,) of the phases.
            rows: (n,) in which windows; in all W if None.
        """
        chosen = slice(None) if rows is None else rows
        s: Array = scales[np.where(self.windows.free[chosen, None], FREE, self.windows.phase[chosen])]
        return s[..., None]

    def deviances(self, residuals: Array) -> Array:
        """(W,) Student's deviance of windows.

        Args:
            residuals: (W, L, K) whitened.
        """
        deviance = student_deviance(residuals, self.density)
        out: Array = np.where(self.windows.inside[..., None], deviance, 0.0).sum((1, 2))
        return out

    def log_likelihood(self, residuals: Array, scales: Array, rows: NDArray[np.int64] | None = None) -> Array:
        """(n,) Student's log density, but for constants.

        Args:
            residuals: (n, L, K) whitened.
            scales: (N_PHASES,) of the phases.
            rows: (n,) in which windows; in all W if None.
        """
        chosen = slice(None) if rows is None else rows
        out = np.empty(len(residuals))
        scale, inside = self.entry_scales(scales, rows)[..., 0], self.windows.inside[chosen]
        log_densities(np.ascontiguousarray(residuals), inside, scale, self.density.degrees_of_freedom, out)
        return out + self.whitening.log_det[chosen]

    def log_likelihood_of(self, world: World, scales: Array, rows: NDArray[np.int64] | None = None) -> Array:
        """(n,) the log-likelihood of a world.

        Args:
            world: The simulator.
            scales: (N_PHASES,) of the phases.
            rows: (n,) in which windows; in all W if None.
        """
        return self.log_likelihood(self.residuals(world, rows), scales, rows)

    def gains(self, after: Array, before: Array) -> Array:
        """(W,) growth of windows' log-likelihoods, linear up to `large_gain` and logarithmic beyond.

        An effect explains many windows; one window whose first state falls into another minimum must not decide.

        Args:
            after: (W,) log-likelihoods.
            before: (W,) log-likelihoods.
        """
        large = self.density.large_gain
        grown: Array = large * np.arcsinh((after - before) / large)
        return grown

    def weighted_gain(self, after: Array, before: Array) -> float:
        """The weighted sum of `gains`.

        Args:
            after: (W,) log-likelihoods.
            before: (W,) log-likelihoods.
        """
        return float(self.gains(after, before) @ self.windows.weights)
