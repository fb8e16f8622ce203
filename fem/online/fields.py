"""Nodal forces and displacements in the modal coordinates of a reduced model."""

import numpy as np

from fem.errors import InputError
from fem.online.reduced_model import ReducedModel

ELSEWHERE = 1e-6  # share of a force's square that may stand at nodes without an encoder


class Fields:
    """The encoder and the decoder of a model, see fem.online.reduced.

    Forces and displacements come node by node, (N, 3), or on the node grid, (nx, ny, nz, 3). After
    `encode`, `carried` tells whether all of the force stood at nodes that contacts push on, and
    `folded` is what stood there, (3 h_force,) of each parity.
    """

    def __init__(self, model: ReducedModel) -> None:
        self.model, self.grid = model, model.grid
        n, (sides, h) = model.meta["nodes"], model.free.shape
        ends = np.cumsum([0] + [len(block.M) for block in model.blocks])
        self.parts = [slice(i, j) for i, j in zip(ends[:-1], ends[1:], strict=True)]
        # (R, 3 h): a product with few long rows is faster than with many short ones
        self._modes = [np.ascontiguousarray(block.decoder.T) for block in model.blocks]
        self._g = np.zeros(model.modes, np.float32)
        self._u = [np.empty(3 * h, np.float32) for _ in model.blocks]
        self._values = np.zeros(3 * sides * h + 1, np.float32)  # the last one for all held nodes
        place = np.full((n, 3), 3 * sides * h)
        for side, nodes in enumerate(model.free):
            place[nodes] = (3 * h * side + np.arange(3 * h).reshape(3, h)).T
        self._layouts: dict[tuple[int, ...], tuple] = {(n, 3): self._layout(np.arange(n), n, place)}
        if model.grid is not None:
            shape = (*model.grid.shape, 3)
            self._layouts[shape] = self._layout(model.grid.index, np.prod(model.grid.shape), place)
        self._sign = self._flips(h)
        self._force_sign = self._flips(model.force.shape[1])
        if sides == 2:
            # nodes on the plane of symmetry are on both sides
            self._apart = np.tile(model.force[0] != model.force[1], 3).astype(np.float32)
            half = np.where(model.free[0] == model.free[1], 0.5, 1.0)
            self._half = np.tile(half, 3).astype(np.float32)
        self.carried = True

    def _layout(self, index, size, place):
        """Of nodes at the places `index` in a field: where the forces stand, left and right, and
        where each value of the answer comes from."""
        component = np.arange(3)[:, None]
        force = [(3 * index[nodes] + component).ravel() for nodes in self.model.force]
        free = [(3 * index[nodes] + component).ravel() for nodes in self.model.free]
        answer = np.full((size, 3), self._values.size - 1)
        answer[index] = place
        return force, free, answer.ravel()

    def _flips(self, h):
        """(3 h,) -1 for the components that the mirror flips."""
        sign = np.ones((3, h), np.float32)
        if self.model.axis is not None:
            sign[self.model.axis] = -1
        return sign.ravel()

    def encode(self, force: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
        """(shape of the field, g (R,) mm) of a force in mN. Raises InputError for another shape and
        for values that are not finite."""
        flat, layout = self._flat(force, "force")
        left = flat.take(layout[0][0])
        there, total = float(left @ left), float(flat @ flat)
        if not total < np.inf:
            raise InputError("the force holds values that are not finite; give finite values")
        if self.model.axis is None:
            folded = [left]
        else:
            right = flat.take(layout[0][1])
            there += float(right @ (right * self._apart))
            right *= self._force_sign
            folded = [left + right, left - right]
        self.folded = folded
        self.carried = total - there <= ELSEWHERE * total
        if not self.carried:
            self._encode_anywhere(flat, layout)
        else:
            for block, part, f in zip(self.model.blocks, self.parts, folded, strict=True):
                np.dot(block.encoder, f, out=self._g[part])
        return force.shape, self._g

    def _flat(self, field, name):
        """(a field as (3 n,) float32, its layout)."""
        layout = self._layouts.get(field.shape)
        if layout is None or field.dtype.kind not in "fiu":
            raise InputError(
                f"the {name} is {field.dtype} of shape {field.shape}; give real numbers of shape "
                + " or ".join(map(str, self._layouts))
            )
        return np.ascontiguousarray(field, np.float32).ravel(), layout

    def _encode_anywhere(self, flat, layout):
        """g of a force at any of the free nodes; what stands at held ones moves nothing."""
        work = self._project(flat, layout)
        for block, part in zip(self.model.blocks, self.parts, strict=True):
            np.dot(block.flexibility, work[part], out=self._g[part])

    def coordinates(self, field: np.ndarray) -> tuple[np.ndarray, float]:
        """(a (R,) mm of the nearest displacement in the modes to a field in mm, |u|^2 over the free
        nodes). Raises InputError for another shape and for values that are not finite."""
        flat, layout = self._flat(field, "displacement")
        with np.errstate(over="ignore"):
            square = float(flat @ flat)
        if not square < np.inf:
            raise InputError("the displacement holds values that are not finite")
        return self._project(flat, layout), square

    def at(self, nodes: np.ndarray) -> np.ndarray:
        """(n, 3, R): the displacement of each node, component and coordinate, by 1 mm of it."""
        found = np.zeros((len(nodes), 3, self.model.modes), np.float32)
        field = np.zeros((self.model.meta["nodes"], 3), np.float32)
        for r, one in enumerate(np.eye(self.model.modes, dtype=np.float32)):
            found[:, :, r] = self.decode(one, field.shape)[nodes]
        return found

    def _project(self, flat, layout):
        """Phi^T of a field at the free nodes."""
        left = flat.take(layout[1][0])
        if self.model.axis is None:
            folded = [left]
        else:
            right = flat.take(layout[1][1])
            right *= self._sign
            folded = [(left + right) * self._half, (left - right) * self._half]
        return np.concatenate([phi @ f for phi, f in zip(self._modes, folded, strict=True)])

    def decode(self, a: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """The displacement in mm, float32, of coordinates a (R,), as a field of this shape."""
        for phi, part, u in zip(self._modes, self.parts, self._u, strict=True):
            np.dot(a[part], phi, out=u)
        values = self._values
        if self.model.axis is None:
            values[:-1] = self._u[0]
        else:
            even, odd = self._u
            right = values[len(even) : -1]
            np.add(even, odd, out=values[: len(even)])
            np.subtract(even, odd, out=right)
            right *= self._sign
        return self._placed(shape)

    def placed(self, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """A field of this shape from the values (sides 3 h,) at the free nodes, left ones first."""
        self._values[:-1] = values
        return self._placed(shape)

    def _placed(self, shape):
        return self._values.take(self._layouts[shape][2]).reshape(shape)
