"""The whole study, from configurations to docs/results.md: train, export, prune, measure, draw.

    python tools/report.py [configs/study.toml] [--quick] [--out docs] [--again STAGE ...]

What is there already is used again: trained runs under runs/, figures of each stage in the cache,
as long as what they depend on is the same: the study's settings, the dataset, the runs' files. A
command that was cut off goes on where it was. --quick takes configs/study_quick.toml, minutes
instead of hours. --untrained measures what is there and trains nothing, --only some stages of it;
the page says what is missing. The study of configs/study.toml also writes its part of README.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from fem.cache import VARIABLE
from fem.commands import command_line
from fem.errors import InputError
from fem.files import vet_output
from fem.locks import lock
from unet_fem.study.runs import CommandFailed, deploy, make_long_data, train_networks
from unet_fem.study.settings import Study, load_study
from unet_fem.study.stages import STAGES, check_needed, run_stage, stage_file

STUDY, QUICK = Path("configs/study.toml"), Path("configs/study_quick.toml")


@command_line
def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study that `arguments` ask for."""
    options = parse(arguments)
    if options.quick and options.study:
        raise InputError(f"give either {options.study} or --quick, not both")
    for option in ("again", "only"):
        for name in getattr(options, option):
            if name not in STAGES:
                raise InputError(f"--{option} {name}: no such stage; there are {', '.join(STAGES)}")
    if options.cache:
        os.environ[VARIABLE] = str(options.cache)  # for the commands that this one starts, too
    study = load_study(options.study or (QUICK if options.quick else STUDY))
    out = options.out or (study.folder if options.quick else Path("docs"))
    vet_output(out, folder=True)
    with lock(study.folder):
        results = carry_out(study, options)
        check_needed(results)
        from unet_fem.study.report import page  # not above: it brings TensorFlow and matplotlib

        readme = Path("README.md") if study.name == STUDY.stem and out == Path("docs") else None
        path = page.write(study, results, out, readme)
    print(f"\nwrote {path} with its figures in {path.parent / path.stem}/")


def carry_out(study: Study, options: argparse.Namespace) -> dict[str, dict]:
    """{stage: its figures}, after the trainings and exports that `options` do not leave out."""
    results = {}
    try:
        if not (options.draw or options.untrained or options.only):
            train_networks(study)
            deploy(study)
            make_long_data(study)
        for name in STAGES:
            read = options.draw or bool(options.only) and name not in options.only
            if read and not stage_file(study, name).is_file():
                continue  # the page says so
            results[name] = run_stage(study, name, name in options.again, only_read=read)
    except CommandFailed as failed:
        print(failed, file=sys.stderr)
        sys.exit(failed.code)
    return results


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = argparse.ArgumentParser(
        prog="python tools/report.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument(
        "study", nargs="?", type=Path, help=f"settings of the study (default: {STUDY})"
    )
    parser.add_argument(
        "--quick", action="store_true", help=f"the study of {QUICK}: every step on small settings"
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="folder of results.md and its figures (default: docs; with --quick: runs/<study>)",
    )
    parser.add_argument(
        "--again",
        nargs="+",
        default=[],
        metavar="STAGE",
        help=f"measure these again: {', '.join(STAGES)}",
    )
    parser.add_argument(
        "--untrained",
        action="store_true",
        help="train nothing: measure what is there; the page says what is missing",
    )
    parser.add_argument(
        "--only",
        nargs="+",
        default=[],
        metavar="STAGE",
        help="train nothing and measure these alone, the others as they are there",
    )
    parser.add_argument(
        "--draw",
        action="store_true",
        help="train and measure nothing: draw and write from what is there",
    )
    parser.add_argument(
        "--cache",
        type=Path,
        help=f"folder of what was measured (default: ${VARIABLE}, or runs/cache)",
    )
    return parser.parse_args(arguments)


if __name__ == "__main__":
    main()
