"""The fit loop: L-BFGS on all transitions, stage by stage, stopped early on validation tosses.

Continuous dynamics are learned first, from transitions that surely involve no
contact; contact (and inertia) follows with them held. Learned together, the
loss lets impulses at resting contact stand in for missing gravity.

The loop yields records and knows no tracker. Its state is plain tensors and
numbers, so that an interrupted fit goes on exactly where it was.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from tossid.errors import DivergedError
from tossid.models.contactnets import ContactNets
from tossid.models.transitions import Transitions


@dataclass(frozen=True)
class FitSettings:
    """How long and how carefully to fit.

    Attributes:
        epochs: at most this many steps of L-BFGS a stage.
        patience: stop a stage after this many epochs without a better validation loss.
        min_improvement: relative improvement that counts as better.
    """

    epochs: int = 60
    patience: int = 8
    min_improvement: float = 1e-4


@dataclass(frozen=True)
class EpochRecord:
    """One epoch: losses [m²/s²], the loss's parts on training data, and how many inner problems stayed unsolved."""

    stage: str
    epoch: int
    train_loss: float
    validation_loss: float
    parts: dict[str, float]
    passes: int
    seconds: float
    best: bool


class Fit:
    """A fit under way.

    Args:
        model: fitted in place; holds the best parameters when `epochs` is exhausted.
        train, validation: transitions of different tosses.
    """

    def __init__(
        self, model: ContactNets, train: Transitions, validation: Transitions, settings: FitSettings | None = None
    ) -> None:
        self.model = model
        self.settings = settings or FitSettings()
        self.data = {"continuous": (train.in_flight(), validation.in_flight()), "contact": (train, validation)}
        self.stages = ["contact"] if model.residual is None else ["continuous", "contact"]
        self.stage = 0
        self.epoch = 0
        self.stale = 0
        self.best_loss = float("inf")
        self.best = copy.deepcopy(model.state_dict())
        self._optimizer: torch.optim.LBFGS | None = None

    def parameters(self, stage: str) -> list[nn.Parameter]:
        """What a stage learns."""
        residual = [] if self.model.residual is None else list(self.model.residual.parameters())
        own = {id(p) for p in residual}
        rest = [p for p in self.model.parameters() if p.requires_grad and id(p) not in own]
        return residual if stage == "continuous" else rest

    def state_dict(self) -> dict[str, Any]:
        """Everything needed to go on: tensors, numbers and strings only."""
        return {
            "stage": self.stage,
            "epoch": self.epoch,
            "stale": self.stale,
            "best_loss": self.best_loss,
            "best": self.best,
            "model": copy.deepcopy(self.model.state_dict()),
            "optimizer": None if self._optimizer is None else self._optimizer.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state_dict()` of an equal fit."""
        self.stage, self.epoch, self.stale = state["stage"], state["epoch"], state["stale"]
        self.best_loss, self.best = state["best_loss"], state["best"]
        self.model.load_state_dict(state["model"])
        self._optimizer = None
        if state["optimizer"] is not None and self.stage < len(self.stages):
            self._optimizer = self._new_optimizer(self.stages[self.stage])
            self._optimizer.load_state_dict(state["optimizer"])

    def epochs(self) -> Iterator[EpochRecord]:
        """Fit, one record an epoch.

        Raises:
            DivergedError: the loss became NaN or infinite; the state before it is attached.
        """
        while self.stage < len(self.stages):
            stage = self.stages[self.stage]
            if self._optimizer is None:
                self._optimizer = self._new_optimizer(stage)
            while self.epoch < self.settings.epochs and self.stale < self.settings.patience:
                yield self._step(stage)
            self.model.load_state_dict(self.best)
            self.stage, self.epoch, self.stale = self.stage + 1, 0, 0
            self.best_loss, self._optimizer = float("inf"), None

    def _new_optimizer(self, stage: str) -> torch.optim.LBFGS:
        return torch.optim.LBFGS(
            self.parameters(stage),
            max_iter=1,
            max_eval=25,
            history_size=20,
            tolerance_grad=0.0,
            tolerance_change=1e-16,
            line_search_fn="strong_wolfe",
        )

    def _step(self, stage: str) -> EpochRecord:
        assert self._optimizer is not None
        train, validation = self.data[stage]
        before = copy.deepcopy(self.model.state_dict())
        started, passes = time.perf_counter(), 0
        parameters = self.parameters(stage)

        def closure() -> float:
            nonlocal passes
            passes += 1
            loss, _ = self.model.loss(train)
            gradients = torch.autograd.grad(loss, parameters)
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter.grad = gradient
            return float(loss.detach())

        self._optimizer.step(closure)
        seconds = time.perf_counter() - started
        with torch.no_grad():
            loss, parts = self.model.loss(train)
            held_out = float(self.model.loss(validation)[0])
        if not torch.isfinite(loss) or held_out != held_out:
            raise DivergedError(f"the loss became {float(loss)} in stage '{stage}', epoch {self.epoch}", state=before)
        better = held_out < self.best_loss * (1 - self.settings.min_improvement)
        if better:
            self.best_loss, self.best, self.stale = held_out, copy.deepcopy(self.model.state_dict()), 0
        else:
            self.stale += 1
        self.epoch += 1
        return EpochRecord(stage, self.epoch, float(loss), held_out, parts, passes, seconds, better)
