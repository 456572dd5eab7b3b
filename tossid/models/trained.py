"""A trained model as a value: the model, how it was trained, what it learned, and its file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

from tossid.models.protocol import DynamicsModel
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings


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
        from tossid.models.checkpoints import checkpoint_bytes
        from tossid.outputs import write_whole

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
        from tossid.models.checkpoints import read_checkpoint

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
        known = {name: _with_interval(x["value"], x["ci95"]) for name, x in self.intervals.items()}
        plain = {k: f"{v:.4g}" for k, v in self.parameters.items() if isinstance(v, float) and k not in known}
        return list({**plain, **known}.items())

    def _stages(self) -> list[tuple[str, list[EpochRecord]]]:
        return [(stage, list(records)) for stage, records in groupby(self.history, key=lambda record: record.stage)]


def _with_interval(value: float, interval: Sequence[float] | None) -> str:
    return "not determined" if interval is None else f"{value:.4g} ({interval[0]:.4g} to {interval[1]:.4g})"


def _curve(values: Sequence[float], *, width: int = 160, height: int = 48) -> str:
    """A line over the epochs as SVG, from the largest value to the smallest."""
    low, high = min(values), max(values)
    span, last = (high - low) or 1.0, max(len(values) - 1, 1)
    points = " ".join(
        f"{width * i / last:.1f},{2 + (height - 4) * (high - value) / span:.1f}" for i, value in enumerate(values)
    )
    line = f"<polyline points='{points}' fill='none' stroke='currentColor'/>"
    return f"<svg width='{width}' height='{height}' viewBox='0 0 {width} {height}'>{line}</svg>"
