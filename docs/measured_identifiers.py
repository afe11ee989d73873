"""Every figure of docs/dev/evaluation.md, and the goals of docs/in-context.md: from the JSON in runs/evaluation.

A table says how many pairs it is of and which code made it. Rows that an evaluation took over from an earlier run are
of other code, and are left out. FOLDER+NAME holds a rival that met the same pairs: its row is in the table of FOLDER,
which says whose code it is.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.report import paper_numbers
from capture_cli.store.evaluation import Evaluation

RUNS = Path(__file__).resolve().parents[1] / "runs" / "evaluation"
HALVES = RUNS.parent / "closed-loop" / "halves.json"
LOOP = {"before": RUNS.parent / "closed-loop" / "declared", "after": RUNS.parent / "closed-loop" / "mended"}
ROUNDS = (1, 3, 5, 10, 30)
WORLD_ROUNDS = (1, 3, 5, 7, 9)  # the paper's, on real robots
BESIDE = (1, 5, 9)  # of them, where robots are side by side
OURS = "capture-refined"
YARDSTICK = "domain-randomization"
AT = 10  # rounds at most after which ratios and coverage are shown and pairs are compared
DOUBTFUL = 1e-3  # p of a sign test
NONE = ""  # of a cell

Rows = list[list[str]]


@dataclass(frozen=True)
class Measured:
    """An evaluation of runs/evaluation: its document without the rows of other code, and who made it. rivals: who made
    rows that are from elsewhere, by label.
    """

    folder: str
    document: Mapping[str, Any]
    provenance: Mapping[str, Any]
    rivals: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: str) -> Measured:
        document = Evaluation.read_document(RUNS / folder)
        made = json.loads((RUNS / folder / "provenance.json").read_text(encoding="utf-8"))
        # as they were called then
        labels = json.loads((RUNS / folder / "evaluation.json").read_text(encoding="utf-8"))["identifiers"]
        other = made.get("taken_over", {}).get("identifiers", [])
        called = zip(labels, document["identifiers"].items(), strict=True)
        rows = {label: e for then, (label, e) in called if then not in other}
        return cls(folder, {**document, "identifiers": rows}, made)

    @property
    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        return self.document["identifiers"]

    @property
    def rounds(self) -> list[int]:
        return [n for n in ROUNDS if n <= self.document["rounds"]]

    def with_rival(self, other: Measured) -> Measured:
        """With the rows of another evaluation that met the same pairs."""
        same = ("task", "effects", "world", "robot", "noise", "policy", "pairs", "seeds", "rounds")
        assert [self.document[key] for key in same] == [other.document[key] for key in same]
        new = {label: e for label, e in other.rows.items() if label not in self.rows}
        document = {**self.document, "identifiers": {**self.rows, **new}}
        return replace(
            self, document=document, rivals={**self.rivals, **dict.fromkeys(new, other.provenance)}
        )

    def about(self, trainings: int = 1) -> str:
        """Counts, and the code. trainings: how many, each in a folder of its own, are like this one."""
        d, code = self.document, self.provenance.get("code")
        seeds = f", {d['seeds']} draws" if d["seeds"] > 1 else ""
        noise = "" if d["noise"] == "none" else f", noise {d['noise']}"
        trained = {e["pairs_trained"] for e in self.rows.values() if e.get("pairs_trained")}
        histories = f", trained on {_either(sorted(trained))} histories" if trained else ""
        by = f"code {code[:8]}" if code else "the code was not noted"
        by += "".join(f", of {label} {made['code'][:8]}" for label, made in self.rivals.items())
        counts = f"{d['pairs']} pairs{seeds}, {d['rounds']} rounds{noise}{histories}"
        several = f" {trainings} trainings, ± their deviation." if trainings > 1 else ""
        return f"`{Path(self.folder).parts[0]}`: {counts}; {by}.{several}"


def air_hockey() -> str:
    """The part of that name."""
    return _sections("air-hockey", differences, "trajectory_difference")


def scooping() -> str:
    """The part of that name."""
    return _sections("scooping", successes, "success")


def _sections(task: str, table: Callable[..., str], told: str) -> str:
    """A section for each evaluation of the task, where there are several trainings of all (FOLDER/N), and one for its
    ablations (FOLDER/N/CELL), of which `told` is told.
    """
    evaluations: dict[str, list[Measured]] = {}
    cells = []
    measured = _measured(task)
    for m in (m for m in measured if "+" not in m.folder):
        folder, *within = Path(m.folder).parts
        for rival in (r for r in measured if _beside(r.folder) == m.folder):
            m = m.with_rival(rival)
        (cells if len(within) > 1 else evaluations.setdefault(folder, [])).append(m)
    sections = [_section(trainings, table) for _, trainings in sorted(evaluations.items())]
    return "\n\n".join([*sections, *([ablations(cells, told)] if cells else [])])


def _beside(folder: str) -> str | None:
    """FOLDER/N of FOLDER+NAME/N; None of others."""
    name, *within = Path(folder).parts
    base, is_rival, _ = name.partition("+")
    return str(Path(base, *within)) if is_rival else None


def worlds() -> str:
    """The part of that name: the paper's Tables III and IV, with robosuite's robots in place of real ones."""
    tables = {
        "air-hockey": (in_world_distances, in_world_gains),
        "scooping": (in_world_successes,),
    }
    texts = []
    for task, made in tables.items():
        found = _measured(task, in_world=True)
        texts += [_about_worlds(found), *(table(found) for table in made)] if found else []
    return "\n\n".join(text for text in texts if text)


def _measured(task: str, *, in_world: bool = False) -> list[Measured]:
    """Of the task and of those that are named like it, where the code was noted; in the plant, or in another world."""
    named = sorted(p.parent.relative_to(RUNS).as_posix() for p in RUNS.rglob("evaluation.json"))
    found = [Measured.read(name) for name in named]
    return [
        m
        for m in found
        if m.document["task"].startswith(task)
        and "code" in m.provenance
        and (m.document["robot"] is not None) == in_world
    ]


def _section(trainings: list[Measured], table: Callable[..., str]) -> str:
    made = [trainings[0].about(len(trainings)), table(*trainings), pairs(*trainings)]
    return "\n\n".join(text for text in made if text)


# --- tables ---


def differences(*trainings: Measured) -> str:
    """How far estimates are from the truth, what the intervals hold and what it cost; then the trajectory difference,
    and that over domain randomisation's, the paper's in brackets. Of several trainings their means.
    """
    m = trainings[0]
    if sum(e["simulated_rollouts"][1] > 1 for e in m.rows.values()) > 1:
        return budgets(*trainings)
    last, at, first, *others = m.document["rounds"], min(AT, m.document["rounds"]), *m.rounds
    compared = any(e["ratio"] for e in m.rows.values())
    header = [
        f"parameters at {first}",
        *map(str, others),
        f"cover at {at}",
        "rollouts",
        f"trajectory at {last}",
    ]
    header += [f"ratio at {at}"] * compared
    rows = []
    for label, e in m.rows.items():
        if label == YARDSTICK:
            continue  # the ratio says what the others are beside it
        of = [t.rows[label] for t in trainings]
        errors = [t["parameter_difference"]["mean"] for t in of]
        cover, ratio = _mean_of(of, "coverage"), _mean_of(of, "ratio")
        row = [
            label,
            *(_spread([error[n] for error in errors]) for n in m.rounds),
            f"{cover[at - 1]:.2f}" if cover is not None else NONE,
            f"{_mean_of(of, 'simulated_rollouts')[last]:.0f}",
            f"{_mean_of(of, 'trajectory_difference')[last]:.3g}",
            *([f"{_two(ratio[at])}{_of_paper(m, e, at)}" if ratio is not None else NONE] * compared),
        ]
        rows.append(row)
    return _table([NONE, *header], rows)


def _mean_of(entries: list[Mapping[str, Any]], key: str) -> np.ndarray | None:
    """By rounds, over trainings."""
    return np.mean([e[key] for e in entries], axis=0) if entries[0].get(key) else None


def ablations(cells: list[Measured], told: str) -> str:
    """The cells of suites, one suite for each training: a row for each value of what they vary, with mean and standard
    deviation over the trainings. told: a figure of the evaluation beside the parameter difference.
    """
    trainings, last = len({Path(m.folder).parent for m in cells}), min(m.document["rounds"] for m in cells)
    document = {**cells[0].document, "rounds": last}
    about = replace(cells[0], document=document).about(trainings)
    found: dict[str, list[Mapping[str, Any]]] = {}
    for m in cells:
        for label, e in m.rows.items():
            found.setdefault(label.partition("(")[2].rstrip(")"), []).append(e)
    figures = {"parameters": lambda e: e["parameter_difference"]["mean"], told: lambda e: e[told]}
    columns = [("parameters", AT), (told, last)]
    rows = [
        [value, *(_spread([figures[name](e)[n] for e in entries]) for name, n in columns)]
        for value, entries in found.items()
    ]
    header = [f"{name.partition('_')[0]} at {n}" for name, n in columns]
    return f"{about}\n\n{_table([NONE, *header], rows)}"


def budgets(m: Measured) -> str:
    """Parameter difference after each round with what was simulated until then, where several simulate by themselves:
    the budget curve.
    """
    rounds = range(1, m.document["rounds"] + 1)
    rows = [
        [
            label,
            *(
                f"{_two(e['parameter_difference']['mean'][n])} ({e['simulated_rollouts'][n]:.0f})"
                for n in rounds
            ),
        ]
        for label, e in m.rows.items()
    ]
    return _table(["parameter difference (rollouts so far)", *map(str, rounds)], rows)


def _of_paper(m: Measured, e: Mapping[str, Any], number: int) -> str:
    theirs = paper_numbers.trajectory_difference(m.document["task"], m.document["noise"], e)
    yardstick = paper_numbers.trajectory_difference("air-hockey", "none", {"identifier": YARDSTICK})
    return f" ({_two(theirs[number][0] / yardstick[number][0])})" if theirs and number in theirs else NONE


def successes(*trainings: Measured) -> str:
    """Success of all but domain randomisation, by rounds. Of several trainings their means."""
    m = trainings[0]
    rows = []
    for label in (label for label in m.rows if label != YARDSTICK):
        shares = [t.rows[label]["success"] for t in trainings]
        rows.append([label, *(_hundredth([share[n] for share in shares]) for n in m.rounds)])
    return _table(["success", *map(str, m.rounds)], rows)


def in_world_distances(found: list[Measured]) -> str:
    """Trajectory difference by rounds, of each robot and in the paper."""
    title = f"trajectory difference at {_said(BESIDE)}, cm"
    return _by_robot(title, found, lambda e: _shown(e["trajectory_difference"]), _paper_distances)


def in_world_gains(found: list[Measured]) -> str:
    """In the end over in the beginning, which all have in common; and success likewise."""
    title = "the last over that before round 1; success then and last, %"
    return _by_robot(title, found, _gain)


def _gain(e: Mapping[str, Any]) -> str:
    distances, successes = e["trajectory_difference"], e["success"]
    return f"{_two(distances[-1] / distances[0])}; {successes[0]:.0%}, {successes[-1]:.0%}".replace("%", "")


def _about_worlds(found: list[Measured]) -> str:
    """Counts and codes of what differs in the robot alone."""
    counts = {(m.document["pairs"], m.document["rounds"]) for m in found}
    codes = sorted({m.provenance["code"][:8] for m in found})
    said = " or ".join(f"{pairs} pairs, {rounds} rounds" for pairs, rounds in sorted(counts))
    return f"`runs/evaluation/{found[0].document['task']}-world-*`: {said}; code {', '.join(codes)}."


def in_world_successes(found: list[Measured]) -> str:
    """Success by rounds, of each robot and in the paper."""
    return _by_robot(
        f"success at {_said(BESIDE)}, %", found, lambda e: _shown(e["success"]), _paper_successes(found)
    )


Paper = Callable[[Mapping[str, Any]], Mapping[int, float] | None]


def _paper_distances(e: Mapping[str, Any]) -> dict[int, float] | None:
    theirs = paper_numbers.trajectory_difference("air-hockey", "none", e, "robosuite")
    return theirs and {number: mean for number, (mean, _) in theirs.items()}


def _paper_successes(found: list[Measured]) -> Paper:
    return lambda e: paper_numbers.success(found[0].document["task"], "none", e, "robosuite")


def _by_robot(
    title: str,
    found: list[Measured],
    cell: Callable[[Mapping[str, Any]], str],
    paper: Paper = lambda e: None,
) -> str:
    """A row for each identifier, a column for each robot, and one for the paper's figures, where there are some."""
    theirs = {label: paper(e) for m in found for label, e in m.rows.items()}
    if of_paper := paper({"identifier": "capture"}):
        theirs["capture"] = of_paper
    with_paper = any(theirs.values())
    rows = []
    for label, figures in theirs.items():
        cells = [cell(m.rows[label]) if label in m.rows else NONE for m in found]
        beside = [_hundredths(figures[n] for n in BESIDE) if figures else NONE]
        rows.append([label, *cells, *(beside if with_paper else [])])
    robots = [m.document["robot"] for m in found]
    return _table([title, *robots, *(["in the paper"] if with_paper else [])], rows)


