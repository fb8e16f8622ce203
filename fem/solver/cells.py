"""Nodal internal forces of a hexahedral mesh, in vectorised NumPy.

Arrays are components-first, (3, 8, E) and (3, 3, Q, E): each ufunc then runs over long contiguous
planes. The products with shape gradients are matrix products with one small matrix that all cells
share. What a scene does not need (stress history, hourglass control, cell-wise Jacobians) is chosen
once, when the kernel is built.

Stresses are in units of mu and start from H = F - I and j = J - 1, never from F and J: a strain of
1e-8 then keeps all its digits, in float32 too, and so does the small j of nearly incompressible
tissue.

    P = mu F + (K j - mu/J) cof F = H + (q - 1)(cof H - H^T) + (q + (q - 1) tr H) I,   q = j/J + K j
      (mu = 1)
    j = tr H + tr cof H + det H,   cof F = (1 + tr H) I - H^T + cof H
"""

import numpy as np

from fem.mesh import element


class FullCells:
    """A run of cells with 2 x 2 x 2 points: F, P and nodal forces, see InternalForce."""

    rule, weight = element.GAUSS, 1.0

    def __init__(self, force, cells, index, hourglass_stiffness):
        self.force, self.cells = force, cells
        self.n, self.q = cells.stop - cells.start, len(self.rule)
        self.index = np.ascontiguousarray(index[:, cells])
        self.mean_dilatation = force.element == "mean_dilatation"
        mesh, dtype, mu = force.mesh, force.dtype, force.material.mu
        self.bulk = force.material.K / mu
        jacobian = element.jacobians(mesh.points, mesh.cells[cells], self.rule)  # (E, Q, 3, 3)
        gradients = element.shape_gradients(self.rule)  # (Q, 3, 8)
        if mesh.congruent:
            volume = np.linalg.det(jacobian[0]) * self.weight  # (Q,) m3
            physical = np.einsum("qra,qrj->jqa", gradients, np.linalg.inv(jacobian[0]))
            self.to_physical = None
            self.volume = volume[:, None]  # (Q, 1)
            self.gradient = physical.reshape(3 * self.q, 8).astype(dtype)
            self.divergence = np.ascontiguousarray(
                (physical * (mu * volume[:, None])).reshape(3 * self.q, 8).T, dtype
            )
        else:
            self.to_physical = np.ascontiguousarray(
                np.linalg.inv(jacobian).transpose(2, 3, 1, 0), dtype
            )  # (r, j, Q, E)
            self.volume = np.ascontiguousarray(np.linalg.det(jacobian).T * self.weight)  # (Q, E)
            self.force_weight = (mu * self.volume).astype(dtype)  # N m
            self.gradient = gradients.transpose(1, 0, 2).reshape(3 * self.q, 8).astype(dtype)
            self.divergence = np.ascontiguousarray(self.gradient.T)
        self.cell_volume = (self.volume * np.ones((self.q, self.n))).sum(axis=0)  # (E,)
        self._start_history()

    def _start_history(self):
        """Rest: no relaxed stress q, no old stress, no viscous stress V = sum g q; all in units of
        mu."""
        self.history = None
        if self.force.material.prony:
            self.history = np.zeros((len(self.force.material.prony), 6, self.q, self.n))
            self.old_stress = np.zeros((6, self.q, self.n))
            self.V = np.zeros((3, 3, self.q, self.n), self.force.dtype)
            self.pairing = 0.0

    def add_force(self, u, out, coefficients, check):
        scratch, shape = self.force.scratch, (self.q, self.n)
        H, C, trace, j, J = self._deformation(u)
        T = scratch("T", (3, *shape))
        worst = int(J.argmin())  # a NaN counts as smallest
        low = float(J.flat[worst])
        if low < self.force.min_J or np.isnan(low):
            self.force.min_J, self.force.worst_cell = low, self.cells.start + worst % self.n
        if check:
            self._check(self._cofactor(H, C, trace), J)
        cof = None if coefficients is None else self._cofactor(H, C, trace)
        q, r = np.divide(j, J, out=T[0]), T[1]
        q += self._pressure(j, T[1])
        np.subtract(q, 1, out=r)
        trace *= r
        trace += q
        C -= H.swapaxes(0, 1)
        C *= r
        C += H
        C.reshape(9, *shape)[::4] += trace
        P = C
        if self.history is not None:
            if coefficients is not None:
                self._update_history(H, cof, P, J, coefficients)
            self._subtract_viscous(H, P)
        self._to_nodes(P, out)

    def _deformation(self, u):
        """H = du/dX, cof H, tr H, j = J - 1 and J, in shared work arrays."""
        scratch, shape = self.force.scratch, (self.q, self.n)
        X, C, T = (
            scratch("X", (5, 3, *shape)),
            scratch("C", (3, 3, *shape)),
            scratch("T", (3, *shape)),
        )
        trace, j, J = scratch("trace", shape), scratch("j", shape), scratch("J", shape)
        H = X[:3]
        self._gradient(u, H)
        X[3:] = X[
            :2
        ]  # rows repeat cyclically, so that one ufunc makes a column of all three cofactor rows
        for k in range(3):
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            np.multiply(X[1:4, k1], X[2:5, k2], out=C[:, k])
            C[:, k] -= np.multiply(X[1:4, k2], X[2:5, k1], out=T)
        np.multiply(H[0], C[0], out=T)
        np.add(T[0], T[1], out=j)
        j += T[2]
        np.add(H[0, 0], H[1, 1], out=trace)
        trace += H[2, 2]
        for i in range(3):
            j += C[i, i]
        j += trace
        np.add(j, 1, out=J)
        return H, C, trace, j, J

    def _cofactor(self, H, C, trace):
        """cof F from C = cof H, in a work array of its own."""
        cof = self.force.scratch("cof", C.shape)
        np.subtract(C, H.swapaxes(0, 1), out=cof)
        cof.reshape(9, *trace.shape)[::4] += trace + 1
        return cof

    def _pressure(self, j, out):
        """K j in units of mu, or K times the cell's mean of j."""
        if not self.mean_dilatation:
            return np.multiply(j, self.bulk, out=out)
        mean = np.einsum("qe,qe->e", self.volume * np.ones((1, self.n)), j) / self.cell_volume
        return (self.bulk * mean).astype(j.dtype)

    def _gradient(self, u, H):
        """du_c/dX_j at the points, (3, 3, Q, E), into H."""
        U = self.force.scratch("U", (3, 8, self.n))
        u.take(self.index, axis=1, out=U, mode="clip")
        if self.to_physical is None:
            np.matmul(self.gradient, U, out=H.reshape(3, 3 * self.q, self.n))
            return
        G, T = self.force.scratch("G", H.shape), self.force.scratch("T", H.shape[1:])
        np.matmul(self.gradient, U, out=G.reshape(3, 3 * self.q, self.n))
        for j in range(3):
            np.multiply(G[:, 0], self.to_physical[0, j], out=H[:, j])
            H[:, j] += np.multiply(G[:, 1], self.to_physical[1, j], out=T)
            H[:, j] += np.multiply(G[:, 2], self.to_physical[2, j], out=T)

    def _to_nodes(self, P, out):
        if self.to_physical is None:
            np.matmul(self.divergence, P.reshape(3, 3 * self.q, self.n), out=out)
            return
        G, T = self.force.scratch("G", P.shape), self.force.scratch("T", P.shape[1:])
        P *= self.force_weight
        for r in range(3):
            np.multiply(P[:, 0], self.to_physical[r, 0], out=G[:, r])
            G[:, r] += np.multiply(P[:, 1], self.to_physical[r, 1], out=T)
            G[:, r] += np.multiply(P[:, 2], self.to_physical[r, 2], out=T)
        np.matmul(self.divergence, G.reshape(3, 3 * self.q, self.n), out=out)

    def _check(self, cof, J):
        """How much stiffer than at rest the stiffest point is: K + mu/J^2 acts along cof F."""
        area = np.einsum("cjqe,cjqe->qe", cof, cof) / 3
        with np.errstate(all="ignore"):
            stiff = 1 + (self.bulk + 1 / np.square(J)) * area
        self.force.stiffening = max(self.force.stiffening, float(stiff.max()) / (self.bulk + 2))

    def _subtract_viscous(self, H, P):
        """P -= F V."""
        T = self.force.scratch("HV", P.shape)
        P -= self.V
        for k in range(3):
            P -= np.multiply(H[:, k, None], self.V[k], out=T)

    def _update_history(self, H, cof, P, J, coefficients):
        """Advance every relaxed stress to S_e = F^-1 P_e, and refresh V; count the work done
        meanwhile."""
        material, force = self.force.material, self.force
        before = self._pair(H)
        stress = np.empty((6, self.q, self.n))
        for k, (i, j) in enumerate(_VOIGT):
            np.einsum("cqe,cqe->qe", cof[:, i], P[:, j], out=stress[k], casting="same_kind")
        stress /= J
        relaxed = 0.0
        for (g, _), (a, old, new, forward), q in zip(material.prony, coefficients, self.history):
            q += a * (old * self.old_stress + new * stress - q)
            relaxed = relaxed + g * (q + forward * (stress - q))
        self.old_stress = stress
        self._hold(stress, relaxed)
        # the viscous stress stood still since the last update, so its work is its product with the
        # change of strain
        force.viscous_work += before - self.pairing
        self.pairing = self._pair(H)

    def _hold(self, stress, relaxed):
        """The viscous stress that stands still from now on."""
        for k, (i, j) in enumerate(_VOIGT):
            self.V[i, j] = self.V[j, i] = relaxed[k]

    def pending_work(self, u):
        """Work in J of the viscous stress since its last update."""
        return 0.0 if self.history is None else self._pair(self._deformation(u)[0]) - self.pairing

    def _pair(self, H):
        """Integral of -V : E over the cells, in J, with the strain E = (H + H^T + H^T H) / 2."""
        total = 0.0
        for i, j in _VOIGT:
            strain = np.einsum("cqe,cqe->qe", H[:, i], H[:, j]) + H[i, j] + H[j, i]
            total -= (0.5 if i == j else 1.0) * np.sum(
                strain * self.V[i, j] * self.volume, dtype=float
            )
        return self.force.material.mu * total

    def energies(self, u):
        H, _, trace, j, _ = self._deformation(u)
        with np.errstate(all="ignore"):
            W = (
                (j - np.log1p(j)) - (j - trace) + np.einsum("cjqe,cjqe->qe", H, H) / 2
            )  # (I1 - 3)/2 - ln J
        if self.mean_dilatation:
            mean = (self.volume * j).sum(axis=0) / self.cell_volume
            bulk = np.sum(self.bulk / 2 * mean**2 * self.cell_volume)
        else:
            bulk = np.sum(self.bulk / 2 * np.square(j) * self.volume)
        return float(
            self.force.material.mu * (np.sum(W * self.volume) + bulk)
        ), self._hourglass_energy()

    def dilatation(self, u):
        *_, J = self._deformation(u)
        return (self.volume * J).sum(axis=0) / self.cell_volume

    def _hourglass_energy(self):
        return 0.0


_VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


class ReducedCells(FullCells):
    """One point a cell with the mean gradient, and hourglass control (Flanagan and Belytschko
    1981).

    The hourglass force k gamma (gamma . u) is exact under rotation: gamma is orthogonal to every
    linear field. k is a share of mu, since one in proportion to K + 2 mu locks as nu goes to 0.5,
    and with Prony terms it relaxes as the cell's stress does: left elastic, it carries the load of
    a long hold.
    """

    rule, weight = element.CENTRE, 8.0

    def __init__(self, force, cells, index, hourglass_stiffness):
        super().__init__(force, cells, index, hourglass_stiffness)
        mesh, dtype = force.mesh, force.dtype
        corners = mesh.points[mesh.cells[cells]]  # (E, 8, 3)
        if mesh.congruent:
            mean = self.gradient.astype(float).reshape(3, 8, 1)
        else:
            jacobian = element.jacobians(
                mesh.points, mesh.cells[cells], element.GAUSS
            )  # (E, Q, 3, 3)
            volume = np.linalg.det(jacobian)
            every = np.einsum(
                "qra,eqrj,eq->jae",
                element.shape_gradients(element.GAUSS),
                np.linalg.inv(jacobian),
                volume,
            )
            self.cell_volume = volume.sum(axis=1)
            mean = every / self.cell_volume
            self.volume = self.cell_volume[None]
            self.to_physical = None
            self.gradient = np.ascontiguousarray(mean, dtype)  # (3, 8, E)
            self.divergence = np.ascontiguousarray(
                force.material.mu * mean * self.cell_volume, dtype
            )
            offset = np.einsum("ha,eaj->hje", element.HOURGLASS, corners)
            self.gamma = np.ascontiguousarray(
                element.HOURGLASS[:, :, None] - np.einsum("hje,jae->hae", offset, mean), dtype
            )
        # as Flanagan and Belytschko, but with mu for K + 2 mu
        stiffness = (
            hourglass_stiffness
            * force.material.mu
            * self.cell_volume
            * np.square(mean).sum(axis=(0, 1))
            / 8
        )
        self.stiffness = stiffness.astype(dtype)  # (E,) N/m
        self.share = 1.0  # (E,) of the stiffness that relaxation has left
        self.congruent = mesh.congruent
        if mesh.congruent:
            rows = np.vstack([self.gradient.astype(float), element.HOURGLASS])
            columns = np.vstack(
                [self.divergence.T.astype(float), element.HOURGLASS * self.stiffness[0]]
            )
            self.rows, self.columns = (
                rows.astype(dtype),
                np.ascontiguousarray(columns.T, dtype),
            )  # (7, 8), (8, 7)

    def _gradient(self, u, H):
        U, Q = self.force.scratch("U", (3, 8, self.n)), self.force.scratch("Q", (3, 7, self.n))
        u.take(self.index, axis=1, out=U, mode="clip")
        if self.congruent:
            np.matmul(self.rows, U, out=Q)
            H[:, :, 0] = Q[:, :3]
        else:
            np.einsum("jae,cae->cje", self.gradient, U, out=H[:, :, 0])
            np.einsum("hae,cae->che", self.gamma, U, out=Q[:, 3:])

    def _to_nodes(self, P, out):
        Q = self.force.scratch("Q", (3, 7, self.n))
        if self.history is not None:
            Q[:, 3:] *= self.share
        if self.congruent:
            Q[:, :3] = P[:, :, 0]
            np.matmul(self.columns, Q, out=out)
        else:
            np.einsum("jae,cje->cae", self.divergence, P[:, :, 0], out=out)
            Q[:, 3:] *= self.stiffness
            out += np.einsum("hae,che->cae", self.gamma, Q[:, 3:])

    def _hold(self, stress, relaxed):
        super()._hold(stress, relaxed)
        elastic, least = (
            np.linalg.norm(stress, axis=(0, 1)),
            1 - sum(g for g, _ in self.force.material.prony),
        )
        left = np.linalg.norm(stress - relaxed, axis=(0, 1))
        self.share = np.clip(
            np.divide(left, elastic, out=np.ones_like(left), where=elastic > 0), least, 1
        ).astype(self.force.dtype)

    def _pair(self, H):
        return super()._pair(H) + self._hourglass_energy(self.share - 1)

    def _hourglass_energy(self, share=1):
        Q = self.force.scratch("Q", (3, 7, self.n))
        return float(
            np.sum(np.square(Q[:, 3:]).sum(axis=(0, 1)) * self.stiffness * share, dtype=float) / 2
        )
