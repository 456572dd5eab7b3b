"""Workers for many pieces of work: one loop over `concurrent.futures`, whatever the workers are.

They are processes of this machine, a Dask scheduler's workers, or Slurm's jobs. Each kind gives an `Executor`; nothing
here schedules or retries. Dask gives a dead worker's work to another. A process of this machine that dies ends the
command; the same command, given again, continues. Workers share files with the command, under the same absolute paths,
and its code.
"""

from __future__ import annotations

import ipaddress
import logging
import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import connection
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from pipelines.config.schemas import DaskLauncher, Launcher, ProcessesLauncher, SlurmLauncher
from pipelines.execution.process import environment, interrupted_later
from tossid.code_digest import code_digest
from tossid.errors import ConfigError, FileError, InputError
from tossid.versions import computing_versions, differing_versions

R = TypeVar("R")
Submit = Callable[..., Future[Any]]

EXTRA = "pip install 'tossid[cluster]'"
_LOOPBACK = "127.0.0.1:0"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@contextmanager
def submitting(launcher: Launcher, count: int | None, items: int) -> Iterator[Submit | None]:
    """What gives work to workers for as long as the command needs them. Its end, of any kind, ends their work.

    Args:
        launcher: Which workers.
        count: Number of processes, None for one a core; a cluster has its own number. With one, none is started.
        items: How many pieces of work there are.

    Yields:
        `submit` of an executor; None where this process does the work alone.

    Raises:
        ConfigError: The cluster cannot be reached, has no TLS, or cannot import tossid.
    """
    workers: AbstractContextManager[Executor] | None
    match launcher:
        case ProcessesLauncher():
            count = min(count or os.cpu_count() or 1, items)
            workers = _processes(count) if count > 1 else None
        case DaskLauncher():
            workers = _dask(launcher)
        case SlurmLauncher():
            workers = _slurm(launcher)
    if not items or workers is None:
        yield None
        return
    with workers as executor:

        def submit(function: Callable[..., R], *args: Any) -> Future[R]:
            with interrupted_later():  # a worker that starts as its command ends complains of a lost lock
                return executor.submit(_with_code, _code(), computing_versions(), function, *args)

        yield submit


def _code() -> str:
    """Digest of the code that a worker may run."""
    return code_digest("tossid", "pipelines")


def _with_code(code: str, versions: dict[str, str], function: Callable[..., R], *args: Any) -> R:
    """Call it, unless this worker's code or packages would give other numbers."""
    differing = differing_versions(computing_versions(), versions)
    if differing:
        pairs = ", ".join(f"{name} {here} (the command has {there})" for name, here, there in differing)
        raise InputError(f"a worker has {pairs}; install the same on both")
    if _code() != code:
        raise InputError("a worker has another version of tossid than the command; install the same on both")
    return function(*args)


@contextmanager
def _processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread each: libraries read that when they are imported."""
    with environment(dict.fromkeys(_ONE_THREAD, "1")):
        pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)
        try:
            yield pool
        except BaseException:
            for child in multiprocessing.active_children():
                child.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """Begin a process: Ctrl-C is its parent's business, and it does not outlive its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


# ---------------------------------------------------------------- clusters


@contextmanager
def _dask(launcher: DaskLauncher) -> Iterator[Executor]:
    """The workers of a scheduler that runs already."""
    if not launcher.insecure and launcher.address.startswith("tcp://") and not _is_loopback(launcher.address):
        problem = f"{launcher.address} has no TLS: whoever reaches that port can run code as you."
        expected = "Expected tls://HOST:PORT and launcher.tls=FOLDER (or launcher.insecure=true)."
        raise ConfigError("launcher.address", f"{problem} {expected}")
    with _client(launcher.address, launcher.wait_s, "launcher.address", security=_certified(launcher.tls)) as executor:
        yield executor


@contextmanager
def _client(scheduler: Any, wait_s: float, key: str, *, security: Any = None) -> Iterator[Executor]:
    """The workers of a scheduler (an address, or a cluster of dask-jobqueue), once it has one."""
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError("launcher", f"Dask is not installed; {EXTRA} installs it.") from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is raised too, and reported here
    try:
        client = Client(scheduler, timeout=wait_s, set_as_default=False, security=security)
    except (OSError, ValueError) as error:
        raise ConfigError(key, f"no Dask scheduler answers at {scheduler}; expected tls://HOST:PORT.") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=wait_s)
            client.run(code_digest)
        except TimeoutError as error:
            raise ConfigError(key, f"no worker came within {wait_s:g} s.") from error
        except ImportError as error:
            raise ConfigError(key, f"its workers cannot import tossid ({error}).") from error
        executor = client.get_executor(pure=False)
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False)
            raise


def _is_loopback(address: str) -> bool:
    host = urlsplit(address).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _certified(folder: Path | None) -> Any:
    """Dask's security from a folder with a certificate, which is its own authority; None without a folder."""
    if folder is None:
        return None
    cert, key = folder / "cert.pem", folder / "key.pem"
    for path in (cert, key):
        if not path.is_file():
            raise FileError(path, "no such file; launcher.tls names a folder with cert.pem and key.pem")
    from distributed.security import Security

    return Security(tls_ca_file=str(cert), tls_client_cert=str(cert), tls_client_key=str(key), require_encryption=True)


@contextmanager
def _slurm(launcher: SlurmLauncher) -> Iterator[Executor]:
    """Jobs of one core, ended with the command.

    The scheduler listens on `launcher.interface` alone, with TLS. Its certificate and key are in a folder of mode 0700
    below outputs/logs/slurm, which the jobs read them from. Dask always opens a port for HTTP; it is on loopback, and
    has no dashboard.
    """
    try:
        import dask
        from dask_jobqueue import SLURMCluster
    except ImportError as error:
        raise ConfigError("launcher", f"dask-jobqueue is not installed; {EXTRA} installs it.") from error
    logs = Path("outputs/logs/slurm").absolute()
    logs.mkdir(parents=True, exist_ok=True)
    # Jobs that have ended are not replaced.
    patience = {"distributed.scheduler.no-workers-timeout": f"{launcher.wait_s}s"}
    with tempfile.TemporaryDirectory(prefix="tls-", dir=logs) as certificates:  # made with mode 0700
        try:
            with dask.config.set(patience):
                cluster = SLURMCluster(
                    queue=launcher.queue,
                    account=launcher.account,
                    memory=launcher.memory,
                    walltime=launcher.walltime,
                    interface=launcher.interface,
                    cores=1,
                    processes=1,
                    n_workers=launcher.jobs,
                    job_name="tossid",
                    log_directory=str(logs),
                    job_script_prologue=[f"export {name}=1" for name in _ONE_THREAD],
                    security=True if launcher.tls else None,
                    shared_temp_directory=certificates,
                    scheduler_options={"dashboard": False, "dashboard_address": _LOOPBACK},
                    worker_extra_args=["--no-dashboard", "--dashboard-address", _LOOPBACK],
                )
        except (OSError, ValueError, RuntimeError) as error:
            raise ConfigError("launcher", f"jobs cannot be submitted to Slurm ({error}).") from error
        with cluster, _client(cluster, launcher.wait_s, "launcher.jobs") as executor:
            yield executor
