"""Cached results: taken again for the same settings, files and version, and for nothing else."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from fem.cache import cache_root, digest, once
from fem.errors import InputError


@dataclass(frozen=True)
class Stage:
    steps: tuple[int, ...] = (1, 2)
    rate: float = 0.5
    folder: str = field(default="here", compare=False)


@dataclass(frozen=True)
class Other:
    steps: tuple[int, ...] = (1, 2)
    rate: float = 0.5


def test_root_is_given_or_set_or_default(monkeypatch):
    """The option comes before the environment variable, and that before runs/cache."""
    monkeypatch.delenv("UNET_FEM_CACHE", raising=False)
    assert cache_root() == Path("runs/cache")
    monkeypatch.setenv("UNET_FEM_CACHE", "/elsewhere")
    assert cache_root() == Path("/elsewhere") and cache_root("given") == Path("given")


def test_once_makes_a_result_once_a_key(tmp_path):
    """The same key reads the file, another key makes the result again in its place."""
    made = []

    def make():
        made.append(None)
        return {"errors": (1.5, None), "n": len(made)}

    path = tmp_path / "stage" / "result.json"
    assert once(path, "a", make) == {"errors": [1.5, None], "n": 1} == once(path, "a", make)
    assert once(path, "b", make)["n"] == 2 and once(path, "a", make)["n"] == 3
    path.write_text('{"key": "a"')
    with pytest.raises(InputError, match="result.json is damaged; delete it"):
        once(path, "a", make)
    with pytest.raises(ValueError, match="JSON"):  # no number that another reader refuses
        once(tmp_path / "nan.json", "a", lambda: float("nan"))
    assert not (tmp_path / "nan.json").exists()


def test_an_edited_file_another_setting_or_version_misses(tmp_path):
    """Every part of the key makes another key; so does the order of the files."""
    a, b = tmp_path / "a.h5", tmp_path / "b.h5"
    a.write_bytes(b"one")
    b.write_bytes(b"two")
    keys = [
        digest(Stage(), [a, b]),
        digest(Stage(rate=0.6), [a, b]),
        digest(Stage(steps=(1, 2, 3)), [a, b]),
        digest(Other(), [a, b]),
        digest(Stage(), [a, b], version=2),
        digest(Stage(), [b, a]),
        digest(Stage(), [a]),
    ]
    a.write_bytes(b"onf")
    keys.append(digest(Stage(), [a, b]))
    assert len(set(keys)) == len(keys) and all(len(key) == 16 for key in keys)


def test_a_touched_clock_or_a_renamed_file_hits(tmp_path):
    """Only content counts; what a dataclass does not compare by does not either."""
    path = tmp_path / "data.h5"
    path.write_bytes(b"content")
    key = digest(Stage(), [path])
    os.utime(path, (1, 1))
    assert digest(Stage(folder="there"), [path]) == key
    assert digest(Stage(), [path.rename(tmp_path / "renamed.h5")]) == key


def test_equal_settings_have_one_key():
    """Lists and tuples, NumPy's scalars and plain ones, and the order of a dict or set."""
    assert digest({"a": 1, "b": [0.5, "x"]}) == digest(
        {"b": (np.float64(0.5), "x"), "a": np.int8(1)}
    )
    assert digest({"x", "y", "z"}) == digest({"z", "y", "x"})
    assert digest(1) != digest(1.0) != digest("1.0")


def test_arrays_count_by_their_whole_content():
    """An array that prints with dots is another when its middle changes; layout in memory does not
    count."""
    values = np.zeros((100, 100))
    key = digest(values)
    assert digest(np.asfortranarray(values)) == key != digest(values.reshape(-1))
    values[50, 50] = 1e-300
    assert digest(values) != key != digest(np.zeros((100, 100), np.float32))


def test_a_key_is_the_same_in_another_process():
    """No order of sets, no address: a process with other hashes gives the same key."""
    settings = {"kinds": {"full", "reduced", "mean"}, "rows": [1, 2.5, None, True], "z": "ü"}
    code = f"from fem.cache import digest; print(digest({settings!r}))"
    for seed in ("1", "2"):
        result = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            env=os.environ | {"PYTHONHASHSEED": seed},
        )
        assert result.stdout.strip() == digest(settings), result.stderr


@pytest.mark.parametrize("value", [object(), {"f": print, "g": json.JSONDecoder()}, lambda: 0])
def test_an_object_without_a_lasting_repr_is_refused(value):
    """What would read otherwise in the next process, or prints its address, is no key."""
    with pytest.raises(InputError, match="no lasting name"):
        digest([value])
    with pytest.raises(InputError, match="no lasting name"):
        digest(np.array([value, None]))
