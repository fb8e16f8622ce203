"""Simulate the interactions of a scene in parallel, and put the finished ones together as a
dataset."""

import json
import multiprocessing
import os
import shutil
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
from tqdm import tqdm

from fem.data.interaction import healthy_interaction
from fem.data.write import write_dataset
from fem.errors import InputError
from fem.files import save_arrays
from fem.workers import start_worker


def generate(scene, path, workers=None):
    """Write the dataset of `scene` to `path` and return {reason: count} of the draws that were
    rejected.

    The result depends on the scene alone, not on the number of worker processes or on
    interruptions.
    """
    path, mesh = Path(path), scene.mesh.build()
    (
        scene.build_solver(mesh),
        scene.mesh.embed(mesh),
    )  # a scene that cannot start fails here, not in a worker
    workers = workers or len(os.sched_getaffinity(0))
    parts = path.with_name(f".{path.name}.{scene.digest()}.parts")
    parts.mkdir(parents=True, exist_ok=True)
    order = scene.interactions.all()
    todo = [(scene, parts, which) for which in order if not _part(parts, *which).is_file()]
    # fresh processes: forking would inherit the state of the thread pools
    context = multiprocessing.get_context("spawn")
    bar = tqdm(
        total=len(order),
        initial=len(order) - len(todo),
        desc=f"simulating {path.name}",
        unit="interaction",
    )
    with bar, ProcessPoolExecutor(min(workers, max(1, len(todo))), context, start_worker) as pool:
        try:
            for done in as_completed([pool.submit(_run, task) for task in todo]):
                done.result()
                bar.update()
        except BrokenProcessPool:
            raise InputError(
                f"a worker process died (out of memory?); {bar.n} of {len(order)} interactions are kept: run the same command again, with fewer --workers"
            ) from None
        except (
            BaseException
        ):  # Ctrl-C too: what has begun ends and is kept, the rest is not started
            pool.shutdown(cancel_futures=True)
            raise
    write_dataset(path, scene, mesh, (_read_part(_part(parts, *which)) for which in order))
    rejected = sum(
        (Counter(_read_part(_part(parts, *which))["rejected"]) for which in order), Counter()
    )
    shutil.rmtree(parts)
    return dict(rejected)


def _part(parts, split, number):
    return parts / f"{split}-{number:04d}.npz"


def _run(task):
    scene, parts, (split, number) = task
    result = healthy_interaction(scene, scene.mesh.build(), split, number)
    result["rejected"] = json.dumps(result["rejected"])
    save_arrays(_part(parts, split, number), **result)


def _read_part(path):
    with np.load(path) as part:
        return {name: part[name] for name in part.files if name != "rejected"} | {
            "rejected": json.loads(str(part["rejected"]))
        }
