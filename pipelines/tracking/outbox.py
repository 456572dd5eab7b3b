"""Messages from a run to its tracking server: sent at once or, while the server is away, kept on disk and sent later.

A message that cannot be sent is a file in outputs/unsent/RUN/, with a copy of the artifact that it carries. The folder
names the server that the messages are for, and they are sent to no other. They are sent again while the run continues,
when it ends, and by every later command that tracks with that server. Sending twice does no harm: MLflow keeps a point
of a metric once, and the other messages replace themselves. A message that the server refuses is set aside in
outputs/unsent/RUN/refused/, with a warning.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.tracking.addresses import redacted, without_password
from pipelines.tracking.mlflow_store import is_remote
from tossid.errors import OutputError
from tossid.outputs import only_writer, output_file, output_folder

if TYPE_CHECKING:
    from mlflow import MlflowClient

UNSENT = Path("outputs/unsent")
"""Folder of messages that wait, relative to the folder that a command is run in."""
RETRY_S = 10.0
"""Time between two attempts while a run continues [s]."""
_SERVER = "server.json"
_REFUSED = "refused"
_WITH_FILES = ("artifact",)


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


_SEND: dict[str, Callable[..., None]] = {
    "metrics": _metrics,
    "params": _params,
    "data": _data,
    "artifact": _artifact,
    "tag": lambda client, run, name, value: client.set_tag(run, name, value),
    "text": lambda client, run, text, name: client.log_text(run, text, name),
    "end": lambda client, run, status, when: client.set_terminated(run, status, when),
}


@dataclass(frozen=True)
class Waiting:
    """Messages of one run that wait on disk.

    Attributes:
        folder: Where they are.
        server: Address of the server that they are for, without its password; "" if it is not known.
        count: Number of messages to be sent.
        refused: Number of messages that the server has refused.
    """

    folder: Path
    server: str
    count: int
    refused: int


class Outbox:
    """Messages of one run, in order.

    Args:
        client: MLflow's client. A store of files is never away: what it refuses is an error at once.
        run: The run's id.
        warn: Takes a sentence about messages that the server has refused.
    """

    def __init__(self, client: MlflowClient, run: str, *, warn: Callable[[str], None] = lambda text: None) -> None:
        self.folder = UNSENT.absolute() / run
        self._client, self._run, self._remote, self._warn = client, run, is_remote(client), warn
        self._tried = float("-inf")

    def send(self, kind: str, *values: Any) -> None:
        """Send a message, or keep it if the server is away or earlier messages still wait.

        Args:
            kind: One of metrics, params, data, artifact, tag, text, end.
            values: What the message holds.

        Raises:
            MlflowException: A store of files refuses it.
        """
        if self.waiting():
            self._keep(kind, values)
            if time.monotonic() - self._tried > RETRY_S:
                self.send_waiting()
            return
        try:
            _SEND[kind](self._client, self._run, *values)
        except Exception as error:
            if not self._remote or not _from_server(error):
                raise
            kept = self._keep(kind, values)
            if is_away(error):
                self._tried = time.monotonic()
            else:
                self._set_aside(kept, error)

    def waiting(self) -> int:
        """Number of messages that wait to be sent."""
        return len(_messages(self.folder))

    def send_waiting(self) -> bool:
        """Send the messages that wait, in order. Those that the server refuses are set aside.

        Returns:
            Whether no message waits any more.
        """
        for path in _messages(self.folder):
            message = json.loads(path.read_text())
            values = message["values"]
            if message["kind"] in _WITH_FILES:
                values[0] = str(self.folder / values[0])
            try:
                _SEND[message["kind"]](self._client, self._run, *values)
            except Exception as error:
                self._tried = time.monotonic()
                if not _from_server(error):
                    raise
                if is_away(error):
                    return False
                self._set_aside(path, error)
                continue
            path.unlink()
            shutil.rmtree(path.with_suffix(""), ignore_errors=True)
        if not (self.folder / _REFUSED).exists():
            shutil.rmtree(self.folder, ignore_errors=True)
        return True

    def _keep(self, kind: str, values: tuple[Any, ...]) -> Path:
        there = _messages(self.folder) + _messages(self.folder / _REFUSED)
        number = max((int(path.stem) for path in there), default=-1) + 1
        if not (self.folder / _SERVER).exists():
            with output_file(self.folder / _SERVER) as temporary:
                temporary.write_text(json.dumps({"uri": _address(self._client)}))
        plain = list(values)
        if kind in _WITH_FILES:
            source = Path(values[0])
            plain[0] = f"{number:06d}/{source.name}"
            with output_folder(self.folder / f"{number:06d}", made_by="tracking") as copy:
                if source.is_dir():
                    shutil.copytree(source, copy / source.name)
                else:
                    shutil.copy2(source, copy / source.name)
        path = self.folder / f"{number:06d}.json"
        with output_file(path) as temporary:
            temporary.write_text(json.dumps({"kind": kind, "values": plain}))
        return path

    def _set_aside(self, message: Path, error: BaseException) -> None:
        """Move a message that the server refuses out of the way of those behind it."""
        refused = self.folder / _REFUSED
        refused.mkdir(exist_ok=True)
        if message.with_suffix("").exists():
            os.replace(message.with_suffix(""), refused / message.stem)
        os.replace(message, refused / message.name)
        first = redacted(str(error).partition("\n")[0])
        self._warn(f"the tracking server refuses a message of run {self._run} ({first}); it is set aside in {refused}")


def _messages(folder: Path) -> list[Path]:
    return sorted(folder.glob("[0-9]*.json"))


def _address(client: MlflowClient) -> str:
    """What messages know their server by: address and user. No password, nor a digest by which one can be guessed."""
    return without_password(str(client.tracking_uri))


def _kept_address(folder: Path) -> str:
    try:
        return str(json.loads((folder / _SERVER).read_text())["uri"])
    except (OSError, ValueError, KeyError, TypeError):  # of an earlier version
        return ""


def _from_server(error: BaseException) -> bool:
    from mlflow.exceptions import MlflowException

    return isinstance(error, MlflowException)


def is_away(error: BaseException) -> bool:
    """Whether the server could not be reached or could not answer, as when its database is away."""
    from mlflow.exceptions import MlflowException

    return isinstance(error, MlflowException) and error.get_http_status_code() >= 500


def waiting_messages() -> list[Waiting]:
    """Messages that wait or were refused, a run an entry."""
    found = []
    for folder in sorted(UNSENT.glob("*")):
        count, refused = len(_messages(folder)), len(_messages(folder / _REFUSED))
        if count or refused:
            found.append(Waiting(folder, _kept_address(folder), count, refused))
    return found


def send_unsent(client: MlflowClient, *, warn: Callable[[str], None] = lambda text: None) -> None:
    """Send what earlier commands kept for this server. Runs that still continue send for themselves.

    Args:
        client: MLflow's client. Messages for other servers stay where they are.
        warn: Takes a sentence about messages that the server has refused.
    """
    here = _address(client)
    for waiting in waiting_messages():
        if not waiting.count or _kept_address(waiting.folder) != here:
            continue
        with suppress(OutputError), only_writer(waiting.folder):
            if not Outbox(client, waiting.folder.name, warn=warn).send_waiting():
                return
