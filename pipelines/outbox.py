"""What a run tells the tracking server: at once, or, while that is away, kept on disk and told later in order.

A message that cannot be told lies as a file in outputs/unsent/RUN/, with a copy of the artifact that it
brings. It is tried again now and then while its run goes on, when the run ends, and by every later command that
tracks. Telling twice does no harm: MLflow keeps a metric's point once, and the rest replaces itself.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.outputs import only_writer, output_file, output_folder
from tossid.errors import OutputError

if TYPE_CHECKING:
    from mlflow import MlflowClient

UNSENT = Path("outputs/unsent")
PATIENCE = 10.0
"""Seconds between two tries while a run goes on."""
_FILES = ("artifact",)


def _metrics(client: MlflowClient, run: str, points: list[list[Any]]) -> None:
    from mlflow.entities import Metric

    client.log_batch(run, metrics=[Metric(*point) for point in points])


def _params(client: MlflowClient, run: str, values: dict[str, str]) -> None:
    from mlflow.entities import Param

    client.log_batch(run, params=[Param(name, value) for name, value in values.items()])


def _data(client: MlflowClient, run: str, dataset: dict[str, str], tags: dict[str, str]) -> None:
    from mlflow.entities import Dataset, DatasetInput, InputTag

    given = DatasetInput(Dataset(**dataset), [InputTag(name, value) for name, value in tags.items()])
    client.log_inputs(run, [given])


def _artifact(client: MlflowClient, run: str, path: str, folder: str | None) -> None:
    if Path(path).is_dir():
        client.log_artifacts(run, path, folder)
    else:
        client.log_artifact(run, path, folder)


_TELL: dict[str, Callable[..., None]] = {
    "metrics": _metrics,
    "params": _params,
    "data": _data,
    "artifact": _artifact,
    "tag": lambda client, run, name, value: client.set_tag(run, name, value),
    "text": lambda client, run, text, name: client.log_text(run, text, name),
    "end": lambda client, run, status, when: client.set_terminated(run, status, when),
}


class Outbox:
    """Messages of one run, in order.

    Args:
        remote: whether the store is a server; what a store of files refuses is an error at once.
    """

    def __init__(self, client: MlflowClient, run: str, *, remote: bool) -> None:
        self.folder = UNSENT.absolute() / run
        self._client, self._run, self._remote = client, run, remote
        self._tried = float("-inf")

    def tell(self, kind: str, *values: Any) -> None:
        """Tell the server, or keep it if the server is away or has not been told what came before."""
        if self.waiting():
            self._keep(kind, values)
            if time.monotonic() - self._tried > PATIENCE:
                self.send()
            return
        try:
            _TELL[kind](self._client, self._run, *values)
        except Exception as error:
            if not (self._remote and is_away(error)):
                raise
            self._tried = time.monotonic()
            self._keep(kind, values)

    def waiting(self) -> int:
        """How many messages are kept."""
        return len(_messages(self.folder))

    def send(self) -> bool:
        """Tell what is kept; whether nothing is left.

        Raises:
            MlflowException: the server is there, and refuses.
        """
        for path in _messages(self.folder):
            message = json.loads(path.read_text())
            values = message["values"]
            if message["kind"] in _FILES:
                values[0] = str(self.folder / values[0])
            try:
                _TELL[message["kind"]](self._client, self._run, *values)
            except Exception as error:
                self._tried = time.monotonic()
                if not is_away(error):
                    raise
                return False
            path.unlink()
            shutil.rmtree(path.with_suffix(""), ignore_errors=True)
        shutil.rmtree(self.folder, ignore_errors=True)
        return True

    def _keep(self, kind: str, values: tuple[Any, ...]) -> None:
        there = _messages(self.folder)
        number = int(there[-1].stem) + 1 if there else 0
        plain = list(values)
        if kind in _FILES:
            source = Path(values[0])
            plain[0] = f"{number:06d}/{source.name}"
            with output_folder(self.folder / f"{number:06d}", made_by="tracking") as copy:
                if source.is_dir():
                    shutil.copytree(source, copy / source.name)
                else:
                    shutil.copy2(source, copy / source.name)
        with output_file(self.folder / f"{number:06d}.json") as temporary:
            temporary.write_text(json.dumps({"kind": kind, "values": plain}))


def _messages(folder: Path) -> list[Path]:
    return sorted(folder.glob("[0-9]*.json"))


def is_away(error: BaseException) -> bool:
    """Whether the server could not be reached or could not answer (its database is away, say)."""
    from mlflow.exceptions import MlflowException

    return isinstance(error, MlflowException) and error.get_http_status_code() >= 500


def unsent_runs() -> list[Path]:
    """Folders of runs with messages that wait."""
    return sorted(folder for folder in UNSENT.glob("*") if _messages(folder))


def send_unsent(client: MlflowClient) -> None:
    """Tell what earlier commands could not; runs that are still going on tell for themselves."""
    for folder in unsent_runs():
        with suppress(OutputError), only_writer(folder):
            if not Outbox(client, folder.name, remote=True).send():
                return
