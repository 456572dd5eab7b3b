"""The stage that minimises open-loop prediction error by Levenberg-Marquardt.

Where contact yields, the last stage goes on when single steps gain nothing any more. Long rollouts are rough, and each
Gauss-Newton step from nearly the same place ends elsewhere, by as much as the tosses leave open. The minimum of the sum
of their quadratics, later ones counting more, does not (averaged iterates, Polyak and Juditsky 1992). Where contact is
rigid, few rollouts jump, and lead away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.least_squares import Damping, damped_step, search_damping
from tossid.models.protocol import StagePlan
from tossid.training.losses import Pass
from tossid.training.prediction import GaussNewton, PredictionError, is_worse

Array = NDArray[np.float64]

SCHEDULE, FIRST_DAMPING, LEAST_DAMPING = Damping(grow=5.0, fall=0.2), 1e-2, 1e-4
"""Damping relative to the diagonal: after steps that lower the loss and that do not, at first, and at least."""
TRIALS = 10
"""Dampings that a step tries before the stage ends."""
LARGEST_STEP = 0.3
"""Largest change of a parameter in one step, in its own unit of order one."""
LEAST_ERROR = 1e-4
"""Standard error of a parameter, in its own unit, below which no step needs to be shorter."""
LEAST_GAIN = 2e-3
"""Relative gain of a step below which the stage ends."""
SETTLING, SETTLING_MANY = 6, 4
"""Most averaged steps; fewer of many tosses, whose differences go to one side: what is left open is less."""
SETTLED = 0.15
"""Averaged step below which the stage ends, in standard errors (rms over the parameters)."""
FRICTIONS = (0.05, 0.15, 0.4, 1.0)
"""Values of friction that are compared with the present one: near zero and far above the slope of flight paths,
rollouts no longer depend on it."""
BETTER_SHARE = 0.8
"""Share of the present loss that another friction must stay below to be preferred."""
SOFTER_SHARE = 0.97
"""Share of rigid contact's loss that a softer start must stay below to be preferred: what a softer contact gains at a
wrong inertia is the inertia's, and that is 2 % at most for simulated tosses of rigid contact."""


@dataclass(frozen=True)
class AveragedQuadratics:
    """The sum of quadratics x^T H x / 2 - b^T x, the k-th weighted with k.

    Attributes:
        H: (P, P).
        b: (P,).
        count: How many.
    """

    H: Array
    b: Array
    count: int = 0

    def with_quadratic(self, H: Array, b: Array) -> AveragedQuadratics:
        """The sum with one more.

        Args:
            H: (P, P) of it.
            b: (P,) of it.
        """
        k = self.count + 1
        return AveragedQuadratics(self.H + k * H, self.b + k * b, k)


