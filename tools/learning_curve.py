"""How the error of each answer falls with the interactions that it learns from, and what it costs.

    python tools/learning_curve.py data/wide.h5 --hard 160 --judge data/tumour.h5 [--sizes 29 58]

Each size takes the first interactions of the split "train" and, in the same share at all sizes, of
the split "hard". Prints Markdown and writes it as .md, with .json and, of several sizes, .png
beside it. What was interrupted goes on when the same command is given again.
"""

import argparse
import os
from pathlib import Path

from fem.commands import command_line
from fem.data.dataset import open_dataset
from fem.errors import InputError
from fem.files import vet_output

SIZES = [29, 58, 116, 232, 660]


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/learning_curve.py", description=__doc__.split("\n\n")[0]
    )
    parser.add_argument("dataset", help="HDF5 file of fem.generate to learn from")
    parser.add_argument("--judge", required=True, help="dataset whose tests judge")
    parser.add_argument("--hard", type=int, default=0, help='of the split "hard" to learn from')
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="of the learning sets")
    parser.add_argument("--answers", nargs="+", default=[], metavar="WORD", help="those with it")
    parser.add_argument("--kept", action="store_true", help="only what was done, nothing new")
    parser.add_argument("--out", type=Path, default=Path("docs/learning_curve"))
    options = parser.parse_args(arguments)
    if min(options.sizes) < 1 or options.hard < 0:
        raise InputError(
            f"--sizes {min(options.sizes)} must be at least 1, and --hard {options.hard} not"
            " negative"
        )
    dataset, judged_by = (
        open_dataset(path).for_learning() for path in (options.dataset, options.judge)
    )
    vet_output(options.out.with_suffix(".md"))
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # read when TensorFlow is imported
    from unet_fem.study.measure.learning_curve import ANSWERS, learning_curve
    from unet_fem.study.report.learning_curve import table, write

    words = options.answers
    answers = tuple(a for a in ANSWERS if not words or any(word in a for word in words))
    if not answers:
        raise InputError(f"--answers {' '.join(words)}: none of {', '.join(ANSWERS)}")
    result = learning_curve(
        dataset, judged_by, sorted(options.sizes), options.hard, answers, options.kept, told
    )
    print(table(result))
    command = (
        f"python tools/learning_curve.py {options.dataset} --hard {options.hard} --judge"
        f" {options.judge} --sizes {' '.join(map(str, sorted(options.sizes)))}"
    )
    write(result, options.out, command)
    print(f"wrote {options.out}.md and what stands beside it")


def told(line):
    """Print it at once."""
    print(line, flush=True)


if __name__ == "__main__":
    main()
