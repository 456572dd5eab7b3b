"""Many calls of one function, in this process or by any executor."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future, as_completed
from typing import TypeVar

from tossid.errors import SolverError, TossidError

T = TypeVar("T")
R = TypeVar("R")


def as_done(
    function: Callable[[T], R], items: Sequence[T], submit: Callable[..., Future[R]] | None = None
) -> Iterator[tuple[T, R | TossidError]]:
    """Each item with the function's result, in the order in which they are done.

    Args:
        function: What is computed of an item.
        items: The items.
        submit: Of an executor (`concurrent.futures`); None to compute them one after another, in this process.

    Yields:
        An item, and its result or the `TossidError` that it ended in.

    Raises:
        SolverError: Workers died, or can no longer be reached. The rest is cancelled, as on any other end.
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
            f"a worker died or was lost ({type(error).__name__}; perhaps for lack of memory); what is done is kept, "
            "and the same command continues; fewer workers take less memory"
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
