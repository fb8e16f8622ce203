"""Networks that learn the displacement of soft tissue from the forces on it."""
