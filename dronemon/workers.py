"""Work shared out over processes that end with the one that started them, however it ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import Connection, Pipe
from multiprocessing.synchronize import Event
from typing import TypeVar

from dronemon.errors import WorkerError

T = TypeVar("T")
R = TypeVar("R")


def share_out(
    do: Callable[[T], R], items: Sequence[T], num_workers: int, cluster: Executor | None = None
) -> Generator[R]:
    """Do something to each item in processes, and give each result when it is there.

    In this process if one worker would do it all; by the cluster's if there is one. One thread
    works on each item, so that results depend neither on the number of workers nor on who does
    what.

    Raises WorkerError if a process dies, and what `do` raises.
    """
    if cluster is not None:
        yield from _as_done(cluster, do, items)
        return
    num_workers = min(num_workers, len(items))
    if num_workers <= 1:
        with _one_thread():
            yield from map(do, items)
        return
    context = multiprocessing.get_context("spawn")
    has_begun = context.Event()
    wanted, want = Pipe(duplex=False)
    pool = ProcessPoolExecutor(num_workers, context, _prepare, (wanted, has_begun))
    try:
        yield from _as_done(pool, do, items)
    except BrokenProcessPool as exc:
        raise WorkerError(_cause_of_death(num_workers, has_begun)) from exc
    finally:
        want.close()
        pool.shutdown(cancel_futures=True)
        wanted.close()


def _as_done(executor: Executor, do: Callable[[T], R], items: Sequence[T]) -> Generator[R]:
    for future in as_completed([executor.submit(do, item) for item in items]):
        yield future.result()


def num_cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _cause_of_death(num_workers: int, has_begun: Event) -> str:
    """What to do about a process that died, as far as can be told."""
    if has_begun.is_set():
        return (
            f"one of {num_workers} worker processes died, perhaps for want of memory; the same "
            "command goes on where this run was, --workers sets how many there are"
        )
    return (
        f"none of {num_workers} worker processes could begin: each first imports the script that "
        "started it; put what the script does, not what it defines, under "
        '`if __name__ == "__main__":`'
    )


def _prepare(wanted: Connection, has_begun: Event) -> None:
    """One thread per process, and interrupts only for the parent, which ends the others.

    wanted: pipe whose other end the parent alone holds: closed when the run ends, also by SIGKILL
    """
    import torch  # not before: who only counts cores does without

    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_when_unwanted, args=(wanted,), daemon=True).start()
    has_begun.set()


def _end_when_unwanted(wanted: Connection) -> None:
    """End this process, in whatever it does, when the other end is closed."""
    wanted.poll(None)
    os._exit(0)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Use one thread, as workers do."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
