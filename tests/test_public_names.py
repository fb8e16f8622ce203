"""`import fem`, `import unet_fem`: what they offer, to users, type checkers and editors."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("fem", "fem.material", "unet_fem", "unet_fem.runtime")
NAMES = [
    (package, name) for package in PACKAGES for name in importlib.import_module(package).__all__
]
PROGRAM = """
import numpy as np
import fem
import unet_fem

mesh: fem.HexMesh = fem.box((2, 2, 2), 1e-3)
surrogate: unet_fem.Surrogate = unet_fem.Surrogate("model.tflite")
moved: np.ndarray = surrogate.step(np.zeros((3, 3, 3, 3)))
scene: fem.Scene = fem.load_scene("scene.toml")
fem.generate(scene, "data.h5")
settings: unet_fem.Settings = unet_fem.load_settings("config.toml")
"""


@pytest.mark.parametrize(("package", "name"), NAMES)
def test_every_public_name_resolves_to_something_that_is_documented(package, name):
    found = getattr(importlib.import_module(package), name)
    if callable(found):
        assert found.__doc__


@pytest.mark.parametrize("package", PACKAGES)
def test_the_stub_tells_type_checkers_the_same_names(package):
    stub = ROOT / package.replace(".", "/") / "__init__.pyi"
    rows = [row for row in ast.parse(stub.read_text()).body if isinstance(row, ast.ImportFrom)]
    names = {alias.asname: getattr(importlib.import_module(row.module), alias.name)
             for row in rows for alias in row.names}  # fmt: skip
    package = importlib.import_module(package)
    assert sorted(names) == package.__all__ == dir(package)
    for name, found in names.items():
        public = getattr(package, name)
        # a command is a module that is called like its function
        assert (
            public is found or public.__name__ == f"{package.__name__}.{name}" and callable(public)
        )


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'fem' has no attribute 'tumor'"):
        importlib.import_module("fem").tumor  # noqa: B018


def test_import_fem_loads_no_library_at_all():
    program = "import fem, unet_fem, sys; print('numpy' in sys.modules, len(sys.modules))"
    first = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert first.stdout.startswith("False"), first.stderr


@pytest.mark.slow
def test_a_type_checker_accepts_a_users_program_and_finds_its_mistakes(tmp_path):
    def check(text):
        (tmp_path / "program.py").write_text(text)
        command = [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml")]
        return subprocess.run(
            [*command, str(tmp_path / "program.py")], cwd=ROOT, capture_output=True, text=True
        )

    good = check(PROGRAM)
    assert not good.returncode, good.stdout
    wrong = check(PROGRAM + 'fem.tumor()\nfem.box("two")\n')
    assert 'has no attribute "tumor"' in wrong.stdout
    assert 'Argument 1 to "box"' in wrong.stdout
