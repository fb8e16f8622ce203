"""The modal network of unet_fem.runtime.modal as a Keras model, on all frames of an interaction at
once."""

from typing import Any

import keras
from keras import ops


class ModalNetwork(keras.Model):
    """l and g -> a - l, (B, T, ...) mm, of B interactions with T frames.

    modes: R; width: of the layers, layers: how many; remembered: how many features are; scales: mm
    of the coordinates that come in, and of the correction. `inputs` of a call: [l; g] (B, T, 2 R),
    and past (B, T, T): q is past p.
    """

    def __init__(
        self,
        modes: int,
        width: int = 256,
        layers: int = 3,
        remembered: int = 32,
        scales: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        super().__init__()
        self.scales, self.remembered = scales, remembered
        dense = keras.layers.Dense
        self.dense = [dense(width, "silu", name=f"dense{n}") for n in range(layers)]
        self.features = dense(remembered, use_bias=False, name="features")
        self.out = dense(modes, use_bias=False, kernel_initializer="zeros", name="out")
        # built here, so that the weights are there before the first call
        inputs = [2 * modes, width + remembered, *[width] * (layers - 2)]
        for layer, size in zip(self.dense, inputs, strict=True):
            layer.build((None, None, size))
        self.features.build((None, None, width))
        self.out.build((None, None, width))
        self.built = True

    def call(self, inputs: Any) -> Any:
        x, past = inputs
        # one more interaction, at rest: what it gives is taken from all
        x = ops.concatenate([x, ops.zeros_like(x[:1])])
        past = ops.concatenate([past, past[:1]])
        a = self.frames(x, lambda p: ops.matmul(past, p - p[-1:]))
        return a[:-1] - a[-1:]

    def frames(self, x: Any, remember: Any) -> Any:
        """a - l and what the layers give at rest, of [l; g]; remember: p -> q."""
        first, second, *more = self.dense
        h = first(x / self.scales[0])
        h = h + second(ops.concatenate([h, remember(self.features(h))], axis=-1))
        for layer in more:
            h = h + layer(h)
        return self.out(h) * self.scales[1]
