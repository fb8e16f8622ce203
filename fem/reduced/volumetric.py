"""What a unit of K / mu adds to the stiffness at rest, in the modes of a reduced model."""

from dataclasses import replace

import numpy as np

from fem.material.base import Hyperelastic, bulk_modulus
from fem.material.neo_hooke import NeoHooke
from fem.mesh.hexmesh import HexMesh
from fem.online.fields import Fields
from fem.online.reduced_model import ReducedModel
from fem.reduced.points import stiffness

OTHER = 0.3  # a Poisson ratio to take the difference with; the stiffness is linear in K


def volumetric_share(
    model: ReducedModel, mesh: HexMesh, material: Hyperelastic
) -> dict[str, np.ndarray]:
    """{"V0", ...}: K_r^-1 K_v (R_b, R_b) float32 of each parity, see fem.online.retissue; nothing
    for tissue that differs from cell to cell, and for other laws."""
    if not isinstance(material, NeoHooke) or np.ndim(material.mu) or np.ndim(material.nu):
        return {}
    fields = Fields(model)
    units = np.eye(model.modes, dtype=np.float32)
    shapes = np.array([fields.decode(a, (mesh.n_nodes, 3)) for a in units])
    other = replace(material, nu=OTHER)
    apart = float((material.K - bulk_modulus(material.mu, OTHER)) / material.mu)
    change = (stiffness(mesh, material, shapes) - stiffness(mesh, other, shapes)) / apart
    found = {}
    for b, (block, part) in enumerate(zip(model.blocks, fields.parts, strict=True)):
        K_v = np.tensordot(shapes[part], change[part], ((1, 2), (1, 2)))
        found[f"V{b}"] = (block.flexibility @ K_v).astype(np.float32)
    return found
