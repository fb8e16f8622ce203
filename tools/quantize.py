"""Export a trained run to TensorFlow Lite in four variants and measure what each costs.

    python tools/quantize.py runs/<name> [--windows 64] [--margin 1.5] [--layers]

Writes lite/{float32,float16,dynamic,int8}.tflite and quantization.json into the run's folder; the
files are for unet_fem.runtime.Surrogate. Each is audited: only builtin operators, and int8 where
its name promises it.
"""

import argparse
import json
import logging
import os
import re
from collections import Counter

import numpy as np

from fem.commands import command_line
from fem.errors import InputError

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


def relative(values, reference):
    """sqrt(sum |values - reference|^2 / sum |reference|^2)."""
    return float(np.linalg.norm(values - reference) / np.linalg.norm(reference))


def layer_errors(reference, quantized, windows):
    """{layer: relative L2 error of its output} of the weighted operators that two .tflite files
    share by name.

    The LSTM has three: all steps' inputs, then each direction's recurrence. reference, quantized:
    the files' bytes, float32 and another. windows: (S, [T,] nx, ny, nz, 3) mN.
    """
    from ai_edge_litert.interpreter import Interpreter, OpResolverType

    from unet_fem.deployment.tflite import WEIGHTED

    def outputs(data):
        plain = OpResolverType.BUILTIN_WITHOUT_DEFAULT_DELEGATES  # keeps every tensor
        net = Interpreter(
            model_content=data,
            experimental_op_resolver_type=plain,
            experimental_preserve_all_tensors=True,
        )
        net.allocate_tensors()
        tensors = {tensor["index"]: tensor for tensor in net.get_tensor_details()}
        found = [op["outputs"][0] for op in net._get_ops_details() if op["op_name"] in WEIGHTED]
        values = {tensors[index]["name"]: [] for index in found}
        for window in windows:
            net.set_tensor(net.get_input_details()[0]["index"], window[None])
            net.invoke()
            for index in found:
                scale, zero = tensors[index]["quantization"]
                value = net.get_tensor(index)
                values[tensors[index]["name"]].append(
                    (value.astype("float32") - zero) * scale if scale else value
                )
        return {name: np.array(parts) for name, parts in values.items()}

    exact, rounded = outputs(reference), outputs(quantized)
    errors, seen = {}, Counter()
    for name in exact:
        if name in rounded:
            layer = re.sub(r"_\d+$", "", name.split("/")[1])  # model_1/layer_1/operator;...
            seen[layer] += 1
            errors[f"{layer} {seen[layer]}" if seen[layer] > 1 else layer] = relative(
                rounded[name], exact[name]
            )
    return errors


def quantize(folder, count, margin, layers):
    """Write the four surrogates of the run in `folder` and return {variant: figures}."""
    from fem.files import write_text
    from unet_fem.deployment import tflite as lite
    from unet_fem.deployment.answers import answers
    from unet_fem.runtime.surrogate_file import write_surrogate
    from unet_fem.training.checkpoint import load_model
    from unet_fem.training.run import open_run
    from unet_fem.training.samples import windows

    logging.getLogger("absl").setLevel(
        logging.ERROR
    )  # the converter's remarks on how it was called
    settings, dataset = open_run(folder)
    model = load_model(settings.folder / "best.keras")
    if model.input_shape[1:] != (
        *(settings.model.window,) * bool(settings.model.window),
        *dataset.grid,
        3,
    ):
        raise InputError(
            f"{folder}: the model takes {model.input_shape[1:]}, its settings or dataset say otherwise; train again"
        )
    test = dataset.read("test")
    shown = lite.calibration_windows(
        windows(dataset.read("train")["force"], settings.model.window), count, margin
    )
    force = test["force"]
    truth = test["displacement"].reshape(-1, *force.shape[2:])
    hard = np.repeat(test["hard"], force.shape[1])
    keras = model.predict(windows(force, settings.model.window), batch_size=16, verbose=0)
    about = lite.surrogate_facts(dataset)
    out = settings.folder / "lite"
    out.mkdir(exist_ok=True)
    figures = {
        "keras": {
            "fem_relative_l2": relative(keras, truth),
            "hard_relative_l2": relative(keras[hard], truth[hard]),
        }
    }
    print("variant        MB  against Keras: L2 %  worst %  against FEM: L2 %  hard %", flush=True)
    print(_row("keras", figures["keras"]), flush=True)
    files = {}
    for variant in lite.VARIANTS:
        files[variant] = data = lite.export(model, variant, shown)
        path = out / f"{variant}.tflite"
        write_surrogate(path, data, **about)
        said = answers(path, force)
        figures[variant] = {
            "bytes": path.stat().st_size,
            "keras_relative_l2": relative(said, keras),
            "keras_worst": float(
                np.abs(said - keras).max() / np.abs(keras).max()
            ),  # of the largest displacement
            "fem_relative_l2": relative(said, truth),
            "hard_relative_l2": relative(said[hard], truth[hard]),
            "operators": dict(lite.audit(data, variant)),
        }
        print(_row(variant, figures[variant]), flush=True)
    for variant in lite.VARIANTS:
        print(
            f"{variant}: "
            + ", ".join(
                f"{count} {name}" for name, count in sorted(figures[variant]["operators"].items())
            )
        )
    if layers:
        seen = windows(force, settings.model.window)
        seen = seen[:: max(1, len(seen) // 32)]
        for variant in ("dynamic", "int8"):
            figures[variant]["layers"] = layer_errors(files["float32"], files[variant], seen)
            print(f"\n{variant}: relative L2 error of each layer's output, %")
            for name, error in figures[variant]["layers"].items():
                print(f"  {100 * error:7.3f}  {name}")
    write_text(settings.folder / "quantization.json", json.dumps(figures, indent=1))
    return out


def _row(name, figures):
    def percent(key, width, digits):
        return f"{100 * figures[key]:{width}.{digits}f}" if key in figures else "-".rjust(width)

    size = f"{figures['bytes'] / 1e6:6.2f}" if "bytes" in figures else "     -"
    return (
        f"{name:<10}{size}  {percent('keras_relative_l2', 19, 4)}  {percent('keras_worst', 7, 4)}"
        f"  {percent('fem_relative_l2', 17, 2)}  {percent('hard_relative_l2', 6, 2)}"
    )


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/quantize.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("run", help="folder of a training run, such as runs/quick")
    parser.add_argument(
        "--windows", type=int, default=64, help="training windows that calibrate int8 (default: 64)"
    )
    parser.add_argument(
        "--margin",
        type=float,
        default=1.5,
        help="how far beyond the strongest int8 reaches (default: 1.5 x)",
    )
    parser.add_argument(
        "--layers", action="store_true", help="also print what each layer's output loses"
    )
    options = parser.parse_args(arguments)
    if options.windows < 2 or not options.margin >= 1:
        raise InputError(
            f"--windows {options.windows} must be at least 2 and --margin {options.margin:g} at least 1"
        )
    out = quantize(options.run, options.windows, options.margin, options.layers)
    print(f"\nfiles: {out}   next: python -m unet_fem.runtime {out / 'int8.tflite'} <dataset>.h5")


if __name__ == "__main__":
    main()
