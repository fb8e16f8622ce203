"""Map where the solver is accurate and where it stops, and write docs/stability.md and
docs/stability.png.

    python tools/stability.py [--quick] [--only WORD] [--out docs]

What the map holds is said in fem/measure/limits.py. The command exits with 1 where a cell is WRONG.
"""

import argparse
import sys
import time
from pathlib import Path

from fem.commands import command_line


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--quick", action="store_true", help="a few cells of most sweeps, in a quarter of a minute"
    )
    parser.add_argument(
        "--only", default="", help="sweeps whose name contains this word, printed and not written"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("docs"), help="folder of stability.md and stability.png"
    )
    options = parser.parse_args(arguments)

    from threadpoolctl import threadpool_limits  # --help pays for no library

    from fem.files import vet_output
    from fem.measure import limits

    if not options.only:
        vet_output(options.out, folder=True)
    with threadpool_limits(1):
        start, cells = time.perf_counter(), []
        to_come = limits.measure(options.quick, options.only)
        if not limits.HAS_ALARM:
            print("this system has no alarm: a run that hangs is not ended")
        for cell in to_come:
            cells.append(cell)
            outcome = cell.reason or f"{cell.error:.1e}"
            print(
                f"{cell.sweep.name:42} {cell.value:>12}  {cell.status:8} {outcome}"
                f"  ({cell.seconds:.1f} s)",
                flush=True,
            )
        counts = limits.counts(cells)
        print(
            f"{len(cells)} cells in {time.perf_counter() - start:.0f} s: "
            + ", ".join(f"{n} {status}" for status, n in counts.items())
        )
        if not options.only:
            from fem.measure import (
                extreme_runs,
                limits_report,
                sweeps,
            )  # Matplotlib, for the figure alone

            locking = [] if options.quick else extreme_runs.locking(sweeps.NU)
            limits_report.write(options.out, cells, locking)
            print(f"wrote {options.out / 'stability.md'} and {options.out / 'stability.png'}")
    sys.exit(counts["WRONG"] > 0)


if __name__ == "__main__":
    main()
