"""The extras of an installation (pyproject.toml): what each brings, and who asks for one that is missing.

The core needs none of them. Nothing is imported here: whether a package is there is all that is asked.
"""

import sys
from dataclasses import dataclass
from importlib.util import find_spec

from capture_cli.errors import OptionError


@dataclass(frozen=True)
class Extra:
    """An extra. brings: its packages, by the names that they are imported by. last_python: that they work with."""

    brings: tuple[str, ...]
    last_python: tuple[int, int] | None = None


EXTRAS = {
    "learn": Extra(("torch", "stable_baselines3", "gymnasium")),
    # it pins numpy below 2, of which there is no wheel for a later Python
    "robosuite": Extra(("robosuite", "gymnasium"), last_python=(3, 12)),
    "ray": Extra(("ray",)),
}


def missing(name: str) -> list[str]:
    """Packages of the extra `name` that are not installed."""
    return [package for package in EXTRAS[name].brings if find_spec(package) is None]


def require(name: str, what: str) -> None:
    """Raise OptionError where `what` (a command, an option with its value) needs the extra `name` and it is missing."""
    packages, last = missing(name), EXTRAS[name].last_python
    if not packages:
        return
    found = f"{what} needs {' and '.join(packages).replace('_', '-')}: not installed here"
    if last is not None and sys.version_info[:2] > last:
        version, newest = (".".join(map(str, v)) for v in (sys.version_info[:2], last))
        raise OptionError(
            f"{found}, and not to be had for Python {version}",
            cure=f"with Python {newest} or older: pip install 'capture[{name}]'",
        )
    raise OptionError(found, cure=f"pip install 'capture[{name}]'")
