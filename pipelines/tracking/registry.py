"""Models in MLflow's registry: written without a pickle, with a signature, and loaded by MLflow's own `pyfunc`.

What is registered predicts: states at some instant in, the motion that follows out, in true metres.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipelines.execution.code_version import version

if TYPE_CHECKING:
    from mlflow.models import ModelSignature

    from tossid.models import TrainedModel

FRAME = 1 / 148.0
"""The length of a step that a call gets which names none [s]."""


class Served:
    """A model as MLflow calls it."""

    def __init__(self, trained: TrainedModel) -> None:
        self.model = trained.model

    def predict(self, model_input: Mapping[str, Any], params: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """The motions that follow from states.

        Args:
            model_input: "q" (B, nq) and "v" (B, nv).
            params: "n_steps", and "dt" [s] between them.

        Returns:
            "q" (B, n_steps + 1, nq) and "v" (B, n_steps + 1, nv), the first states included.
        """
        given = {"n_steps": 1, "dt": FRAME, **(params or {})}
        q, v = (np.ascontiguousarray(model_input[name], dtype=np.float64) for name in ("q", "v"))
        run = self.model.simulator().rollout(q, v, n_steps=int(given["n_steps"]), dt=float(given["dt"]))
        return {"q": run.q, "v": run.v}


def _load_pyfunc(path: str) -> Served:
    """MLflow's entry: the model of a checkpoint (read with weights_only)."""
    from tossid.models import TrainedModel

    return Served(TrainedModel.load(path))


def signature_of(trained: TrainedModel) -> ModelSignature:
    """Names, types and shapes of what goes in and comes out."""
    from mlflow.models import ModelSignature
    from mlflow.types import ParamSchema, ParamSpec, Schema, TensorSpec

    model, kind = trained.model.object, np.dtype(np.float64)
    return ModelSignature(
        inputs=Schema([TensorSpec(kind, (-1, model.nq), "q"), TensorSpec(kind, (-1, model.nv), "v")]),
        outputs=Schema([TensorSpec(kind, (-1, -1, model.nq), "q"), TensorSpec(kind, (-1, -1, model.nv), "v")]),
        params=ParamSchema([ParamSpec("n_steps", "long", 1), ParamSpec("dt", "double", FRAME)]),
    )


EXAMPLE_STEPS = 74
"""Half a second, from the state of the example to the ground."""


def write_model(checkpoint: Path, folder: Path) -> ModelSignature:
    """Write a model in MLflow's form, around a checkpoint; returns its signature.

    The example of a call is the object 0.3 m above the ground, at 1 m/s along x.

    Args:
        checkpoint: Of a training.
        folder: A new folder.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # MLflow, when it is imported, warns of its own type hints
        from mlflow.pyfunc import save_model

    from tossid.models import TrainedModel

    trained = TrainedModel.load(checkpoint)
    signature, model = signature_of(trained), trained.model.object
    q, v = np.zeros((1, model.nq)), np.zeros((1, model.nv))
    q[:, 2:4], v[:, 0] = (0.3, 1.0), 1.0
    save_model(
        folder,
        loader_module=__name__,
        data_path=str(checkpoint),
        signature=signature,
        input_example=({"q": q, "v": v}, {"n_steps": EXAMPLE_STEPS}),
        pip_requirements=[f"tossid=={version()}"],
        metadata={"tossid.model": trained.name, "data": trained.sha256},
    )
    return signature
