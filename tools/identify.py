"""Shear modulus and Prony series of a tissue from a record of a press.

    python tools/identify.py runs/constitutive/network.npz record.csv --position 4.1 4.1 3.05

record.csv has the columns time_s, depth_mm and force_mN (or ms, min, um, m, uN, N): how deep a
probe has pushed the surface at --position, and the force on it. K / mu is that of the network's
tissue.
"""

import argparse

from fem.commands import command_line
from fem.online.constitutive import load_constitutive
from fem.ranges import checked
from fem.reduced.identify import Pressed, identify, read_record


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/identify.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("network", help="network.npz of a constitutive network of the body")
    parser.add_argument("record", help="CSV file")
    parser.add_argument(
        "--position", type=float, nargs=3, required=True, metavar=("X", "Y", "Z"), help="mm"
    )
    parser.add_argument("--radius", type=float, default=2.5, help="of the probe, mm (default: 2.5)")
    parser.add_argument("--terms", type=int, default=2, help="of the Prony series (default: 2)")
    options = parser.parse_args(arguments)
    checked("--terms", options.terms, 0, 6, whole=True)
    record = read_record(options.record)
    model, learned = load_constitutive(options.network)
    pressed = Pressed(model, learned, record, options.position, options.radius)
    print(f"{len(record.time)} rows over {record.time[-1] - record.time[0]:g} s")
    found = identify(pressed, options.terms)
    print(f"misfit {100 * found.misfit:.2f} % of the forces; intervals of {found.confidence:.0%}:")
    values = {"mu": found.mu}
    for k, (g, tau) in enumerate(found.prony, start=1):
        values |= {f"g{k}": g, f"tau{k}": tau}
    for name, value in values.items():
        unit = " Pa" if name == "mu" else " s" if name.startswith("tau") else ""
        line = f"  {name:5} {value:9.4g}{unit:3} ({found.low[name]:.4g} to {found.high[name]:.4g})"
        print(line + ("" if found.told[name] else "   the record does not tell it"))
    for one, other in found.alike:
        print(f"  {one} and {other} cannot be told apart; try --terms {options.terms - 1}")


if __name__ == "__main__":
    main()
