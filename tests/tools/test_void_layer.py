"""The void layer is moved to either end of the grid, and what has none is refused."""

import runpy

import numpy as np
import pytest

from fem.errors import InputError

TOOL = runpy.run_path("tools/void_layer.py")


@pytest.mark.parametrize("first", [0, 1])
def test_the_layers_move_to_either_end(first):
    mask = np.zeros((3, 3, 5), bool)
    mask[..., first : first + 4] = True
    for end, void in (("below", 0), ("above", -1)):
        moved = np.roll(mask, TOOL["shift"](mask, end), axis=-1)
        assert not moved[..., void].any() and moved.sum() == mask.sum()
        assert moved.any(axis=(0, 1)).sum() == 4 and (end == "below") != moved[0, 0, 0]


@pytest.mark.parametrize("layers", ["11111", "11011", "00111", "01110"])
def test_a_grid_without_one_void_layer_at_an_end_is_refused(layers):
    mask = np.broadcast_to(np.array(list(layers)) == "1", (3, 3, 5))
    with pytest.raises(InputError, match="not one void layer"):
        TOOL["shift"](mask, "below")


def test_the_table_has_the_mean_and_each_seed():
    rows = [
        {"network": "net", "parameters": 1000, "void": end, "seed": seed, "train": 0.1}
        | {"validation": error}
        for end, errors in (("below", (0.2, 0.3)), ("above", (0.1, 0.2)))
        for seed, error in enumerate(errors, 1)
    ]
    lines = TOOL["table"](rows).splitlines()[2:]
    assert lines[0] == "| net | 1,000 | below | 10.0 | 25.0 | 20.0, 30.0 |"
    assert lines[1] == "| net | 1,000 | above | 10.0 | 15.0 | 10.0, 20.0 |"
