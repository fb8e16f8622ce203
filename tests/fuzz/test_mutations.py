"""Random mutations of every shipped TOML file, of a dataset and of a surrogate's arrays: each is
taken, or refused in one line; no other exception and no dead process.

    pytest tests/fuzz                      a few hundred, in seconds
    FUZZ=100 pytest -m slow tests/fuzz     a hundred times as many
"""

import copy
import math
import os
import re
import shutil
import tomllib
from pathlib import Path

import h5py
import numpy as np
import pytest
import tomli_w

from fem import settings as config
from fem.data.dataset import open_dataset
from fem.data.scene import SPLITS, Scene
from fem.errors import InputError, SolverStopped
from fem.files import save_arrays
from fem.online.regression import Regression, RegressionStepper
from unet_fem.study.settings import Study
from unet_fem.training.settings import from_tree

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.toml"))
MORE = int(os.environ.get("FUZZ", "10"))
VALUES = [
    0, -1, 1, 2, 3, 10**9, 10**30, 0.0, -1.0, 0.5, 1.0, 1e-300, 1e308, math.nan, math.inf,
    -math.inf, "", "..", "a/b", "x\n", True, [], {}, [0.1, 0.2], [[0.1, 1.0]],
]  # fmt: skip


def refused(function, *arguments):
    """Whether the project refuses in one line; any exception that is not its own passes through."""
    try:
        function(*arguments)
    except (InputError, SolverStopped) as error:
        assert "\n" not in str(error) and len(str(error)) < 1000, error
        return True
    return False


def places(node, where=()):
    """The keys of every leaf of nested dicts and lists."""
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in items:
        if isinstance(value, (dict, list)) and value:
            yield from places(value, (*where, key))
        yield (*where, key)


def at(tree, where):
    for key in where:
        tree = tree[key]
    return tree


def is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def mutated(tree, rng):
    """`tree` with one leaf changed: scaled, replaced, renamed or left out."""
    tree = copy.deepcopy(tree)
    every = list(places(tree))
    numbers = [where for where in every if is_number(at(tree, where))]
    some = numbers if rng.random() < 0.8 else every  # names and texts are mostly refused
    *parents, key = some[rng.integers(len(some))]
    node = tree
    for parent in parents:
        node = node[parent]
    old, kind = node[key], rng.integers(6)
    if is_number(old) and kind < 4:
        factor = (1 + rng.normal(), 10 ** rng.uniform(-1, 1), 1.1, 0.9)[kind]
        node[key] = type(old)(old * factor)
    elif kind == 5 and isinstance(node, dict):
        del node[key]
    else:
        node[key] = copy.deepcopy(VALUES[rng.integers(len(VALUES))])
    return tree


def load(tree):
    """The settings of a tree of any of the three kinds, and what they give at once."""
    if "interactions" in tree or "contact" in tree:
        scene = config.build(Scene, tree)
        assert config.build(Scene, tomllib.loads(scene.toml())) == scene
    elif "networks" in tree:
        config.build(Study, tree)
    else:
        settings = from_tree(tree)
        assert from_tree(tomllib.loads(settings.toml())) == settings


def fuzz_toml(path, count):
    tree, rng = tomllib.loads(path.read_text()), np.random.default_rng(len(path.name))
    load(tree)
    return sum(not refused(load, mutated(tree, rng)) for _ in range(count)) / count


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.name)
def test_mutations_of_settings(path):
    """Thirty a file; a third of all or so pass the parser, so that it is not names alone that are
    tried."""
    assert fuzz_toml(path, 3 * MORE) >= 0.3


@pytest.mark.slow
@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.name)
def test_many_mutations_of_settings(path):
    assert fuzz_toml(path, 100 * MORE) >= 0.3


def read_all(path):
    dataset = open_dataset(path)
    for split in SPLITS[:3]:
        dataset.read(split)
    dataset.contacts("test", 1)
    dataset.sequence("train", 1)
    return dataset.confirmation, dataset.rejected, dataset.material, dataset.for_learning()


