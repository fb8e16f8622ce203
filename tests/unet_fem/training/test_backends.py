"""Two steps of training on Keras's JAX backend are those on TensorFlow."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

TRAINS = """
import json, sys
import keras, numpy as np
import fem
from unet_fem.networks.registry import network
from unet_fem.training.losses import volume_loss

kind, own = sys.argv[1], json.loads(sys.argv[2])
row = network(kind)
options = row.options(**own)
grid, rng = (6, 6, 3), np.random.default_rng(1)
model = row.build(grid, options, (0.1, 0.2))
model.set_weights([0.1 * rng.standard_normal(w.shape) for w in model.get_weights()])
for layer in model.layers:
    if isinstance(layer, keras.layers.Dropout):
        layer.rate = 0.0  # each backend draws numbers of its own
mesh = fem.box([n - 1 for n in grid], 1e-3)
loss = volume_loss(1e3 * mesh.points, mesh.boundary_faces, weight=0.1, threshold=1e-6)
# a plain descent: Adam would divide by gradients that are next to nothing
model.compile(keras.optimizers.SGD(0.1), loss)
force, truth = (
    rng.standard_normal((2, *shape, *grid, 3)).astype("float32")
    for shape in (model.input_shape[1:-4], ())
)
losses = [float(model.train_on_batch(force, truth)) for _ in range(2)]
answer = np.asarray(model(force)).ravel().tolist()
print(json.dumps([keras.backend.backend(), losses, answer]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not importlib.util.find_spec("jax"), reason="jax is not installed")
@pytest.mark.parametrize(
    "kind, own", [("cnn_lstm", {"units": 8, "steps": 2}), ("unet", {"filters": 2})]
)
def test_two_steps_on_jax_agree_with_tensorflow(kind, own):
    found = {}
    for backend in ("tensorflow", "jax"):
        run = subprocess.run(
            [sys.executable, "-c", TRAINS, kind, json.dumps(own)],
            capture_output=True,
            text=True,
            env=os.environ
            | {"KERAS_BACKEND": backend, "PYTHONPATH": str(Path(__file__).parents[3])},
        )
        assert not run.returncode, run.stderr
        name, losses, answer = json.loads(run.stdout.splitlines()[-1])
        assert name == backend and losses[1] != losses[0]
        found[name] = losses, np.array(answer)
    (losses, answer), (own_losses, own_answer) = found["tensorflow"], found["jax"]
    np.testing.assert_allclose(own_losses, losses, rtol=1e-5)
    np.testing.assert_allclose(own_answer, answer, atol=1e-5 * np.abs(answer).max())
