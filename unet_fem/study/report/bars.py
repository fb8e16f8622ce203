"""Figures that compare errors side by side: of the deployed forms, of what pruning made, and of the
arms of the volume term."""

import textwrap

import numpy as np
from matplotlib.figure import Figure

from unet_fem.study.runs import KERAS, smaller_runs
from unet_fem.study.settings import Study
from unet_fem.training.style import styled, subplots

FORMS = {
    KERAS: "Keras",
    "float32": "float32",
    "float16": "float16",
    "dynamic": "dynamic int8",
    "int8": "full int8",
}


@styled()
def bars(groups: dict[str, dict[str, dict]], title: str) -> Figure:
    """A panel for each {heading: {label: {"usual", "hard"}}} with the errors of every label in
    %."""
    figure, axes = subplots(1, len(groups), (4.2 * len(groups), 3.2), sharey=True, squeeze=False)
    for axis, (heading, models) in zip(axes[0], groups.items(), strict=True):
        at = np.arange(len(models))
        for shift, which, label in (
            (-0.2, "usual", "usual unseen interactions"),
            (0.2, "hard", "hard ones"),
        ):
            heights = [100 * (model[which]["relative_l2"] or 0) for model in models.values()]
            drawn = axis.bar(at + shift, heights, 0.4, label=label)
            axis.bar_label(drawn, fmt="%.1f", fontsize=6)
        axis.set_xticks(at, models, fontsize=7)
        axis.set_title(heading, size=9)
        axis.grid(visible=False, axis="x")
        axis.set_axisbelow(True)
    axes[0, 0].set_ylabel("relative L2 error (%)")
    axes[0, -1].legend(fontsize=7, loc="lower right")
    figure.suptitle(title)
    return figure


def quantization(study: Study, accuracy: dict) -> Figure:
    """Errors of every form of the main runs."""
    forms = {
        main.label: {label: f"{main.run}: {form}" for form, label in FORMS.items()}
        for main in study.main
    }
    return bars(_known(forms, accuracy["models"]), "Error after quantization")


def pruning(study: Study, accuracy: dict) -> Figure:
    """Errors of the main runs and of what pruning made of them, as Keras models."""
    made = {main.label: {"unpruned": f"{main.run}: {KERAS}"} for main in study.main}
    labels = {main.run: main.label for main in study.main}
    for run in smaller_runs(study):
        made[labels[run.parent]][textwrap.fill(run.label, 14)] = f"{run.name}: {KERAS}"
    return bars(_known(made, accuracy["models"]), "Error after pruning and fine-tuning")


def _known(groups, models):
    """{heading: {label: entry}} of the names that have an entry."""
    found = {
        heading: {label: models[name] for label, name in names.items() if name in models}
        for heading, names in groups.items()
    }
    return {heading: own for heading, own in found.items() if own}


@styled()
def physics(arms: list[dict], network: str) -> Figure:
    """Errors of the arms with 95 % intervals over the interactions, and each seed as a cross."""
    figure, axes = subplots(1, 3, (8, 3.2))
    titles = {
        "usual": "usual unseen interactions",
        "strong": "of these the quarter\nwith the largest forces",
        "hard": "harder than any in training",
    }
    for axis, (which, title) in zip(axes, titles.items(), strict=True):
        for at, arm in enumerate(arms):
            _arm(axis, at, arm[which], arm["seeds"][which])
        labels = [textwrap.fill(arm["label"], 12) for arm in arms]
        axis.set_xticks(range(len(arms)), labels, fontsize=7)
        axis.set_title(title, size=9)
        axis.margins(x=0.3)
    axes[0].set_ylabel("relative L2 error (%)")
    figure.suptitle(
        f"{network} without and with the volume term: mean of the seeds with 95 % interval, and"
        " each seed (x)",
        size=10,
    )
    return figure


def _arm(axis, at, found, seeds):
    colour = f"C{at}"
    axis.plot(at, 100 * found["relative_l2"], "o", color=colour)
    if found["low"] is not None:
        ends = [100 * found["low"], 100 * found["high"]]
        axis.plot([at, at], ends, "_-", color=colour, markersize=8)
    axis.plot([at + 0.15] * len(seeds), 100 * np.array(seeds), "x", color=colour, markersize=4)