def _shown(by_round: list[float]) -> str:
    return _hundredths(by_round[n] for n in BESIDE if n < len(by_round))


def _hundredths(values: Iterable[float]) -> str:
    return ", ".join(f"{100 * value:.0f}" for value in values)


def _said(rounds: tuple[int, ...]) -> str:
    return ", ".join(map(str, rounds))


def pairs(*trainings: Measured) -> str:
    """`capture-refined` against each other one, pair by pair, with the sign test, in words: of several trainings in
    that which is least in its favour.
    """
    m = trainings[0]
    n = max(n for n in m.rounds if n <= AT)
    said = []
    for label in (label for label, e in m.rows.items() if e.get("paired")):
        of = [t.rows[label]["paired"] for t in trainings]
        c = min(of, key=lambda c: c["nearer"][n] - c["further"][n])
        # where it is beyond doubt the tables above say enough
        if c["p"][n] >= DOUBTFUL:
            said.append(
                f"than {label} {c['nearer'][n]}/{c['as_near'][n]}/{c['further'][n]} (p {c['p'][n]:.2g})"
            )
    least = ", in the training least in its favour," if len(trainings) > 1 else ""
    return f"At {n}{least} `{OURS}` is nearer/as near/further {', '.join(said)}." if said else ""


# --- the closed loop, of docs/worlds.md ---


