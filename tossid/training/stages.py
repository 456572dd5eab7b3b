"""The stages of a fit: the implicit loss by L-BFGS or Adam, and prediction error by Gauss-Newton.

The implicit loss has many parameters (corners, the residual's weights) and an
exact gradient: L-BFGS on all transitions takes tens of passes where Adam, the
sources' choice, takes thousands. Open-loop prediction error is what a user
wants small, but its gradient through contact is noisy; it depends on few numbers
(friction, contact law, inertia), so Gauss-Newton takes its Jacobian by
differences of whole rollouts through the fast kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from math import log
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from tossid.models.shots import Shots, prediction_misses
from tossid.models.transitions import Transitions

Array = NDArray[np.float64]

ALL_BUT_RIGID = (0.05, 0.02, 1e-4)
"""Contact time [ms], damping, and cohesion in tenths of the weight, of a contact that is as stiff as the law can say.

Where contact is rigid (simulated tosses), a softer one would have its effect explained by a wrong inertia."""
STIFF = 0.6
"""Contact times [ms] up to which contact is rigid for all that a simulator's step of 1.7 ms can tell."""


class Pass(NamedTuple):
    """What one epoch of a stage did: losses after it, the loss's parts, and how often the data were gone through."""

    train_loss: float
    validation_loss: float
    parts: dict[str, float]
    passes: int
    done: bool = False


class Stage(Protocol):
    """A part of a fit: some parameters, some loss, some optimizer."""

    name: str
    epochs: int

    def begin(self) -> None:
        """Called once, before the first epoch; not when an interrupted stage goes on."""

    def step(self) -> Pass:
        """One epoch; changes the model in place."""

    def state_dict(self) -> dict[str, Any]:
        """Tensors and numbers to go on from."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""


class LossStage:
    """Minimise `model.loss(transitions)` over some of its parameters.

    Args:
        optimizer: "lbfgs" (an epoch is one step with its line search on all transitions) or "adam" (an epoch goes
            once through the transitions in batches).
    """

    BATCH = 256

    def __init__(
        self,
        name: str,
        model: Any,
        parameters: list[nn.Parameter],
        train: Transitions,
        validation: Transitions,
        *,
        epochs: int,
        optimizer: str = "lbfgs",
        learning_rate: float = 1e-3,
    ) -> None:
        self.name, self.epochs = name, epochs
        self._model, self._parameters = model, parameters
        self._train, self._validation = train, validation
        self._epoch = 0
        self._optimizer: torch.optim.Optimizer
        if optimizer == "lbfgs":
            self._optimizer = torch.optim.LBFGS(
                parameters,
                max_iter=1,
                max_eval=25,
                history_size=20,
                tolerance_grad=0.0,
                tolerance_change=1e-16,
                line_search_fn="strong_wolfe",
            )
        else:
            self._optimizer = torch.optim.Adam(parameters, lr=learning_rate)

    def begin(self) -> None:
        """Nothing to prepare."""

    def step(self) -> Pass:
        """One epoch."""
        passes = self._adam() if isinstance(self._optimizer, torch.optim.Adam) else self._lbfgs()
        self._epoch += 1
        with torch.no_grad():
            loss, parts = self._model.loss(self._train)
            held_out = float(self._model.loss(self._validation)[0])
        return Pass(float(loss), held_out, parts, passes)

    def _gradient(self, batch: Transitions) -> Tensor:
        loss, _ = self._model.loss(batch)
        gradients = torch.autograd.grad(loss, self._parameters)
        for parameter, gradient in zip(self._parameters, gradients, strict=True):
            parameter.grad = gradient
        return loss.detach()

    def _lbfgs(self) -> int:
        passes = 0

        def closure() -> float:
            nonlocal passes
            passes += 1
            return float(self._gradient(self._train))

        self._optimizer.step(closure)
        return passes

    def _adam(self) -> int:
        order = torch.randperm(len(self._train), generator=torch.Generator().manual_seed(self._epoch))
        for batch in order.split(self.BATCH):
            self._gradient(self._train.rows(batch))
            self._optimizer.step()
        return 1

    def state_dict(self) -> dict[str, Any]:
        """The optimizer's state."""
        return {"optimizer": self._optimizer.state_dict(), "epoch": self._epoch}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self._optimizer.load_state_dict(state["optimizer"])
        self._epoch = state["epoch"]


class Sensitivity(NamedTuple):
    """Gauss-Newton's sums a toss: H (n_tosses, P, P) and g (n_tosses, P); x (P,) where they were taken."""

    H: Array
    g: Array
    x: Array


