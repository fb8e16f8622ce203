"""From a trained Keras model to TensorFlow Lite for a CPU, in float32, float16, dynamic-range int8
and full int8.

"dynamic" has int8 weights, one scale a channel, and quantizes activations as they come. "int8" has
int8 activations
too, in ranges that calibration has seen, but for the last convolution: it has int8 weights and
float32 activations, and so have the scale and mask after it. Forces go in in mN and displacements
come out in mm in every variant.
"""

import hashlib
import os
import sys
import tempfile
import warnings
from collections import Counter
from contextlib import contextmanager

import flatbuffers
import numpy as np
import tensorflow as tf
from ai_edge_litert import schema_py_generated as schema
from ai_edge_litert.interpreter import Interpreter

from fem.errors import InputError
from unet_fem.deployment.conv2d import reexpress
from unet_fem.runtime.surrogate import force_size

VARIANTS = ("float32", "float16", "dynamic", "int8")
OPERATORS = {
    code: name for name, code in vars(schema.BuiltinOperator).items() if not name.startswith("_")
}
WEIGHTED = ("CONV_2D", "FULLY_CONNECTED")  # operators whose second input is the layer's weights


def export(model, variant, windows=None):
    """The bytes of a .tflite file that maps one force window in mN, shape (1,
    *model.input_shape[1:]), to mm.

    variant: one of VARIANTS. windows: (S, [T,] nx, ny, nz, 3) mN, for int8 only, see
    `calibration_windows`. Raises InputError for a layer that has no 2-D expression, and for int8
    without windows; see also `audit`.
    """
    if variant not in VARIANTS:
        raise InputError(f"variant '{variant}' is not one of {', '.join(VARIANTS)}")
    if variant == "int8" and (windows is None or not np.any(windows)):
        raise InputError(
            "full int8 is calibrated on force windows, and there are none but zeros; give training windows"
        )
    flat = reexpress(model)
    signature = [tf.TensorSpec(flat.input_shape, "float32", name="force")]
    with quiet():
        traced = tf.function(flat, input_signature=signature).get_concrete_function()
        converter = tf.lite.TFLiteConverter.from_concrete_functions([traced])
        if variant != "float32":
            converter.optimizations = [tf.lite.Optimize.DEFAULT]
        if variant == "float16":
            converter.target_spec.supported_types = [tf.float16]
        data = _calibrated(converter, windows) if variant == "int8" else converter.convert()
        if variant in ("dynamic", "int8"):
            data = _quantize_float_weights(data)
        audit(data, variant)
    return data


@contextmanager
def quiet():
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


