"""From a dataset to a trained and judged run."""
