"""The arrays of a reduced model, from a reduction and the points of a cubature."""

import dataclasses
from typing import Any

import numpy as np

from fem.cache import digest
from fem.material.base import Hyperelastic
from fem.material.laws import KINDS
from fem.online.grid import MM
from fem.online.point_law import point_law
from fem.online.reduced_model import Block, ReducedModel
from fem.reduced.cubature import unit_tangent
from fem.reduced.fit import normal_equations
from fem.reduced.missing import missing_answers
from fem.reduced.points import gradients_at, points_law
from fem.reduced.reduction import Reduction
from fem.reduced.symmetry import Sides


class Assembly:
    """All but the ridge of a model's fit: A, the M of the cubature, and the normal equations.

    seen: how many modes of each parity the points see; weights: mN mm/Pa of the left points.
    """

    def __init__(
        self, reduction: Reduction, seen: list[int], points: Sides, weights: np.ndarray
    ) -> None:
        self.reduction, self.points = reduction, points
        body, h = reduction.body, len(points.left)
        self.law = points_law(body.material, body.mesh, points.rows.ravel())
        left = points_law(body.material, body.mesh, points.left)
        C = unit_tangent(left, h)
        alone = (points.left == points.right) & (points.axis is not None)
        work = weights * point_law(left, h).mu * np.where(alone, 0.5, 1.0)
        self.A, self.M = [], []
        for fields, n, flexibility in zip(
            reduction.fields, seen, reduction.flexibility, strict=True
        ):
            tests = gradients_at(body.mesh, fields, points.left)  # (R, 9, h)
            A = tests[:n].reshape(n, 9 * h).T
            onto = flexibility @ (tests * work).reshape(len(fields), 9 * h)
            linear = np.einsum("iJkLp,nkLp->iJpn", C, tests[:n].reshape(n, 3, 3, h))
            stiffness = points.parities * onto @ linear.reshape(9 * h, n)
            self.A.append(np.ascontiguousarray(A, np.float32))
            self.M.append(np.hstack([onto, -stiffness]))
        self.normals = normal_equations(reduction, self.A, self.law)
        self.missing = missing_answers(reduction)

    def model(self, fit: float | None, **meta: Any) -> ReducedModel:
        """The ReducedModel whose M has a fit with this ridge, or that of the cubature for None."""
        body, M = self.reduction.body, self.M
        if fit is not None:
            stresses = len(self.A[0])
            both = zip(self.normals, M, strict=True)
            M = [normal.solve(start, stresses, fit) for normal, start in both]
        reduction = self.reduction
        arrays = zip(
            self.A,
            M,
            reduction.encoder,
            reduction.decoder,
            reduction.flexibility,
            self.missing,
            strict=True,
        )
        blocks = tuple(
            Block(*(np.ascontiguousarray(array, np.float32) for array in some)) for some in arrays
        )
        meta |= {
            "mesh": body.mesh.digest,
            "material": material_digest(body.material),
            "law": _table(self.law),
            "nodes": body.mesh.n_nodes,
            "interval": reduction.snapshots.interval,
        }
        prony = np.array(self.law.prony, float).reshape(-1, 2)
        return ReducedModel(
            blocks,
            body.loadable.rows,
            body.free.rows,
            prony,
            self.points.axis,
            body.mesh.grid,
            meta,
            places=(body.mesh.points * MM).astype(np.float32),
            faces=body.mesh.contact_faces.astype(np.int32),
        )


def material_digest(material: Hyperelastic) -> str:
    """Sixteen hexadecimal digits of a law and its parameters, cell by cell where they differ."""
    return digest(material)


def _table(law):
    """A law's kind and parameters as plain values."""
    kind = {cls: name for name, cls in KINDS.items()}[type(law)]
    return {"kind": kind} | {
        field.name: _plain(getattr(law, field.name)) for field in dataclasses.fields(law)
    }


def _plain(value):
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, tuple) else value
