"""Who does the work: this process, others, or other machines. One answer for every function that takes `workers`."""

from __future__ import annotations

import logging
import pickle
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    as_completed,
    wait,
)
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import resource_tracker
from typing import Protocol, TypeVar, runtime_checkable

from sampling_design.checkers.strict import is_whole
from sampling_design.errors import ArgumentError, MissingExtraError, SolverError
from sampling_design.records.budget import now

MOST_KILLED = 3  # times that processes may be killed in a row before any of them has finished a job

PATIENCE = 5.0
"""Seconds after which an address where no scheduler answers is said to be none, and a silent one is asked."""

LONGEST_WITHOUT = 60.0
"""Seconds for which a cluster may have no worker: one that grows with its work needs some of them to begin."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@runtime_checkable
class Client(Protocol):
    """What hands out an executor and knows who works there: a Dask client."""

    status: str

    def get_executor(self) -> Executor:
        """Return the executor that runs on the client's machines."""
        ...

    def nthreads(self) -> Mapping[str, int]:
        """Return the workers that are there, with their threads."""
        ...

    def close(self) -> None:
        """Leave the scheduler."""
        ...


Workers = Executor | Client | int | str | None
"""An executor or a Dask client, a number of processes (-1: one per core), the name of a joblib backend, or nobody."""


def check_workers(workers: Workers) -> None:
    """Refuse what is nobody's name.

    Raises ArgumentError if a number of processes is 0 or below -1, or no backend has that name.
    """
    if workers is None or isinstance(workers, (Executor, Client)):
        return
    if is_whole(workers):
        if workers < 1 and workers != -1:
            raise ArgumentError(
                f"`workers` must be a number of processes of at least 1 (or -1: one per core), got {workers}."
            )
        return
    from joblib.parallel import BACKENDS, EXTERNAL_BACKENDS

    known = sorted({*BACKENDS, *EXTERNAL_BACKENDS})
    if workers not in known:
        raise ArgumentError(f"`workers` must name a joblib backend, one of {', '.join(known)}, got {workers!r}.")


def numbered(
    function: Callable[[Item], Result], items: Sequence[Item], workers: Workers
) -> Iterator[tuple[int, Result]]:
    """Yield (number, function(item)) for every item, computed by `workers`, as they are finished.

    A worker that is killed takes nothing with it: what was finished stays, the rest is done by new processes, by this
    one where the executor is not ours to renew, or by the other workers of a Dask cluster. Raises ArgumentError as
    `check_workers`, and if a pool of processes cannot be told of the function; SolverError if processes keep being
    killed before they finish anything; if the scheduler of a cluster is lost, or its last worker, or a job kills every
    worker that takes it up. What was finished by then has been yielded.
    """
    check_workers(workers)
    todo = dict(enumerate(items))
    match workers:
        case None:
            return ((k, function(item)) for k, item in todo.items())
        case Executor():
            if (client := getattr(workers, "_client", None)) is not None:  # that of Dask
                return _on_a_cluster(function, todo, workers, client)
            if isinstance(workers, ProcessPoolExecutor):
                _check_can_travel(function, todo)
            return _surviving(function, todo, workers, None)
        case int():
            return _surviving(function, todo, None, partial(_processes, workers))
        case Client():
            return _on_a_cluster(function, todo, workers.get_executor(), workers)
    from joblib import Parallel, delayed

    chosen = Parallel(n_jobs=-1, backend=workers, return_as="generator_unordered")
    return iter(chosen(delayed(_with_number)(function, k, item) for k, item in todo.items()))


def _check_can_travel(function: Callable[[Item], Result], todo: dict[int, Item]) -> None:
    """Refuse what the standard library's processes cannot be told of; processes of our own can."""
    try:
        pickle.dumps((function, next(iter(todo.values()), None)))
    except (AttributeError, TypeError, pickle.PicklingError) as error:
        raise ArgumentError(
            "`workers`: a ProcessPoolExecutor can only be told of functions that its processes can import, those of a "
            f"module ({error}). Name such a one, or give a number of processes."
        ) from None


def _with_number(function: Callable[[Item], Result], k: int, item: Item) -> tuple[int, Result]:
    return k, function(item)


