"""Simulate the interactions of a scene in parallel and write them to one HDF5 file.

    python -m fem.generate configs/tumour.toml [--out data/tumour.h5] [--workers 2]

Finished interactions wait in a folder beside the file, so a run that was stopped goes on where it was.
"""

import argparse
import json
import multiprocessing
import os
import shutil
import signal
import threading
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from fem.dataset import open_dataset, write_dataset
from fem.errors import InputError, command_line
from fem.interaction import healthy_interaction
from fem.scene import load_scene


def generate(scene, path, workers=None):
    """Write the dataset of `scene` to `path` and return {reason: count} of the draws that were rejected.

    The result depends on the scene alone, not on the number of worker processes or on interruptions.
    """
    path, mesh = Path(path), scene.mesh.build()
    scene.build_solver(mesh), scene.mesh.embed(mesh)  # a scene that cannot start fails here, not in a worker
    workers = workers or len(os.sched_getaffinity(0))
    parts = path.with_name(f".{path.name}.{scene.digest()}.parts")
    parts.mkdir(parents=True, exist_ok=True)
    order = scene.interactions.all()
    todo = [(scene, parts, which) for which in order if not _part(parts, *which).is_file()]
    # fresh processes: forking would inherit the state of the thread pools
    context = multiprocessing.get_context("spawn")
    bar = tqdm(total=len(order), initial=len(order) - len(todo), desc=f"simulating {path.name}", unit="interaction")
    with bar, ProcessPoolExecutor(min(workers, max(1, len(todo))), context, start_worker) as pool:
        try:
            for done in as_completed([pool.submit(_run, task) for task in todo]):
                done.result()
                bar.update()
        except BrokenProcessPool:
            raise InputError(
                f"a worker process died (out of memory?); {bar.n} of {len(order)} interactions are kept: run the same command again, with fewer --workers"
            ) from None
        except BaseException:  # Ctrl-C too: what has begun ends and is kept, the rest is not started
            pool.shutdown(cancel_futures=True)
            raise
    write_dataset(path, scene, mesh, (_read_part(_part(parts, *which)) for which in order))
    rejected = sum((Counter(_read_part(_part(parts, *which))["rejected"]) for which in order), Counter())
    shutil.rmtree(parts)
    return dict(rejected)


def _part(parts, split, number):
    return parts / f"{split}-{number:04d}.npz"


def start_worker():
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is answered by the parent alone
    threadpool_limits(1)  # one thread a process, and sums in one order whatever the number of cores
    # a parent that was killed leaves no orphans behind: they would compute on, or wait for ever
    parent = multiprocessing.parent_process()
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


def _run(task):
    scene, parts, (split, number) = task
    result = healthy_interaction(scene, scene.mesh.build(), split, number)
    result["rejected"] = json.dumps(result["rejected"])
    save_arrays(_part(parts, split, number), **result)


def save_arrays(path, **arrays):
    """np.savez to `path`, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    try:
        with open(partial, "wb") as file:
            np.savez(file, **arrays)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _read_part(path):
    with np.load(path) as part:
        return {name: part[name] for name in part.files if name != "rejected"} | {"rejected": json.loads(str(part["rejected"]))}


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(prog="python -m fem.generate", description=__doc__.split("\n")[0])
    parser.add_argument("scene", help="scene file, such as configs/tumour.toml")
    parser.add_argument("--out", type=Path, help="HDF5 file to write (default: data/<scene>.h5)")
    parser.add_argument("--workers", type=int, help="processes (default: one per core)")
    parser.add_argument("--quiet", action="store_true", help="show the progress alone")
    options = parser.parse_args(arguments)
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers} must be at least 1")
    scene = load_scene(options.scene)
    out = options.out or Path("data") / f"{Path(options.scene).stem}.h5"
    if out.is_file():
        raise InputError(f"{out} exists already; delete it to make it again, or give another --out")
    rejected = generate(scene, out, options.workers)
    counts = ", ".join(f"{reason} {count}" for reason, count in sorted(rejected.items())) or "none"
    print(f"wrote {out} ({out.stat().st_size / 1e6:.0f} MB); rejected draws: {counts}")
    lost = open_dataset(out).embedding_error
    if lost:
        print(f"the mesh has no node grid of its own: from it to the grid and back, displacement changes by {100 * lost:.2g} % (relative L2)")
    if not options.quiet:
        print(f"next: python -m unet_fem.train scene={options.scene} data={out} name={out.stem}")


if __name__ == "__main__":
    main()
