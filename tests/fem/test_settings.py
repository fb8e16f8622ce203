"""Scenes and configurations: strict keys and types, overrides, and a digest that sees every
setting."""

import copy
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from fem import settings as config
from fem.data.scene import Scene, load_scene
from fem.errors import InputError

CONFIGS = Path(__file__).parents[2] / "configs"
SCENES = sorted(
    path for path in CONFIGS.glob("*.toml") if "interactions" in tomllib.loads(path.read_text())
)


def leaves(tree, where=()):
    for key, value in tree.items():
        yield from (
            leaves(value, (*where, key)) if isinstance(value, dict) else [((*where, key), value)]
        )


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.name)
def test_shipped_scenes_load(path):
    """Every scene in configs/ is valid, has the paper's tissue, and builds its mesh: the tumour on
    17 x 17 x 8 nodes."""
    scene = load_scene(path)
    assert (scene.material.mu, scene.material.nu) == (400.0, 0.42)
    mesh = scene.mesh.build()
    assert mesh.n_cells and (scene.mesh.kind != "tumour" or mesh.grid.shape == (17, 17, 8))


def test_scene_of_the_paper_has_its_sample_counts():
    """tumour.toml: 100 test interactions of which 78-85 are hard, about 1210 training and 300
    validation frames."""
    scene = load_scene(CONFIGS / "tumour.toml")
    assert scene.interactions.test == 100 and scene.interactions.hard == (78, 85)
    assert scene.interactions.train * scene.frames.count == pytest.approx(1210, rel=0.02)
    assert scene.interactions.validation * scene.frames.count == pytest.approx(300, rel=0.02)
    assert dict(scene.material.prony).keys() == {0.12, 0.8}


@pytest.mark.parametrize(
    "wrong, right",
    [
        ({"meterial": {}}, "unknown key 'meterial'; the nearest valid one is 'material'"),
        (
            {"solver": {"dampnig": 1.0}},
            "unknown key 'solver.dampnig'; the nearest valid one is 'solver.damping'",
        ),
        ({"contact": {"Radius": [1.0, 2.0]}}, "'contact.radius'"),
        ({"interactions": {"tests": 1}}, "'interactions.test'"),
    ],
)
def test_unknown_key_names_the_nearest_valid_one(tiny, wrong, right):
    """A misspelt key is an InputError that names it with its table, and the key that was meant."""
    with pytest.raises(InputError) as error:
        config.build(Scene, config.merge(tiny, wrong))
    assert right in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"material": {"mu": "400"}}, "material.mu = '400' must be a number, not str"),
        ({"material": {"mu": True}}, "material.mu = True must be a number, not bool"),
        ({"material": {"prony": 0.5}}, "material.prony = 0.5 must be a list"),
        ({"material": {"prony": [[0.5]]}}, r"material.prony[0] = [0.5] must have 2 entries, not 1"),
        ({"frames": {"count": 3.0}}, "frames.count = 3.0 must be a whole number, not float"),
        ({"mesh": {"cells": [4, 4]}}, "mesh.cells = [4, 4] must have 3 entries, not 2"),
        ({"mesh": {"kind": "sphere"}}, "mesh.kind = 'sphere' is not one of 'tumour', 'box'"),
        ({"solver": {"element": "hex20"}}, "solver.element = 'hex20' is not one of"),
        ({"solver": 3}, "'solver' must be a table, not 3"),
        (
            {"contact": {"radius": [1e-3, "wide"]}},
            "contact.radius[1] = 'wide' must be a number, not str",
        ),
    ],
)
def test_wrong_type_names_key_and_value(tiny, wrong, message):
    """A value of the wrong type or length is an InputError that names key, value and what it must
    be."""
    with pytest.raises(InputError) as error:
        config.build(Scene, config.merge(tiny, wrong))
    assert message in str(error.value)


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"material": {"nu": -0.1}}, "material.nu = -0.1"),
        ({"material": {"nu": 0.5}}, "material.nu = 0.5"),
        ({"mesh": {"edge": 0.0}}, "mesh.edge = 0.0"),
        ({"frames": {"count": 1}}, "count = 1"),
        ({"frames": {"interval": float("nan")}}, "interval = nan"),
        ({"interactions": {"train": 0}}, "interactions.train = 0"),
        ({"interactions": {"hard": [1, 2]}}, "interactions.hard = [1, 2]"),
        ({"interactions": {"hard_force": [0.5, 1.0]}}, "interactions.hard_force = [0.5, 1.0]"),
        ({"interactions": {"seed": -1}}, "interactions.seed = -1"),
    ],
)
def test_impossible_value_is_named(tiny, wrong, message):
    """A value outside its range is an InputError that names key and value."""
    with pytest.raises(InputError) as error:
        config.build(Scene, config.merge(tiny, wrong))
    assert message in str(error.value)


