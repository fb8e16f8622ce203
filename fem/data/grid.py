"""Between the nodes of a mesh and the node grid of the networks."""


def on_grid(mesh, embedding, force, displacement):
    """Force and displacement (..., N, 3) at the nodes of `mesh` on its node grid, or that of its
    embedding: (..., nx, ny, nz, 3)."""
    if embedding is None:
        return mesh.to_grid(force), mesh.to_grid(displacement)
    to_grid = embedding.grid_mesh.to_grid
    return to_grid(embedding.force_to_grid(force)), to_grid(
        embedding.displacement_to_grid(displacement)
    )
