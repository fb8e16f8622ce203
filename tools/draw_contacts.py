"""Draw the contacts of a scene's first training interactions from above.

python tools/draw_contacts.py configs/tumour.toml docs/contacts.png
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fem.commands import command_line
from fem.data.draws import drawn_contacts
from fem.data.scene import load_scene
from fem.files import replacing, vet_output
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import MM, MN

DRAWS = 8
COLOURS = "tab:blue", "tab:orange", "tab:green", "tab:red"
CIRCLE = np.exp(2j * np.pi * np.linspace(0, 1, 73))


@command_line
def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python tools/draw_contacts.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("scene", help="such as configs/tumour.toml")
    parser.add_argument("picture", type=Path, help="file to write, such as docs/contacts.png")
    options = parser.parse_args(arguments)
    vet_output(options.picture)
    scene = load_scene(options.scene)
    from matplotlib.figure import Figure  # no refusal has to wait for it

    from fem.contact.surface import surface_of

    mesh = scene.mesh.build()
    surface = surface_of(mesh)
    figure = Figure(figsize=(11, 6), dpi=100, layout="constrained")
    for number, axes in enumerate(figure.subplots(2, 4).flat, 1):
        _draw_surface(axes, mesh)
        for contact, colour in zip(
            drawn_contacts(scene, surface, "train", number, 0), COLOURS, strict=False
        ):
            _draw_contact(axes, contact, colour)
        axes.set_title(f"interaction {number}", size=9)
    figure.suptitle(
        "From above (mm): footprints at start (full) and end (dashed), paths, and arrows along the"
        " force's part in the plane; dots: held; shaded by height",
        size=9,
    )
    with replacing(options.picture) as partial:
        figure.savefig(partial, format="png")


def _draw_surface(axes, mesh: HexMesh) -> None:
    """Faces that can be pushed on, shaded by height, and the held nodes around them."""
    from matplotlib.collections import PolyCollection

    faces = mesh.contact_faces
    corners = MM * mesh.points[faces]
    height = corners[..., 2].mean(axis=1)
    low, span = height.min(), np.ptp(height) or 1.0
    shaded = PolyCollection(corners[..., :2], array=height, cmap="Greys", edgecolor="w", lw=0.3)
    shaded.set_clim(low - 0.5 * span, low + 4 * span)
    axes.add_collection(shaded)
    held = MM * mesh.points[mesh.contact_rim]
    axes.plot(held[:, 0], held[:, 1], ".", color="0.6", markersize=2)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)


def _draw_contact(axes, contact, colour: str) -> None:
    start, end = MM * contact.start[:2], MM * contact.end[:2]
    for centre, style in ((start, "-"), (end, "--")):
        circle = MM * contact.radius * CIRCLE
        axes.plot(centre[0] + circle.real, centre[1] + circle.imag, style, color=colour, lw=1)
    axes.plot(*np.transpose([start, end]), color=colour, lw=1)
    axes.plot(*start, "o", color=colour, markersize=3, label=f"{MN * contact.peak:.2f} mN")
    aside = 2 * contact.direction[:2]
    axes.annotate("", start + aside, start, arrowprops={"arrowstyle": "->", "color": colour})
    axes.legend(fontsize=6, loc="lower right", borderpad=0.3, handlelength=1)


if __name__ == "__main__":
    main()
