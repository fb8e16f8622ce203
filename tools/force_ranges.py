"""How a scene behaves when its contacts push more weakly or harder: refused draws, volume changes,
and how much of the motion is beyond a linear answer.

    python tools/force_ranges.py configs/tumour.toml [--factors 0.5 1 2] [--out docs/forces]

Prints Markdown; --out writes it as .md, and the numbers as .json.
"""

import argparse
import json
from pathlib import Path

from fem.commands import command_line
from fem.errors import InputError

FACTORS = [0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0]


def table(rows: list[dict]) -> str:
    """The rows of fem.measure.force_ranges.measure as Markdown."""

    def percent(value):
        return "-" if value is None else f"{100 * value:.1f}"

    lines = [
        "| force | draws | refused | peak mm, median / 90 % / most | volume % | tumour's volume %"
        " | least J | linear % | linear with memory % |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        refused = ", ".join(f"{n} {reason}" for reason, n in row["refused"].items()) or "none"
        peaks = " / ".join(f"{peak:.2f}" for peak in row.get("peak_mm", ())) or "-"
        cells = [
            f"x {row['factor']:g}, {row['kind']}",
            str(row["draws"]),
            refused,
            peaks,
            percent(row.get("volume")),
            percent(row.get("tumour_volume")),
            f"{row['min_J']:.2f}" if "min_J" in row else "-",
            percent(row.get("linear")),
            percent(row.get("linear_remembered")),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/force_ranges.py", description=__doc__.split("\n\n")[0]
    )
    parser.add_argument("scene", help="scene file, such as configs/tumour.toml")
    parser.add_argument("--factors", type=float, nargs="+", default=FACTORS)
    parser.add_argument("--usual", type=int, default=60, help="draws of each factor (default: 60)")
    parser.add_argument("--hard", type=int, default=20, help="hard draws of each (default: 20)")
    parser.add_argument("--out", type=Path, help="write <out>.md and <out>.json")
    options = parser.parse_args(arguments)
    if not all(0 < factor < 1e3 for factor in options.factors):
        raise InputError(f"--factors {options.factors} must lie between 0 and 1000")
    if not 1 <= options.usual <= 100_000 or not 0 <= options.hard <= 100_000:
        raise InputError(
            f"--usual {options.usual} must be at least 1, --hard {options.hard} not negative, and"
            " both at most 100000"
        )

    from fem.data.scene import load_scene
    from fem.files import vet_stem, write_text
    from fem.measure.force_ranges import measure

    out = vet_stem(options.out, ".md", ".json") if options.out is not None else None
    scene = load_scene(options.scene)
    rows = measure(scene, options.factors, options.usual, options.hard)
    text = table(rows)
    print(text)
    if out:
        low, high = (1e3 * force for force in scene.contact.force)
        radii = " to ".join(f"{1e3 * radius:g}" for radius in scene.contact.radius)
        first, last = scene.interactions.hard_force
        head = (
            f"# Forces of {options.scene}\n\n`python tools/force_ranges.py {options.scene}"
            f" --factors {' '.join(f'{factor:g}' for factor in options.factors)}"
            f" --usual {options.usual} --hard {options.hard} --out {options.out}`\n\n"
            f"Factor 1: {low:g} to {high:g} mN a contact, radius {radii} mm; hard ones {first:g} to"
            f" {last:g} times the largest. Volumes: the largest change of the FEM's own. linear:"
            " relative L2 error of the best linear answer on the usual draws that it was fitted to,"
            " from the forces of the moment and from the forces as the tissue remembers them.\n\n"
        )
        write_text(out[0], head + text + "\n")
        write_text(out[1], json.dumps(rows, indent=1) + "\n")
        print(f"wrote {out[0]} and .json")


if __name__ == "__main__":
    main()
