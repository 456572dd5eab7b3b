"""Open-loop prediction error as a function of a few parameters of a model, with Gauss-Newton's sums by toss.

Its gradient through contact is noisy, and it depends on few parameters (friction, contact law, inertia). So the
Jacobian is taken by differences of whole rollouts to both sides. Of many tosses of a rigid body they go to one side,
ahead for every second toss and back for the others: the error of second order then has no sign in the sum over tosses.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from tossid.models.predictor import Predictor, Simulator
from tossid.models.protocol import DynamicsModel
from tossid.models.shots import Shots, prediction_errors
from tossid.parallel import in_threads

Array = NDArray[np.float64]

HUBER = 0.1
"""Error up to which the pseudo-Huber loss is quadratic [half widths, rad]."""
DIFFERENCE = 0.015
"""Step of the differences, in the parameters' own units of order one."""
CHAOTIC_SHARE = 0.2
"""Share of the frames, those with the largest derivatives, that neither make a step nor judge it."""
RACED_TOSSES = 60
"""Where there are twice as many tosses, starts of the contact law and of friction are first compared on so many of them
and then on more, and steps take differences to one side unless there are joints."""
DIVERGED = 1e6
"""Squared error of a frame whose prediction is not finite."""
RACE_MARGIN = 2.0
"""Standard errors by which a value must be worse than the best one on a share of the tosses to drop out of a race."""


class GaussNewton(NamedTuple):
    """Gauss-Newton's sums, toss by toss.

    Attributes:
        H: (n_tosses, P, P) weighted J^T J.
        g: (n_tosses, P) weighted J^T error.
        x: (P,) parameters at which they were taken.
        calm: (S, L) marks the frames that count in them.
    """

    H: Array
    g: Array
    x: Array
    calm: NDArray[np.bool_]