def closed_loop() -> str:
    """The part of that name: errors and successes by rounds, before the loop was closed and after; then intervals."""
    documents = {when: Evaluation.read_document(folder / "evaluation") for when, folder in LOOP.items()}
    rounds = [0, *(n for n in WORLD_ROUNDS if n <= min(d["rounds"] for d in documents.values()))]
    distances, successes = [], []
    for when, document in documents.items():
        (e,) = document["identifiers"].values()
        pairs = document["pairs"] * document["seeds"]
        distances.append(
            [
                f"trajectory difference {when}, cm",
                *(f"{100 * e['trajectory_difference'][n]:.1f}" for n in rounds),
            ]
        )
        successes.append(
            [f"successes of {pairs} {when}", *(f"{pairs * e['success'][n]:.0f}" for n in rounds)]
        )
    table = _table(["measured strokes", *map(str, rounds)], distances + successes)
    return f"{table}\n\n{_halves()} {_loop_errors()}"


def _halves() -> str:
    """What policy and identifier each gained, in words."""
    halves = json.loads(HALVES.read_text(encoding="utf-8"))
    succeeded = {
        policy: {name: sum(of) for name, of in by.items()} for policy, by in halves["success"].items()
    }
    policy, identifier = succeeded["mended"]["declared"], succeeded["declared"]["mended"]
    return (
        f"After {halves['rounds']} strokes the policy before wins {identifier} with the estimates after, the policy "
        f"after {policy} with those before."
    )


