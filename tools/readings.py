"""Which reading of the paper's samples gives the paper's order of networks: train under each, and
write one table.

    python tools/readings.py [key=value ...] [--readings A B C] [--many SCENE DATA] [--out FILE]

A: whole interactions, as everywhere else. B: frames dealt out at random, as the authors' converter
does. C: three frames of each of more interactions, those of --many. Judged on the reading's own
validation frames and on unseen interactions, which leak under none. What was interrupted goes on
when the same command is given again.
"""

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path

from fem.commands import command_line
from fem.errors import InputError
from fem.files import write_text


@command_line
def main(arguments: Sequence[str] | None = None) -> None:
    """Train and judge what `arguments` ask for."""
    parser = argparse.ArgumentParser(
        prog="python tools/readings.py", description=(__doc__ or "").split("\n\n")[0]
    )
    parser.add_argument("changes", nargs="*", metavar="key=value", help="for both networks")
    parser.add_argument("--readings", nargs="+", default=["A", "B", "C"], metavar="A|B|C")
    parser.add_argument("--many", nargs=2, metavar=("SCENE", "DATA"), help="interactions of C")
    parser.add_argument("--half", action="store_true", help="networks of half their width")
    parser.add_argument("--threads", type=int, default=1, help="of TensorFlow (default: 1)")
    parser.add_argument("--out", type=Path, default=Path("docs/readings"))
    options = parser.parse_args(arguments)
    unknown = [name for name in options.readings if name not in ("A", "B", "C")]
    if unknown:
        raise InputError(f"--readings {unknown[0]} is not one of A, B and C")
    if "C" in options.readings and not options.many:
        raise InputError("reading C needs more interactions; give --many SCENE DATA")
    if wrong := [word for word in options.changes if "=" not in word]:
        raise InputError(f"'{wrong[0]}' is no key=value")

    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # read when TensorFlow is imported
    from unet_fem.deployment.latency import use_threads
    from unet_fem.study.measure import readings

    use_threads(options.threads)
    many = tuple(options.many) if options.many else None
    rows = readings.run(options.readings, options.changes, many, options.half)
    text = readings.table(rows)
    print(text)
    words = ["python tools/readings.py", *options.changes, "--readings", *options.readings]
    words += ["--many", *options.many] if options.many else []
    words += ["--half"] * options.half
    head = (
        f"# Readings of the paper's samples\n\n`{' '.join(words)}`\n\nRelative L2 error in %.\n\n"
    )
    write_text(options.out.with_suffix(".md"), head + text + "\n")
    write_text(options.out.with_suffix(".json"), json.dumps(rows, indent=1) + "\n")
    print(f"wrote {options.out.with_suffix('.md')} and .json")


if __name__ == "__main__":
    main()
