"""The modes of a body, and what follows from them before anything is sampled or fitted."""

import numpy as np

from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.material.laws import KINDS
from fem.mesh.hexmesh import HexMesh
from fem.reduced.points import positions, stiffness
from fem.reduced.snapshots import Snapshots
from fem.reduced.symmetry import mirror_of, point_pairs, sides


class Body:
    """A mesh and its law in halves, where it has a mirror plane.

    axis: that the mirror flips, or None; free, loadable, pairs: the Sides of the nodes that can
    move, of those among them that contacts push on, and of the integration points

    Raises InputError for a law that a file cannot name.
    """

    def __init__(self, mesh: HexMesh, material: Hyperelastic) -> None:
        if type(material) not in KINDS.values():
            raise InputError(
                f"a reduced model cannot keep a law {type(material).__name__}; use one of"
                f" {', '.join(law.__name__ for law in KINDS.values())}"
            )
        self.mesh, self.material = mesh, material
        mirror = mirror_of(mesh, material)
        self.axis = None if mirror is None else mirror[0]
        self.free = sides(np.flatnonzero(~mesh.fixed), mirror)
        pushed = np.unique(mesh.contact_faces)
        self.loadable = sides(pushed[~mesh.fixed[pushed]], mirror)
        edge = np.ptp(mesh.points[mesh.cells[0]], axis=0).min()
        self.pairs = point_pairs(positions(mesh), self.axis, edge)


class Reduction:
    """The first modes of the interactions `members` (places in `snapshots`).

    count: of the modes, or below 1 what they may leave out, relative L2
    modes: (k, R_b) in the snapshots' bases; fields: (R_b, N, 3) of each parity; flexibility: K_r^-1
    (R_b, R_b) mm/mN; encoder (R_b, 3 h_force) mm/mN and decoder (3 h_free, R_b), as in
    fem.online.reduced.
    """

    def __init__(self, body: Body, snapshots: Snapshots, members: list[int], count: float) -> None:
        self.body, self.snapshots, self.members = body, snapshots, members
        self.decomposition = snapshots.decomposition(members)
        number = int(count) if count >= 1 else self.decomposition.count(count)
        self.modes = self.decomposition.modes(number)
        self.fields, self.flexibility, self.encoder, self.decoder = [], [], [], []
        for parity, (Q, phi) in enumerate(zip(snapshots.bases, self.modes, strict=True)):
            coordinates = (Q @ phi).T  # (R_b, 3 h)
            fields = body.free.field(coordinates, parity, body.mesh.n_nodes)
            K = np.tensordot(fields, stiffness(body.mesh, body.material, fields), ((1, 2), (1, 2)))
            flexibility = np.linalg.inv((K + K.T) / 2)
            self.fields.append(fields)
            self.flexibility.append(flexibility)
            self.encoder.append(flexibility @ body.loadable.test_values(fields))
            left = body.free.left_values(coordinates)
            self.decoder.append(left.reshape(len(left), -1).T)

    @property
    def starts(self) -> np.ndarray:
        """Where each parity's coordinates start, and R at the end."""
        return np.cumsum([0] + [len(fields) for fields in self.fields])

    def first(self, count: int) -> list[int]:
        """How many modes of each parity are among the first `count` of all."""
        return [phi.shape[1] for phi in self.decomposition.modes(count)]

    def coordinates(self, i: int) -> np.ndarray:
        """(frames, R) mm of interaction i, the even modes first."""
        return self.snapshots.in_modes(self.modes, i)

    def elastic_answers(self, i: int) -> np.ndarray:
        """g (frames, R) mm of interaction i."""
        parts = zip(self.snapshots.force(i), self.encoder, strict=True)
        return np.hstack([force @ encoder.T for force, encoder in parts])
