"""Where many pieces of work are done: one loop over `concurrent.futures`, whoever the workers are.

Processes of this machine, a Dask scheduler's workers, or Slurm's jobs. Each gives an `Executor`; nothing here
schedules or retries. Dask gives a dead worker's work to another; a process of this machine that dies ends the
command, which goes on with what is done when it is given again. Workers share files with the command, under the
same absolute paths, and its code.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import connection
from typing import Any, TypeVar

from pipelines.schemas.launching import DaskLauncher, Launcher, SlurmLauncher
from pipelines.version import code_digest
from tossid.errors import ConfigError, InputError, SolverError, TossidError

T = TypeVar("T")
R = TypeVar("R")

EXTRA = "pip install 'tossid[cluster]'"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Workers:
    """Workers that are there: what they do work for, and how much of it at the same time."""

    executor: Executor
    count: int

    def submit(self, function: Callable[..., R], *args: Any) -> Future[R]:
        """Have it done by a worker, if that has the same code."""
        return self.executor.submit(_with_code, code_digest(), function, *args)


def as_done(
    function: Callable[[T], R], items: Sequence[T], submit: Callable[[Callable[[T], R], T], Future[R]] | None
) -> Iterator[tuple[T, R | TossidError]]:
    """Each item with what `function` gave of it (or the error that it ended in), as they are done.

    Args:
        submit: of an executor, or of `Workers`; None: one after another, here.

    Raises:
        SolverError: workers died, or can no longer be reached. What is not done is cancelled, as on any other end.
    """
    if submit is None:
        for item in items:
            yield item, _outcome(lambda item=item: function(item))  # type: ignore[misc]
        return
    waiting = {submit(function, item): item for item in items}
    try:
        for done in as_completed(list(waiting)):
            yield waiting.pop(done), _outcome(done.result)
    except BaseException as error:
        for future in waiting:
            future.cancel()
        if not _lost(error):
            raise
        problem = (
            f"a worker died or was lost ({type(error).__name__}; of lack of memory?); what is done is kept, and the "
            "same command goes on with it; fewer workers take less memory"
        )
        raise SolverError(problem, count=len(waiting) + 1, total=len(items)) from error


def _outcome(result: Callable[[], R]) -> R | TossidError:
    try:
        return result()
    except TossidError as error:
        return error


def _lost(error: BaseException) -> bool:
    """Whether workers are gone, not the work wrong."""
    if isinstance(error, (BrokenExecutor, CancelledError)):
        return True
    if "distributed" not in sys.modules:
        return False
    from distributed import KilledWorker
    from distributed.scheduler import NoWorkerError

    return isinstance(error, (KilledWorker, NoWorkerError))


def _with_code(code: str, function: Callable[..., R], *args: Any) -> R:
    """Call it, unless this worker's code would give other numbers."""
    if code_digest() != code:
        raise InputError("a worker has another version of tossid than the command; install the same on both")
    return function(*args)


# ---------------------------------------------------------------- who the workers are


@contextmanager
def open_workers(launcher: Launcher, count: int | None) -> Iterator[Workers]:
    """Workers, while the command needs them; whatever ends it ends their work at once.

    Args:
        launcher: who they are.
        count: how many processes, None for one a core. A cluster has as many as it has.

    Raises:
        ConfigError: the cluster cannot be reached, or does not know tossid.
    """
    if isinstance(launcher, DaskLauncher):
        with _dask(launcher.address, launcher.wait_s, "launcher.address") as found:
            yield found
    elif isinstance(launcher, SlurmLauncher):
        with _slurm(launcher) as cluster, _dask(cluster, launcher.wait_s, "launcher.jobs") as found:
            yield Workers(found.executor, launcher.jobs)
    else:
        count = count or os.cpu_count() or 1
        with _processes(count) as pool:
            yield Workers(pool, count)


@contextmanager
def _processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread each."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))  # libraries read it when a worker imports them
    pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


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
def _dask(scheduler: Any, wait_s: float, key: str) -> Iterator[Workers]:
    """The workers of a scheduler (an address, or a cluster of dask-jobqueue), once there is one."""
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError("launcher", f"Dask is not installed; {EXTRA} installs it.") from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is raised too, and reported here
    try:
        client = Client(scheduler, timeout=wait_s, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigError(key, f"no Dask scheduler answers at {scheduler}; expected tcp://HOST:PORT.") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=wait_s)
        except TimeoutError as error:
            raise ConfigError(key, f"no worker came within {wait_s:g} s.") from error
        try:
            client.run(code_digest)
        except ImportError as error:
            raise ConfigError(key, f"its workers cannot import tossid ({error}).") from error
        executor = client.get_executor(pure=False)
        try:
            yield Workers(executor, sum(client.nthreads().values()))
        except BaseException:
            executor.shutdown(wait=False)
            raise


@contextmanager
def _slurm(launcher: SlurmLauncher) -> Iterator[Any]:
    """Jobs of one core, ended with the command."""
    try:
        import dask
        from dask_jobqueue import SLURMCluster
    except ImportError as error:
        raise ConfigError("launcher", f"dask-jobqueue is not installed; {EXTRA} installs it.") from error
    # jobs that all have ended are not followed by others
    patience = {"distributed.scheduler.no-workers-timeout": f"{launcher.wait_s}s"}
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
                log_directory=os.path.abspath("outputs/logs/slurm"),
                job_script_prologue=[f"export {name}=1" for name in _ONE_THREAD],
                scheduler_options={"dashboard": False},
            )
    except (OSError, ValueError, RuntimeError) as error:
        raise ConfigError("launcher", f"jobs cannot be submitted to Slurm ({error}).") from error
    with cluster:
        yield cluster
