"""The nearest least squares of a pose graph, and its covariances; the factors and their linear algebra are GTSAM's.

Covariances come by block elimination (Schur complement), or by GTSAM where stillness connects time steps.

A pose graph of a recording has two kinds of variables: those of what is static, which all time steps share, and those
of one time step, which meet those of another step only through what is shared. With H the Gauss-Newton Hessian, s the
shared variables and c those of one step (a "group"),

    S = H_ss - Σ_c H_sc H_cc⁻¹ H_cs,    Σ_ss = S⁻¹,    Σ_cc = H_cc⁻¹ + X_c Σ_ss X_cᵀ,    X_c = H_cc⁻¹ H_cs

so that all covariances take a time in proportion to the number of groups (Triggs et al., "Bundle adjustment: a modern
synthesis", 2000, section 6.1). GTSAM's covariances of single variables eliminate all shared ones anew for each.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tossid.errors import SolverError
from tossid.least_squares import Damping, search_damping

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LARGEST_GROUP = 60
"""Numbers that a group may have; larger ones (steps that stillness connects) are left to GTSAM."""
LEAST_EIGENVALUE = 1e-13
"""Of a Hessian that is scaled to a unit diagonal: a smaller one counts as zero."""


WEAK_PRIOR = 3.0
"""Standard deviation of the prior that covariances are taken with where a pose is not determined [m, rad]."""
DIMENSIONS = {"o": 1, "j": 1, "p": 3}
"""Of clocks, joints and prints, by the letter of their keys; poses have six."""
LEVENBERG = Damping(grow=100.0, fall=0.1, least=0.01, vanish=1.0)
"""Gauss-Newton's steps, undamped, until one fails; then λ is 1, 100, …"""
MOST_STEPS = 100
"""Of an optimisation."""
MOST_DAMPING = 1e12
"""λ above which steps are too small to change anything."""


def optimise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """The values at the nearest minimum of the graph's squared error, by Levenberg's damped Gauss-Newton steps.

    GTSAM's own optimisers need time that grows with the square of the number of time steps before they start.

    Raises:
        SolverError: The error at the start is not finite, and no step makes it so.
    """
    if not values.size():
        return values
    error, damping = graph.error(values), 0.0
    for _ in range(MOST_STEPS):
        linear, here = graph.linearize(values), values

        def attempt(
            damping: float,
            linear: gtsam.GaussianFactorGraph = linear,
            here: gtsam.Values = here,
            least: float = error,
        ) -> tuple[gtsam.Values, float] | None:
            try:
                moved = here.retract(damped(linear, here, damping).optimize())
                new = graph.error(moved)
            except RuntimeError:  # singular: only a damped step exists
                return None
            return (moved, new) if new <= least else None

        step, damping = search_damping(attempt, damping, LEVENBERG, most=MOST_DAMPING)
        if step is None:
            if not np.isfinite(error):
                raise SolverError("the pose graph has no finite error at its first poses")
            return values
        values, gain, error, damping = step[0], error - step[1], step[1], LEVENBERG.accepted(damping)
        if gain <= 1e-7 + 1e-9 * error:
            break
    return values


def dimensions(values: gtsam.Values) -> dict[int, int]:
    """Of each key, how many numbers its variable has."""
    return {key: DIMENSIONS.get(chr(gtsam.Symbol(key).chr()), 6) for key in values.keys()}  # noqa: SIM118  (not a dict)


def damped(linear: gtsam.GaussianFactorGraph, values: gtsam.Values, damping: float) -> gtsam.GaussianFactorGraph:
    """A linear graph with a prior of that inverse variance on every number, at zero."""
    if not damping:
        return linear
    out = gtsam.GaussianFactorGraph()
    out.push_back(linear)
    for key, n in dimensions(values).items():
        out.add(gtsam.JacobianFactor(key, np.sqrt(damping) * np.eye(n), np.zeros(n), gtsam.noiseModel.Unit.Create(n)))
    return out


class Marginals(Protocol):
    """Covariances of a graph's variables."""

    def joint(self, keys: list[int]) -> NDArray[np.float64]:
        """The joint covariance of some variables, in the order of their keys."""


class SingularError(ArithmeticError):
    """The Hessian leaves a variable undetermined; the message names it as GTSAM's does.

    Args:
        key: Of the variable.
    """

    def __init__(self, key: int) -> None:
        super().__init__(f"undetermined (Symbol: {gtsam.DefaultKeyFormatter(key)})")


@dataclass(frozen=True, eq=False)
class Covariances:
    """Covariances of shared variables and of groups.

    Attributes:
        place: Of each variable's key: its group (-1 for shared) and where its numbers begin and end there.
        shared: Σ_ss, (S, S).
        X: H_cc⁻¹ H_cs, (n, d, S).
        alone: H_cc⁻¹, (n, d, d).
    """

    place: dict[int, tuple[int, int, int]]
    shared: Array
    X: Array
    alone: Array

    def joint(self, keys: list[int]) -> Array:
        """The joint covariance of some variables of one group, or of some shared ones."""
        groups = {self.place[key][0] for key in keys}
        index = np.concatenate([np.arange(*self.place[key][1:]) for key in keys])
        (group,) = groups
        if group < 0:
            return np.asarray(self.shared[np.ix_(index, index)])
        X = self.X[group, index]
        return np.asarray(self.alone[group][np.ix_(index, index)] + X @ self.shared @ X.T)


