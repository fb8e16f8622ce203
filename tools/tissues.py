"""Other tissues in a constitutive network, with nothing learned again, against the quasi-static
solver with the same tissue.

    python tools/tissues.py data/wide.h5 runs/constitutive/lite/float32.tflite --hard 160

Prints Markdown; --out docs/tissues writes it as .md, and the numbers as .json. Judged are a few of
the interactions held out, by their contacts.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from fem.commands import command_line
from fem.contact.push import Load
from fem.contact.surface import surface_of
from fem.data.dataset import open_dataset
from fem.data.interaction import simulate_frames
from fem.errors import InputError, SolverStopped
from fem.files import vet_output, write_text
from fem.material.base import bulk_modulus
from fem.reduced.build import held_out
from fem.solver.quasistatic import QuasiStatic
from unet_fem.runtime.constitutive import ConstitutiveSurrogate, read_constitutive

SERIES = (
    ((0.12, 330.0), (0.4, 11.0)),
    ((0.3, 2.0), (0.4, 60.0)),
    ((0.2, 0.5), (0.6, 30.0)),
    ((0.5, 1.0),),
    (),
)
BULK = 0.5, 0.75, 0.9, 1.2, 1.5  # times K, mu stays; the full element locks above nu = 0.45
COMMON = 0.1, 10.0  # times mu and K, and the forces
LEAST, BAD = 0.05, 0.05  # mm, |u| of the frames judged; an error that must not be silent
COUNT = 4  # interactions of a kind

HEAD = """\
# Other tissues in a constitutive network

Relative L2 error in % of a network made for `configs/tumour_wide.toml` that was told of another
tissue ([method.md](method.md)), against the quasi-static solver with that tissue; nothing was
learned again. Three usual and four hard interactions held out; the worst of them; the middle bound;
frames flagged.

    python tools/tissues.py data/wide.h5 FILE.tflite --hard 160 --out docs/tissues

"""


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/tissues.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("dataset", help="HDF5 file of fem.generate")
    parser.add_argument("network", help=".tflite of a run of a constitutive network")
    parser.add_argument("--hard", type=int, default=0, help="as it was for fem.reduce")
    parser.add_argument("--out", type=Path, help="where to write .md and .json")
    options = parser.parse_args(arguments)
    if options.hard < 0:
        raise InputError(f"--hard {options.hard} must not be negative")
    read_constitutive(options.network)
    if options.out:
        vet_output(options.out.with_suffix(".json"))
    dataset = open_dataset(options.dataset).for_learning()
    chosen = {name: some[9::10][:COUNT] for name, some in held_out(dataset, options.hard).items()}
    surrogate = ConstitutiveSurrogate(options.network, float(np.diff(dataset.time[:2])[0]))
    rows = []
    for tissue in tissues(dataset.material):
        rows.append(judged(surrogate, dataset, chosen, *tissue))
        print(table(rows[-1:]).splitlines()[2], file=sys.stderr, flush=True)
    text = table(rows)
    print(text)
    if options.out:
        write_text(options.out.with_suffix(".md"), HEAD + text)
        write_text(options.out.with_suffix(".json"), json.dumps(rows, indent=1) + "\n")


def tissues(material):
    """(name, material, factor on the forces) of each row."""
    K, mu = float(material.K), float(material.mu)
    yield "as trained", material, 1.0
    for series in SERIES:
        words = " + ".join(f"{g:g} in {tau:g} s" for g, tau in series) or "none: elastic"
        yield f"Prony {words}", replace(material, prony=series), 1.0
    for factor in BULK:
        ratio = factor * K / mu
        nu = (3 * ratio - 2) / (6 * ratio + 2)
        assert abs(bulk_modulus(mu, nu) - factor * K) < 1e-9 * K
        yield f"K x {factor:g} (nu {nu:.3f})", replace(material, nu=nu), 1.0
    for factor in COMMON:
        yield f"mu, K and forces x {factor:g}", replace(material, mu=factor * mu), factor


def judged(surrogate, dataset, chosen, name, material, factor):
    """{"tissue", then of each kind "error", "worst", "bound", "flagged", "silent", "stopped"}."""
    surrogate.set_material(float(material.mu), float(material.K), material.prony)
    surrogate.warns = False  # the table tells
    row = {"tissue": name}
    for kind, some in chosen.items():
        ends, frames, stopped = [], [], 0
        for split, number in some:
            contacts = dataset.contacts(split, number)
            load = Load(surface_of(dataset.fem_mesh), contacts)
            forces, truth, whole = quasistatic(dataset, material, load, factor)
            stopped += not whole
            surrogate.reset()
            squares = np.zeros(2)
            for force, u in zip(forces, truth, strict=True):
                wrong = np.linalg.norm(surrogate.step(force) - u)
                size = np.linalg.norm(u)
                squares += wrong**2, size**2
                if size > LEAST:
                    frames.append((wrong / size, surrogate.bound, surrogate.flagged))
            ends.append(squares)
        error, bound, flagged = np.array(frames).T
        wrong, size = np.array(ends).T
        row[kind] = {
            "error": float(np.sqrt(wrong.sum() / size.sum())),
            "worst": float(np.sqrt((wrong / size).max())),
            "bound": float(np.median(bound)),
            "flagged": float(flagged.mean()),
            "silent": float(np.mean((error > BAD) & (flagged == 0))),
            "stopped": stopped,
        }
    return row


def quasistatic(dataset, material, load, factor):
    """(forces mN, displacements mm, each (N, 3), whether all frames were reached) of `factor` times
    a load."""
    solver = QuasiStatic(dataset.fem_mesh, material, precision="float32")
    solver.gate = None
    forces, found = [], []
    try:
        for frame in simulate_frames(solver, lambda t: factor * load(t), dataset.time):
            forces.append(frame.force)
            found.append(frame.displacement)
    except SolverStopped:
        pass
    return forces, found, len(found) == len(dataset.time)


def table(rows):
    """Markdown."""
    kinds = [kind for kind in rows[0] if kind != "tissue"]
    lines = [
        "| tissue | " + " | ".join(f"{kind} % | worst | bound | flagged" for kind in kinds) + " |",
        "|---" * (1 + 4 * len(kinds)) + "|",
    ]
    for row in rows:
        cells = [row["tissue"]]
        for kind in kinds:
            one = row[kind]
            cells += [f"{100 * one[name]:.2f}" for name in ("error", "worst", "bound")]
            cells.append(f"{100 * one['flagged']:.0f} %")
        lines.append("| " + " | ".join(cells) + " |")
    silent = max(row[kind]["silent"] for row in rows for kind in kinds)
    stopped = sum(row[kind]["stopped"] for row in rows for kind in kinds)
    lines += [
        "",
        f"Frames that err by more than {100 * BAD:g} % and are not flagged:"
        f" {100 * silent:.1f} % in the worst cell. Runs that the solver did not bring to their"
        f" end, judged as far as it came: {stopped}.",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
