"""The networks and regressions, each from force field to displacement field."""