def covariances(
    linear: gtsam.GaussianFactorGraph, dims: dict[int, int], shared: Collection[int], *, damping: float = 0.0
) -> Covariances | None:
    """Covariances of all variables of a linear factor graph; None where its groups are not small.

    Raises:
        SingularError: The factors and the prior leave a variable undetermined.
    """
    factors = [linear.at(i) for i in range(linear.size())]
    keys = [list(factor.keys()) for factor in factors]
    place, lengths, size = _places(dims, shared, keys)
    n, d = len(lengths), max(lengths, default=0)
    if d > LARGEST_GROUP:
        return None
    H_ss, H_cc, H_cs = damping * np.eye(size), np.zeros((n, d, d)), np.zeros((n, d, size))
    H_cc += damping * np.eye(d)
    for number, length in enumerate(lengths):  # what a smaller group does not need
        rest = np.arange(length, d)
        H_cc[number, rest, rest] = 1.0
    for factor, own in zip(factors, keys, strict=True):
        _add(factor.information(), [place[key] for key in own], H_ss, H_cc, H_cs)
    alone = _inverse(H_cc, place, 0)
    X = alone @ H_cs
    S = H_ss - H_cs.reshape(n * d, size).T @ X.reshape(n * d, size)
    return Covariances(place, _inverse(S[None], place, -1)[0], X, alone)


def marginals_of(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, shared: Collection[int]) -> Marginals:
    """Covariances of all values; where the graph leaves some undetermined, with a weak prior on each.

    Raises:
        SolverError: Even with the prior, some value is not determined.
    """
    linear, dims = graph.linearize(values), dimensions(values)
    for weak in (0.0, WEAK_PRIOR**-2):
        try:
            found = covariances(linear, dims, shared, damping=weak)
            return found if found is not None else _Gtsam(gtsam.Marginals(damped(linear, values, weak), values))
        except (RuntimeError, SingularError) as error:
            undetermined = error
    what = str(undetermined).partition("Symbol: ")[2].partition(")")[0]
    raise SolverError(f"the sightings do not determine every pose of the graph (near {what})") from undetermined


@dataclass(frozen=True, eq=False)
class _Gtsam:
    """Covariances by GTSAM."""

    marginals: gtsam.Marginals

    def joint(self, keys: list[int]) -> NDArray[np.float64]:
        if len(keys) == 1:
            return np.asarray(self.marginals.marginalCovariance(keys[0]))
        joint = self.marginals.jointMarginalCovariance(keys)
        return np.block([[joint.at(one, other) for other in keys] for one in keys])


def _places(
    dims: dict[int, int], shared: Collection[int], factors: list[list[int]]
) -> tuple[dict[int, tuple[int, int, int]], list[int], int]:
    """`Covariances.place`, the length of each group, and that of what is shared."""
    place: dict[int, tuple[int, int, int]] = {}
    lengths = []
    groups = _groups([key for key in dims if key not in shared], factors)
    for number, members in [(-1, [key for key in dims if key in shared]), *enumerate(groups)]:
        at = 0
        for key in members:
            place[key] = (number, at, at + dims[key])
            at += dims[key]
        lengths.append(at)
    return place, lengths[1:], lengths[0]


def _inverse(H: Array, place: dict[int, tuple[int, int, int]], first: int) -> Array:
    """The inverses of symmetric matrices (m, d, d), which belong to the groups from `first` on."""
    if not H.size:
        return H
    scale = np.sqrt(np.maximum(np.diagonal(H, axis1=1, axis2=2), np.finfo(float).tiny))
    scaled = H / (scale[:, :, None] * scale[:, None, :])
    least, along = np.linalg.eigh(0.5 * (scaled + np.swapaxes(scaled, 1, 2)))
    worst = int(np.argmin(least[:, 0]))
    if not least[worst, 0] > LEAST_EIGENVALUE:
        at = int(np.argmax(np.abs(along[worst, :, 0])))
        raise SingularError(next(key for key, (g, a, b) in place.items() if g == first + worst and a <= at < b))
    inverse = (along / least[:, None, :]) @ np.swapaxes(along, 1, 2)
    return np.asarray(inverse / (scale[:, :, None] * scale[:, None, :]))


def _groups(own: list[int], factors: list[list[int]]) -> list[list[int]]:
    """The variables that are no shared ones, by which of them factors connect."""
    if not own:
        return []
    number = {key: i for i, key in enumerate(own)}
    chains = ([number[key] for key in keys if key in number] for keys in factors)
    ends = np.array([pair for chain in chains for pair in itertools.pairwise(chain)], dtype=np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(len(own), len(own)))
    groups: dict[int, list[int]] = {}
    for key, label in zip(own, connected_components(graph, directed=False)[1].tolist(), strict=True):
        groups.setdefault(label, []).append(key)
    return list(groups.values())


def _add(information: Array, places: list[tuple[int, int, int]], H_ss: Array, H_cc: Array, H_cs: Array) -> None:
    """Add a factor's information AᵀA to the blocks."""
    first = np.cumsum([0, *(b - a for _, a, b in places)])
    number = np.repeat([group for group, _, _ in places], np.diff(first))
    index = np.concatenate([np.arange(a, b) for _, a, b in places])
    is_shared = number < 0
    s, own = index[is_shared], index[~is_shared]
    H_ss[s[:, None], s] += information[np.ix_(is_shared, is_shared)]
    if len(own):
        group = number.max()
        H_cc[group, own[:, None], own] += information[np.ix_(~is_shared, ~is_shared)]
        H_cs[group, own[:, None], s] += information[np.ix_(~is_shared, is_shared)]
