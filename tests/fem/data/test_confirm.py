"""Mass scaling is confirmed by a sample at the true mass, in the making of every dataset."""

from dataclasses import replace

import numpy as np
import pytest

from fem import settings as config
from fem.contact.surface import surface_of
from fem.data import build
from fem.data.build import generate
from fem.data.confirm import Confirmation, check_confirmed, confirmed, sampled
from fem.data.dataset import open_dataset
from fem.data.draws import drawn_contacts
from fem.data.interaction import healthy_interaction, simulate
from fem.data.scene import Scene
from fem.errors import InputError
from fem.generate import main

TRUE_MASS = {"solver": {"mass_scaling": 1.0}}


def test_the_sample_has_a_hard_one_first_and_is_spread_over_the_splits(tiny):
    """Three by default: a hard one, one of training and one of validation, drawn by the seed; none
    at the true mass."""
    many = {"interactions": {"train": 9, "validation": 9, "test": 9, "hard": [4, 6]}}
    tree = config.merge(config.merge(tiny, many), {"health": {"confirm": 3}})
    scene = config.build(Scene, tree)
    found = sampled(scene)
    assert [split for split, _ in found] == ["test", "train", "validation"]
    assert 4 <= found[0][1] <= 6 and found == sampled(config.build(Scene, tree))
    assert (
        len(
            {
                tuple(sampled(replace(scene, interactions=replace(scene.interactions, seed=n))))
                for n in range(5)
            }
        )
        > 1
    )
    for count in (0, 5, 99):
        more = sampled(replace(scene, health=replace(scene.health, confirm=count)))
        assert len(more) == len(set(more)) == min(count, 27) and more[:3] == found[:count]
    assert not sampled(config.build(Scene, config.merge(tree, TRUE_MASS)))


def test_the_file_tells_the_distance_from_the_true_mass(tiny_dataset):
    """It is that of the stored displacement from the same contacts with mass_scaling = 1."""
    dataset = open_dataset(tiny_dataset)
    (row,) = dataset.confirmation
    assert (row["split"], row["number"]) == (b"test", 1)
    true = dataset.scene.with_solver(replace(dataset.scene.solver, mass_scaling=1.0))
    mesh = dataset.fem_mesh
    exact = simulate(true, mesh, dataset.contacts("test", 1), surface_of(mesh))["displacement"]
    got = dataset.sequence("test", 1).displacement
    error = np.linalg.norm(got - exact) / np.linalg.norm(exact)
    assert 1e-4 < row["error"] < 0.02 and row["error"] == pytest.approx(error, rel=1e-3)


def test_data_too_far_from_the_true_mass_are_not_written(tiny, tmp_path, monkeypatch, capsys):
    """One line names interaction, distance and remedy; what was simulated is kept and is not
    simulated again."""
    tree = config.merge(tiny, {"health": {"mass_error": 1e-4}})
    scene = tmp_path / "scene.toml"
    scene.write_text(config.dump_toml(tree))
    words = [str(scene), "--out", str(tmp_path / "out.h5"), "--workers", "1"]
    with pytest.raises(SystemExit) as exit:
        main(words)
    assert exit.value.code == 2 and not (tmp_path / "out.h5").exists()
    (folder,) = tmp_path.glob(".out.h5.*.parts")
    assert len(list(folder.glob("*.npz"))) == 4 and len(list(folder.glob("true-mass-*"))) == 1
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith("error: test interaction 1 is 0.")
    assert "health.mass_error = 0.01% is allowed" in message
    assert message.endswith("lower solver.mass_scaling = 4")

    def again(*task):
        raise AssertionError("simulated again")

    for name in ("confirmed", "healthy_interaction"):
        monkeypatch.setattr(build, name, again)
    with pytest.raises(InputError, match="test interaction 1 is"):
        generate(config.build(Scene, tree), tmp_path / "out.h5", workers=1)


def test_a_stop_at_the_true_mass_is_no_confirmation(tiny):
    """It counts as infinitely far away, and so does a NaN."""
    scene = config.build(Scene, config.merge(tiny, {"solver": {"safety": 1.5}}))
    mesh = scene.mesh.build()
    contacts = drawn_contacts(scene, surface_of(mesh), "train", 1, 0)
    found = confirmed(scene, mesh, "train", 1, contacts, np.zeros((3, mesh.n_nodes, 3)))
    assert found == ("train", 1, np.inf)
    nan = Confirmation("test", 1, np.nan)
    for wrong, said in ((found, "stops at the true mass; lower it"), (nan, "test interaction 1")):
        with pytest.raises(InputError, match=said):
            check_confirmed(scene, [Confirmation("train", 2, 0.001), wrong])
    check_confirmed(scene, [])


def test_absurd_mass_scaling_enters_no_dataset(tiny):
    """Every draw is refused for what tells: energy and kinetic share would have let some pass."""
    slow = {"frames": {"count": 3, "interval": 0.4}, "contact": {"ramp": [0.3, 0.4]}}
    tree = config.merge(config.merge(tiny, slow), {"solver": {"mass_scaling": 600.0}})
    scene = config.build(Scene, config.merge(tree, {"health": {"imbalance": 0.05}}))
    with pytest.raises(InputError, match="unfit in all 20 draws .*disequilibrium"):
        healthy_interaction(scene, scene.mesh.build(), "train", 1)
    blind = replace(scene, health=replace(scene.health, disequilibrium=1e6))
    assert healthy_interaction(blind, scene.mesh.build(), "train", 1)["disequilibrium"] > 0.03
