"""Many independent simulations on all cores, or on an executor of the user's own."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import Any

import psutil
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from fem.errors import InputError
from fem.ranges import checked, shown


def available_cores() -> int:
    """How many cores this process may use."""
    try:
        return len(psutil.Process().cpu_affinity())
    except AttributeError:  # macOS binds no process to cores
        return psutil.cpu_count() or 1


def on_all_cores(
    function: Callable[..., Any],
    tasks: Iterable[tuple],
    title: str,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    keep: Callable[[tuple, Any], Any] | None = None,
    unit: str = "run",
    before: int = 0,
) -> list:
    """[function(*task) for task in tasks], with one thread each; `title` stands before the bar.

    executor: any of concurrent.futures, or one that Dask's Client.get_executor() gives; it is left
    open. Without one, `workers` fresh processes (default: one a core).
    keep: called in this process as keep(task, result) as soon as a task has ended, in any order;
    what it gives stands in the list. before: tasks of an earlier run, for the bar.

    `keep`, or the function itself, puts what was finished in files. After an error or Ctrl-C what
    has begun ends and is kept, the rest is not started. Raises InputError if a worker process dies.
    """
    tasks = list(tasks)
    results: list = [None] * len(tasks)
    bar = tqdm(total=before + len(tasks), initial=before, desc=title, unit=unit)
    jobs: dict[Future, int] = {}

    def finish(job: Future) -> None:
        i = jobs.pop(job)  # and with it the result, which may be large
        results[i] = keep(tasks[i], job.result()) if keep else job.result()
        bar.update()

    # one thread a task, and sums in one order whatever the number of cores; here for threads
    with bar, threadpool_limits(1), _pool(executor, workers, len(tasks)) as pool:
        try:
            jobs.update((pool.submit(_alone, function, *task), i) for i, task in enumerate(tasks))
            for job in as_completed(list(jobs)):
                finish(job)
        except BaseException as error:
            for job in as_completed([job for job in jobs if not job.cancel()]):
                if not job.exception():
                    with suppress(InputError):  # it could not be kept: the first one's error counts
                        finish(job)
            done = f"{bar.n} of {bar.total} {unit}s are kept; run the same command again"
            if isinstance(error, BrokenExecutor):
                raise InputError(
                    f"a worker process died (out of memory?); {done}, with fewer workers"
                ) from None
            if isinstance(error, InputError) and keep and bar.n:
                kept = f"{bar.n} of {bar.total} {unit}s are kept"
                raise InputError(f"{error}; {kept}") from None
            if isinstance(error, KeyboardInterrupt):
                raise KeyboardInterrupt(f"{done} to go on") from None
            raise
    return results


def _pool(
    executor: Executor | None, workers: int | None, tasks: int
) -> AbstractContextManager[Executor]:
    if executor is not None:
        if not hasattr(executor, "submit"):
            raise InputError(f"the executor is {shown(executor)}; give one of concurrent.futures")
        return nullcontext(executor)  # the user's, who shuts it down
    if workers is not None:
        checked("workers", workers, 1, 10_000, whole=True)
    if tasks == 1:
        return _Here()
    workers = max(1, min(workers or available_cores(), tasks))
    # fresh processes: forking would inherit the state of the thread pools
    return ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _start_worker)


class _Here(Executor):
    """This process, for a task that is not worth another."""

    def submit(self, function, /, *task):
        job: Future = Future()
        try:
            job.set_result(function(*task))
        except Exception as error:
            job.set_exception(error)
        return job


def _alone(function, *task):
    threadpool_limits(1)
    return function(*task)


def _start_worker():
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is answered by the parent alone
    # a parent that was killed leaves no orphans behind: they would compute on, or wait for ever
    parent = multiprocessing.parent_process()
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
