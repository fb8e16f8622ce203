"""The figures of the paper, from what the accuracy stage has found and the few fields that it
keeps."""

import textwrap

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter

from unet_fem.study import runs as pipeline
from unet_fem.study.measure.accuracy import KERAS, kept_field, regression_name
from unet_fem.study.measure.reference import study_dataset
from unet_fem.training import figures
from unet_fem.training.figures import plt
from unet_fem.training.samples import load_samples

FORMS = {
    KERAS: "Keras",
    "float32": "float32",
    "float16": "float16",
    "dynamic": "dynamic int8",
    "int8": "full int8",
}
MAIN = ("linear regression", "U-Net", "CNN-LSTM")
MILLISECONDS = 250  # of a frame of the animation


def draw(study, results, physics):
    """{name: figure} from the results of the accuracy stage; physics: what statistics.physics makes
    of them."""
    accuracy = results["accuracy"]
    dataset = study_dataset(study)
    test = load_samples(dataset, "test", None)
    names = shown_models(study, accuracy)
    fields = {
        label: kept_field(study, name.removesuffix(f": {KERAS}"), dataset)
        for label, name in names.items()
    }
    models = accuracy["models"]
    count = f"{len(accuracy['numbers'])} unseen interactions"
    return {
        "depth_configurations": figures.depth_curves(
            {
                configuration_label(study, run): models[f"{run}: {KERAS}"]["depth"]
                for run in study.configurations
                if run in accuracy["runs"]
            },
            f"Configurations of the CNN-LSTM, {count}",
        ),
        "depth_models": figures.depth_curves(
            {label: models[name]["depth"] for label, name in names.items()},
            f"Error against depth, {count}",
        ),
        "bland_altman": figures.bland_altman(dataset, test, fields),
        "test_interactions": figures.interaction_curves(
            accuracy["numbers"],
            accuracy["hard"],
            accuracy["force"],
            {"FEM": accuracy["fem_violation"]}
            | {label: models[name]["violation"] for label, name in names.items()},
        ),
        "fields": side_by_side(
            dataset, test, {label: field for label, field in fields.items() if label in MAIN}
        ),
        "quantization": quantization(study, accuracy),
        "pruning": pruning(study, accuracy),
        "physics": physics_figure(physics),
    }


def shown_models(study, accuracy):
    """{label: name in the accuracy stage}: linear regression, the U-Net, the CNN-LSTM, and the
    first run of every arm of the volume term."""
    names = {
        "linear regression": regression_name(study),
        "U-Net": f"{study.unet}: {KERAS}",
        "CNN-LSTM": f"{study.cnn_lstm}: {KERAS}",
    }
    for arm in study.physics:
        names[f"({configuration_label(study, arm.runs[0])}) {arm.label}"] = (
            f"{arm.runs[0]}: {KERAS}"
        )
    return {label: name for label, name in names.items() if name in accuracy["models"]}


def configuration_label(study, run):
    model = study.network(run).model
    return f"{model.units} units, {model.steps} step{'s' * (model.steps > 1)}"


def hard_interaction(dataset, test):
    """(rows of `test` of the hard interaction that the FEM displaces most, its number)."""
    row = np.flatnonzero(test.hard)[
        np.abs(test.displacement[test.hard]).max(axis=(1, 2, 3, 4)).argmax()
    ]
    number = int(test.interaction[row])
    return test.interaction == number, number


