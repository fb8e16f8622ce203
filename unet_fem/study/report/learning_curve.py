"""The learning curve as Markdown and as a figure, see unet_fem.study.measure.learning_curve."""

import json
from pathlib import Path

from matplotlib.figure import Figure

from fem.files import write_text
from unet_fem.training.style import save, styled, subplots

KINDS = ("usual", "hard")


def table(result: dict) -> str:
    """Errors usual / hard in %, a row for each answer and a column for each size, and below what
    the data and the learning cost in CPU seconds."""
    sizes = sorted({row["interactions"] for row in result["rows"]} - {0})
    answers = list(dict.fromkeys(row["answer"] for row in result["rows"]))
    found = {(row["answer"], row["interactions"]): row for row in result["rows"]}
    costs = {row["interactions"]: row["simulation"] for row in result["rows"]}

    def line(name, cells):
        return "| " + " | ".join([name, *cells]) + " |"

    def errors(row):
        return " / ".join(_short(100 * row[name]) for name in KINDS if name in row)

    def cells(answer, write):
        rows = (found.get((answer, size)) or found.get((answer, 0)) for size in sizes)
        return [write(row) if row else "-" for row in rows]

    heads = [*map(str, sizes)]
    rule = "|" + "---|" * (1 + len(sizes))
    lines = [line("usual / hard %", heads), rule]
    lines += [line(answer, cells(answer, errors)) for answer in answers]
    lines += ["", line("CPU seconds", heads), rule]
    lines.append(line("simulations", [f"{costs.get(size, 0):.0f}" for size in sizes]))
    lines += [line(f"{a}", cells(a, lambda row: f"{row['learning']:.0f}")) for a in answers]
    return "\n".join(lines)


def _short(value):
    return f"{value:.2f}" if value < 10 else f"{value:.1f}"


@styled()
def draw(result: dict) -> Figure:
    """Error against the number of interactions, usual on the left and hard on the right."""
    rows = result["rows"]
    kinds = [name for name in KINDS if any(name in row for row in rows)]
    figure, axes = subplots(1, len(kinds), (5 * len(kinds), 4.4), squeeze=False)
    for axis, kind in zip(axes[0], kinds, strict=True):
        for answer in dict.fromkeys(row["answer"] for row in rows):
            own = sorted((r["interactions"], 100 * r[kind]) for r in rows if r["answer"] == answer)
            if own[0][0] == 0:
                axis.axhline(own[0][1], color="gray", linestyle="--", label=answer)
            else:
                axis.plot(*zip(*own, strict=True), "o-", markersize=3, label=answer)
        axis.set(xscale="log", yscale="log", xlabel="interactions to learn from")
        axis.set(ylabel="relative L2 error (%)", title=f"{result['interactions'][kind]} {kind}")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def write(result: dict, out: Path, command: str) -> None:
    """The result as <out>.json and <out>.md, and where there are several sizes as <out>.png."""
    judged = " and ".join(f"{n} {name}" for name, n in result["interactions"].items())
    text = (
        f"# Learning curve\n\n`{command}`\n\nRelative L2 error over free nodes and"
        f" frames in % on {judged} test interactions, by how many interactions were learned from."
        f"\n\n{table(result)}\n"
    )
    if len({row["interactions"] for row in result["rows"]} - {0}) > 1:
        save(draw(result), out.with_suffix(".png"))
        text += f"\n![{out.name}]({out.name}.png)\n"
    write_text(out.with_suffix(".md"), text)
    write_text(out.with_suffix(".json"), json.dumps(result, indent=1) + "\n")