def _loop_errors() -> str:
    """What the intervals claim after the loop, beside what estimates are off by: over parameters, in words."""
    found = Evaluation.read(LOOP["after"] / "evaluation")
    last, target = found.document["rounds"], found.arrays["target"]
    span = np.array([p["high"] - p["low"] for p in found.attributes["parameters"]])
    estimates, sd = (found.arrays[name][0, :, :, last].reshape(-1, len(span)) for name in ("estimates", "sd"))
    off = (estimates - target.reshape(estimates.shape)) / span
    claimed, among, mean = np.median(sd / span, axis=0), off.std(axis=0, ddof=1), np.abs(off.mean(axis=0))
    return (
        f"Intervals then claim standard deviations of {_between(claimed)} of the ranges; errors differ by "
        f"{_between(among)} among tables, and their mean over all tables is {_between(mean)}."
    )


def _between(shares: np.ndarray) -> str:
    return f"{_two(100 * shares.min())} to {_two(100 * shares.max())} %"


# --- the goals of docs/in-context.md ---


def goals() -> str:
    """The part of that name: what was aimed at, beside the paper and what was measured."""
    folders = ("air-hockey", "scooping", "scooping-noise", "scooping-known-noise")
    hockey, lift, noisy, known = (Measured.read(folder).rows for folder in folders)
    theirs, paper_lift = (
        Measured.read(f"{task}-paper").rows["capture"] for task in ("air-hockey", "scooping")
    )
    mine, refined = "capture-trajectory", OURS
    rows = [
        [
            "air hockey, ratio of trajectories at 10: `capture`",
            NONE,
            "0.52",
            _two(theirs["ratio"][10]),
        ],
        [f"`{mine}`", "0.3", NONE, _two(hockey[mine]["ratio"][10])],
        [f"`{refined}`", "0.1", NONE, _two(hockey[refined]["ratio"][10])],
        ["parameter difference at 7: `capture`", NONE, "0.2", _mean(theirs, 7)],
        [f"`{mine}`", "0.05", NONE, _mean(hockey[mine], 7)],
        [f"`{refined}`", "0.01", NONE, _mean(hockey[refined], 7)],
        ["scooping, success from 5 on: `capture`", NONE, "0.8 to 0.9", _lowest(paper_lift, 5)],
        [f"`{mine}`", NONE, NONE, _lowest(lift[mine], 5)],
        [f"`{refined}`", "0.95", NONE, _lowest(lift[refined], 5)],
        [
            f"the same under label noise: `{refined}`",
            "0.85",
            NONE,
            ", ".join(f"{_lowest(noisy[refined], n)} from round {n}" for n in (5, 8, 10)),
        ],
        ["told which labels are random", "0.85", NONE, _lowest(known[refined], 5)],
        [
            f"`{refined}`, 95 % intervals hold, from 5 on",
            "0.92 to 0.98",
            NONE,
            f"air hockey {_held(hockey[refined], 5)}, scooping {_held(lift[refined], 5)}",
        ],
    ]
    return _table(["what", "goal", "paper", "measured"], rows)


