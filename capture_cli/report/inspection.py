"""What `capture inspect` found, at the terminal: what it is, tables, and the findings with their cures."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from capture_cli.common.quantities import MISSING, bound, estimated, percent, significant, with_unit
from capture_cli.model.effects.placed import placed_name
from capture_cli.store.inspection import Inspection
from capture_cli.store.zarr_store import size

Rows = tuple[list[str], list[list[str]]]  # a head, and rows of as many cells
STYLES = {"error": "bold red", "warning": "yellow", "note": "dim"}
SEVERITIES = ("error", "warning", "note")


_KINDS = {
    "file": "file",
    "measured-log": "measured log",
    "estimate": "estimate",
    "diagnosis": "diagnosis",
    "identifier": "learned identifier",
    "policy": "trained policy",
    "evaluation": "evaluation",
    "proposal": "proposal",
    "unfinished": "unfinished run",
    "zarr": "Zarr store",
    "directory": "result of `capture`",
}


def render(seen: Inspection, console: Console) -> None:
    """Print an inspection; plain text where `console` is no terminal."""
    console.print(Text(seen.path, style="bold"), soft_wrap=True)
    console.print(Text(_headline(seen), style="dim"))
    for head, rows in _tables(seen):
        if rows:
            console.print()
            _print_table(console, head, rows)
    console.print()
    _print_findings(console, seen.findings, checked=seen.checked)


def complaints(seen: Inspection) -> list[str]:
    """The findings that results will suffer from, in the form of error messages: what, where, and the cure."""
    serious = sorted(seen.findings, key=lambda f: SEVERITIES.index(f["severity"]))
    return [
        f"{f['severity']}: {seen.path}: {f['where']}: {f['message']}\n  cure: {f['cure']}"
        for f in serious
        if f["severity"] != "note"
    ]


def _headline(seen: Inspection) -> str:
    store, provenance = seen.store, seen.provenance
    parts = [_KINDS[seen.kind]]
    if store["format"]:
        parts.append(f"{store['format']} version {store['version']}")
    if seen.task:
        parts.append(f"task {seen.task}")
    parts += [f"{n} {noun if n != 1 else noun.removesuffix('s')}" for noun, n in seen.sizes.items()]
    parts.append(size(store["bytes"]))
    if provenance and provenance.get("command"):
        made = f"made by `capture {provenance['command']}` {provenance.get('capture')}"
        parts.append(f"{made}, {provenance.get('began')}")
    return ", ".join(parts)


def _tables(seen: Inspection) -> Iterator[Rows]:
    """None where what was found is told in words."""
    if seen.kind == "measured-log":
        yield (
            ["recording", "episodes", "steps", "duration", "rate"],
            _recordings(seen.recordings, seen.channels),
        )
        yield ["channel", "range", "rms", "notes"], _channels(seen.channels)
    elif seen.kind == "zarr":
        arrays = seen.arrays
        yield (
            ["array", "shape", "type"],
            [[a["path"], " x ".join(map(str, a["shape"])), a["dtype"]] for a in arrays],
        )
    elif seen.result and seen.kind in _OF_RESULTS:
        yield from _OF_RESULTS[seen.kind](seen.result)


def _recordings(
    recordings: Sequence[Mapping[str, Any]], channels: Sequence[Mapping[str, Any]]
) -> list[list[str]]:
    unknown = "by channel" if any(c.get("sampling") for c in channels) else "?"
    return [
        [
            r["name"],
            str(r.get("episodes", "?")),
            str(r.get("steps", "?")),
            _number(r.get("duration"), 4, "s"),
            unknown if r.get("rate") is None else _number(r["rate"], 4, "Hz"),
        ]
        for r in recordings
    ]


def _channels(channels: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    rows = []
    for c in channels:
        low, high = (_number(c[side] and c[side]["value"]) for side in ("low", "high"))
        rows.append([c["name"], with_unit(f"{low} to {high}", c["unit"]), _number(c["rms"]), _movement(c)])
    return rows


def _movement(channel: Mapping[str, Any]) -> str:
    fine = 0.01  # of the change from sample to sample: steps below it are how many digits the file has
    if channel["kind"] == "output":
        said = ["output"]
        if channel.get("sampling"):
            said.append(
                f"{channel['sampling']['samples']} samples, {_number(channel['sampling']['rate'], 3, 'Hz')}"
            )
        step, change = channel["quantisation"]["step"], channel["quantisation"]["change"]
        if step is None or (change is not None and step < fine * change):
            return ", ".join(said)
        return ", ".join([*said, with_unit(f"steps of {bound(float(f'{step:.3g}'))}", channel["unit"])])
    moves = channel["excitation"]
    parts = ["input"]
    least_rest = 0.01  # share of the samples
    if moves["at_rest"] is not None and moves["at_rest"] >= least_rest:
        parts.append(f"at rest {percent(moves['at_rest'])}")
    if moves["frequency_95"] is not None:
        parts.append(
            f"half its power below {significant(moves['median_frequency'], 2)} Hz, "
            f"95 % below {significant(moves['frequency_95'], 2)} Hz"
        )
    return ", ".join(parts)


def _number(value: float | None, digits: int = 3, unit: str = "") -> str:
    return "?" if value is None else with_unit(significant(value, digits), unit)


def _print_table(console: Console, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1), header_style="dim", show_edge=False)
    for k, title in enumerate(head):
        last = k == len(head) - 1 and title == "notes"
        table.add_column(Text(title), justify="left" if k == 0 or last else "right", overflow="fold")
    # More rows would push the findings off the screen; --json has them all.
    most_rows = 12
    # one more is as short as its mention
    shown = rows if len(rows) == most_rows + 1 else rows[:most_rows]
    for row in shown:
        table.add_row(*(Text(cell, style="bold" if k == 0 else "") for k, cell in enumerate(row)))
    console.print(table)
    if len(rows) > len(shown):
        console.print(Text(f"and {len(rows) - len(shown)} more: --json has them all", style="dim"))


def _print_findings(console: Console, findings: Sequence[Mapping[str, str]], *, checked: bool) -> None:
    if not findings:
        nothing = Text("nothing wrong was found", style="bold green")
        console.print(nothing if checked else Text("what is in it was not checked", style="dim"))
        return
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    grid.add_column(overflow="fold")
    for f in sorted(findings, key=lambda f: SEVERITIES.index(f["severity"])):
        says = Text.assemble((f"{f['where']}: ", "bold"), f["message"])
        grid.add_row(Text(f["severity"], style=STYLES[f["severity"]]), says)
        grid.add_row("", Text(f["cure"], style="dim"))
    console.print(grid)


# --- tables of what other commands made: fits ---


def _fit(result: Mapping[str, Any]) -> Iterator[Rows]:
    yield ["parameter", "value", "sd"], [[name, *_value(p)] for name, p in result["parameters"].items()]
    yield ["effect", "parameter", "value", "sd"], [row for e in result["effects"] for row in _effect(e)]
    yield ["verdict"], [[result["verdict"]]]


def _effect(effect: Mapping[str, Any]) -> list[list[str]]:
    placed = placed_name(effect["name"], effect["site"])
    if not effect["parameters"]:
        return [[placed, MISSING, MISSING, MISSING]]
    return [[placed, name, *_value(p)] for name, p in effect["parameters"].items()]


def _value(parameter: Mapping[str, Any]) -> list[str]:
    sd, unit = parameter.get("sd"), parameter.get("unit", "")
    return [estimated(parameter), with_unit(significant(sd, 2), unit)]


# --- checkpoints ---


def _identifier(result: Mapping[str, Any]) -> Iterator[Rows]:
    learned, training, histories = result["result"], result.get("training", {}), result["histories"]
    read = result["architecture"]
    facts = [
        ["identifier", result["identifier"]],
        ["reads", f"{read['tokens']} tokens, a window of {read['window']} rounds"],
        ["learned from", f"{learned['pairs']['trained']} histories of {histories['rounds']} rounds"],
        ["their search, noise", f"{histories['search']}, {histories['noise']}"],
        [
            "training",
            f"step {learned.get('best_step')} of {learned.get('steps')}, asked {training.get('steps')}",
        ],
        ["held-out loss", significant(learned.get("validation_loss"), 4)],
    ]
    yield ["learned", ""], facts
    errors, covered = (learned.get(key) or {} for key in ("mean_absolute_error", "coverage"))
    yield (
        ["parameter", "bounds", "mean error / range", "95 % intervals cover"],
        [
            [
                p["name"],
                with_unit(f"{bound(p['low'])} to {bound(p['high'])}", p["unit"]),
                significant(errors.get(p["name"]), 2),
                _share(covered.get(p["name"])),
            ]
            for p in result["parameters"]
        ],
    )


def _policy(result: Mapping[str, Any]) -> Iterator[Rows]:
    judged, training = result.get("result", {}), result.get("training", {})
    rows = [(result["policy"], judged), ("random", judged.get("random", {}))]
    head = ["policy", "episodes of training", "success", "reward"]
    yield (
        head,
        [
            [
                name,
                str(training.get("steps", MISSING)) if of is judged else MISSING,
                _share(of.get("success")),
                significant(of.get("reward")),
            ]
            for name, of in rows
        ],
    )
    for kind in ("parameters", "actions"):
        bounds = zip(result[kind], result["bounds"][kind], strict=True)
        yield [kind.removesuffix("s"), "bounds"], [[n, f"{bound(a)} to {bound(b)}"] for n, (a, b) in bounds]


# --- evaluations and proposals ---


def _evaluation(result: Mapping[str, Any]) -> Iterator[Rows]:
    """How each identifier does after the last round."""
    head = ["identifier", "mean error / range", "trajectory difference", "success", "95 % intervals cover"]
    cells = []
    for label, e in result["identifiers"].items():
        error, difference = e["parameter_difference"]["mean"], e["trajectory_difference"]
        shares = (_share(values[-1] if values else None) for values in (e["success"], e.get("coverage")))
        cells.append([label, significant(error[-1], 2), significant(difference[-1]), *shares])
    yield head, cells


def _proposal(result: Mapping[str, Any]) -> Iterator[Rows]:
    facts = [["proposed", str(result.get("text", MISSING))]]
    if "duration_s" in result:
        facts.append(["duration", with_unit(significant(result["duration_s"]), "s")])
    if "band_hz" in result:
        facts.append(["band", with_unit(" to ".join(map(bound, result["band_hz"])), "Hz")])
    yield ["proposal", ""], facts
    yield ["input", "peak"], [[name, significant(peak)] for name, peak in result.get("peaks", {}).items()]
    action = result.get("action")
    values = action.items() if isinstance(action, dict) else ()
    yield (
        ["action", "value"],
        [[name, with_unit(significant(v["value"], 4), v["unit"])] for name, v in values],
    )
    expected = result.get("expected_sd", {})
    yield ["parameter", "sd then"], [[name, significant(sd, 2)] for name, sd in expected.items()]


def _unfinished(result: Mapping[str, Any]) -> Iterator[Rows]:
    last: Mapping[str, Any] = result.get("last_evaluation", {})
    told = {name: str(v) if isinstance(v, int) else significant(v, 4) for name, v in last.items()}
    yield ["last evaluation", ""], [[name.replace("_", " "), value] for name, value in told.items()]


def _share(share: float | None) -> str:
    return MISSING if share is None else percent(share, 1)


_OF_RESULTS: Mapping[str, Callable[[Mapping[str, Any]], Iterator[Rows]]] = {
    "estimate": _fit,
    "diagnosis": _fit,
    "identifier": _identifier,
    "policy": _policy,
    "evaluation": _evaluation,
    "proposal": _proposal,
    "unfinished": _unfinished,
}
