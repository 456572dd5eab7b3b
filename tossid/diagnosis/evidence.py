"""What is judged, and by what: hypotheses, which are worlds with effects in them, and the evidence of whitened misses.

A hypothesis's log-likelihood is the sum over entries of Student's log density of r / s_phase, r the whitened misses of
its world. s_phase >= 1 is what the simulator misses in a phase beyond noise: while an impact is badly modelled, its
entries must not drown what flight says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.engines import Difference
from tossid.diagnosis.whitening import Whitening, linearise
from tossid.diagnosis.windows import Windows
from tossid.physics.effects import Effect, World

Array = NDArray[np.float64]

NU = 4.0
"""Degrees of freedom of Student's density."""
N_PHASES = 6
FREE = 0
"""Place of free flight's windows among the phases."""
CAP = 30.0
"""Whitened misses beyond this count as this: a chaotic impact is one impact."""
LARGE = 8.0
"""Gain of log-likelihood of a window that is large."""


@dataclass(frozen=True)
class Hypothesis:
    """A world with effects added to it. values: one array (P,) an effect."""

    base: World
    effects: tuple[Effect, ...] = ()
    values: tuple[Array, ...] = ()

    def world(self) -> World:
        """The world with all effects at their values."""
        world = self.base
        for effect, values in zip(self.effects, self.values, strict=True):
            world = effect.at(world, values)
        return world

    def plus(self, effect: Effect, values: Array | None = None) -> Hypothesis:
        """With one effect more, at values that change nothing unless given."""
        if values is None:
            values = effect.nominal(self.world())
        return Hypothesis(self.base, (*self.effects, effect), (*self.values, values))

    def minus(self, name: str) -> Hypothesis:
        """Without the effect of that name."""
        kept = [(e, v) for e, v in zip(self.effects, self.values, strict=True) if e.name != name]
        return Hypothesis(self.base, tuple(e for e, _ in kept), tuple(v for _, v in kept))

    def values_of(self, name: str) -> Array:
        """(P,) of the effect of that name."""
        return next(values for effect, values in zip(self.effects, self.values, strict=True) if effect.name == name)

    def place_of(self, name: str) -> slice:
        """Where the values of the effect of that name are among all."""
        names = [effect.name for effect in self.effects for _ in effect.parameters]
        return slice(names.index(name), names.index(name) + names.count(name))

    def with_instead(self, name: str, effect: Effect, values: Array) -> Hypothesis:
        """With another effect in the place of the effect of that name."""
        k = [each.name for each in self.effects].index(name)
        effects, all_values = list(self.effects), list(self.values)
        effects[k], all_values[k] = effect, values
        return Hypothesis(self.base, tuple(effects), tuple(all_values))

    @property
    def steps(self) -> Array:
        """(P,) units of all parameters, in order."""
        return np.array([p.step for effect in self.effects for p in effect.parameters])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """(P,) lowest and highest plausible values."""
        parameters = [p for effect in self.effects for p in effect.parameters]
        return np.array([p.low for p in parameters]), np.array([p.high for p in parameters])

    def flat(self) -> Array:
        """(P,) all values."""
        return np.concatenate(self.values) if self.values else np.zeros(0)

    def at(self, flat: Array) -> Hypothesis:
        """The same effects at other values (P,)."""
        parts, first = [], 0
        for effect in self.effects:
            parts.append(flat[first : first + len(effect.parameters)])
            first += len(effect.parameters)
        return Hypothesis(self.base, self.effects, tuple(parts))


@dataclass(frozen=True)
class Evidence:
    """Windows with their whitening, ready to judge worlds.

    engines: the difference to another engine.
    """

    windows: Windows
    whitening: Whitening
    n_threads: int = 1
    engines: Difference | None = None

    def residual(self, world: World) -> Array:
        """(W, L, K) whitened misses."""
        return self.whitening(self.windows.misses(self.windows.predicted(world, n_threads=self.n_threads)))

    def of_tosses(self, chosen: NDArray[np.bool_]) -> Evidence:
        """The windows of the tosses that are chosen (n_tosses,)."""
        return self.rows(np.flatnonzero(chosen[self.windows.toss]))

    def rows(self, rows: NDArray[np.int64]) -> Evidence:
        """Some of the windows."""
        engines = None if self.engines is None else self.engines.rows(rows)
        return Evidence(self.windows.rows(rows), self.whitening.rows(rows), self.n_threads, engines)

    def spread(self, scales: Array) -> Array:
        """(W, L, 1) scale of each miss, for those of the phases."""
        s: Array = scales[np.where(self.windows.free[:, None], FREE, self.windows.phase)]
        return s[..., None]

    def renewed(self, world: World, *, refine: int = 1, restarts: int = 0, anew: bool = True) -> Evidence:
        """With states and whitening as they are under another world near by; `anew` as for `linearise`."""
        windows, whitening = linearise(
            self.windows,
            world,
            refine=refine,
            restarts=restarts,
            near=self.whitening,
            anew=anew,
            engines=self.engines,
            n_threads=self.n_threads,
        )
        return Evidence(windows, whitening, self.n_threads, self.engines)

    def scales(self, residual: Array) -> Array:
        """(N_PHASES,) robust size of whitened misses a phase, at least 1; first that of the windows of free flight."""
        out = np.ones(N_PHASES)
        w = self.windows
        for phase in range(N_PHASES):
            chosen = w.inside & w.free[:, None] if phase == FREE else w.counted & (w.phase == phase)
            if chosen.any():
                out[phase] = max(1.0, _student_scale(residual[chosen].ravel()))
        return out

    def log_likelihood(self, residual: Array, scales: Array) -> Array:
        """(W,) of Student's density, but for constants."""
        s = self.spread(scales)
        ll = -0.5 * (NU + 1) * np.log1p((residual / s) ** 2 / NU) - np.log(s)
        out: Array = np.where(self.windows.inside[..., None], ll, 0.0).sum((1, 2)) + self.whitening.volume
        return out


def _student_scale(r: Array) -> float:
    """Maximum likelihood scale of Student's density (a few fixed-point steps)."""
    s2 = max(float(np.median(r**2)) / 0.55, 1e-12)
    for _ in range(20):
        s2 = float(np.mean((NU + 1) * r**2 / (NU + r**2 / s2)))
    return float(np.sqrt(s2))


def student_deviance(residual: Array) -> Array:
    """Student's deviance of whitened misses, which a chaotic impact does not drown."""
    value: Array = (NU + 1) * np.log1p(residual**2 / NU)
    return value


def gains(after: Array, before: Array) -> Array:
    """(W,) by how much windows' log-likelihoods grow, in proportion up to `LARGE`, logarithmically beyond: what an
    effect explains, it explains in many windows; one that falls into another minimum of its first state does not
    decide."""
    grown: Array = LARGE * np.arcsinh((after - before) / LARGE)
    return grown
