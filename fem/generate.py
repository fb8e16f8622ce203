"""Simulate the interactions of a scene in parallel and write them to one HDF5 file.

    python -m fem.generate configs/tumour.toml [--out data/tumour.h5] [--workers 2]
    fem.generate(scene, "data/tumour.h5")      the same from Python

Finished interactions wait in a folder beside the file, so a run that was stopped goes on where it
was.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from fem.commands import command_line
from fem.data.build import generate
from fem.data.dataset import open_dataset
from fem.data.scene import load_scene
from fem.data.write import groups
from fem.errors import InputError
from fem.files import vet_output
from fem.lazy import callable_module

callable_module(__name__, generate)


@command_line
def main(arguments: Sequence[str] | None = None) -> None:
    """Generate the dataset of a scene, as the words of a command line ask."""
    options = _options(arguments)
    if options.workers is not None and not 1 <= options.workers <= 10_000:
        raise InputError(f"--workers {options.workers} must be at least 1 and at most 10000")
    scene = load_scene(options.scene)
    if options.out is not None:
        vet_output(options.out)
    out = options.out or Path("data") / f"{Path(options.scene).stem}.h5"
    if out.is_file():
        raise InputError(f"{out} exists already; delete it to make it again, or give another --out")
    rejected = generate(scene, out, options.workers)
    print(f"wrote {out} ({out.stat().st_size / 1e6:.0f} MB); rejected draws: {_counts(rejected)}")
    dataset = open_dataset(out)
    kept = Counter(groups(scene))
    for group, counts in dataset.rejected.items():
        print(
            f"  {group}: {sum(counts.values())} for {kept[group]} interactions ({_counts(counts)})"
        )
    if len(dataset.confirmation):
        print(
            f"{len(dataset.confirmation)} interactions again at the true mass: displacement differs"
            f" by up to {dataset.confirmation['error'].max():.2%} (relative L2)"
        )
    lost = dataset.embedding_error
    if lost:
        print(
            "the mesh has no node grid of its own: from it to the grid and back, displacement"
            f" changes by {100 * lost:.2g} % (relative L2)"
        )
    if not options.quiet:
        config = "paper_unet" if lost else "constitutive"  # which is judged on the mesh's own grid
        hard = 4 * scene.interactions.hard_set // 5  # the others are to choose by
        print(
            f"next: python -m unet_fem.train configs/{config}.toml scene={options.scene} data={out}"
            f" name={out.stem} samples.hard={hard}"
        )


def _counts(rejected: dict[str, int]) -> str:
    return ", ".join(f"{reason} {count}" for reason, count in sorted(rejected.items())) or "none"


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m fem.generate", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("scene", help="scene file, such as configs/tumour.toml")
    parser.add_argument("--out", type=Path, help="HDF5 file to write (default: data/<scene>.h5)")
    parser.add_argument("--workers", type=int, help="processes (default: one per core)")
    parser.add_argument("--quiet", action="store_true", help="show the progress alone")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    main()
