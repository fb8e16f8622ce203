"""Which requirement each extra brings."""

import re
from configparser import ConfigParser
from pathlib import Path

import pytest

from fem.lazy import EXTRAS

SETUP = ConfigParser()
SETUP.read(Path(__file__).parents[1] / "setup.cfg")
BRINGS = {
    extra: [re.match(r"[\w-]+(\[.*\])?", line).group() for line in lines.strip().splitlines()]
    for extra, lines in SETUP["options.extras_require"].items()
}


def test_the_base_is_numpy_alone():
    (line,) = SETUP["options"]["install_requires"].strip().splitlines()
    assert line.startswith("numpy")


def test_extras_build_on_each_other():
    assert BRINGS["runtime"] == ["ai-edge-litert"]
    assert not any("unet-fem" in name for name in BRINGS["fem"])
    assert BRINGS["train"][0] == "unet-fem[fem, runtime]"
    assert BRINGS["deploy"][0] == "unet-fem[train]"
    assert BRINGS["test"][0] == "unet-fem[deploy]"


@pytest.mark.parametrize("library", EXTRAS)
def test_a_missing_library_is_told_with_the_extra_that_brings_it(library):
    names = {name.replace("-", "_") for name in BRINGS[EXTRAS[library]]}
    assert library in names
