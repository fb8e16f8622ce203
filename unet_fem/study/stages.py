"""The measurements of a study, in order. Each leaves its figures as JSON, and one that is there is
not taken again."""

import importlib
import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

from fem.errors import InputError

# name, which is a module of unet_fem.study.measure with run(study): fields of the study that its
# figures depend on
STAGES = {
    "reference": ("fem",),
    "fixed_latency": ("fem",),
    "accuracy": ("networks", "deployed", "prune", "pod_modes", "fem"),
    "time_dependence": ("cnn_lstm", "unet", "window", "long_scene"),
    "force_range": ("cnn_lstm", "unet", "stability"),
    "run_time": ("deployed", "prune", "pod_modes", "fem", "rounds"),
}


def run_stage(study, name, again=False, only_read=False):
    """The figures of stage `name`: read if they are there and were taken with these settings,
    otherwise measured now."""
    path = study.folder / f"{name}.json"
    settings = {field: repr(getattr(study, field)) for field in STAGES[name]}
    if path.is_file() and not again:
        try:
            written = json.loads(path.read_text())
        except ValueError:
            raise InputError(f"{path} is damaged; delete it") from None
        if only_read or written["settings"] == settings:
            return written["result"]
    if only_read:
        raise InputError(f"there is no {path} to draw from; run this command without --draw")
    print(f"\nmeasuring: {name}", flush=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    # a process of its own: TensorFlow's threads, precision and memory are settled once a process
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        result = pool.submit(_run, name, study).result()
    from fem.files import write_text  # not above: it brings TensorFlow, which reading does not need

    write_text(
        path, json.dumps({"settings": settings, "result": result}, indent=1, allow_nan=False)
    )
    return result


def _run(name, study):
    return importlib.import_module(f"unet_fem.study.measure.{name}").run(study)
