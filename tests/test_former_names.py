"""The import paths of version 0.1 lead to the new ones, for one release, with a warning."""

import importlib
import subprocess
import sys
import warnings

import pytest

import fem.former
import unet_fem.former

TABLE = fem.former.FEM | unet_fem.former.FORMER
GONE = fem.former.GONE | unet_fem.former.GONE
PATHS = [
    (old, *word.partition(":")[::2], new)
    for old, homes in TABLE.items()
    for new, names in homes.items()
    for word in names.split()
]


@pytest.mark.parametrize(("old", "name", "now", "new"), PATHS)
def test_an_old_path_gives_what_the_new_one_gives_and_warns(old, name, now, new):
    module = importlib.import_module(old)
    place = f"{old}.{name} is {new}.{now or name} now; the old path goes in version 0.3"
    with pytest.warns(DeprecationWarning) as said:
        found = getattr(module, name)
    assert place in [str(warning.message) for warning in said]
    assert found is getattr(importlib.import_module(new), now or name)
    assert getattr(found, "__module__", new) == new  # where it is defined, not where it passes by


@pytest.mark.parametrize("path", GONE)
def test_what_is_no_more_says_what_to_use(path):
    module, _, name = path.rpartition(".")
    with pytest.raises(ImportError, match=f"{path} is no more; "):
        getattr(importlib.import_module(module), name)


def test_the_warning_points_at_the_line_that_imports():
    with pytest.warns(DeprecationWarning) as said:
        from fem.mesh import HexMesh  # noqa: F401
    assert {warning.filename for warning in said} == {__file__}


def test_an_old_module_has_no_other_names():
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        from unet_fem.models import nothing  # noqa: F401


def test_new_paths_do_not_warn():
    program = "import fem, unet_fem, fem.mesh, fem.solver.explicit, fem.data.dataset"
    run = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True)
    assert not run.returncode, run.stderr.decode()


def test_the_finder_answers_to_old_names_alone():
    remembered = fem.former._Finder
    assert sys.meta_path.count(remembered) == 1
    assert remembered.find_spec("fem.nothing") is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert remembered.find_spec("fem.kernel").name == "fem.kernel"
    with pytest.raises(ModuleNotFoundError, match="fem.nothing"):
        importlib.import_module("fem.nothing")
