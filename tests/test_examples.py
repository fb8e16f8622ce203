"""The examples do what they say, in a reduced size."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from fem.online.constitutive import ConstitutiveStepper
from fem.online.press import Press

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name):
    """The module of an example."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    """That of a whole small block, softer and thicker than the tumour."""
    conftest = EXAMPLES.parent / "tests/fem/conftest.py"
    spec = importlib.util.spec_from_file_location("whole_block", conftest)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    import fem

    block = fem.box((4, 3, 2), edge=1e-3).with_sets(fixed="z min", loaded="z max")
    model = module.whole(block, module.TISSUE)
    learned = {"gain": np.ones(model.modes, "float32"), "effort": np.array([1e-3, 6.0])}
    for b, one in enumerate(model.blocks):
        learned[f"N{b}"] = -one.M[:, : len(one.A)]
    return Press(ConstitutiveStepper(model, learned), model.surface())


@pytest.mark.parametrize("controlled", [False, True])
@pytest.mark.parametrize("coupling", [0.5, 1.0, 2.0])
def test_the_tissue_of_a_haptic_loop_makes_no_energy(press, coupling, controlled, monkeypatch):
    loop = example("press_loop")
    monkeypatch.setattr(loop, "RADIUS", 1.2)
    monkeypatch.setattr(loop, "PERIOD", 0.4)
    done = loop.run(press, 0.4, coupling, controlled)
    assert done.given > 1e-3 and done.taken > 0.5 * done.given, "it was pressed, and let go again"
    assert done.passive > -0.01
    assert np.isfinite(done.force).all()
