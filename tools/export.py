"""Export an interaction of a dataset for ParaView, with physical times, forces, volume ratios and
energies.

    python tools/export.py data/quick.h5 --interaction 3 out/

Open out/test-0003.pvd in ParaView.
"""

import argparse

from fem.commands import command_line
from fem.data.dataset import open_dataset
from fem.data.paraview import write_sequence
from fem.data.scene import SPLITS
from fem.files import vet_output


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/export.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("dataset", help="HDF5 file of fem.generate")
    parser.add_argument("folder", help="where to write; made if missing")
    parser.add_argument(
        "--interaction", type=int, default=1, help="its number within the split, from 1 (default)"
    )
    parser.add_argument("--split", choices=SPLITS, default="test", help="default: test")
    options = parser.parse_args(arguments)
    vet_output(options.folder, folder=True)
    sequence = open_dataset(options.dataset).sequence(options.split, options.interaction)
    collection = write_sequence(
        options.folder,
        f"{options.split}-{options.interaction:04d}",
        sequence.mesh,
        sequence.time,
        {"displacement": sequence.displacement, "force": sequence.force},
        sequence.energy,
    )
    print(
        f"wrote {collection} ({len(sequence.time)} frames to {sequence.time[-1]:g} s);"
        " open it in ParaView, and move the mesh with Warp By Vector"
    )
    if not sequence.energy:
        print("the dataset is from before energies were kept; generate it again to have them")


if __name__ == "__main__":
    main()
