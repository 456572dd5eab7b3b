"""Work by processes, by Dask's workers and by Slurm's jobs: the same numbers, and what happens when a worker dies."""

from __future__ import annotations

import json
import os
import re
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from pipelines.config.schemas import DaskLauncher, ProcessesLauncher, SlurmLauncher
from pipelines.execution.workers import _with_code, submitting
from pipelines.tracking.runs import find_runs
from tests.conftest import ROOT
from tests.pipelines.disturbed import hooked
from tests.pipelines.processes import cluster, wait_for
from tests.pipelines.test_durability import PORTS, outside
from tests.test_parallel import die_of_three, halved
from tossid.errors import ConfigError, FileError, InputError, SolverError, TossidError
from tossid.parallel import as_done
from tossid.studies.cells import CELL
from tossid.versions import computing_versions

HERE = ProcessesLauncher("processes")


def end_this_job(x: int) -> int:
    os.killpg(0, signal.SIGKILL)
    return x


def words(found: list[tuple[int, Any]]) -> dict[int, Any]:
    return {x: str(y) if isinstance(y, TossidError) else y for x, y in found}


def test_an_error_of_ours_is_an_outcome_and_a_process_that_dies_ends_the_command_with_one_line() -> None:
    with submitting(HERE, 2, 3) as submit:
        assert words(list(as_done(halved, [4, 3, 2], submit))) == {4: 2, 3: "3 is odd", 2: 1}
    with pytest.raises(SolverError, match="a worker died or was lost"), submitting(HERE, 2, 3) as submit:
        list(as_done(die_of_three, [1, 3, 5], submit))


def test_a_worker_with_other_code_or_packages_gives_no_numbers() -> None:
    versions = computing_versions()
    with pytest.raises(InputError, match="another version of tossid"):
        _with_code("an older one's hash", versions, halved, 2)
    with pytest.raises(InputError, match=rf"numpy {versions['numpy']} \(the command has 1\.0\); install the same"):
        _with_code("of any code", {**versions, "numpy": "1.0"}, halved, 2)


@pytest.mark.parametrize(
    ("address", "tls", "error", "says"),
    [
        ("tcp://127.0.0.1:9", None, ConfigError, r"launcher\.address: no Dask scheduler answers at tcp://127"),
        ("tcp://10.0.0.1:8786", None, ConfigError, r"has no TLS.*launcher\.tls=FOLDER"),
        ("tcp://cluster.lab:8786", None, ConfigError, r"has no TLS.*launcher\.tls=FOLDER"),
        ("tls://127.0.0.1:9", "empty", FileError, r"cert\.pem: no such file"),
    ],
)
def test_schedulers_that_are_refused(
    tmp_path: Path, address: str, tls: str | None, error: type[TossidError], says: str
) -> None:
    pytest.importorskip("distributed", reason="Dask is an extra: pip install -e '.[cluster]'")
    launcher = DaskLauncher("dask", address, tmp_path / tls if tls else None, False, 0.5)
    with pytest.raises(error, match=says):
        submitting(launcher, None, 2).__enter__()


@pytest.fixture
def in_process() -> Iterator[str]:
    """The address of a scheduler with two workers in this process."""
    distributed = pytest.importorskip("distributed", reason="Dask is an extra: pip install -e '.[cluster]'")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as scheduler:
        yield scheduler.scheduler_address


def test_a_study_by_dask(beside: Path, answer: Any, in_process: str) -> None:
    small = ["sweep.models=[cn]", "sweep.values=[4.905,9.81]", "sweep.train=['epochs=1']", "data=tosses"]
    there = answer("evaluate", "--sweep", "gravity", *small, "launcher=dask", f"launcher.address={in_process}")
    (folder,) = beside.glob("outputs/sweeps/gravity-*")
    os.rename(folder, beside / "apart")
    here = answer("evaluate", "--sweep", "gravity", *small, "sweep.workers=1")
    assert numbers(here) == numbers(there)


def numbers(report: dict[str, Any]) -> list[Any]:
    return [{name: value for name, value in cell.items() if name not in ("run", "seconds")} for cell in report["cells"]]


