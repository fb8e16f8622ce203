"""How near the force of a press comes to that of the quasi-static FEM, and how long a tick takes.

python tools/press.py data/paper.h5 runs/constitutive/network.npz [--depth 0.12] [--out docs/press]
"""

import argparse
import json
from pathlib import Path

from fem.commands import command_line
from fem.data.dataset import open_dataset
from fem.files import vet_output, write_text
from fem.measure.machine import processor
from fem.measure.press import pressing, tick_times
from fem.measure.timing import quantiles
from fem.online.press import Press
from fem.ranges import checked


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/press.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("dataset", help="HDF5 file of fem.generate, of the same body")
    parser.add_argument("network", help="file of a constitutive network")
    parser.add_argument("--depth", type=float, default=0.12, help="mm at most (default: 0.12)")
    parser.add_argument("--count", type=int, default=6, help="presses (default: 6)")
    parser.add_argument("--ticks", type=int, default=3000, help="to be timed (default: 3000)")
    parser.add_argument("--out", type=Path, help="also write .json")
    options = parser.parse_args(arguments)
    checked("--depth", options.depth, 1e-4, 1e3, "mm")
    checked("--count", options.count, 1, 1000, whole=True)
    checked("--ticks", options.ticks, 10, 10_000_000, whole=True)
    if options.out:
        vet_output(options.out.with_suffix(".json"))
    dataset = open_dataset(options.dataset)
    press = Press.open(options.network)
    press.stepper.model.check(dataset.mesh_digest)
    found = {}
    for dt in (0.01, 0.001):
        one = pressing(press, dataset, options.depth, options.count, seconds=60 * dt, dt=dt)
        found[f"{1e3 * dt:g} ms"] = one._asdict()
        print(
            f"ticks of {1e3 * dt:g} ms: force off by {100 * one.force:.2f} %, worst press"
            f" {100 * one.worst:.2f} %; up to {one.largest:.2f} mN,"
            f" {100 * one.flagged:.0f} % flagged"
        )
    times = quantiles(1e3 * tick_times(press, options.ticks, depth=options.depth))
    print(", ".join(f"{name} {value:.3f} ms" for name, value in times.items()), "a tick")
    if options.out:
        about = {
            "network": Path(options.network).name,
            "machine": processor(),
            "depth": options.depth,
        }
        text = json.dumps(about | {"error": found, "tick_ms": times}, indent=1)
        write_text(options.out.with_suffix(".json"), text + "\n")


if __name__ == "__main__":
    main()
