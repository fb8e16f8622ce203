"""Nodal internal forces of a hexahedral mesh, in vectorised NumPy.

Arrays are components-first, (3, 8, E) and (3, 3, Q, E): each ufunc then runs over long contiguous planes. The products
with shape gradients are matrix products with one small matrix that all cells share. What a scene does not need (stress
history, hourglass control, cell-wise Jacobians) is chosen once, when the kernel is built.
"""

import numpy as np
import scipy.sparse

from fem import element
from fem.errors import InputError

CHUNK = 2048  # cells per pass: keeps a pass inside the processor's cache, whatever the size of the mesh
ELEMENTS = ("full", "reduced", "mean_dilatation")


class InternalForce:
    """f(u) for one mesh and material; call it with u (3, N) in m to get the internal force (3, N) in N.

    element: "full" (2 x 2 x 2 points), "mean_dilatation" (the same with one pressure a cell, which does not lock as nu
    goes to 0.5) or "reduced" (one point and hourglass control).
    precision: "float64" or "float32" for the work inside cells; nodal vectors are float64 in both.
    hourglass_stiffness: dimensionless, used by "reduced" alone.

    After a call, `min_J` and `stiffening` describe that state if `check` was true. With Prony terms the viscous part of
    the stress is brought up to date by `relax(dt)` before a call, and is otherwise kept as it was.
    """

    def __init__(self, mesh, material, element="full", precision="float64", hourglass_stiffness=0.05):
        if element not in ELEMENTS:
            raise InputError(f"element '{element}' is not one of {', '.join(ELEMENTS)}")
        if precision not in ("float64", "float32"):
            raise InputError(f"precision '{precision}' is not 'float64' or 'float32'")
        self.mesh, self.material, self.element = mesh, material, element
        self.dtype = np.dtype(precision)
        self.min_J, self.stiffening, self.worst_cell = 1.0, 1.0, 0
        self._cell_force = np.empty((3, 8, mesh.n_cells), self.dtype)
        index = np.ascontiguousarray(mesh.cells.T)  # (8, E)
        ones = np.ones(index.size, self.dtype)
        self._scatter = scipy.sparse.csr_matrix((ones, (index.ravel(), np.arange(index.size))), (mesh.n_nodes, index.size))
        self._scratch = {}
        make = _ReducedCells if element == "reduced" else _FullCells
        starts = range(0, mesh.n_cells, CHUNK)
        self._chunks = [make(self, slice(s, min(s + CHUNK, mesh.n_cells)), index, hourglass_stiffness) for s in starts]
        self._relax = None
        self.viscous_work = 0.0  # J, work of the viscous stresses so far: minus what relaxation has spared

    def scratch(self, name, shape):
        """A work array that all chunks share; contents do not survive the next chunk."""
        key = name, shape
        if key not in self._scratch:
            self._scratch[key] = np.empty(shape, self.dtype)
        return self._scratch[key]

    def relax(self, elapsed, ahead=0.0):
        """Let the next call advance the stress history by `elapsed` seconds, and hold it for `ahead` seconds.

        The held stress is that of the middle of those seconds, which makes standing still second-order accurate.
        """
        self._relax = float(elapsed), float(ahead)

    def __call__(self, u, out=None, check=False):
        """Internal force (3, N) at displacement u (3, N)."""
        u = u if u.dtype == self.dtype else u.astype(self.dtype)
        coefficients = None if self._relax is None else history_coefficients(self.material.prony, *self._relax)
        if check:
            self.min_J, self.stiffening = np.inf, 0.0
        for chunk in self._chunks:
            chunk.add_force(u, self._cell_force[:, :, chunk.cells], coefficients, check)
        self._relax = None
        out = np.empty((3, self.mesh.n_nodes)) if out is None else out
        for component in range(3):
            out[component] = self._scatter @ self._cell_force[component].ravel()
        return out

    def energies(self, u):
        """(strain, hourglass) energy in J of the displacement u (3, N), the strain energy without relaxation."""
        u = u if u.dtype == self.dtype else u.astype(self.dtype)
        return tuple(np.sum([chunk.energies(u) for chunk in self._chunks], axis=0))

    def dilatation(self, u):
        """J of every cell (E,), the mean over its points, at displacement u (3, N)."""
        u = u if u.dtype == self.dtype else u.astype(self.dtype)
        return np.concatenate([chunk.dilatation(u) for chunk in self._chunks])


