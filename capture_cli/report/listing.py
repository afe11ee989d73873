"""Tables of `capture tasks` and `capture effects`."""

from collections.abc import Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text


def print_tasks(tasks: Sequence[dict[str, Any]], console: Console) -> None:
    """One block per task."""
    if not tasks:
        console.print("There is no built-in task; name your own: capture tasks --task task.toml")
    for task in tasks:
        window = f", windows of {task['window']:g} s" if task["window"] else ""
        step = f" (model step {task['timestep']:g} s{window})"
        console.print(Text.assemble((task["name"], "bold"), step))
        table = _table("parameter", "unit", "low", "high", "nominal")
        for p in task["parameters"]:
            table.add_row(p["name"], p["unit"], *(f"{p[k]:g}" for k in ("low", "high", "nominal")))
        console.print(table)
        for kind in ("inputs", "outputs"):
            channels = ", ".join(f"{c['name']} [{c['unit']}] from column {c['column']}" for c in task[kind])
            console.print(f"{kind}: {channels or 'none'}")


def print_effects(listed: Sequence[dict[str, Any]], console: Console) -> None:
    """Under the place that they act on, each effect with what it is, its parameters and, of a task, its sites."""
    for place, effects in groupby(listed, key=itemgetter("place")):
        table = _table(Text(place, style="bold"), "")
        for effect in effects:
            table.add_row(effect["name"], effect["summary"])
            if details := _parameters_and_sites(effect):
                table.add_row("", Text(details, style="dim"))
        console.print(table)


def print_effect(effect: dict[str, Any], console: Console) -> None:
    """What an effect is, its law, where it sits, and what its parameters may be."""
    console.print(Text.assemble((effect["name"], "bold"), f" ({effect['place']}): {effect['summary']}\n"))
    for paragraph in effect["law"].split("\n\n"):
        console.print(f"{' '.join(paragraph.split())}\n")
    console.print(f"sits at: {effect['where']}")
    if "sites" in effect:
        console.print(f"here: {_sites(effect)}")
    console.print(f"exported as: {effect['exported_as']}")
    if effect["parameters"]:
        console.print("" if "sites" in effect else "\nRanges in an example machine; with --task, in yours:")
        table = _table("parameter", "unit", "low", "high", "null")
        for p in effect["parameters"]:
            null = "any (shape)" if p["shape"] else f"{p['null']:.4g}"
            table.add_row(p["name"], p["unit"], f"{p['low']:.4g}", f"{p['high']:.4g}", null)
        console.print(table)


def _parameters_and_sites(effect: dict[str, Any]) -> str:
    parameters = ", ".join(f"{p['name']} ({p['unit']})" for p in effect["parameters"])
    if "sites" not in effect:
        return parameters
    return f"{parameters} at {_sites(effect)}".strip() if effect["sites"] else _sites(effect)


def _sites(effect: dict[str, Any]) -> str:
    return ", ".join(s or "(whole model)" for s in effect["sites"]) or "nowhere in this model"


def _table(*columns: str | Text) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table
