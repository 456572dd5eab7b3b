"""A training under way: what is kept beside its outputs, so that an interrupted one goes on where it was."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import torch

from pipelines.checkpoints import write_tensors
from pipelines.outputs import output_file
from pipelines.runs import RUN, run_id_in
from tossid.errors import FileError

SCHEMA = "tossid.training/1"
STATE = "state.pt"


class UnderWay:
    """The folder of a training that has not finished: its run's id, and its state after the last kept epoch."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self) -> str | None:
        """The id of its run; None where no training is under way."""
        return run_id_in(self.folder)

    def begin(self, run: str) -> None:
        """Note whose state is kept here."""
        with output_file(self.folder / RUN) as temporary:
            temporary.write_text(json.dumps({"run": run}) + "\n")

    def save(self, state: dict[str, Any]) -> None:
        """Keep a state, whole or not at all."""
        write_tensors({"schema": SCHEMA, **state}, self.folder / STATE)

    def state(self) -> dict[str, Any] | None:
        """The kept state, None if there is none.

        Raises:
            FileError: it is damaged, or none of ours.
        """
        path = self.folder / STATE
        if not path.is_file():
            return None
        try:
            content = torch.load(path, weights_only=True)
        except Exception as error:
            problem = f"not the readable state of a training ({type(error).__name__}); restart=true starts anew"
            raise FileError(path, problem) from error
        if not isinstance(content, dict) or content.get("schema") != SCHEMA:
            raise FileError(path, f"not a training's state of schema {SCHEMA}; restart=true starts anew")
        return content

    def clear(self) -> None:
        """Forget it: the training has finished, or starts anew."""
        shutil.rmtree(self.folder, ignore_errors=True)
