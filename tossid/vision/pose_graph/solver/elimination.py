"""Covariances of a linear factor graph by block elimination (Schur complement).

A pose graph of a recording has two kinds of variables: those of what is static, which all time steps share, and those
of one time step, which meet those of another step only through what is shared. With H the Gauss-Newton Hessian, s the
shared variables and c those of one step (a "group"),

    S = H_ss - Σ_c H_sc H_cc⁻¹ H_cs,    Σ_ss = S⁻¹,    Σ_cc = H_cc⁻¹ + X_c Σ_ss X_cᵀ,    X_c = H_cc⁻¹ H_cs

so that all covariances take a time in proportion to the number of groups (Triggs et al., "Bundle adjustment: a modern
synthesis", 2000, section 6.1). GTSAM's covariances of single variables eliminate all shared ones anew for each.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LARGEST_GROUP = 60
"""Numbers that a group may have; larger ones (steps that stillness connects) are left to GTSAM."""
LEAST_EIGENVALUE = 1e-13
"""Of a Hessian that is scaled to a unit diagonal: a smaller one counts as zero."""


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
        """The joint covariance of some variables of one group, or of some shared ones.

        Args:
            keys: Of the variables.
        """
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

    Args:
        linear: The factors.
        dims: Of each variable's key, how many numbers it has.
        shared: Keys of the variables that more than one group may meet.
        damping: Inverse variance of a prior on every number.

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
    parent = {key: key for key in own}

    def root(key: int) -> int:
        while parent[key] != key:
            parent[key] = parent[parent[key]]
            key = parent[key]
        return key

    for keys in factors:
        mine = [key for key in keys if key in parent]
        for key in mine[1:]:
            parent[root(key)] = root(mine[0])
    groups: dict[int, list[int]] = {}
    for key in own:
        groups.setdefault(root(key), []).append(key)
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
