"""The file of a reduced model: its arrays, and what they must fulfil. NumPy alone.

An uncompressed .npz (a zip of .npy arrays, little-endian, C order), which C reads as well. What the
arrays mean stands in fem.online.reduced.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fem.errors import InputError
from fem.files import load_arrays, save_arrays
from fem.material.base import Hyperelastic
from fem.material.laws import KINDS
from fem.online.contact_surface import ContactSurface
from fem.online.grid import NodeGrid

FORMAT = "unet-fem reduced 1"
REMEDY = "make one with python -m fem.reduce data.h5"
BLOCK = {"A": ("S", "n"), "M": ("R", "z"), "encoder": ("R", "f"), "decoder": ("d", "R")}
BLOCK |= {"flexibility": ("R", "R"), "missing": ("k", "f")}  # axes of the arrays of a parity
META = {"mesh": str, "material": str, "law": dict, "nodes": int, "interval": float}


@dataclass(frozen=True, eq=False)
class Block:
    """The arrays of one parity, float32; h: left points, n: its modes that points see.

    A (9 h, n) 1/mm; M (R, 9 h + n) mm and 1; encoder (R, 3 h_force) mm/mN; decoder (3 h_free, R);
    flexibility (R, R) mm/mN; missing (k, 3 h_force) mm/mN.
    """

    A: np.ndarray
    M: np.ndarray
    encoder: np.ndarray
    decoder: np.ndarray
    flexibility: np.ndarray
    missing: np.ndarray


@dataclass(frozen=True, eq=False)
class ReducedModel:
    """A reduced model, see fem.online.reduced for its equations.

    blocks: of the even and the odd modes, or of all where there is no mirror
    force, free: (sides, h) numbers of the loadable and of the free nodes: left ones and, with a
    mirror, their images; prony: (K, 2) g and tau in s; axis: the component that the mirror flips,
    or None; grid: NodeGrid of the mesh, or None; meta: plain values, with `mesh` and `material`
    digests, `law`, `nodes`, and `interval` in s, that of the frames it was fitted to; places (N, 3)
    mm of the nodes and faces (M, 4) that contacts push on, or None in older files; law: that of the
    points

    Raises InputError for arrays that do not fit each other or are not finite.
    """

    blocks: tuple[Block, ...]
    force: np.ndarray
    free: np.ndarray
    prony: np.ndarray
    axis: int | None
    grid: NodeGrid | None
    meta: dict[str, Any]
    places: np.ndarray | None = None
    faces: np.ndarray | None = None
    law: Hyperelastic = field(init=False)

    def __post_init__(self) -> None:
        sides = len(self.blocks)
        if sides not in (1, 2) or (self.axis is None) != (sides == 1):
            raise InputError(f"{sides} blocks and mirror axis {self.axis} do not fit; {REMEDY}")
        for name, kind in META.items():
            if not isinstance(self.meta.get(name), kind):
                raise InputError(f"the model's meta has no {name} ({kind.__name__}); {REMEDY}")
        sizes = {"f": 3 * self.force.shape[-1], "d": 3 * self.free.shape[-1]}
        for b, block in enumerate(self.blocks):
            local = {"n": block.A.shape[-1], "R": len(block.M), "k": len(block.missing)}
            sizes.setdefault("S", len(block.A))
            local["z"] = sizes["S"] + local["n"]
            for name, axes in BLOCK.items():
                shape = tuple((sizes | local)[axis] for axis in axes)
                _check(f"{name}{b}", getattr(block, name), shape, "f", "float32")
            if local["n"] > local["R"]:
                raise InputError(f"A{b} sees {local['n']} modes of {local['R']}; {REMEDY}")
        if sizes["S"] % 9:
            raise InputError(f"A0 has {sizes['S']} rows, which are no 9 a point; {REMEDY}")
        for name, rows in (("force", sides), ("free", sides)):
            nodes = getattr(self, name)
            _check(name, nodes, (rows, nodes.shape[-1]), "iu")
            if nodes.size and not 0 <= nodes.min() <= nodes.max() < self.meta["nodes"]:
                raise InputError(f"{name} names a node outside the mesh; {REMEDY}")
        _check("prony", self.prony, (len(self.prony), 2), "f")
        if self.faces is not None:
            n = self.meta["nodes"]
            _check("places", np.asarray(self.places), (n, 3), "f")
            _check("faces", self.faces, (len(self.faces), 4), "iu")
            if not len(self.faces) or not 0 <= self.faces.min() <= self.faces.max() < n:
                raise InputError(f"faces names no face, or a node outside the mesh; {REMEDY}")
        object.__setattr__(self, "law", self._law())

    def _law(self):
        given = dict(self.meta["law"])
        kind = given.pop("kind", None)
        if kind not in KINDS:
            raise InputError(f"the model has a law '{kind}', not one of {', '.join(KINDS)}")
        try:
            return KINDS[kind](**given)
        except TypeError as error:
            raise InputError(f"the model's law is damaged ({error}); {REMEDY}") from None

    @property
    def modes(self) -> int:
        """R, of all blocks."""
        return sum(len(block.M) for block in self.blocks)

    @property
    def points(self) -> int:
        """m, of all sides."""
        return len(self.blocks) * (len(self.blocks[0].A) // 9)

    def surface(self) -> ContactSurface:
        """That contacts push on. Raises InputError for a file that was made before it was kept."""
        if self.places is None or self.faces is None:
            raise InputError(f"the reduced model does not hold its body's surface; {REMEDY}")
        carries = np.zeros(len(self.places), bool)
        carries[self.free.ravel()] = True
        return ContactSurface(self.places, self.faces, carries)

    def check(self, mesh: str, material: str | None = None) -> None:
        """Raises InputError unless it was made for the mesh, and the material, with these
        digests."""
        for name, given in (("mesh", mesh), ("material", material)):
            if given is not None and given != self.meta[name]:
                raise InputError(
                    f"the reduced model is of another {name} ({self.meta[name][:8]}, not"
                    f" {given[:8]}); {REMEDY}"
                )

    def arrays(self) -> dict[str, np.ndarray]:
        """What a file of it holds, by name, little-endian and in C order."""
        arrays: dict[str, Any] = {"force": self.force, "free": self.free, "prony": self.prony}
        if self.grid is not None:
            arrays |= {"grid_shape": np.array(self.grid.shape), "grid_index": self.grid.index}
        if self.faces is not None:
            arrays |= {"places": self.places, "faces": self.faces}
        for b, block in enumerate(self.blocks):
            arrays |= {f"{name}{b}": getattr(block, name) for name in BLOCK}
        meta = json.dumps(self.meta | {"axis": self.axis}, allow_nan=False).encode()
        little = {
            name: np.ascontiguousarray(a, a.dtype.newbyteorder("<")) for name, a in arrays.items()
        }
        return little | {"meta": np.frombuffer(meta, np.uint8)}

    @classmethod
    def of(cls, arrays: dict[str, np.ndarray], path: Path | str) -> "ReducedModel":
        """That of `arrays`, among which others may be; path: for messages. Raises InputError where
        one is missing or damaged."""
        try:
            meta = json.loads(arrays["meta"].tobytes().decode())
            axis = meta.pop("axis")
            count = 1 if axis is None else 2
            blocks = tuple(Block(*(arrays[f"{name}{b}"] for name in BLOCK)) for b in range(count))
            grid = None
            if "grid_index" in arrays:
                grid = NodeGrid(tuple(arrays["grid_shape"]), arrays["grid_index"])
            kept = {name: arrays[name] for name in ("force", "free", "prony")}
            kept |= {name: arrays[name] for name in ("places", "faces") if name in arrays}
            return cls(blocks, **kept, axis=axis, grid=grid, meta=meta)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        except (KeyError, ValueError, AttributeError, TypeError, IndexError) as error:
            raise InputError(f"{path} is damaged ({repr(error)[:120]}); {REMEDY}") from None

    def save(self, path: Path | str) -> None:
        """Write it to `path` (.npz), at once or not at all."""
        save_arrays(path, format=FORMAT, **self.arrays())

    @classmethod
    def load(cls, path: Path | str) -> "ReducedModel":
        """That of the file at `path`. Raises InputError for a file that is missing, damaged or
        another's."""
        if not Path(path).is_file():
            raise InputError(f"no reduced model {path}; {REMEDY}")
        arrays = load_arrays(path)
        if str(arrays.pop("format", None)) != FORMAT:
            raise InputError(f"{path} is not a whole '{FORMAT}' file; {REMEDY}")
        return cls.of(arrays, path)


def _check(name, values, shape, kinds, dtype=None):
    """Raises InputError unless an array is of this shape, kind and type, if one is given, and
    finite."""
    if values.shape != shape or values.dtype.kind not in kinds or dtype not in (None, values.dtype):
        raise InputError(
            f"{name} is {values.dtype} of shape {values.shape} and the others need {shape};"
            f" {REMEDY}"
        )
    if not np.isfinite(values).all():
        raise InputError(f"{name} holds values that are not finite; {REMEDY}")
