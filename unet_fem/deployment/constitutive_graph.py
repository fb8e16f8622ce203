"""The constitutive network as one TensorFlow Lite graph: a frame, from the elastic answer to the
force to the displacement, history in and out."""

from typing import Any

import numpy as np
import tensorflow as tf

from fem.errors import InputError
from fem.online.reduced_model import ReducedModel
from unet_fem.deployment.tflite import lite_converter, quiet
from unet_fem.deployment.tflite_graph import audit, named_outputs
from unet_fem.networks.constitutive import ConstitutiveCell, Memory, Rates
from unet_fem.runtime.rates import rates

VARIANTS = ("float32", "float16", "dynamic")


def export_constitutive(
    cell: ConstitutiveCell, model: ReducedModel, variant: str = "float32"
) -> bytes:
    """The bytes of a .tflite file, of builtin operators alone.

    In: g (1, R) mm; given (1, R) mm, where the frame starts if again (1, 1) is 1, and not if it is
    0; bulk: K / mu; the Memory and the Rates by their names. Out: a (1, R) mm; displacement (1,
    sides 3 h) mm of the left and then the right free nodes; signs (1, 2), see ConstitutiveCell; the
    new Memory as new_history, new_slow and new_correction.

    A frame of two evaluations is two calls, the second one with `a` of the first as `given`.
    variant: "float16" halves the weights in the file, "dynamic" has int8 weights. Raises InputError
    for another.
    """
    if variant not in VARIANTS:
        raise InputError(f"variant '{variant}' is not one of {', '.join(VARIANTS)}")
    prony = tuple((float(g), float(tau)) for g, tau in model.prony)
    rate = Rates(*rates(prony, 1.0))
    memory = cell.rest(1, rate.advance.shape[1] - 1, rate.creep.shape[1] - 1)
    decoders = [tf.constant(block.decoder.T) for block in model.blocks]
    sign = np.ones((3, model.free.shape[1]), "float32")
    if model.axis is not None:
        sign[model.axis] = -1

    def frame(g: Any, given: Any, again: Any, bulk: Any, *rest: Any) -> dict:
        past, now = Memory(*rest[: len(memory)]), Rates(*rest[len(memory) :])
        a, new, signs = cell(g, past, now, bulk=bulk, given=(given, again))
        u = [a[:, part] @ decoder for part, decoder in zip(cell.parts, decoders, strict=True)]
        if cell.sides == 2:
            u = [u[0] + u[1], (u[0] - u[1]) * sign.reshape(1, -1)]
        answer = {"a": a, "displacement": tf.concat(u, axis=1), "signs": signs}
        return answer | {f"new_{name}": value for name, value in new._asdict().items()}

    R = (1, cell.modes)
    shapes = {"g": R, "given": R, "again": (1, 1), "bulk": cell.bulk.shape or (1,)}
    shapes |= {n: x.shape for values in (memory, rate) for n, x in values._asdict().items()}
    specs = [tf.TensorSpec(shape, "float32", name=name) for name, shape in shapes.items()]
    with quiet():
        traced = tf.function(frame, input_signature=specs).get_concrete_function()
        data = lite_converter(traced, variant).convert()
        audit(data, "float32")
    return named_outputs(data, sorted(traced.structured_outputs))
