"""Keras models as files, written whole or not at all, and read without running what is in them."""

import io
import json
import time
import zipfile
from pathlib import Path
from typing import Any

import h5py
import keras

from fem.errors import InputError
from fem.files import DAMAGES, replacing
from unet_fem.networks.layers import float32_twin

LARGEST = 2**33  # bytes of a model's file, unpacked: weights of 2e9 parameters
FIRST = 315_619_200  # s, 2 January 1980: zip archives know no earlier time
LONGEST = 2**26  # bytes of its description
# what a description may name: Keras's own classes, and of those none that loads or runs other code
MODULES = {None, "keras", "keras.layers", "keras.initializers", "keras.regularizers"}
INSIDE = ("keras.src.layers.", "keras.src.ops.", "keras.src.models.")
FOREIGN = {"Lambda", "TFSMLayer", "TorchModuleWrapper", "JaxLayer", "FlaxLayer", "function"}


def save_model(model: keras.Model, path: Path | str) -> None:
    """Write a whole Keras model in float32 to `path` (.keras)."""
    if time.time() < FIRST:
        raise InputError(f"the clock says {time.ctime()}, and no .keras file is so old; set it")
    with replacing(path) as partial:
        keras.saving.save_model(float32_twin(model), partial)


def load_model(path: Path | str) -> keras.Model:
    """The Keras model at `path`.

    Keras's safe mode is on, and the description is vetted before: it may name Keras's own layers
    alone, none that runs code of the file's. Raises InputError if the file is missing, damaged,
    or of that kind.
    """
    if not Path(path).is_file():
        raise InputError(f"no model {path}; train one with python -m unet_fem.train")
    try:
        _vet(Path(path))
        return keras.saving.load_model(path, compile=False, safe_mode=True)
    except InputError:
        raise
    # Keras fails in many ways on what it did not write
    except (*DAMAGES, IndexError, ImportError, RecursionError) as error:
        raise InputError(
            f"{path} cannot be loaded ({' '.join(str(error).split())[:200]}); delete it and train"
            " again"
        ) from None


def _vet(path: Path) -> None:
    """Raises InputError for a .keras file that is too large unpacked, names other code, or whose
    weights lie elsewhere."""
    with zipfile.ZipFile(path) as archive:
        sizes = {member.filename: member.file_size for member in archive.infolist()}
        if sum(sizes.values()) > LARGEST or sizes.get("config.json", 0) > LONGEST:
            raise InputError(
                f"{path} would unpack to {sum(sizes.values()) / 2**20:.0f} MiB; do not trust it"
            )
        _vet_description(json.loads(archive.read("config.json")), path)
        for name in sizes:
            if name.endswith(".h5"):
                with archive.open(name) as weights:
                    check_links(io.BytesIO(weights.read()), path)


def _vet_description(node: Any, path: Path) -> None:
    if isinstance(node, dict):
        module, name = node.get("module"), node.get("class_name")
        own = (
            (module in MODULES or str(module).startswith(INSIDE))
            and node.get("registered_name") in (None, name)
            and name not in FOREIGN
            and str(name)[:1] in "_ABCDEFGHIJKLMNOPQRSTUVWXYZ"  # a class, or what NumPy has
        )
        if name is not None and not own:
            raise InputError(
                f"{path} asks for {module}.{name}, which is no layer of Keras's own; it may run"
                " code of its maker's and is not loaded"
            )
        for item in node.values():
            _vet_description(item, path)
    elif isinstance(node, list):
        for item in node:
            _vet_description(item, path)


def check_links(file: Path | str | io.BytesIO, path: Path | str | None = None) -> None:
    """Raises InputError if an HDF5 file of weights has links, or bytes that are in other files."""

    def visit(group):
        for name in group:
            member = group[name] if type(group.get(name, getlink=True)) is h5py.HardLink else None
            own = member is not None and not (
                isinstance(member, h5py.Dataset) and (member.external or member.is_virtual)
            )
            if not own:
                raise InputError(
                    f"'{group.name}/{name}' of {path or file} lies in another file; it is not read"
                )
            if isinstance(member, h5py.Group):
                visit(member)

    with h5py.File(file, "r") as opened:
        visit(opened)
