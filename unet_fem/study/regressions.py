"""The regressions among the competitors of a study."""

import numpy as np

from unet_fem.networks.pod import linear, predict, reduced, truncated
from unet_fem.training.samples import load_samples


def linear_name(frames):
    """Of the linear regression on a window of so many frames; None for one."""
    return (
        f"linear regression, {frames} frames" if (frames or 1) > 1 else "linear regression, 1 frame"
    )


def competitors(study, dataset):
    """{name: (frames of the window, Regression)}: linear for every window of the study's networks,
    POD on the one best in validation."""
    windows = sorted({network.settings.model.window or 1 for network in study.networks})
    found, least = {}, np.inf
    for frames in windows:
        train, validation = (
            load_samples(dataset, split, frames) for split in ("train", "validation")
        )
        full = linear(train, validation, dataset.free)
        error = np.sum(
            (predict(full, validation.force) - validation.displacement) ** 2, dtype=float
        )
        if error < least:
            least, best = error, (frames, full, train, validation)
        found[linear_name(frames)] = frames, full
    frames, *samples = best
    for model in reduced(*samples, max(study.pod_modes)):
        for modes in study.pod_modes:
            if modes <= len(model.modes):
                found[f"{model.family}, {modes} modes"] = frames, truncated(model, modes)
    return found


def actions(study, dataset):
    """{name: action} of `competitors`: each takes one frame of force into its window and gives the
    displacement on the grid."""
    force = dataset.read("test")["force"][0, -1]
    return {
        name: _action(model, frames, force)
        for name, (frames, model) in competitors(study, dataset).items()
    }


def _action(model, frames, force):
    window = np.zeros((1, frames, *force.shape), "float32")

    def action():
        window[0, :-1] = window[0, 1:]
        window[0, -1] = force
        return predict(model, window)[0]

    return action
