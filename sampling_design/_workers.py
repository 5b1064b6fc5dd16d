"""Who does the work: this process, others, or other machines. One answer for every function that takes `workers`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, as_completed
from typing import Protocol, TypeVar, runtime_checkable

from sampling_design.errors import ArgumentError

Item = TypeVar("Item")
Result = TypeVar("Result")


@runtime_checkable
class Client(Protocol):
    """What hands out an executor: a Dask client."""

    def get_executor(self) -> Executor:
        """Return the executor that runs on the client's machines."""
        ...


Workers = Executor | Client | int | str | None
"""An executor or a Dask client, a number of processes (-1: one per core), the name of a joblib backend, or nobody."""


def check_workers(workers: Workers) -> None:
    """Refuse what is nobody's name.

    Raises
    ------
    ArgumentError
        If a number of processes is 0 or below -1, or no backend has that name.
    """
    if workers is None or isinstance(workers, (Executor, Client)):
        return
    if isinstance(workers, int) and not isinstance(workers, bool):
        if workers < 1 and workers != -1:
            raise ArgumentError(
                f"`workers` must be a number of processes of at least 1 (or -1: one per core), got {workers}."
            )
        return
    from joblib.parallel import BACKENDS, EXTERNAL_BACKENDS

    known = sorted({*BACKENDS, *EXTERNAL_BACKENDS})
    if workers not in known:
        raise ArgumentError(f"`workers` must name a joblib backend, one of {', '.join(known)}, got {workers!r}.")


def mapped(
    function: Callable[[Item], Result], items: Sequence[Item], workers: Workers, ordered: bool = True
) -> Iterator[Result]:
    """Yield function(item) for every item, computed by `workers`; in order, or as they are finished.

    Raises
    ------
    ArgumentError
        As `check_workers`.
    """
    check_workers(workers)
    if workers is None:
        return map(function, items)
    if isinstance(workers, (Executor, Client)):
        executor = workers if isinstance(workers, Executor) else workers.get_executor()
        if ordered:
            return iter(executor.map(function, items))
        return (future.result() for future in as_completed([executor.submit(function, item) for item in items]))
    from joblib import Parallel, delayed

    chosen = {"n_jobs": workers} if isinstance(workers, int) else {"n_jobs": -1, "backend": workers}
    order = {} if ordered else {"return_as": "generator_unordered"}
    return iter(Parallel(**order, **chosen)(delayed(function)(item) for item in items))
