"""Time the finite-element solver on one core, beside a plain NumPy step and felupe.

    python tools/benchmark_fem.py [--quick] [--out docs/benchmark_fem.json]
    python tools/benchmark_fem.py --quasistatic --out docs/benchmark_quasistatic.json

The tables are printed as Markdown; felupe is optional (pip install -e '.[test]').
"""

import argparse
import json
from pathlib import Path

from fem.commands import command_line


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--quick", action="store_true", help="few repetitions and no box above 10 thousand cells"
    )
    parser.add_argument(
        "--quasistatic", action="store_true", help="the quasi-static solver beside the explicit one"
    )
    parser.add_argument("--out", type=Path, help="write the figures as JSON too")
    options = parser.parse_args(arguments)

    from threadpoolctl import threadpool_limits  # --help pays for no library

    from fem.files import vet_output, write_text
    from fem.measure import quasistatic, speed

    if options.out is not None:
        vet_output(options.out)

    with threadpool_limits(1):
        result = (quasistatic if options.quasistatic else speed).measure(options.quick)
    if options.out:
        write_text(options.out, json.dumps(result, indent=1) + "\n")
        print(f"\nwrote {options.out}")


if __name__ == "__main__":
    main()