def test_missing_key_and_missing_table_are_named(tiny):
    """What has no default must be there."""
    del tiny["material"]["mu"]
    with pytest.raises(InputError, match="'material.mu' is missing"):
        config.build(Scene, tiny)
    del tiny["material"]
    with pytest.raises(InputError, match="'material' is missing"):
        config.build(Scene, tiny)


def test_missing_and_malformed_files(tmp_path):
    """A missing file names its neighbours, a malformed one its first wrong line; both on one
    line."""
    (tmp_path / "other.toml").write_text("[mesh\n")
    with pytest.raises(
        InputError, match="no configuration file .*missing.toml; beside it are other.toml"
    ):
        load_scene(tmp_path / "missing.toml")
    with pytest.raises(InputError, match="not valid TOML.*line 1"):
        load_scene(tmp_path / "other.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not valid TOML"):
        load_scene(tmp_path / "binary.toml")
    with pytest.raises(InputError, match="no configuration file"):
        load_scene(tmp_path)


def test_toml_round_trip(tiny):
    """A scene written as TOML and read again is the same scene; texts, flags and tiny numbers
    survive."""
    scene = config.build(Scene, tiny)
    assert config.build(Scene, tomllib.loads(scene.toml())) == scene
    tree = {
        "a": 'say "x\\y"',
        "b": True,
        "c": 1e-300,
        "d": [[0.1, 3], []],
        "e": float("inf"),
        "f": {"g": -7, "h": {"i": "j"}},
        "networks": [{"name": "a", "changes": ["x=1"]}, {"name": "b"}],
        "notes": "two\nlines\tand a tab",
    }
    assert tomllib.loads(config.dump_toml(tree)) == tree


def test_values_of_numpy_and_python_are_written_plainly():
    """NumPy scalars and arrays, tuples and paths are written as TOML's own kinds; None is left
    out, in nested tables too."""
    tree = {
        "mu": np.float64(400.0),
        "n": np.int32(3),
        "flag": np.bool_(True),
        "cells": np.array([4, 4, 2]),
        "pairs": ((0.1, 0.2),),
        "file": Path("a") / "b",
        "none": None,
        "table": {"none": None, "low": np.float32(0.5), "tables": [{"none": None, "a": 1}]},
    }
    assert tomllib.loads(config.dump_toml(tree)) == {
        "mu": 400.0,
        "n": 3,
        "flag": True,
        "cells": [4, 4, 2],
        "pairs": [[0.1, 0.2]],
        "file": str(Path("a/b")),
        "table": {"low": 0.5, "tables": [{"a": 1}]},
    }


@dataclass(frozen=True)
class Inner:
    low: float = 0.0

    def __post_init__(self):
        config.normalised(self)


@dataclass(frozen=True)
class Outer:
    rate: float
    count: int
    pairs: tuple[tuple[float, float], ...] = ()
    cells: tuple[int, int, int] | None = None
    kind: Literal["a", "b"] = "a"
    flag: bool = False
    file: str = ""
    inner: Inner = field(default_factory=Inner)
    lines: str | tuple[str, ...] = ()

    def __post_init__(self):
        config.normalised(self)


