"""Many independent simulations on all cores."""

import multiprocessing
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor, as_completed

from threadpoolctl import threadpool_limits
from tqdm import tqdm


def start_worker():
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is answered by the parent alone
    threadpool_limits(1)  # one thread a process, and sums in one order whatever the number of cores
    # a parent that was killed leaves no orphans behind: they would compute on, or wait for ever
    parent = multiprocessing.parent_process()
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


def on_all_cores(function, tasks, title):
    """[function(*task) for task in tasks], in processes of one thread each; `title` stands before
    the bar.

    The functions keep what they have finished in files, so that after an interruption the rest
    alone is left.
    """
    tasks = list(tasks)
    if len(tasks) == 1:  # not worth a process
        with threadpool_limits(1):
            return [function(*tasks[0])]
    workers = max(1, min(len(os.sched_getaffinity(0)), len(tasks)))
    bar = tqdm(total=len(tasks), desc=title, unit="run")
    with (
        bar,
        ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), start_worker) as pool,
    ):
        jobs = [pool.submit(function, *task) for task in tasks]
        try:
            for done in as_completed(jobs):
                done.result()
                bar.update()
        except BaseException:  # what has begun ends and is kept, the rest is not started
            pool.shutdown(cancel_futures=True)
            raise
    return [job.result() for job in jobs]
