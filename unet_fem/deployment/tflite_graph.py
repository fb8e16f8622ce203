"""What a .tflite file holds: its operators named and audited, and float weights made int8."""

from collections import Counter

import flatbuffers
import numpy as np
from ai_edge_litert import schema_py_generated as schema
from ai_edge_litert.interpreter import Interpreter

from fem.errors import InputError

OPERATORS = {
    code: name for name, code in vars(schema.BuiltinOperator).items() if not name.startswith("_")
}
WEIGHTED = ("CONV_2D", "FULLY_CONNECTED")  # operators whose second input is the layer's weights
REMEDY = "express its layer by 2-D operators in unet_fem.deployment.conv2d.EXPRESSIONS"


def parts_of(data: bytes) -> schema.ModelT:
    """The parts of a .tflite file's bytes."""
    return schema.ModelT.InitFromPackedBuf(data, 0)


def weighted(parts: schema.ModelT) -> list[schema.OperatorT]:
    """The WEIGHTED operators, in the order in which they run."""
    return [op for op in parts.subgraphs[0].operators if operator_name(parts, op) in WEIGHTED]


def operator_name(parts: schema.ModelT, op: schema.OperatorT) -> str:
    """Name of an operator; a custom one's is its own."""
    code = parts.operatorCodes[op.opcodeIndex]
    number = max(code.builtinCode, code.deprecatedBuiltinCode)
    return code.customCode.decode() if code.customCode else OPERATORS[number]


def quantize_float_weights(data: bytes) -> bytes:
    """`data` with the weights that the converter left in float32 (the small, and the denied ones)
    in int8, by channel."""
    parts = parts_of(data)
    for op in weighted(parts):
        tensor = parts.subgraphs[0].tensors[op.inputs[1]]
        if tensor.type != schema.TensorType.FLOAT32:
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
        if operator_name(parts, op) == "CONV_2D":
            code.version = max(
                code.version, 5
            )  # the first with float activations and int8 weights by channel
        else:
            code.version = max(code.version, 12)
            op.builtinOptions.asymmetricQuantizeInputs = True
    builder = flatbuffers.Builder(len(data))
    builder.Finish(parts.Pack(builder), b"TFL3")
    return bytes(builder.Output())


def audit(data: bytes, variant: str) -> Counter[str]:
    """{operator: count} of a .tflite file's bytes, after loading it and running it once.

    Raises InputError naming the operator and the variant unless all are builtin, none is CONV_3D,
    and in "dynamic" and "int8" every convolution and fully connected layer has int8 weights; in
    "int8" all but the last have int8 activations too.
    """
    parts = parts_of(data)
    names = [operator_name(parts, op) for op in parts.subgraphs[0].operators]
    for name in names:
        if name not in OPERATORS.values() or name in ("CUSTOM", "CONV_3D"):
            fault = "stays float32" if name == "CONV_3D" else "is not builtin"
            raise InputError(f"{variant}: operator {name} {fault}; {REMEDY}")
    if variant in ("dynamic", "int8"):
        _check_int8(parts, variant)
    try:
        interpreter = Interpreter(model_content=data)
        interpreter.allocate_tensors()
        interpreter.invoke()
    except (RuntimeError, ValueError) as error:
        raise InputError(
            f"{variant}: the file converts but does not run ({str(error).splitlines()[0]});"
            f" {REMEDY}"
        ) from None
    return Counter(names)


def _check_int8(parts, variant):
    """Raises InputError where weights, or activations of "int8" before the last layer, are no
    int8."""
    layers = weighted(parts)
    for n, op in enumerate(layers):
        activation, weights = (parts.subgraphs[0].tensors[index] for index in op.inputs[:2])
        wanted = {"weights": weights}
        if variant == "int8" and n < len(layers) - 1:
            wanted["activations"] = activation
        for what, tensor in wanted.items():
            if tensor.type != schema.TensorType.INT8:
                raise InputError(
                    f"{variant}: {operator_name(parts, op)} '{tensor.name.decode()}'"
                    f" has no int8 {what}; {REMEDY}"
                )


def named_outputs(data: bytes, names: list[str]) -> bytes:
    """The .tflite file `data` with `names` for its outputs, which the converter calls Identity,
    Identity_1, ..."""
    parts = parts_of(data)
    tensors = parts.subgraphs[0].tensors
    for index in parts.subgraphs[0].outputs:
        _, _, number = tensors[index].name.decode().partition("_")
        tensors[index].name = names[int(number or 0)]
    builder = flatbuffers.Builder(len(data))
    builder.Finish(parts.Pack(builder), b"TFL3")
    return bytes(builder.Output())