class RolloutStage:
    """Minimises the error of open-loop rollouts.

    Args:
        plan: What is learned.
        prediction: The error as a function of it.
        epochs: Most steps.
        settles: Whether to go on by averaged steps, where contact yields.

    Attributes:
        friction_restarted: Whether another friction was clearly better when the stage began.
    """

    def __init__(self, plan: StagePlan, prediction: PredictionError, epochs: int, *, settles: bool = False) -> None:
        self.name, self.epochs = plan.name, epochs
        self.prediction = prediction
        self._plan, self._settles = plan, settles
        self._damping = FIRST_DAMPING
        self._averaged: AveragedQuadratics | None = None
        self.friction_restarted = False

    def begin(self) -> None:
        """Choose where the contact law and friction start, where they are learned.

        Of a rival, contact is rigid, and friction stays. Otherwise contact is rigid unless a softer start is clearly
        better, and friction stays unless another value is.
        """
        law, friction, compare = self._plan.contact_law, self._plan.friction, self.prediction.compare
        if law is not None and self._plan.rival:
            law.move(law.rigid())
        elif law is not None:
            starts = [law.rigid(), *law.soft_starts()]
            losses = compare(law.move, starts)
            best = int(np.argmin(losses))
            law.move(starts[best if losses[best] < SOFTER_SHARE * losses[0] else 0])
        if friction is not None:
            x, values = self.prediction.parameters(), [float(friction().detach()), *FRICTIONS]
            losses = compare(friction.move, values)
            best = int(np.argmin(losses))
            self.friction_restarted = losses[best] < BETTER_SHARE * losses[0]
            self.prediction.set_parameters(x)
            if self.friction_restarted:
                friction.move(values[best])

    def step(self) -> Pass:
        """One step of Levenberg-Marquardt.

        `done` when it gains little, when no damping makes it better, and when these rollouts depend on no parameter.
        """
        prediction, law = self.prediction, self._plan.contact_law
        prediction.renew_shots()
        errors = prediction.errors(prediction.train)
        loss = prediction.loss(errors, prediction.train)
        sums = prediction.gauss_newton(errors)
        passes, done = (2 if prediction.central else 1) * len(sums.x) + 1, True
        if sums.H.any():  # rollouts that never land, as gravity is given too weak, depend on nothing
            loss, trials, done = self._damped(sums, errors) if self._averaged is None else self._settle(sums)
            passes += trials
            if done and self._averaged is None and self._settles and law is not None and law.yields:
                self._averaged, done = AveragedQuadratics(0 * sums.H[0], 0 * sums.x), False
        return Pass(loss, self.validation_loss(), {"prediction": loss}, passes, done)

    def validation_loss(self) -> float:
        """The loss of validation shots."""
        return self.prediction.validation_loss()

    def _damped(self, sums: GaussNewton, errors: Array) -> tuple[float, int, bool]:
        """Steps with growing damping until one lowers the loss of calm frames.

        Returns:
            The loss of all frames, how many steps were tried, and whether the stage is done.
        """
        prediction, x, H, g, trials = self.prediction, sums.x, sums.H.sum(0), sums.g.sum(0), 0
        scale = np.diag(H) + 1e-6 * np.trace(H) / len(x)
        before = prediction.loss(errors, prediction.train, sums.calm)

        def attempt(damping: float) -> Array | None:
            nonlocal trials
            trials += 1
            step = damped_step(H, g, damping, scale)
            prediction.set_parameters(x + np.clip(step, -LARGEST_STEP, LARGEST_STEP))
            now = prediction.errors(prediction.train)
            return now if prediction.loss(now, prediction.train, sums.calm) < before else None

        after, damping = search_damping(attempt, self._damping, SCHEDULE, trials=TRIALS)
        if after is None:
            prediction.set_parameters(x)
            self._damping = FIRST_DAMPING
            return prediction.loss(errors, prediction.train), trials, True
        self._damping = max(SCHEDULE.accepted(damping), LEAST_DAMPING)
        gain = before - prediction.loss(after, prediction.train, sums.calm)
        return prediction.loss(after, prediction.train), trials, gain < LEAST_GAIN * before

    def _settle(self, sums: GaussNewton) -> tuple[float, int, bool]:
        """To the minimum of the sum of the quadratics so far, the k-th of which counts k times.

        Returns:
            As of `_damped`; done where the step is short beside what the tosses leave open.
        """
        averaged, H = self._averaged, sums.H.sum(0)
        assert averaged is not None
        averaged = self._averaged = averaged.with_quadratic(H, H @ sums.x - sums.g.sum(0))
        ridge = 1e-6 * np.trace(averaged.H) / len(H) * np.eye(len(H))
        step = np.linalg.solve(averaged.H + ridge, averaged.b - averaged.H @ sums.x)
        self.prediction.set_parameters(sums.x + np.clip(step, -LARGEST_STEP, LARGEST_STEP))
        standard_errors = np.linalg.norm(sums.g @ np.linalg.inv(H + ridge), axis=0)  # the toss is the unit
        short = np.sqrt(np.mean((step / np.maximum(standard_errors, LEAST_ERROR)) ** 2)) < SETTLED
        most = SETTLING if self.prediction.central else SETTLING_MANY
        return self.prediction.training_loss(), 1, bool(short) or averaged.count >= most

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
            self._averaged = AveragedQuadratics(np.array(H), np.array(b), count)


def clearly_better(losses: tuple[Array, Array], rival: tuple[Array, Array]) -> bool:
    """Whether validation tosses are predicted clearly better than by a rival.

    They are where their losses are lower beyond their scatter. Few tosses scatter too much for that: there, the loss
    has to be lower by the share by which another friction has to be better, and the losses of training and validation
    tosses together beyond their scatter.

    Args:
        losses: Of training and of validation tosses, `PredictionError.mean_losses`.
        rival: The same of the rival.
    """
    if is_worse(rival[1] - losses[1]):
        return True
    by_share = losses[1].sum() < BETTER_SHARE * rival[1].sum()
    return bool(by_share) and is_worse(np.concatenate(rival) - np.concatenate(losses))
