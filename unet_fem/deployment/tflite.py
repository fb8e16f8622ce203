"""From a trained Keras model to TensorFlow Lite for a CPU, in float32, float16, dynamic-range int8
and full int8.

"dynamic" has int8 weights, one scale a channel, and quantizes activations as they come. "int8" has
int8 activations too, in ranges that calibration has seen, but for the last convolution: it has int8
weights and float32 activations, and so have the scale and mask after it. Forces go in in mN and
displacements come out in mm in every variant.
"""

import hashlib
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import keras
import numpy as np
import tensorflow as tf

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.online.input_field import InputField
from fem.ranges import checked, checked_array
from unet_fem.deployment.conv2d import reexpress
from unet_fem.deployment.tflite_graph import (
    WEIGHTED,
    audit,
    operator_name,
    parts_of,
    quantize_float_weights,
)
from unet_fem.networks.layers import correction
from unet_fem.runtime.surrogate import force_size

VARIANTS = ("float32", "float16", "dynamic", "int8")


def export(model: keras.Model, variant: str, windows: np.ndarray | None = None) -> bytes:
    """The bytes of a .tflite file that maps one force window in mN, shape (1,
    *model.input_shape[1:]), to mm; of a model that corrects the elastic answer the window is of
    that, in mm, and the correction alone comes out, so that no variant rounds the answer.

    variant: one of VARIANTS. windows: (S, [T,] nx, ny, nz, 3) mN, for int8 only, see
    `calibration_windows`. Raises InputError for a layer that has no 2-D expression, and for int8
    without windows; see also unet_fem.deployment.tflite_graph.audit.
    """
    if variant not in VARIANTS:
        raise InputError(f"variant '{variant}' is not one of {', '.join(VARIANTS)}")
    if variant == "int8" and (windows is None or not np.any(windows)):
        raise InputError(
            "full int8 is calibrated on force windows, and there are none but zeros;"
            " give training windows"
        )
    if variant == "int8":
        windows = checked_array("windows", windows, (None, *model.input_shape[1:]))
    flat = reexpress(correction(model))
    signature = [tf.TensorSpec(flat.input_shape, "float32", name="force")]
    with quiet():
        traced = tf.function(flat, input_signature=signature).get_concrete_function()
        converter = lite_converter(traced, variant)
        data = _calibrated(converter, windows) if variant == "int8" else converter.convert()
        if variant in ("dynamic", "int8"):
            data = quantize_float_weights(data)
        audit(data, variant)
    return data


@contextmanager
def quiet() -> Iterator[None]:
    """Hold back what the converter's C++ writes to this process's standard error, and show it if it
    fails."""
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        except Exception as error:
            if not isinstance(error, InputError):
                held.seek(0)
                os.write(kept, held.read())
            raise
        finally:
            sys.stderr.flush()
            os.dup2(kept, 2)
            os.close(kept)


def calibration_windows(
    force: np.ndarray, count: int = 64, margin: float = 1.5, seed: int = 1
) -> np.ndarray:
    """Force windows that show int8 its ranges: a random half of `count`, and the strongest half,
    `margin` times over.

    Without a margin any force above the training's is clipped: on test interactions that push up to
    1.6 times as hard the trained CNN-LSTM is then eight times as far from Keras (7.4 % against 0.9
    %).

    force: training windows (S, [T,] nx, ny, nz, 3) mN. Returns (count, [T,] nx, ny, nz, 3), or
    fewer if S is small. Raises InputError for no windows, values that are not finite and numbers
    out of range.
    """
    checked("count", count, 2, 1_000_000, whole=True)
    checked("margin", margin, 1, 100)
    if np.ndim(force) not in (5, 6) or not len(force) or not np.isfinite(force).all():
        raise InputError(
            f"force windows of shape {np.shape(force)} must be finite and at least one, (S, [T,]"
            " nx, ny, nz, 3)"
        )
    half = min(count // 2, len(force))
    strongest = np.argsort(np.abs(force).reshape(len(force), -1).max(axis=1))[-half:]
    some = np.random.default_rng(seed).choice(len(force), half, replace=False)
    return np.concatenate([force[np.sort(some)], margin * force[strongest]]).astype("float32")


def lite_converter(traced: Any, variant: str) -> tf.lite.TFLiteConverter:
    """The converter of a concrete function to `variant`, not calibrated yet."""
    converter = tf.lite.TFLiteConverter.from_concrete_functions([traced])
    if variant != "float32":
        converter.optimizations = [tf.lite.Optimize.DEFAULT]
    if variant == "float16":
        converter.target_spec.supported_types = [tf.float16]
    return converter


def _calibrated(converter, windows):
    """Full int8, with the last weighted operator and all after it in float32."""
    converter.representative_dataset = lambda: (
        [np.asarray(window[None], "float32")] for window in windows
    )
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # the debugger opens TensorFlow's own, deprecated interpreter
        debugger = tf.lite.experimental.QuantizationDebugger(
            converter=converter, debug_dataset=converter.representative_dataset
        )
        parts = parts_of(debugger.calibrated_model)
        operators, tensors = parts.subgraphs[0].operators, parts.subgraphs[0].tensors
        last = max(n for n, op in enumerate(operators) if operator_name(parts, op) in WEIGHTED)
        names = [tensors[op.outputs[0]].name.decode() for op in operators[last:]]
        debugger.options = tf.lite.experimental.QuantizationDebugOptions(denylisted_nodes=names)
        return debugger.get_nondebug_quantized_model()


def surrogate_facts(dataset: Dataset, field: InputField | None = None) -> dict[str, Any]:
    """What a surrogate's file says beside its graph, from a fem.data.dataset.Dataset and what the
    network sees in place of the forces: see
    unet_fem.runtime.surrogate_file.write_surrogate."""
    points, faces = dataset.surface
    index = dataset.fem_mesh.grid_index  # None where the mesh is embedded in the grid
    return {
        "mask": dataset.free,
        "index": np.empty(0, int) if index is None else index,
        "points": points,
        "faces": faces,
        "mesh": mesh_digest(dataset),
        "interval": dataset.scene.frames.interval,
        "largest_force": force_size(dataset.read("train")["force"]),
        "field": field,
    }


def mesh_digest(dataset: Dataset) -> str:
    """Sixteen hexadecimal digits of the mesh that the networks of a dataset see."""
    found = hashlib.sha256()
    parts = ((dataset.points, "<f8"), (dataset.cells, "<i8"), (dataset.mask, "?"))
    for values, kind in (*parts, (dataset.fixed, "?")):
        found.update(np.ascontiguousarray(values, kind).tobytes())
    return found.hexdigest()[:16]
