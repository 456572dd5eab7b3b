"""The stage that minimises open-loop prediction error by Levenberg-Marquardt.

Prediction error is what a user wants small, but its gradient through contact is noisy. It depends on few parameters
(friction, contact law, inertia), so the Jacobian is taken by differences of whole rollouts to both sides. Of many
tosses of a rigid body they go to one side, ahead for every second toss and back for the others: the error of second
order then has no sign in the sum over tosses.

Where contact yields, the last stage goes on when single steps gain nothing any more. Long rollouts are rough, and each
Gauss-Newton step from nearly the same place ends elsewhere, by as much as the tosses leave open. The minimum of the sum
of their quadratics, later ones counting more, does not. Where contact is rigid, few rollouts jump, and lead away.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from math import log
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from tossid.least_squares import Damping, damped_step, search_damping
from tossid.models.predictor import Predictor, Simulator
from tossid.models.protocol import Coefficient, DynamicsModel, StagePlan
from tossid.models.shots import Shots, prediction_errors
from tossid.parallel import in_threads
from tossid.settings.training import RestartSettings, RolloutSettings
from tossid.training.gauss_newton import Averaged, GaussNewton
from tossid.training.losses import Pass

Array = NDArray[np.float64]

SCHEDULE, LEAST_DAMPING = Damping(grow=5.0, fall=0.2), 1e-4
"""Damping after steps that lower the loss, not below the least, and after steps that do not."""
LEAST_ERROR = 1e-4
"""Standard error of a parameter, in its own unit of order one, below which no step needs to be shorter."""
DIVERGED = 1e6
"""Squared error of a frame whose prediction is not finite."""


class RolloutStage:
    """Minimises the pseudo-Huber prediction error of open-loop rollouts.

        loss = mean over frames of d² (sqrt(1 + |error|² / d²) - 1),   d = settings.huber

    `shots.prediction_errors` has the error. After contact, predictions grow chaotic: frames whose derivatives
    are among the largest, as they are where a step is taken, count neither in the step nor in whether it is accepted.
    With them the loss is rough, and steps ended at the nearest of its many minima.

    Args:
        plan: What is learned.
        model: Changed in place.
        make_shots: Training and validation shots for the model as it is. Called every epoch, as the first state that
            a flight gives depends on the centre of mass.
        settings: Steps, differences, limits.
        restarts: Values of friction that are compared with its present one.
        settles: Whether to go on by averaged steps, where contact yields.
        n_threads: For rollouts.

    Attributes:
        friction_restarted: Whether another friction was clearly better when the stage began.
        central: Whether differences go to both sides: they do with few tosses, and with joints.
    """

    def __init__(
        self,
        plan: StagePlan,
        model: DynamicsModel,
        make_shots: Callable[[], tuple[Shots, Shots]],
        settings: RolloutSettings,
        *,
        restarts: RestartSettings | None = None,
        settles: bool = False,
        n_threads: int = 1,
    ) -> None:
        self.name, self.epochs = plan.name, settings.epochs
        self._plan, self._model, self._settings = plan, model, settings
        self._make_shots = make_shots
        self._train, self._validation = make_shots()
        self._n_threads = n_threads
        self._damping, self._settles = settings.damping, settles
        self._averaged: Averaged | None = None
        self._relaxed = False
        self._shares = self._train.in_shares(settings.raced_tosses)
        self.central = len(self._shares) == 1 or model.object.n_joints > 0
        self._restarts = restarts or RestartSettings()
        self.friction_restarted = False

    def begin(self) -> None:
        """Choose where the contact law and friction start, where they are learned.

        Of a rival, contact is rigid, and friction stays. Otherwise contact is rigid unless a softer start is clearly
        better, and friction stays unless another value is: near zero and far above the slope of flight paths, rollouts
        no longer depend on it.
        """
        self._begin_contact_law()
        friction = self._plan.friction
        if friction is None or not self._restarts.frictions:
            return
        x, now = self._get(), float(friction().detach())
        values = [now, *self._restarts.frictions]
        losses = self._compared(friction.move, values)
        best = int(np.argmin(losses))
        self.friction_restarted = losses[best] < self._restarts.better_share * losses[0]
        self.set_parameters(x)
        if self.friction_restarted:
            friction.move(values[best])

    def loss_with(self, friction: Coefficient, mu: float) -> float:
        """Loss of the training shots with another friction, which the model then has.

        Args:
            friction: The model's.
            mu: Its value.
        """
        friction.move(mu)
        return self._loss(self._errors(self._train), self._train)

    def _compared(self, put: Callable[[Any], None], values: Sequence[Any]) -> list[float]:
        """Losses of the training shots with each value; infinite where a share of the tosses shows that it is worse.

        Values race over growing shares of the tosses. One drops out where the mean of the tosses' losses, less those
        with the value that is best so far, is above zero by so many standard errors (Maron and Moore 1994, with paired
        differences). The first value's loss is computed in any case.

        Args:
            put: Puts a value into the model.
            values: To compare.
        """
        sums: list[list[Array]] = [[] for _ in values]
        left = list(range(len(values)))
        for shots in self._shares:
            for i in left:
                put(values[i])
                sums[i].append(self._sums_by_toss(self._errors(shots), shots))
            so_far = {i: np.concatenate(sums[i]) for i in left}
            best = min(left, key=lambda i: so_far[i].sum())
            left = [i for i in left if i == 0 or not self._is_worse(so_far[i] - so_far[best])]
        frames = self._train.inside.sum()
        return [float(so_far[i].sum() / frames) if i in left else float("inf") for i in range(len(values))]

    def _is_worse(self, behind: Array) -> bool:
        """Whether losses of tosses (n,) less those with another value are above zero, beyond their scatter."""
        scatter = behind.std(ddof=1) if len(behind) > 1 else np.inf
        return bool(behind.mean() > self._settings.race_margin * scatter / np.sqrt(len(behind)))

    def _begin_contact_law(self) -> None:
        law, settings = self._plan.starts, self._settings
        if law is None:
            return
        grid = law.starts(settings.contact_times_ms, settings.dampings, simulator_step_ms=settings.simulator_step_ms)
        soft = [law.value.detach().clone(), *grid]
        starts = [law.rigid()] + [start for start in soft if start[0] > log(settings.rigid_time_ms)]

        def put(start: torch.Tensor) -> None:
            with torch.no_grad():
                law.value.copy_(start)

        if self._plan.rival:
            put(law.rigid())
            return
        losses = self._compared(put, starts)
        best = int(np.argmin(losses))
        put(starts[best if losses[best] < settings.softer_share * losses[0] else 0])

    def step(self) -> Pass:
        """One step of Levenberg-Marquardt.

        `done` when it gains little, when no damping makes it better, and when these rollouts depend on no parameter.
        """
        self._train, self._validation = self._make_shots()
        x = self._get()
        errors = self._errors(self._train)
        loss = self._loss(errors, self._train)
        sums = self.gauss_newton(errors, central=self.central)
        passes, done = (2 if self.central else 1) * len(x) + 1, True
        if sums.H.any():  # rollouts that never land, as gravity is given too weak, depend on nothing
            loss, trials, done = self._try(sums, errors) if self._averaged is None else self._settle(sums)
            passes += trials
            if done and self._averaged is None and self._settles and self._yields():
                self._averaged, done = Averaged(0 * sums.H[0], 0 * x), False
        return Pass(loss, self.validation_loss(), {"prediction": loss}, passes, done)

    def validation_loss(self) -> float:
        """The loss of validation shots."""
        return self._loss(self._errors(self._validation), self._validation)

    def losses_by_toss(self) -> tuple[Array, Array]:
        """Parts of the losses of training and of validation shots (n_tosses,), from first states as they are now."""
        self._train, self._validation = self._make_shots()
        train, validation = (
            self._sums_by_toss(self._errors(shots), shots) / shots.inside.sum()
            for shots in (self._train, self._validation)
        )
        return train, validation

    def clearly_better(self, rival: tuple[Array, Array]) -> bool:
        """Whether validation tosses are predicted clearly better than by a rival.

        They are where their losses are lower beyond their scatter. Few tosses scatter too much for that: there, the
        loss has to be lower by the share by which another friction has to be better, and the losses of training and
        validation tosses together beyond their scatter.

        Args:
            rival: Its `losses_by_toss`.
        """
        train, validation = self.losses_by_toss()
        if self._is_worse(rival[1] - validation):
            return True
        by_share = validation.sum() < self._restarts.better_share * rival[1].sum()
        return bool(by_share) and self._is_worse(np.concatenate(rival) - np.concatenate([train, validation]))

    def _try(self, sums: GaussNewton, errors: Array) -> tuple[float, int, bool]:
        """Steps with growing damping until one lowers the loss of calm frames.

        Returns:
            The loss of all frames, how many steps were tried, and whether the stage is done.
        """
        settings, x, H, g, trials = self._settings, sums.x, sums.H.sum(0), sums.g.sum(0), 0
        scale = np.diag(H) + 1e-6 * np.trace(H) / len(x)
        before = self._loss(errors, self._train, sums.calm)

        def attempt(damping: float) -> Array | None:
            nonlocal trials
            trials += 1
            step = damped_step(H, g, damping, scale)
            self.set_parameters(x + np.clip(step, -settings.largest_step, settings.largest_step))
            now = self._errors(self._train)
            return now if self._loss(now, self._train, sums.calm) < before else None

        after, damping = search_damping(attempt, self._damping, SCHEDULE, trials=settings.trials)
        if after is None:
            self.set_parameters(x)
            self._damping = settings.damping
            return self._loss(errors, self._train), trials, True
        self._damping = max(SCHEDULE.accepted(damping), LEAST_DAMPING)
        gain = before - self._loss(after, self._train, sums.calm)
        return self._loss(after, self._train), trials, gain < settings.least_gain * before

    def _yields(self) -> bool:
        """Whether a contact law is learned that is not as good as rigid."""
        law = self._plan.starts
        return law is not None and float(law.value.detach()[0]) > log(self._settings.rigid_time_ms)

    def _settle(self, sums: GaussNewton) -> tuple[float, int, bool]:
        """To the minimum of the sum of the quadratics so far, the k-th of which counts k times.

        Returns:
            As of `_try`; done where the step is short beside what the tosses leave open.
        """
        settings, averaged, H = self._settings, self._averaged, sums.H.sum(0)
        assert averaged is not None
        averaged = self._averaged = averaged.with_quadratic(H, H @ sums.x - sums.g.sum(0))
        ridge = 1e-6 * np.trace(averaged.H) / len(H) * np.eye(len(H))
        step = np.linalg.solve(averaged.H + ridge, averaged.b - averaged.H @ sums.x)
        self.set_parameters(sums.x + np.clip(step, -settings.largest_step, settings.largest_step))
        standard_errors = np.linalg.norm(sums.g @ np.linalg.inv(H + ridge), axis=0)  # the toss is the unit
        short = np.sqrt(np.mean((step / np.maximum(standard_errors, LEAST_ERROR)) ** 2)) < settings.settled
        most = settings.settling if self.central else settings.settling_many
        done = bool(short) or averaged.count >= most
        return self._loss(self._errors(self._train), self._train), 1, done

    def gauss_newton(self, errors: Array | None = None, *, central: bool = True) -> GaussNewton:
        """Gauss-Newton's sums at the present parameters, toss by toss.

        Args:
            errors: Of the training shots, where they are known.
            central: Whether to take differences to both sides; if not, they go ahead for every second toss and back for
                the others, which costs half as many rollouts.
        """
        settings, x, shots = self._settings, self._get(), self._train
        errors, by = self._errors(shots) if errors is None else errors, settings.difference
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
        calm = shots.inside & (size <= np.quantile(size[shots.inside], 1 - settings.chaotic_share))
        weight = calm / np.sqrt(1 + (errors**2).sum(-1) / settings.huber**2) / shots.inside.sum()
        rows, w = J.reshape(len(J), -1, len(x)), np.repeat(weight, errors.shape[-1], axis=1)[..., None]
        n = int(shots.toss.max()) + 1
        H, g = np.zeros((n, len(x), len(x))), np.zeros((n, len(x)))
        np.add.at(H, shots.toss, (rows * w).mT @ rows)
        np.add.at(g, shots.toss, np.squeeze(rows.mT @ (w * errors.reshape(*w.shape)), -1))
        return GaussNewton(H, g, x, calm)

    def with_relaxed_contact(self) -> RolloutStage | None:
        """This stage, its rollouts by the convex relaxation of Coulomb's law; None where they cannot have it."""
        if not isinstance(simulator := self._model.simulator(), Simulator) or simulator.relaxed() is None:
            return None
        other = copy.copy(self)
        other._relaxed = True
        return other

    def training_losses(self) -> Array:
        """(n_tosses,) sums of the loss over the frames of each training toss, at the present parameters."""
        return self._sums_by_toss(self._errors(self._train), self._train)

    def set_parameters(self, x: Array) -> None:
        """Put parameters into the model.

        Args:
            x: (P,), flat.
        """
        with torch.no_grad():
            values = torch.from_numpy(np.ascontiguousarray(x)).clone()
            nn.utils.vector_to_parameters(values, self._plan.parameters)

    def _get(self) -> Array:
        return nn.utils.parameters_to_vector(self._plan.parameters).detach().numpy().copy()

    def _simulator(self) -> Predictor:
        now = self._model.simulator()
        return now.relaxed() or now if self._relaxed and isinstance(now, Simulator) else now

    def _moved(self, x: Array, j: int, by: float) -> Predictor:
        """The simulator with parameter j changed."""
        changed = x.copy()
        changed[j] += by
        self.set_parameters(changed)
        return self._simulator()

    def _errors(self, shots: Shots) -> Array:
        return prediction_errors(self._simulator(), shots, n_threads=self._n_threads)

    def _loss(self, errors: Array, shots: Shots, counted: NDArray[np.bool_] | None = None) -> float:
        return float(self._loss_by_frame(errors, counted).sum() / shots.inside.sum())

    def _sums_by_toss(self, errors: Array, shots: Shots) -> Array:
        """(n_tosses,) sums of the loss over the frames of each toss that has shots."""
        sums = self._loss_by_frame(errors).sum(axis=1)
        return np.asarray(np.bincount(np.unique(shots.toss, return_inverse=True)[1], weights=sums), dtype=float)

    def _loss_by_frame(self, errors: Array, counted: NDArray[np.bool_] | None = None) -> Array:
        d = self._settings.huber
        size = np.where(np.isfinite(errors).all(-1), (errors**2).sum(-1), DIVERGED)
        size = size if counted is None else np.where(counted, size, 0.0)
        return np.asarray(d**2 * (np.sqrt(1 + size / d**2) - 1))

    def state_dict(self) -> dict[str, Any]:
        """The damping and the averaged quadratics."""
        average = self._averaged
        summed = None if average is None else [average.H.tolist(), average.b.tolist(), average.count]
        return {"damping": self._damping, "averaged": summed}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state_dict()` of an equal stage."""
        self._damping = float(state["damping"])
        if state["averaged"] is not None:
            H, b, count = state["averaged"]
            self._averaged = Averaged(np.array(H), np.array(b), count)
