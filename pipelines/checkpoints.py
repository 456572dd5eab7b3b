"""Checkpoints: what a trained model needs to be built again. Tensors, numbers and strings; no code is ever read."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pipelines.config import as_plain
from pipelines.outputs import output_file
from pipelines.schemas import ModelConfig
from tossid.errors import FileError
from tossid.models.contactnets import ContactNets, ContactNetsSettings
from tossid.models.e2e import EndToEnd
from tossid.models.implicit import LossWeights
from tossid.models.protocol import DynamicsModel
from tossid.motion import Measurement
from tossid.objects import ObjectModel, object_from_mjcf

SCHEMA = "tossid.checkpoint/2"


def build_model(
    config: ModelConfig, given: ObjectModel, *, seed: int, measurement: Measurement | None = None
) -> DynamicsModel:
    """The untrained model that the keys name, for the given object and the measurement of the tosses to learn from."""
    if config.name == "e2e":
        return EndToEnd(given, hidden=config.hidden, seed=seed)
    settings = ContactNetsSettings(
        gravity=config.gravity,
        learn_contact_law=config.name in ("cnrpi", "diffsim"),
        learn_residual=config.name != "cn",
        learn_inertia=config.name in ("cnrpi", "diffsim"),
        inertia=config.inertia,
        hidden=config.hidden,
        residual_weight=config.residual_weight,
        weights=LossWeights(config.complementarity, config.dissipation, config.penetration, config.gap_scale),
        implicit=config.name != "diffsim",
        refine_geometry=config.name == "diffsim",
    )
    com = given.com.copy()
    com[0] += config.start_com
    off = np.random.default_rng(seed).normal(size=given.corner_pos.shape) * config.start_corners
    start = given.with_changes(inertia=config.start_inertia * given.inertia, com=com, corner_pos=given.corner_pos + off)
    return ContactNets(start, settings, seed=seed, measurement=measurement)


@dataclass(frozen=True)
class Checkpoint:
    """A trained model, and the dataset that it was trained on."""

    model: DynamicsModel
    config: ModelConfig
    data: Path
    sha256: str


def save_checkpoint(
    path: Path, *, model: DynamicsModel, config: ModelConfig, seed: int, data: Path, sha256: str, fit: dict[str, Any]
) -> None:
    """Write a checkpoint, whole or not at all. `fit`: the state of the fit, to go on from; {} when it is done."""
    given = model.object
    content = {
        "schema": SCHEMA,
        "config": as_plain(config),
        "seed": seed,
        "data": str(data.resolve()),
        "sha256": sha256,
        "object": {
            "mjcf": given.mjcf,
            "name": given.name,
            "friction": given.friction,
            "restitution": given.restitution,
            "compliance": given.compliance,
            "relaxation": given.relaxation,
            "cohesion": given.cohesion,
            "width": given.width,
        },
        "model": model.state_dict(),
        "fit": fit,
    }
    write_tensors(content, path)


def write_tensors(content: dict[str, Any], path: Path) -> None:
    """`torch.save` to a file, whole or not at all. (torch itself reports a full disk as no `OSError`.)"""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    with output_file(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The content of a checkpoint file.

    Raises:
        FileError: it is no checkpoint, or damaged.
    """
    try:
        content = torch.load(path, weights_only=True)
    except Exception as error:
        raise FileError(path, f"not a readable checkpoint ({type(error).__name__})") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise FileError(path, f"not a checkpoint of schema {SCHEMA}")
    return content


def load_checkpoint(path: Path) -> Checkpoint:
    """The trained model of a checkpoint file.

    Raises:
        FileError: it is no checkpoint, or damaged.
    """
    content = read_checkpoint(path)
    try:
        config = ModelConfig(**{"start_corners": 0.0, **content["config"]})  # a key that older ones lack
        about = dict(content["object"])
        given = object_from_mjcf(about.pop("mjcf"), **about)
        model = build_model(config, given, seed=content["seed"])
        model.load_state_dict(content["model"])
        return Checkpoint(model, config, Path(content["data"]), content["sha256"])
    except Exception as error:  # what is damaged may be anywhere in it
        raise FileError(path, f"a damaged checkpoint ({type(error).__name__}: {error})") from error
