"""Trained models in files. A checkpoint holds tensors, numbers and text; no code is ever read from it."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import asdict, replace
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tossid import budget
from tossid.errors import FileError, InputError
from tossid.models.registry import build_model, settings_from
from tossid.models.trained import EpochRecord, TrainedModel
from tossid.objects import ObjectModel, Roundness, object_from_mjcf
from tossid.objects.references import check_alone, stands_alone
from tossid.settings.kinds import from_plain, to_plain
from tossid.settings.training import TrainSettings
from tossid.store.object_text import text_of_model

SCHEMA = "tossid.checkpoint/4"
"""What is written: settings, history and parameters with the weights."""
LOG_COHESION = "tossid.checkpoint/3"
"""What is read, too: the same with the logarithm of cohesion."""
OLDER = "tossid.checkpoint/2"
"""What is read, too: the model's keys, its seed, and the weights, with the logarithm of cohesion."""
_STATED = ("name", "friction", "restitution", "compliance", "relaxation", "cohesion", "width")
"""What of an object its MJCF does not say."""


def checkpoint_bytes(trained: TrainedModel) -> bytes:
    """A trained model as the content of a file.

    Args:
        trained: The model.
    """
    given = trained.model.object
    # the model's settings say how its start differs from this text, so that it stays as it is where it can
    text = given.mjcf if stands_alone(given.mjcf) else text_of_model(given)
    content = {
        "schema": SCHEMA,
        "settings": to_plain(trained.settings),
        "data": None if trained.data is None else str(trained.data.resolve()),
        "sha256": trained.sha256,
        "object": {"mjcf": text, **{name: getattr(given, name) for name in _STATED}},
        "corners": _corners(given),
        "model": trained.model.state_dict(),
        "parameters": trained.parameters,
        "history": [asdict(record) for record in trained.history],
        "seconds": trained.seconds,
        "versions": trained.versions,
    }
    return tensor_bytes(content)


def tensor_bytes(content: Mapping[str, Any]) -> bytes:
    """Plain values and tensors as `torch.save` writes them.

    Args:
        content: Numbers, text, tensors, lists and dicts of these.
    """
    buffer = io.BytesIO()
    torch.save(dict(content), buffer)
    return buffer.getvalue()


def read_checkpoint(path: Path) -> TrainedModel:
    """The trained model of a checkpoint file.

    Args:
        path: The file, of this schema or of one of the two before.

    Raises:
        FileError: It is no checkpoint, or damaged.
    """
    budget.check_archive(path)
    try:
        content = torch.load(path, weights_only=True)
    except Exception as error:
        raise FileError(path, f"not a readable checkpoint ({type(error).__name__})") from error
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema not in (SCHEMA, LOG_COHESION, OLDER):
        raise FileError(path, f"not a checkpoint of schema {OLDER} to {SCHEMA.split('/')[1]}")
    try:
        content = _renewed(content) if schema == OLDER else content
        return _trained(content if schema == SCHEMA else _with_linear_cohesion(content))
    except InputError as error:
        raise FileError(path, f"a checkpoint that cannot be used: {error}") from error
    except Exception as error:  # what is damaged may be anywhere in it
        raise FileError(path, f"a damaged checkpoint ({type(error).__name__}: {error})") from error


def _trained(content: dict[str, Any]) -> TrainedModel:
    settings = _train_settings(content["settings"])
    about = dict(content["object"])
    check_alone(about["mjcf"])
    given: ObjectModel = _with_corners(object_from_mjcf(about.pop("mjcf"), **about), content.get("corners"))
    model = build_model(settings.model, given, seed=settings.seed)
    model.load_state_dict(content["model"])
    return TrainedModel(
        model,
        settings,
        content["parameters"] or model.parameters_report(),
        tuple(EpochRecord(**record) for record in content["history"]),
        content["seconds"],
        None if content["data"] is None else Path(content["data"]),
        content["sha256"],
        dict(content.get("versions", {})),
    )


def _corners(given: ObjectModel) -> dict[str, torch.Tensor] | None:
    """Round corners, which not every MJCF gives back; None for points."""
    if given.roundness is None:
        return None
    parts = {"corner_body": given.corner_body, "corner_pos": given.corner_pos, **given.roundness._asdict()}
    return {name: torch.as_tensor(part) for name, part in parts.items()}


def _with_corners(given: ObjectModel, corners: dict[str, torch.Tensor] | None) -> ObjectModel:
    """The object with the round corners that `_corners` wrote."""
    if corners is None:
        return given
    parts = {name: np.array(part.numpy()) for name, part in corners.items()}
    body, pos = parts.pop("corner_body"), parts.pop("corner_pos")
    return given.with_changes(corner_body=body, corner_pos=pos, roundness=Roundness(**parts))


def _train_settings(values: dict[str, Any]) -> TrainSettings:
    model = settings_from(values["model"])
    rest = {name: value for name, value in values.items() if name != "model"}
    if "intervals" in rest:  # of earlier versions: resampled sets of tosses
        rest["intervals"] = {name: value for name, value in rest["intervals"].items() if name != "draws"}
    return replace(from_plain(TrainSettings(), rest), model=model)


def _renewed(content: dict[str, Any]) -> dict[str, Any]:
    """The content of an older checkpoint as this schema has it."""
    model = {name.replace("residual.", "k_res.", 1): value for name, value in content["model"].items()}
    settings = {"model": content["config"], "seed": content["seed"]}
    return {**content, "settings": settings, "model": model, "parameters": {}, "history": [], "seconds": 0.0}


def _with_linear_cohesion(content: dict[str, Any]) -> dict[str, Any]:
    """The content of a checkpoint that has the logarithm of cohesion, with cohesion itself."""
    model, name = dict(content["model"]), "contact_law.value"
    if name in model:
        time, damping, log_cohesion = model[name].tolist()
        model[name] = torch.tensor([time, damping, exp(min(log_cohesion, 3.0))], dtype=torch.float64)
    return {**content, "model": model}
