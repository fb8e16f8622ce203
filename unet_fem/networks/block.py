"""The coarse block that the CNN-LSTM's two directions fill, and the units that fill it."""

import math

from fem.errors import InputError


def coarse_block(grid: tuple[int, int, int]) -> tuple[int, int, int]:
    """Cells (x, y, z) of the block for a grid of nodes (nx, ny, nz). Raises InputError for a grid
    smaller than (4, 4, 3)."""
    nx, ny, nz = grid
    block = (nx // 4, ny // 4, nz // 3)
    if 0 in block:
        raise InputError(
            f"grid {nx} x {ny} x {nz} is too small for the CNN-LSTM; give at least 4 x 4 x 3 nodes"
        )
    return block


def block_channels(units: int, block: tuple[int, int, int]) -> int:
    """Channels of the block that 2 * units LSTM outputs fill. Raises InputError where they do not
    come out even, and names the units that do."""
    cells = math.prod(block)
    if 2 * units % cells == 0:
        return 2 * units // cells
    multiple = cells // math.gcd(2, cells)
    below = units // multiple * multiple
    fitting = f"{below} or {below + multiple}" if below else f"{multiple}"
    size = " x ".join(map(str, block))
    raise InputError(
        f"2 * {units} LSTM outputs do not fill a block of {size} = {cells} cells;"
        f" use {fitting} units"
    )