class RolloutStage:
    """Minimise the pseudo-Huber prediction error of open-loop rollouts by Levenberg-Marquardt.

    loss = mean over frames of d² (sqrt(1 + |miss|² / d²) - 1), d = `SCALE`; see `shots.prediction_misses`.
    After contact, predictions grow chaotic: frames whose derivative is among the
    largest `CHAOTIC` count in the loss, but not in the step.

    Args:
        make_shots: training and validation shots for the model as it is; called every
            epoch, as what the flight says of the first state depends on the centre of mass.
    """

    SCALE = 0.1
    """Miss [half widths, rad] up to which errors count quadratically."""
    DIFFERENCE = 0.015
    """Step of the central differences, to either side, in the parameters' own units of order one."""
    SOFTER = 0.97
    """Share of the all but rigid contact's loss that a softer one must stay below."""
    CHAOTIC = 0.2
    LARGEST_STEP = 0.3
    CONVERGED = 2e-3
    """Relative gain of a step below which the stage ends."""
    TRIALS = 6

    def __init__(
        self,
        name: str,
        model: Any,
        parameters: list[nn.Parameter],
        make_shots: Callable[[], tuple[Shots, Shots]],
        *,
        epochs: int,
        n_threads: int = 1,
    ) -> None:
        self.name, self.epochs = name, epochs
        self._model, self._parameters = model, parameters
        self._make_shots = make_shots
        self._train, self._validation = make_shots()
        self._n_threads = n_threads
        self._damping = 1e-2

    def begin(self) -> None:
        """Look through the starts of a contact law that is to be learned: the loss over it has ridges.

        All but rigid is what it starts from unless a softer one is clearly better.
        """
        value = self._model.contact_law.value
        if not any(value is parameter for parameter in self._parameters):
            return
        soft = [value.detach().clone(), *self._model.contact_law.starts()]
        starts = [start for start in soft if start[0] > log(STIFF)] + [torch.tensor(ALL_BUT_RIGID).double().log()]
        losses = []
        for start in starts:
            with torch.no_grad():
                value.copy_(start)
            losses.append(self._loss(self._misses(self._train), self._train))
        best = int(np.argmin(losses))
        with torch.no_grad():
            value.copy_(starts[best if losses[best] < self.SOFTER * losses[-1] else -1])

    def step(self) -> Pass:
        """One step of Levenberg-Marquardt; `done` when it gains little, when no damping makes it better, and when
        nothing that is learned is felt by these rollouts."""
        self._train, self._validation = self._make_shots()
        x = self._get()
        miss = self._misses(self._train)
        loss = self._loss(miss, self._train)
        sensitivity = self.sensitivity(miss)
        H, g = sensitivity.H.sum(0), sensitivity.g.sum(0)
        if not H.any():  # rollouts that never land, say, as gravity is given too weak
            held_out = self._loss(self._misses(self._validation), self._validation)
            return Pass(loss, held_out, {"prediction": loss}, 2 * len(x) + 1, done=True)
        scale = np.diag(H) + 1e-6 * np.trace(H) / len(x)
        passes, better = 2 * len(x) + 1, False
        while not better and passes < 2 * len(x) + 1 + self.TRIALS:
            step = -np.linalg.solve(H + self._damping * np.diag(scale), g)
            self._set(x + np.clip(step, -self.LARGEST_STEP, self.LARGEST_STEP))
            trial = self._loss(self._misses(self._train), self._train)
            passes += 1
            better = trial < loss
            self._damping *= 0.2 if better else 5.0
        self._damping = max(self._damping, 1e-4)
        if better:
            done = loss - trial < self.CONVERGED * loss
            loss = trial
        else:
            self._set(x)
            done, self._damping = True, 1e-2
        held_out = self._loss(self._misses(self._validation), self._validation)
        return Pass(loss, held_out, {"prediction": loss}, passes, done)

    def sensitivity(self, miss: Array | None = None) -> Sensitivity:
        """Gauss-Newton's sums at the present parameters, toss by toss."""
        x, shots = self._get(), self._train
        miss = self._misses(shots) if miss is None else miss
        J = np.empty((*miss.shape, len(x)))
        for j in range(len(x)):
            J[..., j] = (self._moved(x, j, self.DIFFERENCE) - self._moved(x, j, -self.DIFFERENCE)) / (
                2 * self.DIFFERENCE
            )
        self._set(x)
        size = np.einsum("slip,slip->sl", J, J)
        calm = size <= np.quantile(size[shots.inside], 1 - self.CHAOTIC)
        weight = calm / np.sqrt(1 + (miss**2).sum(-1) / self.SCALE**2) / shots.inside.sum()
        n = int(shots.toss.max()) + 1
        H, g = np.zeros((n, len(x), len(x))), np.zeros((n, len(x)))
        for s in range(len(miss)):
            rows, w = J[s].reshape(-1, len(x)), np.repeat(weight[s], miss.shape[-1])
            H[shots.toss[s]] += (rows * w[:, None]).T @ rows
            g[shots.toss[s]] += rows.T @ (w * miss[s].ravel())
        return Sensitivity(H, g, x)

    def set_parameters(self, x: Array) -> None:
        """Put the flat vector x (P,) into the model."""
        self._set(x)

    def _moved(self, x: Array, j: int, by: float) -> Array:
        """Misses of the training shots with parameter j moved."""
        moved = x.copy()
        moved[j] += by
        self._set(moved)
        return self._misses(self._train)

    def _misses(self, shots: Shots) -> Array:
        return prediction_misses(self._model.simulator(), shots, n_threads=self._n_threads)

    def _loss(self, miss: Array, shots: Shots) -> float:
        size = np.where(np.isfinite(miss).all(-1), (miss**2).sum(-1), 1e6)
        return float((self.SCALE**2 * (np.sqrt(1 + size / self.SCALE**2) - 1)).sum() / shots.inside.sum())

    def _get(self) -> Array:
        return nn.utils.parameters_to_vector(self._parameters).detach().numpy().copy()

    def _set(self, x: Array) -> None:
        with torch.no_grad():
            nn.utils.vector_to_parameters(torch.from_numpy(np.ascontiguousarray(x)).clone(), self._parameters)

    def state_dict(self) -> dict[str, Any]:
        """The damping."""
        return {"damping": self._damping}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self._damping = float(state["damping"])
