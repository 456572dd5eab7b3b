"""Stages that minimise a model's own loss over transitions, by L-BFGS or Adam.

The implicit loss has many parameters (corners, the weights of k_res) and an exact gradient: L-BFGS on all transitions
takes tens of passes where Adam, which the papers use, takes thousands.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from tossid.models.protocol import DynamicsModel, StagePlan
from tossid.models.transitions import Transitions
from tossid.settings.training import TrainSettings


class Pass(NamedTuple):
    """What one epoch of a stage did.

    Attributes:
        train_loss: Loss on training data after it.
        validation_loss: Loss on validation data after it.
        parts: Parts of the training loss.
        passes: How often the data were gone through.
        done: Whether the stage has converged.
    """

    train_loss: float
    validation_loss: float
    parts: dict[str, float]
    passes: int
    done: bool = False


class Stage(Protocol):
    """A part of a fit: some parameters, some loss, some optimizer.

    Attributes:
        name: What it is called in records.
        epochs: Its most epochs.
    """

    name: str
    epochs: int

    def begin(self) -> None:
        """Prepare; called once before the first epoch, and not when an interrupted stage goes on."""

    def step(self) -> Pass:
        """One epoch; changes the model in place."""

    def validation_loss(self) -> float:
        """The loss of validation data as the model is now."""

    def state_dict(self) -> dict[str, Any]:
        """Tensors and numbers to go on from."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state_dict()` of an equal stage."""


QUADRATIC_START = 0.1
"""Distance from its minimum (in a parameter's unit) beyond which a parameter with a quadratic loss starts there; a
nearer one is left to the optimizer, as a given gravity that is right but for a few per cent."""
LBFGS_HISTORY, LBFGS_EVALUATIONS = 20, 25
"""Steps that L-BFGS remembers, and most passes through the data of one line search."""


class Evaluation(NamedTuple):
    """The loss at a point, its parts and its gradients."""

    loss: Tensor
    parts: dict[str, float]
    gradients: Sequence[Tensor]


class LossStage:
    """Minimises `model.loss(transitions)` over the parameters of a plan.

    An epoch of L-BFGS is one step with its line search on all transitions; one of Adam goes once through them in
    batches. A step of L-BFGS begins where the line search before it ended: that point is not computed again.

    Args:
        plan: What is learned.
        model: Changed in place.
        train: Transitions to learn from.
        validation: Transitions that end the stage.
        settings: Optimizer and epochs.
    """

    def __init__(
        self,
        plan: StagePlan,
        model: DynamicsModel,
        train: Transitions,
        validation: Transitions,
        settings: TrainSettings,
    ) -> None:
        self.name, self.epochs = plan.name, settings.epochs
        self._plan, self._model, self._train, self._validation = plan, model, train, validation
        self._batch, self._epoch = settings.batch, 0
        self._evaluated: dict[bytes, Evaluation] = {}
        self._by_adam = (plan.optimizer or settings.optimizer) == "adam"
        self._optimizer: torch.optim.Optimizer
        with _without_compiler():
            if self._by_adam:
                self._optimizer = torch.optim.Adam(plan.parameters, lr=settings.learning_rate)
            else:
                self._optimizer = torch.optim.LBFGS(
                    plan.parameters,
                    max_iter=1,
                    max_eval=LBFGS_EVALUATIONS,
                    history_size=LBFGS_HISTORY,
                    tolerance_grad=0.0,  # the stage itself decides when it has converged
                    tolerance_change=1e-16,
                    line_search_fn="strong_wolfe",
                )

    def begin(self) -> None:
        """Put the parameter in which the loss is quadratic where its slope, a straight line, is zero."""
        along = self._plan.quadratic
        if along is None:
            return

        def slope() -> Tensor:
            return torch.autograd.grad(self._model.loss(self._train)[0], [along])[0]

        start, at_start = along.detach().clone(), slope()
        along.data.copy_(start + 1.0)
        # Newton's step in one number, whose curvature is the difference of two slopes one unit apart
        rise = slope() - at_start
        step = -at_start / rise if rise > 0 else torch.zeros_like(rise)
        along.data.copy_(start + step if step.abs() > QUADRATIC_START else start)

    def step(self) -> Pass:
        """One epoch."""
        passes = self._adam() if self._by_adam else self._lbfgs()
        self._epoch += 1
        last = self._evaluated.get(self._point())
        self._evaluated = {} if last is None else {self._point(): last}
        with torch.no_grad():
            loss, parts = self._model.loss(self._train) if last is None else (last.loss, last.parts)
        return Pass(float(loss), self.validation_loss(), parts, passes)

    def validation_loss(self) -> float:
        """The model's loss of validation transitions."""
        with torch.no_grad():
            return float(self._model.loss(self._validation)[0])

    def _evaluate(self, batch: Transitions) -> Evaluation:
        loss, parts = self._model.loss(batch)
        return Evaluation(loss.detach(), parts, torch.autograd.grad(loss, self._plan.parameters))

    def _set_gradients(self, gradients: Sequence[Tensor]) -> None:
        for parameter, gradient in zip(self._plan.parameters, gradients, strict=True):
            parameter.grad = gradient.clone()

    def _point(self) -> bytes:
        return b"".join(parameter.detach().numpy().tobytes() for parameter in self._plan.parameters)

    def _lbfgs(self) -> int:
        """A step of L-BFGS; returns how often the data were gone through."""
        passes = 0

        def closure() -> float:
            nonlocal passes
            point = self._point()
            if point not in self._evaluated:
                passes += 1
                self._evaluated[point] = self._evaluate(self._train)
            self._set_gradients(self._evaluated[point].gradients)
            return float(self._evaluated[point].loss)

        self._optimizer.step(closure)
        return passes

    def _adam(self) -> int:
        """A pass of Adam through the data in batches."""
        order = torch.randperm(len(self._train), generator=torch.Generator().manual_seed(self._epoch))
        for batch in order.split(self._batch):
            self._set_gradients(self._evaluate(self._train.rows(batch)).gradients)
            self._optimizer.step()
        return 1

    def state_dict(self) -> dict[str, Any]:
        """The optimizer's state."""
        with _without_compiler():
            return {"optimizer": self._optimizer.state_dict(), "epoch": self._epoch}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state_dict()` of an equal stage."""
        with _without_compiler():
            self._optimizer.load_state_dict(state["optimizer"])
        self._epoch = state["epoch"]


@contextmanager
def _without_compiler() -> Iterator[None]:
    """Here torch's optimizers do without torch's compiler, whose import takes over a second.

    torch imports it to mark methods of optimizers that it is not to compile (`torch._compile`), and keeps the marked
    method beside the original. Nothing is compiled here, so the original is put there meanwhile. (Steps of Adam import
    the compiler all the same.)
    """
    originals = [getattr(method, "__wrapped__", None) for method in vars(torch.optim.Optimizer).values()]
    mark, marked = "__dynamo_disable", []
    if "torch._dynamo" not in sys.modules:
        marked = [method for method in originals if method is not None and not hasattr(method, mark)]
    for method in marked:
        setattr(method, mark, method)
    try:
        yield
    finally:
        for method in marked:
            delattr(method, mark)
