"""Warnings: on stderr, for what is on stdout may be read by a program."""

import sys


def warn(what: str, cure: str = "") -> None:
    """Print what may be wrong, and what mends it."""
    print(f"warning: {what}" + (f"\n  cure: {cure}" if cure else ""), file=sys.stderr)
