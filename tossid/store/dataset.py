"""Tosses of one object, in memory: what the verbs of tossid take and give."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tossid.errors import InputError, nearest
from tossid.html import html_table
from tossid.objects import ObjectModel
from tossid.store.writing import dataset_writer
from tossid.types import SPLITS, OnDemand, RecordingOrder, Toss

_DRAWN = 12
"""Tosses that the figure in a notebook draws."""


@dataclass(frozen=True, slots=True, repr=False)
class Dataset:
    """Tosses of one object.

    Attributes:
        object: The object.
        tosses: A tuple, or `OnDemand` of an open file.
        rate_hz: Frames a second.
        source: Which importer or simulator made it.
        provenance: Where it comes from: text, numbers and booleans by name.
        order: The order of recording and its sessions; None where it was not looked at.
        truth: The exact motions, of tosses that were synthesized; files of datasets do not hold it.
    """

    object: ObjectModel
    tosses: Sequence[Toss]
    rate_hz: float
    source: str
    provenance: dict[str, Any] = field(default_factory=dict)
    truth: Dataset | None = None
    order: RecordingOrder | None = None

    def __len__(self) -> int:
        """The number of tosses."""
        return len(self.tosses)

    @property
    def names(self) -> tuple[str, ...]:
        """The tosses' names, in their order."""
        return tuple(toss.name for toss in self.tosses)

    def of_split(self, *splits: str) -> tuple[Toss, ...]:
        """The tosses of the named splits, in their order."""
        return tuple(toss for toss in self.tosses if toss.split in splits)

    def split(self, name: str) -> Dataset:
        """The dataset of one split's tosses.

        Raises:
            InputError: There is no such split, or no toss is in it.
        """
        if name not in SPLITS:
            near = nearest(name, SPLITS)
            hint = f" Did you mean '{near}'?" if near else ""
            raise InputError(f"there is no split '{name}', expected one of {', '.join(SPLITS)}.{hint}")
        where = [i for i, toss in enumerate(self.tosses) if toss.split == name]
        if not where:
            raise InputError(f"none of the {len(self)} tosses is in split '{name}'")
        return self._at(where)

    def save(self, path: str | Path) -> None:
        """Write it as one HDF5 file, see `tossid.write_dataset`."""
        write_dataset(self, path)

    def _at(self, where: Sequence[int]) -> Dataset:
        """The dataset of some tosses; what was read on demand still is."""
        tosses = self.tosses
        chosen = OnDemand(lambda i: tosses[where[i]], len(where), kept=0) if isinstance(tosses, OnDemand) else None
        truth = None if self.truth is None else self.truth._at(where)
        return replace(self, tosses=chosen or tuple(tosses[i] for i in where), truth=truth)

    def __repr__(self) -> str:
        truth = ", with truth" if self.truth is not None else ""
        about = f"{len(self)} tosses at {self.rate_hz:g} Hz, {self.source}{truth}"
        return f"Dataset of '{self.object.name}': {about}"

    def _repr_html_(self) -> str:
        """A table of what it holds, and the height of the first tosses over time, for a notebook."""
        splits = Counter(toss.split or "none" for toss in self.tosses)
        frames = sum(len(toss) for toss in self.tosses)
        facts = {
            "object": f"{self.object.name} ({self.object.n_joints} joints, {self.object.mass.sum():.3g} kg)",
            "tosses": f"{len(self)} ({', '.join(f'{name} {count}' for name, count in splits.items())})",
            "frames": f"{frames} at {self.rate_hz:g} Hz",
            "source": self.source + (", with truth" if self.truth is not None else ""),
        }
        return html_table([], list(facts.items())) + _heights(self.tosses[:_DRAWN])


def write_dataset(dataset: Dataset, path: str | Path) -> None:
    """Write a dataset as one HDF5 file (schema: `tossid.store.schema`).

    The file appears whole or not at all: what was there before stays until the new one is complete on the disk. Equal
    datasets give equal bytes.

    Args:
        dataset: What is written, but for its `truth`. Its provenance says under `covariance_source` where the
            covariances come from.
        path: The file (.h5).

    Raises:
        InputError: The dataset breaks the schema (names, joints, provenance).
        ObjectError: The object cannot be described in MJCF.
        OutputError: The disk is full, or the file cannot be written there.
    """
    with dataset_writer(dataset.object, Path(path)) as writer:
        for toss in dataset.tosses:
            writer.add(toss)
        writer.finish(
            rate_hz=dataset.rate_hz, source=dataset.source, provenance=dataset.provenance, order=dataset.order
        )


def _heights(tosses: Sequence[Toss]) -> str:
    """The height of the tosses' base over time, as SVG."""
    if not tosses:
        return ""
    width, height, margin = 420, 140, 18
    seconds = max(float(toss.t[-1] - toss.t[0]) for toss in tosses)
    low, high = (float(f(np.concatenate([toss.q[:, 2] for toss in tosses]))) for f in (np.min, np.max))
    lines = []
    for toss in tosses:
        x = margin + (toss.t - toss.t[0]) / seconds * (width - 2 * margin)
        y = height - margin - (toss.q[:, 2] - low) / max(high - low, 1e-9) * (height - 2 * margin)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        lines.append(f'<polyline points="{points}" fill="none" stroke="currentColor" stroke-opacity="0.5"/>')
    label = f"height of the base, {low:.3g} to {high:.3g} m, over {seconds:.3g} s"
    text = f'<text x="{margin}" y="12" font-size="11" fill="currentColor">{label}</text>'
    return f'<svg viewBox="0 0 {width} {height}" width="{width}">{text}{"".join(lines)}</svg>'