FAKE_SBATCH = """#!/bin/sh
# What sbatch does for a user: keep the script, start it, say the job's number.
cp "$1" "$0.script"
setsid sh "$0.script" >> "$0.log" 2>&1 &
echo $! >> "$0.jobs"
echo "Submitted batch job $!"
"""


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Slurm itself is not there; its two commands are, and the jobs are real workers. Where these leave their notes."""
    pytest.importorskip("dask_jobqueue", reason="dask-jobqueue is an extra: pip install -e '.[cluster]'")
    command(tmp_path / "sbatch", FAKE_SBATCH)
    command(tmp_path / "scancel", '#!/bin/sh\nkill -- "-$1" 2>/dev/null || kill "$1"\n')
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))  # what the job is to do stands in this file
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_slurms_jobs_compute_and_nobody_is_taken_without_its_certificate(slurm: Path) -> None:
    from distributed import Client

    launcher = SlurmLauncher("slurm", 1, None, None, "1GiB", "00:10:00", "lo", True, 120.0)
    with submitting(launcher, None, 2) as submit:
        assert words(list(as_done(halved, [4, 3], submit))) == {4: 2, 3: "3 is odd"}
        (address,) = set(re.findall(r"tls://127.0.0.1:\d+", (slurm / "sbatch.script").read_text()))
        (certificates,) = (slurm / "outputs/logs/slurm").glob("tls-*")
        assert stat.S_IMODE(certificates.stat().st_mode) == 0o700
        for stranger in (address, address.replace("tls://", "tcp://")):
            with pytest.raises((OSError, TypeError, ValueError)):
                Client(stranger, timeout=3, set_as_default=False)
    assert not certificates.exists()
    (job,) = (slurm / "sbatch.jobs").read_text().split()
    # ended with the command
    assert wait_for(lambda: not Path(f"/proc/{job}").exists() or "Z" in state_of(job), 60)


@pytest.mark.slow
def test_slurms_scheduler_and_workers_listen_on_the_named_interface_alone(slurm: Path, beside: Path) -> None:
    keys = "sweep.models=[cn] sweep.train=['epochs=1'] sweep.values=[9.81] data=tosses launcher=slurm launcher.jobs=1"
    words = [*keys.split(), "launcher.interface=lo", "launcher.memory=2GiB", "--quiet"]
    hook = hooked(beside / "hook", PORTS, BOUND=str(beside / "bound"))
    command = [sys.executable, "-m", "pipelines.cli.app", "evaluate", "--sweep", "gravity", *words]
    subprocess.run(command, env=os.environ | hook, check=True, timeout=600)
    assert (beside / "bound").read_text(), "a scheduler has to listen somewhere"
    assert outside(beside / "bound") == []


@pytest.mark.slow
@pytest.mark.usefixtures("slurm")
def test_slurms_jobs_have_all_died() -> None:
    launcher = SlurmLauncher("slurm", 1, None, None, "1GiB", "00:10:00", "lo", True, 30.0)
    with pytest.raises(SolverError, match=r"lost .NoWorkerError"), submitting(launcher, None, 2) as submit:
        list(as_done(end_this_job, [1, 2], submit))


def state_of(pid: str) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "Z"


def command(path: Path, text: str) -> None:
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


@pytest.mark.slow
def test_a_worker_that_is_killed_is_replaced_by_the_others(beside: Path, answer: Any) -> None:
    """24 trainings by two workers; one is killed in the middle. Each cell once, with the numbers of this process."""
    pytest.importorskip("distributed", reason="Dask is an extra: pip install -e '.[cluster]'")
    study = ["evaluate", "--sweep", "gravity", "data=tosses", "sweep.models=[cn,cnrp]", "sweep.seeds=[0,1,2]"]
    study += ["sweep.values=[0,4.905,9.81,19.62]", "sweep.train=['epochs=2']"]
    places: Callable[[], list[Path]] = lambda: list(beside.glob(f"outputs/sweeps/*/cells/*/{CELL}"))  # noqa: E731
    elsewhere = beside / "elsewhere"
    elsewhere.mkdir()
    with cluster(elsewhere) as there:
        keys = [
            "launcher=dask",
            f"launcher.address={there.address}",
            f"launcher.tls={there.tls}",
            "launcher.wait_s=120",
        ]
        running = subprocess.Popen(
            [sys.executable, "-m", "pipelines.cli.app", *study, *keys, "--json"],
            cwd=beside, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert wait_for(lambda: len(places()) >= 3 or running.poll() is not None, 300)
        done = len(places())
        there.workers[0].kill()
        out, err = running.communicate(timeout=500)
        assert running.returncode == 0, err + (elsewhere / "cluster.log").read_text()[-3000:]
        assert there.workers[1].poll() is None
    assert 3 <= done < 24, "the worker was to be killed in the middle"
    report = json.loads(out)
    assert report["failed"] == []
    nested = find_runs(parent=report["run"])
    assert sorted(run.info.run_id for run in nested) == sorted(cell["run"] for cell in report["cells"])
    assert len(nested) == 24
    os.rename(beside / "outputs", beside / "apart")
    here = answer(*study, "sweep.workers=1")
    assert numbers(report) == numbers(here)


def test_a_worker_takes_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    with submitting(HERE, 2, 2) as submit:
        assert submit is not None
        assert submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"