def _ready() -> None:
    """Let an interrupt end this process without a word: the one that hands out the work says so once."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def _deaf() -> Iterator[None]:
    """Processes that begin inside hear no interrupt before they are ready: they inherit that from here."""
    resource_tracker.ensure_running()  # begun inside it would unblock the signal behind our back (Python 3.11)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _processes(count: int) -> Executor:
    """Processes of our own, new ones where the last were killed."""
    from joblib import cpu_count
    from joblib.externals.loky import get_reusable_executor

    many = cpu_count() if count < 0 else count
    pool: Executor = get_reusable_executor(max_workers=many, initializer=_ready)
    with _deaf(), suppress(BrokenExecutor):
        pool.submit(_ready)  # starts them all
    return pool


def _surviving(
    function: Callable[[Item], Result],
    todo: dict[int, Item],
    executor: Executor | None,
    renewed: Callable[[], Executor] | None,
) -> Iterator[tuple[int, Result]]:
    """Yield what an executor computes, and go on where it breaks."""
    idle = 0
    while todo:
        pool = executor if renewed is None else renewed()
        assert pool is not None
        before, futures = len(todo), dict[Future[Result], int]()
        try:
            for k, item in todo.items():
                futures[pool.submit(function, item)] = k
        except BrokenExecutor:
            pass  # it broke while it was given work: what it has finished by then still counts
        try:
            for future in as_completed(futures):
                try:
                    result = future.result()
                except BrokenExecutor:
                    continue
                k = futures[future]
                del todo[k]
                yield k, result
        finally:
            for future in futures:
                future.cancel()
        if not todo:
            return
        if renewed is None:  # a broken executor stays broken
            for k, item in list(todo.items()):
                yield k, function(item)
            return
        idle = 0 if len(todo) < before else idle + 1
        if idle == MOST_KILLED:
            raise SolverError(
                f"`workers`: processes were killed {MOST_KILLED} times before they finished anything, with {len(todo)} "
                "jobs left. Is the memory too small for so many? Fewer workers need less."
            )


def _on_a_cluster(
    function: Callable[[Item], Result], todo: dict[int, Item], executor: Executor, client: Client
) -> Iterator[tuple[int, Result]]:
    """Yield what the workers of a Dask cluster compute; a dead one is replaced by the others, as Dask does."""
    futures = dict[Future[Result], int]()
    killed = done = 0

    def ended(why: str) -> SolverError:
        return SolverError(
            f"`workers`: {why}, with {len(todo) - done} of {len(todo)} jobs left. What was finished is kept where "
            "`resume` names a file (`-o DIR` on the command line): the same call goes on from there."
        )

    try:
        for k, item in todo.items():
            try:
                futures[executor.submit(function, item)] = k
            except Exception:
                if client.status == "running":
                    raise
                raise ended("the Dask scheduler was lost") from None
        for future in _finished(futures, client, ended):
            try:
                result = future.result()
            except CancelledError:
                raise ended("the Dask scheduler was lost") from None
            except getattr(sys.modules.get("distributed"), "KilledWorker", ()):
                killed += 1
                continue
            done += 1
            yield futures[future], result
        if killed:
            raise ended("the jobs that are left killed every worker of the cluster that took them up (out of memory?)")
    finally:
        for future in futures:
            future.cancel()


def _finished(
    futures: Iterable[Future[Result]], client: Client, ended: Callable[[str], SolverError]
) -> Iterator[Future[Result]]:
    """Yield futures as they end, unless the cluster is left without scheduler or without workers."""
    waiting, last_alive = set(futures), now()
    while waiting:
        finished, waiting = wait(waiting, timeout=PATIENCE, return_when=FIRST_COMPLETED)
        yield from sorted(finished, key=lambda future: future.cancelled() or future.exception() is not None)
        try:
            if finished or client.nthreads():
                last_alive = now()
        except (OSError, TimeoutError):
            raise ended("the Dask scheduler was lost") from None
        if now() - last_alive > LONGEST_WITHOUT:
            raise ended(f"the Dask cluster has had no worker for {LONGEST_WITHOUT:g} s")


def cluster(address: str) -> Client:
    """Return a Dask client of a scheduler.

    Raises ArgumentError if none answers at that address; MissingExtraError if distributed is not installed.
    """
    try:
        from distributed import Client as DaskClient
    except ImportError:
        raise MissingExtraError("distributed", "distributed") from None
    for name in (
        "distributed",
        "distributed.client",
        "distributed.core",
        "tornado.application",
    ):  # what is lost is said once, by us
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        connect: Callable[..., Client] = DaskClient
        client = connect(address, timeout=PATIENCE)
    except (OSError, TimeoutError, ValueError) as error:
        raise ArgumentError(
            f"`scheduler` must be the address of a running Dask scheduler such as tcp://10.0.0.5:8786, got {address!r} "
            f"({str(error) or type(error).__name__:.80})."
        ) from None
    return client
