"""Magnitude pruning: zeros inside the convolutions of a trained network.

It is the paper's way, by the TensorFlow Model Optimization toolkit, which works on Keras 2 models
only and switches its process to them: keep it in a process of its own (tools/prune.py).
"""

from collections.abc import Callable

import keras
import numpy as np

from unet_fem.deployment.twins import legacy_twin
from unet_fem.networks.registry import Options


def magnitude_prune(
    model: keras.Model,
    options: Options,
    sparsity: float,
    inputs: np.ndarray,
    targets: np.ndarray,
    loss: Callable,
    *,
    epochs: int,
    batch_size: int = 16,
    learning_rate: float = 1e-4,
    precision: str = "float32",
) -> None:
    """Fine-tune `model` while a polynomial schedule drives `sparsity` (0-1) of its convolutions'
    weights to zero.

    options: of the network, see unet_fem.networks.registry. inputs, targets: training samples as
    `model.fit` takes them; loss(y_true, y_pred). The schedule ends at half of the epochs, and the
    rest recovers. precision: Keras's policy for the fine-tuning. Changes the weights of `model` in
    place.
    """
    import tensorflow_model_optimization as tfmot  # switches the process, see above
    import tf_keras

    steps = -(-len(inputs) // batch_size) * epochs
    schedule = tfmot.sparsity.keras.PolynomialDecay(
        0.0, sparsity, 0, max(1, steps // 2), frequency=max(1, steps // 100)
    )

    def wrap(layer):
        if isinstance(layer, tf_keras.layers.Conv3D):
            # float32: masks and weights; under a mixed policy the wrapper would round the weights
            # in every step
            return tfmot.sparsity.keras.prune_low_magnitude(
                layer, pruning_schedule=schedule, dtype="float32"
            )
        return layer

    policy = tf_keras.mixed_precision.global_policy()
    tf_keras.mixed_precision.set_global_policy(precision)
    try:
        legacy = legacy_twin(model, options)
        twin = tf_keras.models.clone_model(legacy, clone_function=wrap)
        rate = tf_keras.optimizers.schedules.CosineDecay(learning_rate, steps)
        twin.compile(tf_keras.optimizers.Adam(rate, epsilon=1e-12), loss)
        tfmot.sparsity.keras.strip_pruning(twin).set_weights(
            legacy.get_weights()
        )  # clone_model copies the architecture alone
        twin.fit(
            inputs,
            targets,
            batch_size=batch_size,
            epochs=epochs,
            verbose=2,
            callbacks=[tfmot.sparsity.keras.UpdatePruningStep()],
        )
        model.set_weights(tfmot.sparsity.keras.strip_pruning(twin).get_weights())
    finally:
        tf_keras.mixed_precision.set_global_policy(policy)
