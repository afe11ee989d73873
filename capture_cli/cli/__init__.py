"""The command line: one command = one module: an options value in, one call of its stage, results out. No logic.

`program` runs it from its first line to its last and gives exit codes, `app` has all commands. Nothing heavy is
imported before a command is known.
"""

from capture_cli.cli.program import main

__all__ = ["main"]
