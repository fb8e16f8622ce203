"""The modal network of unet_fem.runtime.modal as a Keras model, on all frames of an interaction at
once."""

from typing import Any

import keras
import numpy as np
from keras import ops


@keras.saving.register_keras_serializable("unet_fem")
class ModalNetwork(keras.Model):
    """l and g -> a - l, (B, T, ...) mm, of B interactions with T frames.

    modes: R; width: S of the layers, layers: how many; remembered: how many features are; scales:
    mm of the coordinates that come in, and of the correction. `inputs` of a call: [l; g] (B, T,
    2 R), and past (B, T, T), what the features of each frame weigh in q of another, see `past`.
    """

    def __init__(
        self,
        modes: int,
        width: int = 256,
        layers: int = 3,
        remembered: int = 32,
        scales: tuple[float, float] = (1.0, 1.0),
        **named: Any,
    ) -> None:
        super().__init__(**named)
        self.sizes = {"modes": modes, "width": width, "layers": layers, "remembered": remembered}
        self.scales = tuple(map(float, scales))
        dense = keras.layers.Dense
        self.dense = [dense(width, "silu", name=f"dense{n}") for n in range(layers)]
        self.features = dense(remembered, use_bias=False, name="features")
        self.out = dense(modes, use_bias=False, kernel_initializer="zeros", name="out")
        # built here, so that the weights are there before the first call
        shape, widths = (None, None, 2 * modes), [width + remembered] + [width] * (layers - 2)
        for layer, inputs in zip(self.dense, [2 * modes, *widths], strict=True):
            layer.build((*shape[:2], inputs))
        self.features.build((*shape[:2], width))
        self.out.build((*shape[:2], width))
        self.built = True

    def call(self, inputs: Any) -> Any:
        x, past = inputs
        first, second, *more = self.dense
        # one more interaction, at rest: what it gives is taken from all
        h = first(ops.concatenate([x, ops.zeros_like(x[:1])]) / self.scales[0])
        p = self.features(h)
        p = p - p[-1:]
        past = ops.concatenate([past, past[:1]])
        h = h + second(ops.concatenate([h, ops.matmul(past, p)], axis=-1))
        for layer in more:
            h = h + layer(h)
        a = self.out(h)
        return (a[:-1] - a[-1:]) * self.scales[1]

    def weights_of_file(self) -> dict[str, np.ndarray]:
        """{"W0", "b0", ..., "P", "out"} of unet_fem.runtime.modal, all float32."""
        found = {"P": self.features.kernel, "out": self.out.kernel * self.scales[1]}
        for n, layer in enumerate(self.dense):
            found |= {f"W{n}": layer.kernel, f"b{n}": layer.bias}
        found["W0"] = found["W0"] / self.scales[0]
        arrays = {name: ops.convert_to_numpy(value).T for name, value in found.items()}
        return {name: np.ascontiguousarray(value, "float32") for name, value in arrays.items()}

    def get_config(self) -> dict:
        return self.sizes | {"scales": self.scales}
