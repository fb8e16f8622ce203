"""Write the mesh of configs/lobe.toml: a curved, distorted block, with its nodes and cells in no
order, as meshers leave them.

    python tools/make_lobe.py [configs/lobe.vtu]

An arched slab of 12 x 12 x 6 cells, about 19 x 15 x 9 mm: bent over an angle of 100 degrees,
bulging and thicker in the middle, with thinner cells towards the top, skewed and unevenly spaced.
Lengths are in mm; the array `top` marks the nodes of the outer surface.
"""

import argparse
from pathlib import Path

import meshio
import numpy as np

from fem.commands import command_line
from fem.errors import InputError
from fem.files import replacing, vet_output
from fem.mesh.shapes import box

CELLS = (12, 12, 6)


def lobe(cells=CELLS, seed=1):
    """The mesh as a meshio.Mesh in mm, shuffled with `seed`."""
    block = box(cells, 1.0, "none")
    a, b, c = (block.points / cells).T  # each from 0 to 1, c from the inner surface to the outer
    rng = np.random.default_rng(seed)
    inside = (a * (1 - a) * b * (1 - b) * c * (1 - c) > 0)[:, None]
    a, b, c = (
        np.stack([a, b, c]) + (inside * rng.uniform(-0.12, 0.12, block.points.shape) / cells).T
    )
    a = a + 0.04 * np.sin(2 * np.pi * a) + 0.05 * np.sin(np.pi * a) * (b - 0.5)
    b = b + 0.05 * np.sin(np.pi * b) * np.cos(np.pi * c)
    depth = c + 0.25 * c * (1 - c)
    bulge = np.sin(np.pi * a) * np.sin(np.pi * b)
    radius = 7.0 + depth * (3.5 + 2.0 * bulge)  # mm
    angle = np.radians(100) * (a - 0.5)
    points = np.stack(
        [
            radius * np.sin(angle),
            15.0 * (b - 0.5) * (1 + 0.15 * depth * np.cos(angle)),
            radius * np.cos(angle),
        ],
        axis=1,
    )
    node, cell = rng.permutation(block.n_nodes), rng.permutation(block.n_cells)
    number = np.argsort(node)
    top = (block.points[:, 2] == cells[2]).astype(np.uint8)
    return meshio.Mesh(
        points[node], [("hexahedron", number[block.cells[cell]])], point_data={"top": top[node]}
    )


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/make_lobe.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument(
        "file",
        nargs="?",
        type=Path,
        default=Path("configs/lobe.vtu"),
        help="where to write (default: configs/lobe.vtu)",
    )
    file = vet_output(parser.parse_args(arguments).file)
    if file.suffix != ".vtu":
        raise InputError(f"{file} is no .vtu file; give a name that ends in .vtu")
    with replacing(file) as partial:
        lobe().write(partial)
    print(f"wrote {file}")


if __name__ == "__main__":
    main()