def calibration_windows(force, count=64, margin=1.5, seed=1):
    """Force windows that show int8 its ranges: a random half of `count`, and the strongest half,
    `margin` times over.

    Without a margin any force above the training's is clipped: on test interactions that push up to
    1.6 times as hard the trained CNN-LSTM is then eight times as far from Keras (7.4 % against 0.9
    %).

    force: training windows (S, [T,] nx, ny, nz, 3) mN. Returns (count, [T,] nx, ny, nz, 3), or
    fewer if S is small.
    """
    half = min(count // 2, len(force))
    strongest = np.argsort(np.abs(force).reshape(len(force), -1).max(axis=1))[-half:]
    some = np.random.default_rng(seed).choice(len(force), half, replace=False)
    return np.concatenate([force[np.sort(some)], margin * force[strongest]]).astype("float32")


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
        parts = schema.ModelT.InitFromPackedBuf(debugger.calibrated_model, 0)
        operators, tensors = parts.subgraphs[0].operators, parts.subgraphs[0].tensors
        last = max(n for n, op in enumerate(operators) if _operator(parts, op) in WEIGHTED)
        names = [tensors[op.outputs[0]].name.decode() for op in operators[last:]]
        debugger.options = tf.lite.experimental.QuantizationDebugOptions(denylisted_nodes=names)
        return debugger.get_nondebug_quantized_model()


def _operator(parts, op):
    """Name of a flatbuffer operator; a custom one's is its own."""
    code = parts.operatorCodes[op.opcodeIndex]
    number = max(code.builtinCode, code.deprecatedBuiltinCode)
    return code.customCode.decode() if code.customCode else OPERATORS[number]


def _quantize_float_weights(data):
    """`data` with the weights that the converter left in float32 (the small, and the denied ones)
    in int8, by channel."""
    parts = schema.ModelT.InitFromPackedBuf(data, 0)
    for op in parts.subgraphs[0].operators:
        tensor = parts.subgraphs[0].tensors[op.inputs[1]] if len(op.inputs) > 1 else None
        if _operator(parts, op) not in WEIGHTED or tensor.type != schema.TensorType.FLOAT32:
            continue
        buffer = parts.buffers[tensor.buffer]
        weights = np.frombuffer(bytes(buffer.data), "float32").reshape(
            tensor.shape[0], -1
        )  # (F, ...)
        scale = np.maximum(np.abs(weights).max(axis=1) / 127, np.float32(1e-30))
        buffer.data = np.round(weights / scale[:, None]).astype("int8").view("uint8").ravel()
        tensor.type = schema.TensorType.INT8
        tensor.quantization = schema.QuantizationParametersT(
            scale=scale, zeroPoint=np.zeros(len(scale), "int64")
        )
        code = parts.operatorCodes[op.opcodeIndex]
        if _operator(parts, op) == "CONV_2D":
            code.version = max(
                code.version, 5
            )  # the first with float activations and int8 weights by channel
        else:
            code.version = max(code.version, 12)
            op.builtinOptions.asymmetricQuantizeInputs = True
    builder = flatbuffers.Builder(len(data))
    builder.Finish(parts.Pack(builder), b"TFL3")
    return bytes(builder.Output())


def surrogate_facts(dataset):
    """What a surrogate's file says beside its graph, from a fem.data.dataset.Dataset: see
    unet_fem.runtime.surrogate_file.write_surrogate."""
    points, faces = dataset.surface
    return {
        "mask": dataset.free,
        "index": dataset.mesh.grid_index,
        "points": points,
        "faces": faces,
        "mesh": mesh_digest(dataset.mesh),
        "interval": dataset.scene.frames.interval,
        "largest_force": force_size(dataset.read("train")["force"]),
    }


def mesh_digest(mesh):
    """Sixteen hexadecimal digits of a HexMesh's points, cells and fixed nodes."""
    found = hashlib.sha256()
    for values, kind in ((mesh.points, "<f8"), (mesh.cells, "<i8"), (mesh.fixed, "?")):
        found.update(np.ascontiguousarray(values, kind).tobytes())
    return found.hexdigest()[:16]


def audit(data, variant):
    """{operator: count} of a .tflite file's bytes, after loading it and running it once.

    Raises InputError naming the operator and the variant unless all are builtin, none is CONV_3D,
    and in "dynamic" and "int8" every convolution and fully connected layer has int8 weights; in
    "int8" all but the last have int8 activations too.
    """
    parts = schema.ModelT.InitFromPackedBuf(data, 0)
    graph = parts.subgraphs[0]
    names = [_operator(parts, op) for op in graph.operators]
    for name in names:
        if name not in OPERATORS.values() or name in ("CUSTOM", "CONV_3D"):
            raise InputError(
                f"{variant}: operator {name} {'stays float32' if name == 'CONV_3D' else 'is not builtin'}; {REMEDY}"
            )
    weighted = [(name, op) for name, op in zip(names, graph.operators) if name in WEIGHTED]
    for n, (name, op) in enumerate(weighted):
        activation, weights = (graph.tensors[index] for index in op.inputs[:2])
        if variant in ("dynamic", "int8") and weights.type != schema.TensorType.INT8:
            raise InputError(
                f"{variant}: {name} '{weights.name.decode()}' has no int8 weights; {REMEDY}"
            )
        if (
            variant == "int8"
            and activation.type != schema.TensorType.INT8
            and n < len(weighted) - 1
        ):
            raise InputError(
                f"{variant}: {name} '{activation.name.decode()}' has no int8 activations; {REMEDY}"
            )
    try:
        interpreter = Interpreter(model_content=data)
        interpreter.allocate_tensors()
        interpreter.invoke()
    except (RuntimeError, ValueError) as error:
        raise InputError(
            f"{variant}: the file converts but does not run ({str(error).splitlines()[0]}); {REMEDY}"
        ) from None
    return Counter(names)


REMEDY = "express its layer by 2-D operators in unet_fem.deployment.conv2d.EXPRESSIONS"
