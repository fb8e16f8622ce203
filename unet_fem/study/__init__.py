"""The study: error against run time, and every table and figure of the paper. `python
tools/report.py` runs it."""
