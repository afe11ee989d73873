"""How an input acts between rows, as a task file says it: `interpolate` and `late`."""

from collections.abc import Mapping
from typing import Any

from capture_cli.common.frozen import frozen
from capture_cli.errors import TaskError
from capture_cli.log.input_sequences import EVENLY, HELD, Hold


@frozen
class SETTINGS:
    # Of more commands from row to row an input changes evenly; a later one is a delay of the machine.
    most_commands: int = 100
    latest: float = 1.0  # s


NAMES = {"hold": HELD.commands, "linear": EVENLY.commands}


def hold_of(entry: Mapping[str, Any], where: str) -> Hold | None:
    """What the table of an input says; None where it says nothing. Raises TaskError for what is none."""
    interpolate, late = entry.get("interpolate"), entry.get("late", 0.0)
    if interpolate is None and "late" not in entry:
        return None
    if type(late) not in (int, float) or not abs(late) <= SETTINGS.latest:
        raise TaskError(
            f"{where}: late = {late!r}",
            cure=f"give seconds from {-SETTINGS.latest:g} to {SETTINGS.latest:g}: negative where the input acts before "
            "its row",
        )
    if isinstance(interpolate, str) and interpolate in NAMES:
        return Hold(NAMES[interpolate], float(late))
    if type(interpolate) is int and 2 <= interpolate <= SETTINGS.most_commands:
        return Hold(float(interpolate), float(late))
    found = "late without interpolate" if interpolate is None else f"interpolate = {interpolate!r}"
    raise TaskError(
        f"{where}: {found}",
        cure=f'write interpolate = "hold", "linear", or a whole number n from 2 to {SETTINGS.most_commands} where the '
        "log has every n-th command; or leave both out to let the log tell",
    )


def keys_of(hold: Hold) -> dict[str, str | int | float]:
    """What a task file says of an input that acts so."""
    names = {commands: name for name, commands in NAMES.items()}
    interpolate = names.get(hold.commands) or int(hold.commands)
    return {"interpolate": interpolate, **({"late": float(f"{hold.late:.6g}")} if hold.late else {})}
