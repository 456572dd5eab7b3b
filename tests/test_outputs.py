"""Outputs appear whole or not at all, whatever ends the command."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tossid import outputs
from tossid.errors import InputError, OutputError
from tossid.outputs import move_files, output_file, output_folder, output_stream, recover_folder


def entries(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "a.h5"
    with output_file(out) as temporary:
        temporary.write_text("new")
        assert temporary.suffix == ".h5"
        assert not out.exists()
    assert out.read_text() == "new"
    assert entries(out.parent) == ["a.h5"]


def test_an_error_leaves_the_earlier_file(tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    out.write_text("old")
    with pytest.raises(RuntimeError), output_file(out) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert out.read_text() == "old"
    assert entries(tmp_path) == ["a.h5"]


def test_a_folder_is_replaced_whole(tmp_path: Path) -> None:
    out = tmp_path / "rec"
    for content in ("one", "two"):
        with output_folder(out, made_by="test") as temporary:
            (temporary / content).write_text(content)
    assert entries(out) == [outputs.MARKER, "two"]
    assert entries(tmp_path) == ["rec"]


def test_a_replacement_that_died_halfway_is_put_back(tmp_path: Path) -> None:
    (tmp_path / ".rec.old").mkdir()
    (tmp_path / ".rec.old" / outputs.MARKER).write_text("{}")
    (tmp_path / ".rec.old" / "kept").write_text("kept")
    outputs.recover_folder(tmp_path / "rec")
    assert (tmp_path / "rec" / "kept").read_text() == "kept"


def test_the_folder_that_one_is_in_is_put_back_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (tmp_path / ".mine.old").mkdir()
    monkeypatch.chdir(folder)
    recover_folder(Path("."))
    assert folder.is_dir()
    assert not (tmp_path / ".mine.old").exists()


def test_an_error_leaves_the_earlier_folder(tmp_path: Path) -> None:
    out = tmp_path / "rec"
    with output_folder(out, made_by="test") as temporary:
        (temporary / "one").write_text("one")
    with pytest.raises(KeyboardInterrupt), output_folder(out, made_by="test") as temporary:
        (temporary / "two").write_text("two")
        raise KeyboardInterrupt
    assert entries(out) == [outputs.MARKER, "one"]
    assert entries(tmp_path) == ["rec"]


def test_a_strangers_folder_is_never_replaced(tmp_path: Path) -> None:
    out = tmp_path / "thesis"
    out.mkdir()
    (out / "chapter.tex").write_text("years of work")
    with pytest.raises(InputError, match="did not write"), output_folder(out, made_by="test"):
        pass
    assert (out / "chapter.tex").read_text() == "years of work"


def test_files_take_the_places_of_others(tmp_path: Path) -> None:
    for name, content in {"new/a": "2", "new/in/b": "2", "old/a": "1", "old/c": "1"}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    move_files(tmp_path / "new", tmp_path / "old")
    found = {path.relative_to(tmp_path / "old"): path.read_text() for path in (tmp_path / "old").rglob("?")}
    assert found == {Path("a"): "2", Path("in/b"): "2", Path("c"): "1"}


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    out = tmp_path / "rec"
    out.mkdir()
    with output_folder(out, made_by="test") as temporary:
        (temporary / "one").write_text("one")
    assert (out / "one").is_file()


def test_a_folder_where_a_file_should_go(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"), output_file(tmp_path):
        pass


@pytest.mark.parametrize(
    ("code", "words"), [(errno.ENOSPC, "disk is full"), (errno.EROFS, "read-only"), (errno.EACCES, "no permission")]
)
def test_the_disks_refusals_become_one_error(tmp_path: Path, code: int, words: str) -> None:
    out = tmp_path / "a.h5"
    out.write_text("old")
    with pytest.raises(OutputError, match=words) as caught, output_file(out) as temporary:
        temporary.write_text("half")
        raise OSError(code, os.strerror(code))
    assert str(out) in str(caught.value)
    assert out.read_text() == "old"
    assert entries(tmp_path) == ["a.h5"]


def test_a_full_disk_while_flushing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    out = tmp_path / "a.h5"
    monkeypatch.setattr(outputs.os, "fsync", full)
    with pytest.raises(OutputError, match="disk is full"), output_file(out) as temporary:
        temporary.write_text("new")
    assert entries(tmp_path) == []


def test_a_full_disk_as_hdf5_words_it(tmp_path: Path) -> None:
    words = "[Errno 28] Can't write data (file write failed: errno = 28, error message = 'No space left on device')"
    assert outputs.disk_problem(OSError(words)) == "the disk is full"


def test_errors_about_other_files_are_not_blamed_on_the_output(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(PermissionError), output_file(tmp_path / "out" / "a.h5"):
        raise PermissionError(errno.EACCES, "no", str(tmp_path / "input.h5"))


def test_a_second_writer_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    with output_file(out) as temporary:
        with pytest.raises(OutputError, match=f"another tossid command .*{os.getpid()}"), output_file(out):
            pass
        temporary.write_text("first")
    assert out.read_text() == "first"
    assert entries(tmp_path) == ["a.h5"]


WRITER = """
import sys, time
from pathlib import Path
from tossid.outputs import output_file
with output_file(Path(sys.argv[1])) as temporary:
    temporary.write_text("half")
    print("writing", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize(("number", "left"), [(signal.SIGINT, 1), (signal.SIGKILL, 3)])
def test_a_killed_writer_leaves_the_earlier_file(tmp_path: Path, number: signal.Signals, left: int) -> None:
    out = tmp_path / "a.h5"
    out.write_text("old")
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(out)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"writing\n"
        with pytest.raises(OutputError, match=str(writer.pid)), output_file(out):
            pass
        writer.send_signal(number)
        writer.communicate(timeout=20)
    assert out.read_text() == "old"
    assert len(entries(tmp_path)) == left  # a killed process cannot tidy up
    with output_file(out) as temporary:  # the next one does, and is not held back by a dead one's lock
        temporary.write_text("new")
    assert out.read_text() == "new"
    assert entries(tmp_path) == ["a.h5"]


def test_a_killed_writer_of_a_folder_is_tidied_up_after(tmp_path: Path) -> None:
    script = WRITER.replace("output_file(Path(sys.argv[1]))", "output_folder(Path(sys.argv[1]), made_by='test')")
    script = script.replace("import output_file", "import output_folder").replace(
        'temporary.write_text("half")', '(temporary / "half").write_text("half")'
    )
    out = tmp_path / "rec"
    with output_folder(out, made_by="test") as temporary:
        (temporary / "one").write_text("one")
    with subprocess.Popen([sys.executable, "-c", script, str(out)], stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"writing\n"
        writer.kill()
    assert len(entries(tmp_path)) == 3
    assert entries(out) == [outputs.MARKER, "one"]
    with output_folder(out, made_by="test") as temporary:
        (temporary / "two").write_text("two")
    assert entries(out) == [outputs.MARKER, "two"]
    assert entries(tmp_path) == ["rec"]


def test_what_a_killed_writer_leaves_goes_with_the_next(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with output_file(path) as temporary, output_stream(temporary) as stream:
        stream.write(b"half")
        left = [name for name in entries(tmp_path) if not name.endswith(".lock")]
    assert len(left) == 1
    (tmp_path / left[0]).write_bytes(b"half")  # as kill -9 would have left it
    with output_file(path) as temporary:
        temporary.write_text("new")
    assert entries(tmp_path) == ["a.h5"]


def test_other_outputs_temporaries_are_left_alone(tmp_path: Path) -> None:
    others = [".ab.tmp-1-00000000.h5", ".a.tmp-1-00000000.txt", ".a.tmp-mine.h5"]
    for name in others:
        (tmp_path / name).write_text("")
    (tmp_path / ".a.tmp-1-00000000.h5").write_text("")
    with output_file(tmp_path / "a.h5") as temporary:
        temporary.write_text("new")
    assert entries(tmp_path) == sorted([*others, "a.h5"])


def test_a_rooms_word_about_the_temporary_names_the_output(tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    words = r"a\.h5: cannot be written: the disk is full"
    with pytest.raises(OutputError, match=words) as caught, output_file(out) as temporary:
        raise OutputError(f"{temporary}: no") from full
    assert ".tmp-" not in str(caught.value)


def test_many_writers_leave_one_whole_file(tmp_path: Path) -> None:
    script = WRITER.replace("time.sleep(60)", "time.sleep(0.02); temporary.write_text('whole' * 1000)")
    deadline = time.monotonic() + 20
    writers = [
        subprocess.Popen(
            [sys.executable, "-c", script, str(tmp_path / "a.h5")], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for _ in range(4)
    ]
    codes = [writer.wait(timeout=max(1, deadline - time.monotonic())) for writer in writers]
    assert 0 in codes
    assert (tmp_path / "a.h5").read_text() == "whole" * 1000
    assert entries(tmp_path) == ["a.h5"]
