"""The planted-effect benchmark: a version of `capture diagnose` is asked about logs of `_planted_logs`, and judged."""
