"""Work by processes, by Dask's workers and by Slurm's jobs: the same numbers, and what happens when a worker dies."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from pipelines.cli import app
from pipelines.config.schemas import DaskLauncher, ProcessesLauncher, SlurmLauncher
from pipelines.execution.workers import _with_code, open_workers
from pipelines.tracking.runs import find_runs
from tests.pipelines.cluster import cluster, wait_for
from tests.pipelines.conftest import one_line
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


def test_an_error_of_ours_is_an_outcome_and_any_other_ends_the_work() -> None:
    assert words(list(as_done(halved, [4, 3, 2], None))) == {4: 2, 3: "3 is odd", 2: 1}
    with open_workers(HERE, 2) as there:
        assert words(list(as_done(halved, [4, 3, 2], there.submit))) == {4: 2, 3: "3 is odd", 2: 1}
    with pytest.raises(ZeroDivisionError):
        list(as_done(lambda x: 1 // x, [0], None))


def test_a_process_that_dies_ends_the_command_with_one_line() -> None:
    with pytest.raises(SolverError, match="a worker died or was lost"), open_workers(HERE, 1) as there:
        list(as_done(die_of_three, [1, 3, 5], there.submit))


def test_other_code_gives_no_numbers() -> None:
    with pytest.raises(InputError, match="another version of tossid"):
        _with_code("an older one's hash", computing_versions(), halved, 2)


def test_other_packages_give_no_numbers() -> None:
    here, there = computing_versions()["numpy"], {**computing_versions(), "numpy": "1.0"}
    with pytest.raises(InputError, match=rf"a worker has numpy {here} \(the command has 1\.0\); install the same"):
        _with_code("of any code", there, halved, 2)


def test_no_scheduler_there(project: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("distributed", reason="Dask is an extra: pip install -e '.[cluster]'")
    nobody = open_workers(DaskLauncher("dask", "tcp://127.0.0.1:9", None, False, 0.5), None)
    with pytest.raises(ConfigError, match=r"launcher\.address: no Dask scheduler answers at tcp://127"), nobody:
        pass
    assert app.run(["evaluate", "--sweep", "gravity", "launcher=dask"]) == 2
    assert "launcher.address: is needed" in one_line(capfd.readouterr().err)


@pytest.mark.parametrize("address", ["tcp://10.0.0.1:8786", "tcp://cluster.lab:8786"])
def test_a_scheduler_without_tls_on_another_machine_is_refused(address: str) -> None:
    with pytest.raises(ConfigError, match=r"has no TLS.*launcher\.tls=FOLDER"):
        open_workers(DaskLauncher("dask", address, None, False, 0.5), None).__enter__()


def test_a_folder_without_a_certificate_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"cert\.pem: no such file"):
        open_workers(DaskLauncher("dask", "tls://127.0.0.1:9", tmp_path, False, 0.5), None).__enter__()


def test_slurm_without_an_interface_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    assert app.run(["evaluate", "--sweep", "gravity", "launcher=slurm"]) == 2
    assert "launcher.interface: is needed" in one_line(capfd.readouterr().err)


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
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))  # what the job is to do stands in this file
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_slurms_jobs(slurm: Path) -> None:
    launcher = SlurmLauncher("slurm", 1, None, None, "1GiB", "00:10:00", "lo", True, 120.0)
    with open_workers(launcher, None) as there:
        assert there.count == 1
        assert words(list(as_done(halved, [4, 3], there.submit))) == {4: 2, 3: "3 is odd"}
    (job,) = (slurm / "sbatch.jobs").read_text().split()
    # ended with the command
    assert wait_for(lambda: not Path(f"/proc/{job}").exists() or "Z" in state_of(job), 60)


@pytest.mark.slow
def test_slurms_scheduler_takes_nobody_without_its_certificate(slurm: Path) -> None:
    from distributed import Client

    launcher = SlurmLauncher("slurm", 1, None, None, "1GiB", "00:10:00", "lo", True, 120.0)
    with open_workers(launcher, None) as there:
        address = there.executor._client.scheduler.address  # type: ignore[attr-defined]
        assert address.startswith("tls://127.0.0.1:")
        (certificates,) = (slurm / "outputs/logs/slurm").glob("tls-*")
        assert stat.S_IMODE(certificates.stat().st_mode) == 0o700
        for stranger in (address, address.replace("tls://", "tcp://")):
            with pytest.raises((OSError, TypeError, ValueError)):
                Client(stranger, timeout=3, set_as_default=False)
    assert not certificates.exists()


@pytest.mark.slow
@pytest.mark.usefixtures("slurm")
def test_slurms_jobs_have_all_died() -> None:
    launcher = SlurmLauncher("slurm", 1, None, None, "1GiB", "00:10:00", "lo", True, 30.0)
    with pytest.raises(SolverError, match=r"lost .NoWorkerError"), open_workers(launcher, None) as there:
        list(as_done(end_this_job, [1, 2], there.submit))


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
            [*there.head, sys.executable, "-m", "pipelines.cli.app", *study, *keys, "--json"],
            cwd=beside, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert wait_for(lambda: len(places()) >= 3 or running.poll() is not None, 300)
        done = len(places())
        there.workers[0].kill()
        killed = time.monotonic()
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
    print(f"networks apart: {there.apart}; killed after {done} of 24; done {time.monotonic() - killed:.0f} s later")


def imports_and_threads(module: str) -> tuple[bool, str]:
    return module in sys.modules, os.environ["OMP_NUM_THREADS"]


def test_workers_are_forked_from_a_process_that_has_imported_what_they_need(tmp_path: Path) -> None:
    """In a process of its own, of which such a process is begun once; Ctrl-C meanwhile is the command's alone."""
    script = tmp_path / "forked.py"
    script.write_text(
        "import os, signal, time\n"
        "from pipelines.execution.workers import import_for_workers, open_workers\n"
        "from tests.pipelines.execution.test_workers import HERE, imports_and_threads\n"
        "if __name__ == '__main__':\n"
        "    signal.signal(signal.SIGINT, lambda *_: print('Ctrl-C', flush=True))\n"
        "    import_for_workers(HERE, 'colorsys', 'torch')\n"
        "    os.killpg(0, signal.SIGINT)\n"
        "    with open_workers(HERE, 1) as there:\n"
        "        print(there.submit(imports_and_threads, 'colorsys').result())\n"
    )
    root = Path(__file__).resolve().parents[3]
    environment = {**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "7"}
    done = subprocess.run(
        [sys.executable, str(script)], env=environment, capture_output=True, text=True, start_new_session=True
    )
    assert done.stdout.splitlines() == ["Ctrl-C", "(True, '1')"]
    assert done.stderr == ""