def spoil(path, rng):
    """One member or attribute of an HDF5 file changed."""
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name, kind = names[rng.integers(len(names))], rng.integers(6)
        member = file[name]
        if kind == 0:
            del file[name]
        elif kind == 1:
            del file[name]
            file[name] = h5py.SoftLink("/time")
        elif kind == 2 or isinstance(member, h5py.Group):
            attribute = list(file.attrs)[rng.integers(len(file.attrs))]
            file.attrs[attribute] = ["", "{}", "[1]", 3, math.nan, b"\xff"][rng.integers(6)]
        elif kind == 3:
            shape, dtype = member.shape, member.dtype
            del file[name]
            file.create_dataset(name, shape[1:] if len(shape) > 1 else (0,), dtype)
        else:
            values = member[()]
            flat = values.reshape(-1).view("u1")
            flat[rng.integers(flat.size, size=8)] = rng.integers(256, size=8)
            member[...] = values


def test_mutations_of_a_dataset(tiny_dataset, tmp_path):
    """A hundred, of which some hit what has no meaning by itself, such as a digit of a force."""
    rng, passed, count = np.random.default_rng(5), 0, 10 * MORE
    for _ in range(count):
        path = tmp_path / "copy.h5"
        shutil.copy(tiny_dataset, path)
        spoil(path, rng)
        passed += not refused(read_all, path)
    assert 0 < passed < count


def test_mutations_of_the_bytes_of_a_dataset(tiny_dataset, tmp_path):
    """Bytes anywhere in the file: HDF5 finds what is wrong with its own, we with ours."""
    rng, whole = np.random.default_rng(6), tiny_dataset.read_bytes()
    for _ in range(5 * MORE):
        data = bytearray(whole)
        for place in rng.integers(len(data), size=4):
            data[place] = rng.integers(256)
        path = tmp_path / "copy.h5"
        path.write_bytes(data[: len(data) if rng.random() < 0.8 else rng.integers(len(data))])
        refused(read_all, path)


def test_mutations_of_a_regression(tmp_path):
    """Its arrays, and the bytes of its archive."""
    rng, path = np.random.default_rng(7), tmp_path / "model.npz"
    mask = np.ones((3, 3, 3), bool)
    kernel = rng.normal(size=(27, 81)).astype("f4")
    Regression(mask, np.arange(27), kernel, interval=0.25).save(path)
    whole, passed = path.read_bytes(), 0
    with np.load(path) as file:
        arrays = dict(file)

    def use():
        stepper = RegressionStepper.open(path)
        assert np.isfinite(stepper.step(np.ones((3, 3, 3, 3)))).all()

    odd = [np.array("x"), np.zeros(0), np.full((2, 2), np.nan), np.array(-1), np.arange(9.0)]
    for i in range(20 * MORE):
        if i % 2:
            data = bytearray(whole)
            for place in rng.integers(len(data), size=3):
                data[place] = rng.integers(256)
            path.write_bytes(data)
        else:
            name = list(arrays)[rng.integers(len(arrays))]
            save_arrays(path, **arrays | {name: odd[rng.integers(len(odd))]})
        passed += not refused(use)
    assert passed < 20 * MORE


def test_mutations_as_text(tmp_path):
    """A letter changed anywhere in a scene file."""
    rng, path = np.random.default_rng(8), tmp_path / "scene.toml"
    text = CONFIGS[0].parent.joinpath("tumour_tiny.toml").read_text()
    assert re.search("seed", text) and tomli_w.dumps({}) == ""
    for _ in range(10 * MORE):
        letters = list(text)
        letters[rng.integers(len(letters))] = "\0'\"[]{}=#.\n-9é"[rng.integers(14)]
        path.write_text("".join(letters))
        refused(lambda: load(config.read_toml(path)))
