"""The command line of each stage: one file = one command. Options in, one stage call, results out; no logic."""
