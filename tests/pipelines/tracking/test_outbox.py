"""Messages to a tracking server: none is lost while it is away, and none goes to another server."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pipelines.tracking.outbox import UNSENT, Outbox, Waiting, send_unsent, waiting_messages

SERVER = "http://ann:secret@tracking.lab:5000"


class Recorder:
    """A client that notes what is sent, that cannot reach its server, or whose server refuses."""

    def __init__(self, uri: str = SERVER) -> None:
        self.tracking_uri = uri
        self.sent: list[Any] = []
        self.away = False
        self.refuses: tuple[str, ...] = ()

    def __getattr__(self, name: str) -> Any:
        def call(run: str, *args: Any, **more: Any) -> None:
            from mlflow.exceptions import MlflowException

            if self.away:
                raise MlflowException("API request failed with exception Connection refused")
            if name in self.refuses:
                raise MlflowException.invalid_parameter_value("no such run")
            if name == "log_artifact":
                args = (Path(args[0]).read_text(), *args[1:])
            if "metrics" in more:
                args = tuple(point.step for point in more["metrics"])
            self.sent.append((name, *args))

        return call


@pytest.fixture
def client() -> Any:
    return Recorder()


def test_messages_wait_in_order_and_survive_their_process(project: Path, client: Any) -> None:
    box = Outbox(client, "r1")
    box.send("tag", "a", "1")
    client.away = True
    (project / "note.txt").write_text("first")
    box.send("metrics", [["loss", 0.5, 7, 1]])
    box.send("artifact", "note.txt", None)
    (project / "note.txt").write_text("changed since")
    box.send("metrics", [["loss", 0.4, 8, 2]])
    assert (box.waiting(), client.sent) == (3, [("set_tag", "a", "1")])
    assert waiting_messages() == [Waiting(UNSENT / "r1", "http://ann:***@tracking.lab:5000", 3, 0)]

    send_unsent(client)  # the next command, in vain
    assert box.waiting() == 3
    client.away = False
    send_unsent(client)
    assert client.sent[1:] == [("log_batch", 1), ("log_artifact", "first", None), ("log_batch", 2)]
    assert waiting_messages() == []
    assert list(UNSENT.glob("*")) == []


@pytest.mark.parametrize(
    "other", ["http://bob:secret@tracking.lab:5000", "http://elsewhere:5000", "sqlite:///mlflow.db"]
)
def test_a_message_is_sent_to_its_own_server_only(project: Path, client: Any, other: str) -> None:
    client.away = True
    Outbox(client, "r1").send("tag", "a", "1")
    elsewhere: Any = Recorder(other)
    send_unsent(elsewhere)
    assert elsewhere.sent == []
    assert [waiting.count for waiting in waiting_messages()] == [1]


def test_neither_a_password_lies_on_disk_nor_what_depends_on_it(project: Path) -> None:
    """A digest of the address would let a short password be guessed."""
    kept = []
    for password in ("secret", "another"):
        client: Any = Recorder(f"http://ann:{password}@tracking.lab:5000")
        client.away = True
        Outbox(client, password).send("tag", "a", "1")
        kept.append({path.name: path.read_bytes() for path in (UNSENT / password).iterdir()})
        assert not [name for name, content in kept[-1].items() if password.encode() in content]
    assert kept[0] == kept[1]


def test_a_new_password_gets_what_waits(project: Path, client: Any) -> None:
    client.away = True
    Outbox(client, "r1").send("tag", "a", "1")
    renewed: Any = Recorder(SERVER.replace("secret", "renewed"))
    send_unsent(renewed)
    assert renewed.sent == [("set_tag", "a", "1")]
    assert waiting_messages() == []


def test_a_refused_message_is_set_aside_with_a_warning_and_the_others_are_sent(project: Path, client: Any) -> None:
    said: list[str] = []
    client.away = True
    box = Outbox(client, "r1", warn=said.append)
    (project / "note.txt").write_text("a note")
    box.send("tag", "a", "1")
    box.send("artifact", "note.txt", None)
    box.send("text", "words", "words.md")
    client.away, client.refuses = False, ("log_artifact",)
    send_unsent(client, warn=said.append)
    assert [name for name, *_ in client.sent] == ["set_tag", "log_text"]
    (line,) = said
    assert "r1" in line
    assert "no such run" in line
    assert [(waiting.count, waiting.refused) for waiting in waiting_messages()] == [(0, 1)]
    assert (UNSENT / "r1/refused/000001/note.txt").read_text() == "a note"

    send_unsent(client, warn=said.append)  # it is not tried again
    assert len(said) == 1


def test_a_message_that_is_refused_at_once_is_set_aside_too(project: Path, client: Any) -> None:
    said: list[str] = []
    client.refuses = ("set_tag",)
    box = Outbox(client, "r1", warn=said.append)
    box.send("tag", "a", "1")
    box.send("text", "words", "words.md")
    assert [name for name, *_ in client.sent] == ["log_text"]
    assert len(said) == 1


@pytest.mark.parametrize("reason", ["away", "refuses"])
def test_a_store_of_files_is_never_away(project: Path, reason: str) -> None:
    from mlflow.exceptions import MlflowException

    client: Any = Recorder("sqlite:///mlflow.db")
    setattr(client, reason, True if reason == "away" else ("set_tag",))
    with pytest.raises(MlflowException):
        Outbox(client, "r1").send("tag", "a", "1")
    assert waiting_messages() == []


def test_a_command_runs_while_messages_for_a_dead_server_wait(beside: Path, answer: Any, client: Any) -> None:
    client.away = True
    Outbox(client, "0" * 32).send("tag", "a", "1")
    answer("register", "name=cube")
    trained = answer("train", "model=cn", "epochs=1", "data=tosses")
    assert trained["model"] == "cn"
    assert [waiting.count for waiting in waiting_messages()] == [1]


def test_the_doctor_lists_what_waits_and_for_whom(project: Path, answer: Any, client: Any) -> None:
    client.away = True
    Outbox(client, "r1").send("tag", "a", "1")
    found = answer("doctor")["findings"]
    (line,) = [finding for finding in found if finding["what"] == "unsent messages"]
    assert "http://ann:***@tracking.lab:5000" in json.dumps(line)
    assert "secret" not in json.dumps(found)
    assert "outputs/unsent/r1" in line["advice"]
