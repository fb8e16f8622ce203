"""The linear elastic answer of a dataset's mesh and law."""

import dataclasses

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.data.elastic import elastic_answer
from fem.errors import InputError
from fem.online.creep import remembered_force
from fem.online.grid import MM, MN
from fem.solver.elastic import elastic_stepper
from fem.solver.rest import equilibrium


@pytest.fixture(scope="module")
def dataset(tiny_dataset):
    return open_dataset(tiny_dataset)


def test_it_is_the_state_of_rest_under_small_forces(dataset):
    mesh, field = dataset.fem_mesh, dataset.read("train", ("force",))["force"][0, 1]
    force = 1e-4 * mesh.grid.from_grid(field).astype(float)  # mN
    rest = equilibrium(mesh, dataset.material.elastic(), force / MN, residual=1e-7).displacement
    answer = elastic_answer(dataset)
    found = mesh.grid.from_grid(answer(1e-4 * field[None])[0])
    assert np.linalg.norm(found - MM * rest) < 1e-4 * np.linalg.norm(MM * rest)
    assert answer.family == "elastic" and answer.interval == 0.2
    np.testing.assert_array_equal(answer.mask, dataset.free)


def test_its_stepper_answers_the_remembered_force(dataset):
    read = dataset.read("train")
    force, truth = read["force"], read["displacement"]
    body, answer = elastic_stepper(dataset.fem_mesh, dataset.material), elastic_answer(dataset)
    assert body.interval is None
    for frames, fem in zip(force, truth, strict=True):
        body.reset()
        found = np.array([body.step(frame, 0.2) for frame in frames])
        flat = frames.reshape(len(frames), -1).astype(float)
        seen = remembered_force(body.memory.creep, flat, 0.2).reshape(frames.shape)
        np.testing.assert_allclose(found, answer(seen.astype("float32")), rtol=1e-4, atol=1e-7)
        assert np.linalg.norm(found - fem) < 0.1 * np.linalg.norm(fem)
    with pytest.raises(InputError, match="give dt"):
        body.step(force[0, 1])


def test_elastic_tissue_and_the_force_of_the_moment_keep_no_memory(dataset):
    mesh, material = dataset.fem_mesh, dataset.material
    assert elastic_stepper(mesh, material.elastic()).memory is None
    body = elastic_stepper(mesh, material, memory=False, interval=0.2)
    assert body.memory is None and body.interval == 0.2


def test_a_mesh_embedded_in_the_grid_is_refused(dataset):
    embedded = dataclasses.replace(dataset.fem_mesh, grid=None)
    with pytest.raises(InputError, match="embedded.*input.physics = 'force'"):
        elastic_stepper(embedded, dataset.material)
