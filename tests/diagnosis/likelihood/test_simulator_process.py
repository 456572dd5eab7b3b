"""A user's simulator in a process of its own: right answers come back, and each way to fail is one clear error."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tossid.diagnosis.likelihood.simulator_process import FromFile, SimulatorProcess
from tossid.errors import InputError

Q0 = np.array([[0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.7, 0.0, 1.0, 0.0, 0.0]])

V0 = np.array([[0.3, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.4, 1.0, 0.0, 0.0, 0.0]])


def falling(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Free fall without spin."""
    t = dt * np.arange(n_steps + 1)[:, None]
    q, v = (np.repeat(each[:, None], n_steps + 1, axis=1) for each in (q0, v0))
    g = np.array([0.0, 0.0, -9.81])
    q[..., :3] += v0[:, None, :3] * t + 0.5 * g * t**2
    v[..., :3] += g * t
    return q, v


@pytest.fixture
def made() -> Iterator[Any]:
    processes: list[SimulatorProcess] = []

    def make(source: Any, seconds: float = 60.0) -> SimulatorProcess:
        process = SimulatorProcess(source, about="mine", seconds=seconds)
        processes.append(process)
        return process

    yield make
    for process in processes:
        process.close()


def test_motions_come_back_as_the_function_has_them(made: Any) -> None:
    process = made(falling)
    for got, wanted in zip(process(Q0, V0, 7, 0.01), falling(Q0, V0, 7, 0.01), strict=True):
        np.testing.assert_array_equal(got, wanted)
    assert process(Q0[:1], V0[:1], 2, 0.01)[0].shape == (1, 3, 7)
    assert process.frames == 2 * 7 + 2


def test_it_runs_in_another_process_that_starts_again_after_it_was_closed(made: Any) -> None:
    def telling(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
        q, v = falling(q0, v0, n_steps, dt)
        q[:, 1:, 0] = os.getpid() * 1e-6
        return q, v

    process = made(telling)
    first = process(Q0, V0, 1, 0.01)[0][0, 1, 0]
    assert first != os.getpid() * 1e-6
    assert process(Q0, V0, 1, 0.01)[0][0, 1, 0] == first
    process.close()
    assert process(Q0, V0, 1, 0.01)[0][0, 1, 0] not in (first, os.getpid() * 1e-6)


def but(**values: Any) -> Any:
    """Free fall with q or v at `at` set to something else."""

    def simulate(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> Any:
        q, v = falling(q0, v0, n_steps, dt)
        q[values["at"]] = values["is_"](q[values["at"]])
        return q, v

    return simulate


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (lambda *_: os.kill(os.getpid(), signal.SIGSEGV), r"its process crashed \(SIGSEGV\), called with 2 first"),
        (lambda *_: os._exit(3), r"its process ended \(exit status 3\)"),
        (
            but(at=np.s_[1, 3:, 2], is_=lambda x: np.nan),
            r"q that is not finite in 1 of 2 motions, in row 1 from frame 3 of 5",
        ),
        (lambda *each: tuple(x[:, 1:] for x in falling(*each)), r"q of shape \(2, 5, 7\), expected \(2, 6, 7\)"),
        (lambda q0, v0, *_: (np.broadcast_to(0.0, (10**6, 10**6)), v0), r"q of shape \(1000000, 1000000\), expected"),
        (but(at=np.s_[:, 1:, 2], is_=lambda x: 1e300), r"q of 1e\+300, expected at most 10000"),
        (but(at=np.s_[..., :3], is_=lambda x: x + 0.02), r"begin 0.02 from the first states"),
        (but(at=np.s_[..., 3:7], is_=lambda x: 1.5 * x), r"quaternions of length 1.5"),
        (lambda *_: {}["friction"], r"raises KeyError: 'friction' \(line \d+ of test_simulator_process.py\)"),
        (lambda *_: None, r"returns NoneType, expected a pair of arrays"),
    ],
    ids=["crash", "exit", "nan", "shape", "huge", "far", "first", "quaternion", "raises", "none"],
)
def test_each_failure_is_one_clear_error(made: Any, function: Any, says: str) -> None:
    with pytest.raises(InputError, match=f"mine: .*{says}"):
        made(function)(Q0, V0, 5, 0.01)


def test_a_hang_is_ended(made: Any) -> None:
    process = made(lambda *_: time.sleep(60), seconds=1.0)
    began = time.perf_counter()
    with pytest.raises(InputError, match="gave no answer within 1 s, and was ended"):
        process(Q0, V0, 5, 0.01)
    assert time.perf_counter() - began < 30


LEFT = """
import os, subprocess, sys, time
from pathlib import Path
from tossid.diagnosis.likelihood.simulator_process import FromFile, SimulatorProcess
import numpy as np

def hangs(*_):
    started = subprocess.Popen(["sleep", "600"])
    Path("started").write_text(f"{os.getpid()} {started.pid}")
    time.sleep(600)

if __name__ == "__main__":
    source = hangs if sys.argv[1] == "given" else FromFile(Path(__file__), "hangs")
    SimulatorProcess(source, about="mine", seconds=600.0)(np.zeros((1, 7)), np.zeros((1, 6)), 1, 0.01)
"""


@pytest.mark.parametrize(
    ("source", "end"), [("given", signal.SIGKILL), ("file", signal.SIGTERM), ("file", signal.SIGINT)]
)
def test_nothing_is_left_of_a_simulator_whose_command_has_ended(
    source: str, end: signal.Signals, tmp_path: Path
) -> None:
    (tmp_path / "left.py").write_text(LEFT)
    command = subprocess.Popen([sys.executable, "left.py", source], cwd=tmp_path, stderr=subprocess.DEVNULL)
    _until(lambda: len((tmp_path / "started").read_text().split()) == 2 if (tmp_path / "started").exists() else False)
    left = [int(pid) for pid in (tmp_path / "started").read_text().split()]
    command.send_signal(end)
    command.wait(30)
    _until(lambda: not any(_running(pid) for pid in left))


def _until(true: Callable[[], bool]) -> None:
    began = time.monotonic()
    while not true():
        assert time.monotonic() - began < 60
        time.sleep(0.05)


def _running(pid: int) -> bool:
    """Whether a process is there, and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_a_function_of_a_file(made: Any, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(
        "import numpy as np\nprint('loaded')\n"
        "def simulate(q0, v0, n_steps, dt):\n"
        "    print('called')\n"
        "    return np.repeat(q0[:, None], n_steps + 1, 1), np.repeat(v0[:, None], n_steps + 1, 1)\n"
    )
    still, _ = made(FromFile(path, "simulate"))(Q0, V0, 3, 0.01)
    np.testing.assert_array_equal(still, np.repeat(Q0[:, None], 4, axis=1))
    with pytest.raises(InputError, match="has no function 'other'"):
        made(FromFile(path, "other"))(Q0, V0, 3, 0.01)
    path.write_text("import no_such_engine\n")
    with pytest.raises(InputError, match=r"cannot be loaded: ModuleNotFoundError.*\(line 1 of mine.py\)"):
        made(FromFile(path, "simulate"))(Q0, V0, 3, 0.01)