class PredictionError:
    """The pseudo-Huber error of open-loop rollouts.

        loss = mean over frames of d² (sqrt(1 + |error|² / d²) - 1),   d = `HUBER`

    `models.shots.prediction_errors` has the error. After contact, predictions grow chaotic: frames whose derivatives
    are among the largest do not count in Gauss-Newton's sums. With them the loss is rough, and steps end at the nearest
    of its many minima.

    Args:
        model: Its parameters are changed in place.
        parameters: That the error is a function of.
        make_shots: Training and validation shots for the model as it is.
        n_threads: For rollouts.

    Attributes:
        train: Shots of training tosses.
        validation: Shots of validation tosses.
        central: Whether differences go to both sides, which costs twice as many rollouts: they do with few tosses, and
            with joints.
    """

    def __init__(
        self,
        model: DynamicsModel,
        parameters: Sequence[nn.Parameter],
        make_shots: Callable[[], tuple[Shots, Shots]],
        *,
        n_threads: int = 1,
    ) -> None:
        self._model, self._parameters, self._make_shots = model, parameters, make_shots
        self._n_threads, self._relaxed = n_threads, False
        self.train, self.validation = make_shots()
        self._shares = self.train.in_shares(RACED_TOSSES)
        self.central = len(self._shares) == 1 or model.object.n_joints > 0

    def renew_shots(self) -> None:
        """Take first states anew: those that flights give depend on the centre of mass."""
        self.train, self.validation = self._make_shots()

    def parameters(self) -> Array:
        """The present parameters, flat (P,)."""
        return nn.utils.parameters_to_vector(self._parameters).detach().numpy().copy()

    def set_parameters(self, x: Array) -> None:
        """Put parameters into the model.

        Args:
            x: (P,), flat.
        """
        with torch.no_grad():
            values = torch.from_numpy(np.ascontiguousarray(x)).clone()
            nn.utils.vector_to_parameters(values, self._parameters)

    def errors(self, shots: Shots) -> Array:
        """Errors of predictions (S, L, nv) with the present parameters."""
        return prediction_errors(self._simulator(), shots, n_threads=self._n_threads)

    def loss(self, errors: Array, shots: Shots, counted: NDArray[np.bool_] | None = None) -> float:
        """The mean loss over the frames of shots.

        Args:
            errors: Of the shots.
            shots: The shots.
            counted: (S, L) marks the frames that are not left out; None for all.
        """
        return float(self._loss_by_frame(errors, counted).sum() / shots.inside.sum())

    def training_loss(self) -> float:
        """The loss of training shots at the present parameters."""
        return self.loss(self.errors(self.train), self.train)

    def validation_loss(self) -> float:
        """The loss of validation shots at the present parameters."""
        return self.loss(self.errors(self.validation), self.validation)

    def training_losses(self) -> Array:
        """(n_tosses,) sums of the loss over the frames of each training toss, at the present parameters."""
        return self._losses_by_toss(self.train)

    def mean_losses(self) -> tuple[Array, Array]:
        """Parts of the losses of training and of validation shots by toss (n_tosses,), with first states taken anew."""
        self.renew_shots()
        train, validation = (
            self._losses_by_toss(shots) / shots.inside.sum() for shots in (self.train, self.validation)
        )
        return train, validation

    def compare(self, put: Callable[[Any], None], values: Sequence[Any]) -> list[float]:
        """Losses of the training shots with each value; infinite where a share of the tosses shows that it is worse.

        Values race over growing shares of the tosses. One drops out where the mean of the tosses' losses, less those
        with the value that is best so far, is above zero by `RACE_MARGIN` standard errors (Maron and Moore 1994, with
        paired differences). The first value's loss is computed in any case.

        Args:
            put: Puts a value into the model.
            values: To compare.
        """
        sums: list[list[Array]] = [[] for _ in values]
        left = list(range(len(values)))
        for shots in self._shares:
            for i in left:
                put(values[i])
                sums[i].append(self._losses_by_toss(shots))
            so_far = {i: np.concatenate(sums[i]) for i in left}
            best = min(left, key=lambda i: so_far[i].sum())
            left = [i for i in left if i == 0 or not is_worse(so_far[i] - so_far[best])]
        frames = self.train.inside.sum()
        return [float(so_far[i].sum() / frames) if i in left else float("inf") for i in range(len(values))]

    def gauss_newton(self, errors: Array | None = None) -> GaussNewton:
        """Gauss-Newton's sums at the present parameters, toss by toss.

        Args:
            errors: Of the training shots, where they are known.
        """
        x, shots, central, by = self.parameters(), self.train, self.central, DIFFERENCE
        errors = self.errors(shots) if errors is None else errors
        J, odd = np.empty((*errors.shape, len(x))), shots.toss % 2 == 1
        every = np.full(len(odd), True)
        chosen = [(every, 1), (every, -1)] if central else [(~odd, 1), (odd, -1)]
        parts = [(which, shots if central else shots.chosen(which), sign) for which, sign in chosen if which.any()]
        moves = [(*part, j) for part in parts for j in range(len(x))]
        simulators = [self._moved(x, j, sign * by) for _, _, sign, j in moves]
        self.set_parameters(x)
        found = in_threads(lambda k: prediction_errors(simulators[k], moves[k][1]), range(len(moves)), self._n_threads)
        for (which, _, sign, j), moved in zip(moves, found, strict=True):
            T = moved.shape[1]
            if central:
                J[..., j] = moved if sign > 0 else (J[..., j] - moved) / (2 * by)
            else:
                J[which, :T, :, j] = (moved - errors[which, :T]) / (sign * by)
                J[which, T:, :, j] = 0.0
        size = np.einsum("slip,slip->sl", J, J)
        calm = shots.inside & (size <= np.quantile(size[shots.inside], 1 - CHAOTIC_SHARE))
        # the pseudo-Huber loss's weight of a frame, 1 / sqrt(1 + |e|²/d²)
        weight = calm / np.sqrt(1 + (errors**2).sum(-1) / HUBER**2) / shots.inside.sum()
        rows, w = J.reshape(len(J), -1, len(x)), np.repeat(weight, errors.shape[-1], axis=1)[..., None]
        n = int(shots.toss.max()) + 1
        H, g = np.zeros((n, len(x), len(x))), np.zeros((n, len(x)))
        np.add.at(H, shots.toss, (rows * w).mT @ rows)
        np.add.at(g, shots.toss, np.squeeze(rows.mT @ (w * errors.reshape(*w.shape)), -1))
        return GaussNewton(H, g, x, calm)

    def with_relaxed_contact(self) -> PredictionError | None:
        """The same, its rollouts by the convex relaxation of Coulomb's law; None where they cannot have it."""
        if not isinstance(simulator := self._model.simulator(), Simulator) or simulator.relaxed() is None:
            return None
        other = copy.copy(self)
        other._relaxed = True
        return other

    def _simulator(self) -> Predictor:
        now = self._model.simulator()
        return now.relaxed() or now if self._relaxed and isinstance(now, Simulator) else now

    def _moved(self, x: Array, j: int, by: float) -> Predictor:
        """The simulator with parameter j changed."""
        changed = x.copy()
        changed[j] += by
        self.set_parameters(changed)
        return self._simulator()

    def _losses_by_toss(self, shots: Shots) -> Array:
        """(n_tosses,) sums of the loss over the frames of each toss that has shots."""
        sums = self._loss_by_frame(self.errors(shots)).sum(axis=1)
        return np.asarray(np.bincount(np.unique(shots.toss, return_inverse=True)[1], weights=sums), dtype=float)

    def _loss_by_frame(self, errors: Array, counted: NDArray[np.bool_] | None = None) -> Array:
        size = np.where(np.isfinite(errors).all(-1), (errors**2).sum(-1), DIVERGED)
        size = size if counted is None else np.where(counted, size, 0.0)
        return np.asarray(HUBER**2 * (np.sqrt(1 + size / HUBER**2) - 1))


def is_worse(behind: Array) -> bool:
    """Whether losses of tosses less those with another value are above zero, beyond their scatter.

    Args:
        behind: (n_tosses,) differences.
    """
    scatter = behind.std(ddof=1) if len(behind) > 1 else np.inf
    return bool(behind.mean() > RACE_MARGIN * scatter / np.sqrt(len(behind)))
