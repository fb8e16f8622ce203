"""At which end of the grid's third axis the layer without nodes serves the networks: both learn the
same data with it below and above, and are judged on the validation interactions.

    python tools/void_layer.py data/paper.h5 [--epochs 10] [--seeds 3] [--out docs/void_layer]

Prints Markdown; --out writes it as .md, and the numbers as .json. The data are moved along the axis
by one layer, so that no other dataset is needed.
"""

import argparse
import json
import sys
from pathlib import Path

from fem.commands import command_line
from fem.errors import InputError

ENDS = ("below", "above")
BATCH, RATE = 16, 1e-3


def shift(mask, end):
    """By how many layers the arrays of a grid with `mask` (nx, ny, nz) of material nodes go up for
    its one void layer to lie at `end`. Raises InputError if it has not exactly one, at an end."""
    layers = mask.any(axis=(0, 1))
    if layers.sum() != len(layers) - 1 or layers[1:-1].sum() != len(layers) - 2:
        raise InputError(
            "the grid has not one void layer, at an end of its third axis; give a dataset of"
            " mesh.kind = 'tumour'"
        )
    return int(end == "below") - int(layers.argmax())


def trained(path, kind, end, seed, epochs):
    """{"network", "parameters", "void", "seed", "train", "validation"} of a small network of `kind`
    learned with the void layer at `end`: relative L2 errors of its last epoch."""
    import os

    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import keras
    import numpy as np
    import tensorflow

    from fem.data.dataset import open_dataset
    from unet_fem.metrics import relative_l2
    from unet_fem.networks.registry import CnnLstm, UNet, network
    from unet_fem.training.samples import scales, training_samples

    tensorflow.config.threading.set_intra_op_parallelism_threads(1)
    dataset = open_dataset(path).for_learning()
    up = shift(dataset.mask, end)
    options = {"cnn_lstm": CnnLstm(units=128), "unet": UNet(filters=16)}[kind]
    train, validation = training_samples(dataset, options.window)
    (x, y), judged = (
        [np.roll(field, up, axis=-2) for field in (samples.force, samples.displacement)]
        for samples in (train, validation)
    )
    keras.utils.set_random_seed(seed)
    free = np.roll(dataset.free, up, axis=-1)
    model = network(kind).build(dataset.grid, options, scales(train), free)
    rate = keras.optimizers.schedules.CosineDecay(RATE, epochs * -(-len(x) // BATCH))
    model.compile(keras.optimizers.Adam(rate, epsilon=1e-12), "mse")
    model.fit(x, y, batch_size=BATCH, epochs=epochs, verbose=0)
    errors = [relative_l2(model.predict(f, verbose=0), u) for f, u in ((x, y), judged)]
    return {
        "network": network(kind).label,
        "parameters": model.count_params(),
        "void": end,
        "seed": seed,
        "train": errors[0],
        "validation": errors[1],
    }


def table(rows):
    """The rows of `trained` as Markdown: mean over the seeds, and the seeds' errors."""
    lines = [
        "| network | parameters | void layer | training % | validation % | of each seed % |",
        "|---|---|---|---|---|---|",
    ]
    for kind, count in dict.fromkeys((row["network"], row["parameters"]) for row in rows):
        for end in ENDS:
            own = [row for row in rows if (row["network"], row["void"]) == (kind, end)]
            means = [
                100 * sum(row[name] for row in own) / len(own) for name in ("train", "validation")
            ]
            each = ", ".join(f"{100 * row['validation']:.1f}" for row in own)
            lines.append(
                f"| {kind} | {count:,} | {end} | {means[0]:.1f} | {means[1]:.1f} | {each} |"
            )
    return "\n".join(lines)


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/void_layer.py", description=__doc__.split("\n\n")[0]
    )
    parser.add_argument("data", type=Path, help="dataset whose grid has one void layer")
    parser.add_argument("--epochs", type=int, default=10, help="of each training (default: 10)")
    parser.add_argument("--seeds", type=int, default=3, help="trainings of each (default: 3)")
    parser.add_argument("--workers", type=int, help="processes (default: one a core)")
    parser.add_argument("--out", type=Path, help="write <out>.md and <out>.json")
    options = parser.parse_args(arguments)
    if min(options.epochs, options.seeds, options.workers or 1) < 1:
        raise InputError(
            f"--epochs {options.epochs}, --seeds {options.seeds} and --workers {options.workers}"
            " must be at least 1"
        )

    from fem.data.dataset import open_dataset
    from fem.files import write_text
    from fem.workers import on_all_cores

    shift(open_dataset(options.data).for_learning().mask, "below")
    tasks = [
        (options.data, kind, end, seed, options.epochs)
        for seed in range(1, options.seeds + 1)
        for kind in ("unet", "cnn_lstm")
        for end in ENDS
    ]

    def told(_, row):
        print(json.dumps(row), file=sys.stderr, flush=True)
        return row

    rows = on_all_cores(
        trained, tasks, "networks", workers=options.workers, keep=told, unit="network"
    )
    text = table(rows)
    print(text)
    if options.out:
        head = (
            f"# The void layer's end\n\n`python tools/void_layer.py {options.data}"
            f" --epochs {options.epochs} --seeds {options.seeds} --out {options.out}`\n\n"
        )
        write_text(options.out.with_suffix(".md"), head + text + "\n")
        write_text(options.out.with_suffix(".json"), json.dumps(rows, indent=1) + "\n")
        print(f"wrote {options.out.with_suffix('.md')} and .json")


if __name__ == "__main__":
    main()
