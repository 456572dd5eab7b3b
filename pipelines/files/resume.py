"""An unfinished training: what is kept beside its outputs, so that an interrupted one goes on where it was."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import torch

from pipelines.tracking.runs import RUN, run_id_in
from tossid import budget
from tossid.errors import FileError
from tossid.outputs import output_file, write_whole

SCHEMA = "tossid.training/1"
STATE = "state.pt"


class Unfinished:
    """The folder of a training that has not finished: its run's id, and its state after the last saved epoch.

    Args:
        folder: Where they are.
        code: Digest of the code that trains. What other code has left is not gone on with.
    """

    def __init__(self, folder: Path, *, code: str) -> None:
        self.folder, self.code = folder, code

    def of_other_code(self) -> bool:
        """Say whether other code has left something here."""
        if self.run() is None and not (self.folder / STATE).is_file():
            return False
        try:
            return bool(json.loads((self.folder / RUN).read_text())["code"] != self.code)
        except (OSError, ValueError, KeyError, TypeError):
            return True

    def run(self) -> str | None:
        """The id of its run; None where no training is unfinished."""
        return run_id_in(self.folder)

    def begin(self, run: str) -> None:
        """Note whose state is kept here.

        Args:
            run: The run's id.
        """
        with output_file(self.folder / RUN) as temporary:
            temporary.write_text(json.dumps({"run": run, "code": self.code}) + "\n")

    def save(self, state: dict[str, Any]) -> None:
        """Keep a state, whole or not at all.

        Args:
            state: Of `tossid.training.api.Epoch`.
        """
        from tossid.models.trained import tensor_bytes

        write_whole(self.folder / STATE, tensor_bytes({"schema": SCHEMA, **state}))

    def state(self) -> dict[str, Any] | None:
        """The kept state, None if there is none.

        Raises:
            FileError: It is damaged, or none of ours.
        """
        path = self.folder / STATE
        if not path.is_file():
            return None
        budget.check_archive(path)
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
