"""Many independent simulations on all cores."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor, as_completed

from threadpoolctl import threadpool_limits
from tqdm import tqdm

from fem.generate import start_worker


def on_all_cores(function, tasks, title):
    """[function(*task) for task in tasks], in processes of one thread each; `title` stands before the bar.

    The functions keep what they have finished in files, so that after an interruption the rest alone is left.
    """
    tasks = list(tasks)
    if len(tasks) == 1:  # not worth a process
        with threadpool_limits(1):
            return [function(*tasks[0])]
    workers = max(1, min(len(os.sched_getaffinity(0)), len(tasks)))
    bar = tqdm(total=len(tasks), desc=title, unit="run")
    with bar, ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), start_worker) as pool:
        jobs = [pool.submit(function, *task) for task in tasks]
        try:
            for done in as_completed(jobs):
                done.result()
                bar.update()
        except BaseException:  # what has begun ends and is kept, the rest is not started
            pool.shutdown(cancel_futures=True)
            raise
    return [job.result() for job in jobs]
