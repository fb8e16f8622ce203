"""A setting that a kind of model has no use for is refused, and what is not refused is read."""

import shutil
import sys
import tomllib
from dataclasses import fields

import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError
from unet_fem import train
from unet_fem.networks.registry import NETWORKS
from unet_fem.training.run import read_settings
from unet_fem.training.settings import TABLES, from_tree, load_settings, unused, without

OTHER = {
    "schedule": "constant",
    "precision": "mixed_bfloat16",
    "volume_of": "tumour",
    "memory": "creep",
    "physics": "elastic",
    "split": "frames",
}


def tree(kind, **tables):
    return {"name": "a", "scene": "a.toml", "data": "a.h5", "model": {"kind": kind}} | tables


def changed(kind, table, name):
    """Settings with one of another value than the default."""
    usual = getattr(TABLES[table](), name)
    own = {name: OTHER.get(name) or usual + (1 if isinstance(usual, int) else 0.01)}
    if name == "seed" and table == "samples":  # of a draw
        own["each"] = 3
    return from_tree(tree(kind, **{table: own}))


@pytest.mark.parametrize("kind", NETWORKS)
def test_a_setting_is_refused_or_tells_runs_apart(kind):
    """Every setting of every table: the row of the kind says which."""
    for table, cls in TABLES.items():
        for own in fields(cls):
            if own.name in unused(kind)[table]:
                with pytest.raises(InputError, match=f"{table}.* no meaning for model.kind = "):
                    changed(kind, table, own.name)
            else:
                settings = changed(kind, table, own.name)
                assert settings != from_tree(tree(kind))
                assert from_tree(tomllib.loads(settings.toml())) == settings


@pytest.mark.parametrize(
    "kind", ["linear", "elastic", pytest.param("unet", marks=pytest.mark.slow)]
)
def test_what_is_not_refused_is_read(kind, tiny_dataset, tmp_path, monkeypatch):
    """Every setting that a kind takes is read in its run, other than to compare settings."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(tiny_dataset, "a.h5")
    scene = open_dataset("a.h5").scene
    (tmp_path / "a.toml").write_text(scene.toml())
    tables = {"input": {"memory": "creep"}, "train": {"epochs": 1}}
    tables["samples"] = {"each": 2, "split": "frames", "seed": 1}
    own = tree(kind, **without(tables, unused(kind)))
    if kind == "unet":
        own["model"]["filters"] = 2
    settings = from_tree(own)
    read = set()
    for table, cls in TABLES.items():

        def get(self, name, table=table):
            caller = sys._getframe(1).f_code
            if caller.co_name != "__eq__" and not caller.co_filename.endswith("settings.py"):
                read.add((table, name))
            return object.__getattribute__(self, name)

        monkeypatch.setattr(cls, "__getattribute__", get, raising=False)
    train(settings)
    takes = {
        (table, own.name)
        for table, cls in TABLES.items()
        for own in fields(cls)
        if own.name not in unused(kind)[table]
    }
    assert takes and takes <= read, takes - read


def test_another_kind_leaves_out_what_the_file_says_of_its_own(tmp_path):
    """And says so; what the command line says itself is refused."""
    path, said = tmp_path / "a.toml", []
    path.write_text(
        from_tree(tree("unet", train={"batch_size": 4}, loss={"direction_weight": 1})).toml()
    )
    assert load_settings(path, ["model.kind=linear"], said.append) == from_tree(tree("linear"))
    assert len(said) == 1 and "[model], [train], loss.direction_weight" in said[0]
    with pytest.raises(InputError, match="train.batch_size = 3 has no meaning"):
        load_settings(path, ["model.kind=linear", "train.batch_size=3"])
    assert load_settings(path, [], said.append).train.batch_size == 4 and len(said) == 1


def test_the_run_of_a_regression_made_before_is_read_without_what_it_did_not_use(tmp_path):
    (tmp_path / "config.toml").write_text(
        'name = "a"\nscene = "a.toml"\ndata = "a.h5"\n[model]\nkind = "linear"\nsteps = 2\n'
        "[train]\nepochs = 7\nbatch_size = 3\n[loss]\nvolume_weight = 0.3\n"
    )
    settings = read_settings(tmp_path)
    assert settings.model.steps == 2 and "train" not in tomllib.loads(settings.toml())
