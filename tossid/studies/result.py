"""What a study gives: a row for each cell, tables, figures."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tossid.evaluation.evaluate import evaluate
from tossid.html import html_table
from tossid.models import TrainedModel
from tossid.objects import GRAVITY
from tossid.outputs import output_file, write_whole
from tossid.plain_json import jsonable
from tossid.store import Dataset
from tossid.studies.tables import csv_table, markdown_table, measured_penetration, seed_means

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
        """The trained model of a row, by its number from 0."""
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
        """Figures by name: metrics over the swept value, from the first state and from the flight.

        A study of gravity also has what k_res repairs, in the cell that was given the most wrong gravity. A study of
        something else than gravity, tosses and inertia has no figures.
        """
        from tossid.evaluation.figures import data_efficiency, gravity_sweep, inertia_study

        if self.swept == "start_inertia":
            return {"inertia_study": inertia_study(self.rows)}
        starts = {"": False} | ({"_from_flight": True} if all("from_flight" in row for row in self.rows) else {})
        if self.swept == "tosses":
            return {
                f"data_efficiency{suffix}": data_efficiency(self.rows, swept=self.swept, from_flight=from_flight)
                for suffix, from_flight in starts.items()
            }
        if self.swept != "gravity":
            return {}
        depth = measured_penetration(self.held_out.tosses, self.held_out.object)
        figures = {
            f"gravity_sweep{suffix}": gravity_sweep(self.rows, measured_penetration_mm=depth, from_flight=from_flight)
            for suffix, from_flight in starts.items()
        }
        for i in sorted(range(len(self.rows)), key=lambda i: -abs(self.rows[i]["gravity"] - GRAVITY)):
            model = self.model(i)
            if model.settings.model.learn_k_res:
                return figures | evaluate(model, self.held_out).acceleration_figure()
        return figures

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
        """Write cells.json, cells.csv, table.md and, under figures/, the figures into a folder; returns the files."""
        folder = Path(folder)
        texts = {
            "cells.json": json.dumps(jsonable(self.rows), indent=1) + "\n",
            "cells.csv": csv_table(self.rows, self.swept),
            "table.md": markdown_table(self.rows, self.swept),
        }
        paths = [folder / name for name in texts]
        for path, text in zip(paths, texts.values(), strict=True):
            write_whole(path, text.encode())
        for name, figure in self.figures().items():
            paths.append(folder / "figures" / f"{name}.png")
            with output_file(paths[-1]) as temporary:
                figure.savefig(temporary)
        return paths

    def __repr__(self) -> str:
        table = [self.table()[0], *self.table()[1]]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = ["  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)) for row in table]
        return "\n".join([f"Study over {self.swept}: {len(self.held_out.tosses)} held-out tosses", *lines, *self.notes])

    def _repr_html_(self) -> str:
        title = f"<p>Study over <b>{escape(self.swept)}</b>: {len(self.held_out.tosses)} held-out tosses</p>"
        return title + html_table(*self.table())
