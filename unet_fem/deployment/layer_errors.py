"""Where a quantized network loses what it loses: the error of each layer's output."""

import re
from collections import Counter

import numpy as np
from ai_edge_litert.interpreter import Interpreter, OpResolverType

from unet_fem.deployment.tflite_graph import parts_of, weighted
from unet_fem.metrics import relative_l2


def layer_errors(
    reference: bytes, quantized: bytes, windows: np.ndarray
) -> dict[str, float | None]:
    """{layer: relative L2 error of its output} of the weighted operators that two .tflite files
    share by name.

    The LSTM has three: all steps' inputs, then each direction's recurrence. reference, quantized:
    the files' bytes, float32 and another. windows: (S, [T,] nx, ny, nz, 3) mN.
    """
    exact, rounded = _outputs(reference, windows), _outputs(quantized, windows)
    errors: dict[str, float | None] = {}
    seen: Counter[str] = Counter()
    for name in exact:
        if name in rounded:
            layer = re.sub(r"_\d+$", "", name.split("/")[1])  # model_1/layer_1/operator;...
            seen[layer] += 1
            errors[f"{layer} {seen[layer]}" if seen[layer] > 1 else layer] = relative_l2(
                rounded[name], exact[name]
            )
    return errors


def _outputs(data, windows):
    """{tensor: (S, ...)} of the outputs of the weighted operators of a .tflite file's bytes."""
    plain = OpResolverType.BUILTIN_WITHOUT_DEFAULT_DELEGATES  # keeps every tensor
    net = Interpreter(
        model_content=data,
        experimental_op_resolver_type=plain,
        experimental_preserve_all_tensors=True,
    )
    net.allocate_tensors()
    tensors = {tensor["index"]: tensor for tensor in net.get_tensor_details()}
    found = [op.outputs[0] for op in weighted(parts_of(data))]
    values: dict[str, list[np.ndarray]] = {tensors[index]["name"]: [] for index in found}
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
