"""A trained model as a value: the model, how it was trained, what it learned, and its file.

A checkpoint holds tensors, numbers and text; no code is ever read from it.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from html import escape
from itertools import groupby
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tossid import budget
from tossid.errors import FileError, InputError
from tossid.html import number_words
from tossid.models.protocol import DynamicsModel
from tossid.models.registry import build_model, settings_from
from tossid.objects import ObjectModel, Roundness, object_from_mjcf
from tossid.objects.references import check_alone, stands_alone
from tossid.outputs import write_whole
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


@dataclass(frozen=True)
class EpochRecord:
    """One epoch of a training.

    Attributes:
        stage: The stage's name.
        epoch: Its number in the stage, from 1.
        train_loss: Loss on training data after it (implicit loss [m²/s²], rollouts [half widths², rad²]).
        validation_loss: The same on validation data.
        parts: The loss's parts on training data.
        passes: How often the data were gone through.
        seconds: How long it took.
        best: Whether the validation loss was the stage's best so far.
    """

    stage: str
    epoch: int
    train_loss: float
    validation_loss: float
    parts: dict[str, float]
    passes: int
    seconds: float
    best: bool

    def losses(self) -> dict[str, float]:
        """The losses by name, such as "contact/validation"."""
        found = {"train": self.train_loss, "validation": self.validation_loss, **self.parts}
        return {f"{self.stage}/{name}": value for name, value in found.items()}


@dataclass(frozen=True)
class TrainedModel:
    """What `tossid.train` returns.

    Attributes:
        model: The model.
        settings: How it was trained.
        parameters: What it learned, with units in the names; under "uncertainty", intervals of what rollouts determine.
        history: The epochs.
        seconds: How long training took, interrupted sessions included.
        data: The dataset's file, None for one in memory.
        sha256: Of that file; of a dataset in memory, of its training tosses.
        versions: Of Python and of the packages that computed it, by name; empty where its file does not say.
    """

    model: DynamicsModel
    settings: TrainSettings
    parameters: dict[str, Any]
    history: tuple[EpochRecord, ...] = ()
    seconds: float = 0.0
    data: Path | None = None
    sha256: str = ""
    versions: dict[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What the model is called: its variant's name."""
        return self.settings.model.name

    @property
    def object(self) -> ObjectModel:
        """The object as it was learned."""
        return self.model.learned_object()

    @property
    def converged(self) -> bool:
        """Whether training has converged, as far as its tosses can tell; True where nothing is known against it."""
        return bool(self.parameters.get("convergence", {}).get("converged", True))

    @property
    def intervals(self) -> dict[str, dict[str, Any]]:
        """95 % intervals of what rollouts learned: {name: {"value", "ci95"}}; empty where there are none.

        "ci95" is None of what the tosses do not determine, and "reason" says why.
        """
        found: dict[str, dict[str, Any]] = self.parameters.get("uncertainty", {}).get("intervals", {})
        return found

    def save(self, path: str | Path) -> Path:
        """Write the model to a file, whole or not at all.

        Args:
            path: The file; `.pt` is customary.

        Returns:
            The path.

        Raises:
            OutputError: The disk refuses.
        """
        write_whole(Path(path), checkpoint_bytes(self))
        return Path(path)

    @classmethod
    def load(cls, path: str | Path) -> TrainedModel:
        """A model from a file that `save` or `tossid train` wrote.

        Args:
            path: The file.

        Raises:
            FileError: It is no checkpoint, or damaged.
        """
        return read_checkpoint(Path(path))

    def __repr__(self) -> str:
        lines = [f"TrainedModel {self.name} of {self.model.object.name}, {len(self.history)} epochs"]
        lines += [f"  not converged: {reason}" for reason in self.parameters.get("convergence", {}).get("reasons", [])]
        lines += [f"  {name}: {value}" for name, value in self._rows()]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in self._rows())
        head = "<tr><th>learned</th><th>value (95 % interval)</th></tr>"
        title = f"<p><b>{escape(self.name)}</b> of {escape(self.model.object.name)}: {len(self.history)} epochs, "
        curves = "".join(
            f"<figure style='display:inline-block'>{_curve([r.validation_loss for r in records])}"
            f"<figcaption>{escape(stage)}: validation loss {records[-1].validation_loss:.3g}</figcaption></figure>"
            for stage, records in self._stages()
        )
        reasons = self.parameters.get("convergence", {}).get("reasons", [])
        warned = "".join(f"<p><b>not converged</b>: {escape(reason)}</p>" for reason in reasons)
        return f"{title}{self.seconds:.1f} s</p>{warned}<table>{head}{rows}</table>{curves}"

    def _rows(self) -> list[tuple[str, str]]:
        """Names and values of the parameters that are single numbers, with their intervals."""
        found = self.intervals
        known = {name: _with_interval(x["value"], x["ci95"]) for name, x in found.items() if x["ci95"] is not None}
        plain = {k: number_words(v) for k, v in self.parameters.items() if isinstance(v, float) and k not in found}
        others = ", ".join(name for name in found if name not in known)
        return list({**plain, **known, **({"not determined": others} if others else {})}.items())

    def _stages(self) -> list[tuple[str, list[EpochRecord]]]:
        return [(stage, list(records)) for stage, records in groupby(self.history, key=lambda record: record.stage)]


def _with_interval(value: float, interval: Sequence[float]) -> str:
    return f"{number_words(value)} ({number_words(interval[0])} to {number_words(interval[1])})"


def _curve(values: Sequence[float], *, width: int = 160, height: int = 48) -> str:
    """A line over the epochs as SVG, from the largest value to the smallest."""
    low, high = min(values), max(values)
    span, last = (high - low) or 1.0, max(len(values) - 1, 1)
    points = " ".join(
        f"{width * i / last:.1f},{2 + (height - 4) * (high - value) / span:.1f}" for i, value in enumerate(values)
    )
    line = f"<polyline points='{points}' fill='none' stroke='currentColor'/>"
    return f"<svg width='{width}' height='{height}' viewBox='0 0 {width} {height}'>{line}</svg>"


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