def history_coefficients(prony, elapsed, ahead=0.0):
    """[(a, old, new, forward)] per term: q <- q + a (old S_old + new S_new - q), exact where S runs linearly.

    q_k is the relaxed stress of term k: q' = (S_e - q) / tau, S = S_e - sum g_k q_k. `expm1` keeps a = 1 - exp(-x)
    exact for steps far below the relaxation time. `forward` carries q to the middle of the `ahead` seconds to come.
    """
    result = []
    for _, tau in prony:
        x = elapsed / tau
        a = -np.expm1(-x)
        new = (1 - a / x) / a if x > 1e-4 else 0.5 + x / 12  # the series where the quotient would cancel
        result.append((a, 1 - new, new, -np.expm1(-ahead / (2 * tau))))
    return result


class _FullCells:
    """A run of cells with 2 x 2 x 2 points: F, P and nodal forces, see InternalForce."""

    rule, weight = element.GAUSS, 1.0

    def __init__(self, force, cells, index, hourglass_stiffness):
        self.force, self.cells = force, cells
        self.n, self.q = cells.stop - cells.start, len(self.rule)
        self.index = np.ascontiguousarray(index[:, cells])
        self.mean_dilatation = force.element == "mean_dilatation"
        mesh, dtype = force.mesh, force.dtype
        jacobian = element.jacobians(mesh.points, mesh.cells[cells], self.rule)  # (E, Q, 3, 3)
        gradients = element.shape_gradients(self.rule)  # (Q, 3, 8)
        if mesh.congruent:
            volume = np.linalg.det(jacobian[0]) * self.weight  # (Q,) m3
            physical = np.einsum("qra,qrj->jqa", gradients, np.linalg.inv(jacobian[0]))
            self.to_physical = None
            self.volume = volume[:, None]  # (Q, 1)
            self.gradient = physical.reshape(3 * self.q, 8).astype(dtype)
            self.divergence = np.ascontiguousarray((physical * volume[:, None]).reshape(3 * self.q, 8).T, dtype)
        else:
            self.to_physical = np.ascontiguousarray(np.linalg.inv(jacobian).transpose(2, 3, 1, 0), dtype)  # (r, j, Q, E)
            self.volume = np.ascontiguousarray(np.linalg.det(jacobian).T * self.weight)  # (Q, E)
            self.volume_low = self.volume.astype(dtype)
            self.gradient = gradients.transpose(1, 0, 2).reshape(3 * self.q, 8).astype(dtype)
            self.divergence = np.ascontiguousarray(self.gradient.T)
        self.cell_volume = (self.volume * np.ones((self.q, self.n))).sum(axis=0)  # (E,)
        self._start_history()

    def _start_history(self):
        """Rest: no relaxed stress q, no old stress; M = mu I - sum g q turns P = mu F + p cof F into F M + p cof F."""
        self.history = None
        if self.force.material.prony:
            mu = self.force.material.mu
            self.history = np.zeros((len(self.force.material.prony), 6, self.q, self.n))
            self.old_stress = np.zeros((6, self.q, self.n))
            self.M = np.zeros((3, 3, self.q, self.n), self.force.dtype)
            self.M.reshape(9, self.q, self.n)[::4] = mu
            self.pairing = 0.0

    def add_force(self, u, out, coefficients, check):
        X, C, J, p = self._deformation(u, check)
        F = X[:3]
        if coefficients is not None:
            self._update_history(F, C, J, p, coefficients)
        C *= p
        if self.history is None:
            F *= self.force.material.mu
            F += C
            P = F
        else:
            P = C
            self._add_product(F, P)
        self._to_nodes(P, out)

    def _deformation(self, u, check):
        """F (in rows 0-2 of X), cof F, J and p = K (J - 1) - mu / J, in shared work arrays."""
        scratch, shape = self.force.scratch, (self.q, self.n)
        X, C, T = scratch("X", (5, 3, *shape)), scratch("C", (3, 3, *shape)), scratch("T", (3, *shape))
        J, p = scratch("J", shape), scratch("p", shape)
        F = X[:3]
        self._gradient(u, F)
        F.reshape(9, *shape)[::4] += 1
        X[3:] = X[:2]  # rows repeat cyclically, so that one ufunc makes a column of all three cofactor rows
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            np.multiply(X[1:4, j1], X[2:5, j2], out=C[:, j])
            C[:, j] -= np.multiply(X[1:4, j2], X[2:5, j1], out=T)
        np.multiply(F[0], C[0], out=T)
        np.add(T[0], T[1], out=J)
        J += T[2]
        if check:
            self._check(C, J)
        material = self.force.material
        np.divide(-material.mu, J, out=p)
        if self.mean_dilatation:
            mean = np.einsum("qe,qe->e", self.volume * np.ones((1, self.n)), J) / self.cell_volume
            p += (material.K * (mean - 1)).astype(J.dtype)
        else:
            np.subtract(J, 1, out=T[0])
            T[0] *= material.K
            p += T[0]
        return X, C, J, p

    def _gradient(self, u, F):
        """du_c/dX_j at the points, (3, 3, Q, E), into F."""
        U = self.force.scratch("U", (3, 8, self.n))
        u.take(self.index, axis=1, out=U, mode="clip")
        if self.to_physical is None:
            np.matmul(self.gradient, U, out=F.reshape(3, 3 * self.q, self.n))
            return
        H, T = self.force.scratch("H", F.shape), self.force.scratch("T", F.shape[1:])
        np.matmul(self.gradient, U, out=H.reshape(3, 3 * self.q, self.n))
        for j in range(3):
            np.multiply(H[:, 0], self.to_physical[0, j], out=F[:, j])
            F[:, j] += np.multiply(H[:, 1], self.to_physical[1, j], out=T)
            F[:, j] += np.multiply(H[:, 2], self.to_physical[2, j], out=T)

    def _to_nodes(self, P, out):
        if self.to_physical is None:
            np.matmul(self.divergence, P.reshape(3, 3 * self.q, self.n), out=out)
            return
        H, T = self.force.scratch("H", P.shape), self.force.scratch("T", P.shape[1:])
        P *= self.volume_low
        for r in range(3):
            np.multiply(P[:, 0], self.to_physical[r, 0], out=H[:, r])
            H[:, r] += np.multiply(P[:, 1], self.to_physical[r, 1], out=T)
            H[:, r] += np.multiply(P[:, 2], self.to_physical[r, 2], out=T)
        np.matmul(self.divergence, H.reshape(3, 3 * self.q, self.n), out=out)

    def _check(self, C, J):
        """Smallest J, and how much stiffer than at rest the stiffest point is: K + mu/J^2 acts along cof F."""
        worst = int(J.argmin()) % self.n
        low = float(J.min())
        if not low >= self.force.min_J:  # a NaN counts as worse
            self.force.min_J, self.force.worst_cell = low, self.cells.start + worst
        material = self.force.material
        area = np.einsum("cjqe,cjqe->qe", C, C) / 3
        with np.errstate(all="ignore"):
            stiff = material.mu + (material.K + material.mu / np.square(J)) * area
        self.force.stiffening = max(self.force.stiffening, float(stiff.max()) / material.p_modulus)

    def _add_product(self, F, P):
        """P += F M."""
        T = self.force.scratch("FM", P.shape)
        for k in range(3):
            P += np.multiply(F[:, k, None], self.M[k], out=T)

    def _update_history(self, F, C, J, p, coefficients):
        """Advance every relaxed stress to S_e = mu I + p/J cof^T cof, and refresh M; count the work done meanwhile."""
        material, force = self.force.material, self.force
        before = self._pair(F)
        stress = np.empty((6, self.q, self.n))
        for k, (i, j) in enumerate(_VOIGT):
            np.einsum("cqe,cqe->qe", C[:, i], C[:, j], out=stress[k], casting="same_kind")
        stress *= p / J
        stress[:3] += material.mu
        relaxed = 0.0
        for (g, _), (a, old, new, forward), q in zip(material.prony, coefficients, self.history):
            q += a * (old * self.old_stress + new * stress - q)
            relaxed = relaxed + g * (q + forward * (stress - q))
        self.old_stress = stress
        for k, (i, j) in enumerate(_VOIGT):
            self.M[i, j] = self.M[j, i] = material.mu * (i == j) - relaxed[k]
        # the viscous stress stood still since the last update, so its work is its product with the change of strain
        force.viscous_work += before - self.pairing
        self.pairing = self._pair(F)

    def _pair(self, F):
        """Integral of (M - mu I) : E over the cells, in J."""
        total = 0.0
        for i, j in _VOIGT:
            strain = np.einsum("cqe,cqe->qe", F[:, i], F[:, j]) - (i == j)
            part = self.M[i, j] - self.force.material.mu * (i == j)
            total += (0.5 if i == j else 1.0) * np.sum(strain * part * self.volume, dtype=float)
        return total

    def energies(self, u):
        material = self.force.material
        X, _, J, _ = self._deformation(u, False)
        trace = np.einsum("cjqe,cjqe->qe", X[:3], X[:3])
        with np.errstate(all="ignore"):
            W = material.mu / 2 * (trace - 3 - 2 * np.log(J))
        if self.mean_dilatation:
            mean = (self.volume * J).sum(axis=0) / self.cell_volume
            bulk = np.sum(material.K / 2 * (mean - 1) ** 2 * self.cell_volume)
        else:
            bulk = np.sum(material.K / 2 * np.square(J - 1) * self.volume)
        return float(np.sum(W * self.volume) + bulk), self._hourglass_energy()

    def dilatation(self, u):
        _, _, J, _ = self._deformation(u, False)
        return (self.volume * J).sum(axis=0) / self.cell_volume

    def _hourglass_energy(self):
        return 0.0


_VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


class _ReducedCells(_FullCells):
    """One point a cell with the mean gradient, and elastic hourglass control (Flanagan and Belytschko 1981).

    The hourglass force k gamma (gamma . u) is exact under rotation: gamma is orthogonal to every linear field.
    """

    rule, weight = element.CENTRE, 8.0

    def __init__(self, force, cells, index, hourglass_stiffness):
        super().__init__(force, cells, index, hourglass_stiffness)
        mesh, dtype = force.mesh, force.dtype
        corners = mesh.points[mesh.cells[cells]]  # (E, 8, 3)
        if mesh.congruent:
            mean = self.gradient.astype(float).reshape(3, 8, 1)
        else:
            jacobian = element.jacobians(mesh.points, mesh.cells[cells], element.GAUSS)  # (E, Q, 3, 3)
            volume = np.linalg.det(jacobian)
            every = np.einsum("qra,eqrj,eq->jae", element.shape_gradients(element.GAUSS), np.linalg.inv(jacobian), volume)
            self.cell_volume = volume.sum(axis=1)
            mean = every / self.cell_volume
            self.volume = self.cell_volume[None]
            self.to_physical = None
            self.gradient = np.ascontiguousarray(mean, dtype)  # (3, 8, E)
            self.divergence = np.ascontiguousarray(mean * self.cell_volume, dtype)
            offset = np.einsum("ha,eaj->hje", element.HOURGLASS, corners)
            self.gamma = np.ascontiguousarray(element.HOURGLASS[:, :, None] - np.einsum("hje,jae->hae", offset, mean), dtype)
        # Flanagan-Belytschko: the largest frequency of a cell's hourglass motion in proportion to its dilatational one
        stiffness = hourglass_stiffness * force.material.p_modulus * self.cell_volume * np.square(mean).sum(axis=(0, 1)) / 8
        self.stiffness = stiffness.astype(dtype)  # (E,) N/m
        self.congruent = mesh.congruent
        if mesh.congruent:
            rows = np.vstack([self.gradient.astype(float), element.HOURGLASS])
            columns = np.vstack([self.divergence.T.astype(float), element.HOURGLASS * self.stiffness[0]])
            self.rows, self.columns = rows.astype(dtype), np.ascontiguousarray(columns.T, dtype)  # (7, 8), (8, 7)

    def _gradient(self, u, F):
        U, Q = self.force.scratch("U", (3, 8, self.n)), self.force.scratch("Q", (3, 7, self.n))
        u.take(self.index, axis=1, out=U, mode="clip")
        if self.congruent:
            np.matmul(self.rows, U, out=Q)
            F[:, :, 0] = Q[:, :3]
        else:
            np.einsum("jae,cae->cje", self.gradient, U, out=F[:, :, 0])
            np.einsum("hae,cae->che", self.gamma, U, out=Q[:, 3:])

    def _to_nodes(self, P, out):
        Q = self.force.scratch("Q", (3, 7, self.n))
        if self.congruent:
            Q[:, :3] = P[:, :, 0]
            np.matmul(self.columns, Q, out=out)
        else:
            np.einsum("jae,cje->cae", self.divergence, P[:, :, 0], out=out)
            Q[:, 3:] *= self.stiffness
            out += np.einsum("hae,che->cae", self.gamma, Q[:, 3:])

    def _hourglass_energy(self):
        Q = self.force.scratch("Q", (3, 7, self.n))
        return float(np.sum(np.square(Q[:, 3:]).sum(axis=(0, 1)) * self.stiffness, dtype=float) / 2)
