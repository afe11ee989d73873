"""A plug-in folder as a name -> class table.

One file is one plug-in: `effects/coulomb_friction.py` is the effect `coulomb-friction`, and its class is the one
subclass of the folder's base class that the file defines. Nothing is imported until it is asked for, and there is
no second list to keep.
"""

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Generic, TypeVar

from capture_cli.errors import OptionError, did_you_mean

T = TypeVar("T")


def with_first(names: Iterable[str], first: Sequence[str]) -> list[str]:
    """The names, those of `first` before others, in its order; others by the alphabet."""
    return sorted(names, key=lambda name: (first.index(name) if name in first else len(first), name))


class Registry(Generic[T]):
    """The plug-ins of `package` (say "capture_cli.model.effects"), each a subclass of `base` in a file of its own.

    Files named base.py or in `not_listed`, and files that begin with an underscore, are not plug-ins. besides: another
    registry, whose plug-ins are found here, too.
    """

    def __init__(
        self,
        package: str,
        base: str,
        kind: str,
        not_listed: tuple[str, ...] = (),
        besides: "Registry | None" = None,
    ):
        self.package = package
        self.base = base
        self.kind = kind
        self.not_listed = ("base", *not_listed)
        self.besides = besides
        self._classes: dict[str, type[T]] = {}

    def names(self) -> list[str]:
        """Public names, sorted; reads the folder, imports no plug-in."""
        return sorted([*self.own_names, *(self.besides.names() if self.besides is not None else ())])

    @cached_property
    def own_names(self) -> tuple[str, ...]:
        """Those of the package itself."""
        folder = Path(importlib.import_module(self.package).__file__).parent
        stems = (m.name for m in pkgutil.iter_modules([str(folder)]) if not m.name.startswith("_"))
        return tuple(sorted({s.replace("_", "-") for s in stems} - set(self.not_listed)))

    def get(self, name: str, offered: Callable[[type[T]], bool] | None = None) -> type[T]:
        """The class called `name`. Raises OptionError, naming those that exist.

        offered: which of them to name, where others are of no use.
        """
        if name not in self.names():
            names = self.names() if offered is None else [n for n, c in self.items() if offered(c)]
            raise OptionError(f"unknown {self.kind} {name!r}", cure=did_you_mean(name, names))
        if name not in self.own_names:
            return self.besides.get(name)
        if name not in self._classes:
            self._classes[name] = self._class(name)
        return self._classes[name]

    def _class(self, name: str) -> type[T]:
        module = importlib.import_module(f"{self.package}.{name.replace('-', '_')}")
        base = getattr(importlib.import_module(f"{self.package}.base"), self.base)
        own = [
            c
            for _, c in inspect.getmembers(module, inspect.isclass)
            if issubclass(c, base) and c.__module__ == module.__name__ and not inspect.isabstract(c)
        ]
        if len(own) != 1:
            raise TypeError(f"{module.__name__} must define one {self.base}, and defines {len(own)}")
        return own[0]

    def items(self) -> list[tuple[str, type[T]]]:
        """Every (name, class); imports them all."""
        return [(name, self.get(name)) for name in self.names()]
