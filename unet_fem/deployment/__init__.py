"""From a trained network to TFLite on a CPU."""
