"""`python -m capture_cli` is the `capture` command."""

from capture_cli.cli import main

main()