def side_by_side(dataset, test, fields):
    """FEM and each of `fields` on one section of a hard interaction at its largest displacement,
    and below each its error."""
    rows, number = hard_interaction(dataset, test)
    own = test.select(rows)
    sample, j = figures.most_displaced(dataset, own)
    truth = own.displacement[sample]
    figure, axes = plt.subplots(
        2,
        len(fields) + 1,
        figsize=(2.9 * (len(fields) + 1), 3.9),
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    limit = np.linalg.norm(truth[:, j], axis=-1).max()
    cells = figures.draw_section(axes[0, 0], dataset, j, truth, truth, limit)
    axes[0, 0].set_title(f"FEM (max {limit:.2f} mm)", size=8)
    for (above, below), (name, field) in zip(axes[:, 1:].T, fields.items()):
        found = field[rows][sample]
        figures.draw_section(above, dataset, j, found, found, limit)
        above.set_title(name, size=8)
        figures.draw_section(below, dataset, j, truth, found - truth, limit)
        share = np.linalg.norm((found - truth)[dataset.free]) / np.linalg.norm(truth[dataset.free])
        below.set_title(
            f"error: max {np.linalg.norm((found - truth)[:, j], axis=-1).max():.2f} mm, relative L2 {100 * share:.0f} %",
            size=8,
        )
    axes[1, 0].set_visible(False)
    for axis in (axes[0, 0], axes[1, 1]):
        axis.set_ylabel("up (mm)")
    axes[0, 0].tick_params(labelbottom=True)
    for axis in (axes[0, 0], *axes[1, 1:]):
        axis.set_xlabel("across (mm)")
    figure.colorbar(cells, ax=axes, label="displacement or error (mm)", shrink=0.7)
    section = f"section {j + 1} of {dataset.grid[1]}"
    figure.suptitle(
        f"Test interaction {number} at its largest displacement, {section}; errors on the FEM's shape",
        size=10,
    )
    return figure


def animate(study, results, path):
    """Write a GIF of one hard interaction to `path`: FEM, U-Net and CNN-LSTM on a section, their
    errors and the force below."""
    dataset = study_dataset(study)
    test = load_samples(dataset, "test", None)
    rows, number = hard_interaction(dataset, test)
    own = test.select(rows)
    fields = {
        name: kept_field(study, run, dataset)[rows]
        for name, run in (("U-Net", study.unet), ("CNN-LSTM", study.cnn_lstm))
    }
    truth, (_, j) = own.displacement, figures.most_displaced(dataset, own)
    limit = np.linalg.norm(truth[:, :, j], axis=-1).max()
    force = np.linalg.norm(own.force, axis=-1).sum(axis=(1, 2, 3))
    figure, axes = plt.subplots(2, 3, figsize=(8.4, 3.8), dpi=100, layout="constrained")
    sections = [(axes[0, 0], "FEM", truth, truth)]
    for (above, below), (name, field) in zip(axes[:, 1:].T, fields.items()):
        sections += [
            (above, name, field, field),
            (below, f"error of the {name}", truth, field - truth),
        ]
    cells = []
    for axis, title, shape, values in sections:
        cells.append(figures.draw_section(axis, dataset, j, shape[0], values[0], limit))
        axis.set_title(title, size=9)
        axis.set_ylim(*_range(dataset, j, truth))
        axis.tick_params(labelsize=7)
    figure.colorbar(cells[0], ax=axes[:, 2], label="displacement or error (mm)")
    axes[1, 0].plot(dataset.time, force, "-", color="slategray")
    (now,) = axes[1, 0].plot([0], force[:1], "o", color="crimson")
    axes[1, 0].set(xlabel="time (s)", ylabel="total force (mN)")
    heading = figure.suptitle(f"Test interaction {number}", size=10)

    def show(frame):
        for part, (_, _, shape, values) in zip(cells, sections):
            figures.move_section(part, dataset, j, shape[frame], values[frame])
        now.set_data([dataset.time[frame]], [force[frame]])
        heading.set_text(
            f"Test interaction {number}, section {j + 1} of {dataset.grid[1]} (mm): {dataset.time[frame]:.2f} s"
        )

    with plt.rc_context({"savefig.bbox": None}):  # frames of one size
        FuncAnimation(figure, show, frames=len(truth), interval=MILLISECONDS).save(
            path, PillowWriter(fps=1000 / MILLISECONDS)
        )
    plt.close(figure)


def _range(dataset, j, truth):
    up = (dataset.points + truth)[:, :, j] @ figures.section_plane(dataset)[:, 1]  # (F, nx, nz) mm
    inside = up[:, dataset.mask[:, j]]
    margin = 0.1 * np.ptp(inside)
    return inside.min() - margin, inside.max() + margin


def bars(groups, title):
    """A panel for each {heading: {label: {"test", "hard"}}} with the errors of every label in %."""
    figure, axes = plt.subplots(
        1,
        len(groups),
        figsize=(4.2 * len(groups), 3.2),
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axis, (heading, models) in zip(axes[0], groups.items()):
        at = np.arange(len(models))
        for shift, (which, label) in zip(
            (-0.2, 0.2), (("test", "all test interactions"), ("hard", "hard ones"))
        ):
            drawn = axis.bar(
                at + shift, [100 * model[which] for model in models.values()], 0.4, label=label
            )
            axis.bar_label(drawn, fmt="%.1f", fontsize=6)
        axis.set_xticks(at, models, fontsize=7)
        axis.set_title(heading, size=9)
        axis.grid(visible=False, axis="x")
        axis.set_axisbelow(True)
    axes[0, 0].set_ylabel("relative L2 error (%)")
    axes[0, -1].legend(fontsize=7, loc="lower right")
    figure.suptitle(title)
    return figure


def quantization(study, accuracy):
    """Errors of every form of the two main runs."""
    models, groups = accuracy["models"], {}
    for heading, run in (("CNN-LSTM", study.cnn_lstm), ("U-Net", study.unet)):
        found = {
            label: models[f"{run}: {form}"]
            for form, label in FORMS.items()
            if f"{run}: {form}" in models
        }
        groups |= {heading: found} if found else {}
    return bars(groups, "Error after quantization")


def pruning(study, accuracy):
    """Errors of the two main runs and of what pruning made of them, as Keras models."""
    models, groups = accuracy["models"], {}
    for heading, run in (("CNN-LSTM", study.cnn_lstm), ("U-Net", study.unet)):
        runs = {"unpruned": run} | pipeline.pruned_runs(study, run)
        found = {
            textwrap.fill(label, 14): models[f"{name}: {KERAS}"]
            for label, name in runs.items()
            if f"{name}: {KERAS}" in models
        }
        groups |= {heading: found} if found else {}
    return bars(groups, "Error after pruning and fine-tuning")


def physics_figure(physics):
    """Errors of the arms with 95 % intervals over the interactions, and each seed as a cross."""
    figure, axes = plt.subplots(1, 3, figsize=(8, 3.2), layout="constrained")
    titles = {
        "test": "all test interactions",
        "strong": "the quarter with the largest forces",
        "hard": "beyond training",
    }
    for axis, (which, title) in zip(axes, titles.items()):
        for at, arm in enumerate(physics):
            found = arm[which]
            axis.plot(at, 100 * found["relative_l2"], "o", color=f"C{at}")
            if found["low"] is not None:
                axis.plot(
                    [at, at],
                    [100 * found["low"], 100 * found["high"]],
                    "_-",
                    color=f"C{at}",
                    markersize=8,
                )
            axis.plot(
                [at + 0.15] * len(arm["seeds"][which]),
                100 * np.array(arm["seeds"][which]),
                "x",
                color=f"C{at}",
                markersize=4,
            )
        axis.set_xticks(
            range(len(physics)), [textwrap.fill(arm["label"], 12) for arm in physics], fontsize=7
        )
        axis.set_title(title, size=9)
        axis.margins(x=0.3)
    axes[0].set_ylabel("relative L2 error (%)")
    figure.suptitle(
        "CNN-LSTM without and with the volume term: mean of the seeds with 95 % interval, and each seed (x)",
        size=10,
    )
    return figure
