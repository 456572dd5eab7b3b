"""Where tosses go one by one: into a dataset's file, or into memory."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.outputs import output_file
from tossid.store import Dataset, dataset_writer, open_dataset
from tossid.store.writing import DatasetWriter
from tossid.types import RecordingOrder, Toss


class _InMemory:
    """Takes tosses one by one, as `DatasetWriter` does, and keeps them."""

    def __init__(self, model: ObjectModel) -> None:
        self._model, self._tosses = model, list[Toss]()
        self.dataset: Dataset | None = None

    def add(self, toss: Toss) -> None:
        self._tosses.append(toss)

    def finish(
        self,
        *,
        rate_hz: float,
        source: str,
        provenance: Mapping[str, Any],
        splits: Mapping[str, str] | None = None,
        order: RecordingOrder | None = None,
    ) -> None:
        if not self._tosses:
            raise InputError("the dataset has no tosses")
        given = splits or {}
        tosses = tuple(replace(toss, split=given.get(toss.name, toss.split)) for toss in self._tosses)
        self.dataset = Dataset(self._model, tosses, rate_hz, source, dict(provenance), order=order)


class DatasetOutput:
    """Where the tosses of a dataset go: to a file, or to memory."""

    def __init__(self, file: Path | None) -> None:
        """Collect tosses; `file`: the file to write, None for memory."""
        self._file = file
        self._memory: _InMemory | None = None

    @property
    def folder(self) -> Path:
        """A folder for temporary files: the output's, or the system's."""
        return Path(tempfile.gettempdir()) if self._file is None else self._file.parent

    @contextmanager
    def sink(self, model: ObjectModel) -> Iterator[DatasetWriter | _InMemory]:
        """What takes the tosses one by one, while the block lasts.

        Args:
            model: The object.
        """
        if self._file is not None:
            with dataset_writer(model, self._file) as writer:
                yield writer
        else:
            self._memory = _InMemory(model)
            yield self._memory

    def dataset(self, out: Path | None) -> Dataset:
        """The finished dataset.

        Args:
            out: The file, now in its place, from which tosses are read when they are asked for; None for memory.

        Returns:
            The dataset. The file is closed when the tosses are no longer used.
        """
        if out is None:
            assert self._memory is not None
            assert self._memory.dataset is not None
            return self._memory.dataset
        stack = ExitStack()
        dataset = stack.enter_context(open_dataset(out))
        weakref.finalize(dataset.tosses, stack.close)
        return dataset


@contextmanager
def dataset_output(out: Path | None) -> Iterator[DatasetOutput]:
    """A place for a dataset, while the block lasts.

    Args:
        out: The file to write, which appears whole when the block ends, or not at all; None for memory.
    """
    if out is None:
        yield DatasetOutput(None)
        return
    with output_file(out) as temporary:
        yield DatasetOutput(temporary)
