"""What a study gives: a row for each cell, tables, figures."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tossid.html import html_table
from tossid.models import TrainedModel
from tossid.outputs import output_file
from tossid.plain_json import jsonable
from tossid.store import Dataset
from tossid.studies.kept import write_text
from tossid.studies.tables import Row, csv_table, markdown_table, measured_penetration, seed_means

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Study:
    """What `tossid.study` returns.

    Attributes:
        swept: What the swept setting is called: "gravity".
        rows: Each cell's model, seed, value, metrics with intervals over the held-out tosses, what was learned, the
            validation loss and the seconds that training took.
        failed: Model, seed, value and error of the cells that failed.
        held_out: The tosses that they were evaluated on.
        checkpoints: Each row's model: its file, or the content of it.
        notes: What the splits leak by copies, and what was left out, and why.
    """

    swept: str
    rows: tuple[dict[str, Any], ...]
    failed: tuple[dict[str, Any], ...]
    held_out: Dataset = field(repr=False)
    checkpoints: tuple[bytes | Path, ...] = field(repr=False)
    notes: tuple[str, ...] = ()

    def model(self, row: int) -> TrainedModel:
        """The trained model of a row.

        Args:
            row: Its number, from 0.
        """
        kept = self.checkpoints[row]
        if isinstance(kept, Path):
            return TrainedModel.load(kept)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "checkpoint.pt"
            path.write_bytes(kept)
            return TrainedModel.load(path)

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Head and rows of a short table: means over seeds of the main metrics."""
        return seed_means(self.rows, self.swept)

    def figures(self) -> dict[str, Figure]:
        """Figures by name: metrics over the swept value, and what k_res repairs at the most wrong gravity."""
        from tossid.studies.figures import study_figures

        def model_of(row: Row) -> TrainedModel:
            return self.model(next(i for i, own in enumerate(self.rows) if own is row))

        return study_figures(self.swept, self.rows, self.held_out, model_of=model_of)

    def as_json(self) -> dict[str, Any]:
        """All of it but models and tosses, as plain values."""
        plain: dict[str, Any] = jsonable(
            {
                "n_tosses": len(self.held_out.tosses),
                "split": "test",
                "measured": {"penetration_mm": measured_penetration(self.held_out.tosses, self.held_out.object)},
                "cells": self.rows,
                "failed": self.failed,
            }
        )
        return plain

    def save(self, folder: str | Path) -> list[Path]:
        """Write cells.json, cells.csv, table.md and, under figures/, the figures.

        Args:
            folder: Made where it is missing.

        Returns:
            The files.
        """
        folder = Path(folder)
        texts = {
            "cells.json": json.dumps(jsonable(self.rows), indent=1) + "\n",
            "cells.csv": csv_table(self.rows, self.swept),
            "table.md": markdown_table(self.rows, self.swept),
        }
        paths = []
        for name, text in texts.items():
            paths.append(folder / name)
            write_text(paths[-1], text)
        for name, figure in self.figures().items():
            paths.append(folder / "figures" / f"{name}.png")
            with output_file(paths[-1]) as temporary:
                figure.savefig(temporary)
        return paths

    def __repr__(self) -> str:
        head, rows = self.table()
        widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
        lines = [
            "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)) for row in (head, *rows)
        ]
        return "\n".join([f"Study over {self.swept}: {len(self.held_out.tosses)} held-out tosses", *lines, *self.notes])

    def _repr_html_(self) -> str:
        title = f"<p>Study over <b>{escape(self.swept)}</b>: {len(self.held_out.tosses)} held-out tosses</p>"
        return title + html_table(*self.table())