def _mean(e: Mapping[str, Any], number: int) -> str:
    return _two(e["parameter_difference"]["mean"][number])


def _lowest(e: Mapping[str, Any], first: int) -> str:
    return f"{min(e['success'][first:]):.2f}"


def _held(e: Mapping[str, Any], first: int) -> str:
    held = e["coverage"][first - 1 :]
    return f"{min(held):.2f} to {max(held):.2f}"


# --- cells ---


def _two(value: float) -> str:
    """Two digits, never with an exponent."""
    text = f"{value:.2g}"
    return f"{value:.5f}".rstrip("0").rstrip(".") if "e" in text else text


def _spread(values: list[float]) -> str:
    """The mean, of several ± their standard deviation."""
    about = f" ± {_two(float(f'{np.std(values, ddof=1):.1g}'))}" if len(values) > 1 else ""
    return f"{_two(np.mean(values))}{about}"


def _hundredth(shares: list[float]) -> str:
    """The mean share to the hundredth, of several ± their standard deviation."""
    about = f" ± {_two(round(np.std(shares, ddof=1), 2))}" if len(shares) > 1 else ""
    return f"{np.mean(shares):.2f}{about}"


def _either(values: list[int]) -> str:
    return " or ".join(f"{v:,}" for v in values)


def _table(header: list[str], rows: Rows) -> str:
    lines = [f"| {' | '.join(cells)} |" for cells in [header, *rows]]
    return "\n".join([lines[0], f"|---|{'-:|' * (len(header) - 1)}", *lines[1:]])