def test_equal_settings_are_equal_however_they_were_built():
    """Ints for floats, lists and arrays for tuples, NumPy's scalars and tables for plain ones: the
    same settings, hash, repr and text."""
    plain = Outer(1.0, 2, ((0.0, 1.0),), (1, 2, 3), "b", True, "a/b", Inner(2.0), ("one", "two"))
    loose = Outer(
        np.float64(1),
        np.int64(2),
        [[0, np.float32(1)]],
        np.array([1, 2, 3]),
        np.str_("b"),
        np.bool_(True),
        Path("a/b"),
        {"low": 2},
        ["one", "two"],
    )
    assert loose == plain and hash(loose) == hash(plain) and repr(loose) == repr(plain)
    text = config.dump_toml(config.to_dict(loose))
    assert text == config.dump_toml(config.to_dict(plain))
    assert config.build(Outer, tomllib.loads(text)) == plain
    assert type(loose.rate) is float and type(loose.count) is int and type(loose.flag) is bool


@pytest.mark.parametrize(
    "change, message",
    [
        ({"rate": "1"}, "rate = '1' must be a number, not str"),
        ({"count": 2.0}, "count = 2.0 must be a whole number, not float"),
        ({"count": np.array([2])}, "count = [2] must be a whole number, not list"),
        ({"flag": 1}, "flag = 1 must be true or false, not int"),
        ({"cells": (1, 2)}, "cells = (1, 2) must have 3 entries, not 2"),
        ({"kind": "c"}, "kind = 'c' is not one of 'a', 'b'"),
        ({"rate": None}, "rate = None must be a number"),
    ],
)
def test_settings_built_in_python_are_refused_like_those_of_a_file(change, message):
    """A wrong type given in Python is the InputError that a file would get."""
    with pytest.raises(InputError) as error:
        Outer(**({"rate": 1.0, "count": 2} | change))
    assert message in str(error.value)


def test_overrides():
    """key=value words become nested values, as TOML where it is TOML and as text where it is
    not."""
    words = [
        "train.epochs=3",
        "train.rate=1e-4",
        "name=a",
        "flag=true",
        "size=[1, 2]",
        "text='4'",
        "path=data/x=y.h5",
    ]
    assert config.parse_overrides(words) == {
        "train": {"epochs": 3, "rate": 1e-4},
        "name": "a",
        "flag": True,
        "size": [1, 2],
        "text": "4",
        "path": "data/x=y.h5",
    }
    for bad in (["epochs"], ["=3"], ["a=1", "a.b=2"]):
        with pytest.raises(InputError, match=bad[-1]):
            config.parse_overrides(bad)


def test_merge_goes_table_by_table():
    """Overrides replace single entries of a table and leave the originals alone."""
    base = {"a": {"b": 1, "c": 2}, "d": 3}
    kept = copy.deepcopy(base)
    assert config.merge(base, {"a": {"b": 5}, "e": 6}) == {"a": {"b": 5, "c": 2}, "d": 3, "e": 6}
    assert base == kept


def test_digest_changes_with_any_setting(tiny):
    """Each single setting, given or default, changes the digest, or has no meaning and is refused;
    giving a default explicitly does not."""
    scene = config.build(Scene, tiny)
    full = tomllib.loads(scene.toml())
    assert config.build(Scene, full).digest() == scene.digest()
    digests, settings = {scene.digest()}, list(leaves(full))
    other = {"full": "reduced", "float32": "float64", "all but top": "bottom"}
    for (table, key), value in settings:
        changed = copy.deepcopy(full)
        if key == "kind":
            changed["mesh"] = {"kind": "tumour", "edge": full["mesh"]["edge"]}
        elif isinstance(value, str):
            changed[table][key] = other[value]
        elif key == "hard":
            changed["interactions"] |= {"test": 2, "hard": [1, 2]}
        elif isinstance(value, list):
            changed[table][key] = (
                np.array(value) * 1.001 if key not in ("cells",) else np.array(value) + 1
            ).tolist()
        else:
            changed[table][key] = value + 1 if isinstance(value, int) else (value or 1.0) * 1.001
        if key in ("travel", "low", "onset") and changed[table][key] == value:
            changed[table][key] = [0.0, 9.0]
        if key in ("hourglass_motion", "hourglass_share"):  # of the reduced element alone
            with pytest.raises(InputError, match=f"health.{key} = .* has no meaning"):
                config.build(Scene, changed)
            continue
        digests.add(config.build(Scene, changed).digest())
    assert len(digests) == len(settings) - 2 + 1
