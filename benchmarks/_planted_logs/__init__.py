"""Logs with a known answer, made in memory: machines, effects of a size that shows so much, dresses (see `cases`)."""
