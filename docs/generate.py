"""Writes the pages, and parts of pages, that are made from the code: `make docs`. A test compares them with it."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import pkgutil
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from datetime import datetime
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple, get_args, get_origin, get_type_hints

from typer.models import ArgumentInfo, OptionInfo

from capture_cli.store.schema import Schema
from docs import effects_page, measured_identifiers

ROOT = Path(__file__).resolve().parents[1]
NOT_KEPT = (
    ".git",
    ".venv*",
    ".hypothesis",
    ".pytest_cache",
    ".ruff_cache",
    "__pycache__",
    "build",
    "site",
    "*.egg-info",
)

BAR = "\\|"  # in a table
COMMON = 5  # commands: an option that so many have is described once
_OPTIONS = ("| option | what it is | default |", "|---|---|---|")
PAIRS = 10_000  # what `python -m benchmarks` takes where no --pairs is given
# Captions for the tree of README.md, of what has no docstring.
CAPTIONS = {
    "CHANGELOG.md": "what changed, by version",
    "LICENSE": "MIT",
    "Makefile": "every task of a developer; each sets up what it needs",
    "README.md": "this page",
    "SECURITY.md": "what a file from a stranger can and cannot do, how that is tested, how to report",
    "mkdocs.yml": "the site of these pages, which `make site` builds",
    "pyproject.toml": "the package, its dependencies, the settings of pytest and ruff",
    "constraints": "the exact versions that are installed",
    "datasets": "two logs with an effect that their models lack, and how they were made",
    "capture_cli": "the package, a room a folder",
    "docs": "these pages, and what writes those that come from the code (generate.py)",
    "docs/dev": "for developers: architecture, findings, benchmarks, evaluation",
    "docs/examples": "task files of machines that were measured by others",
    "runs": "what is shipped ready-made, with provenance: policies, identifiers, results of the benchmarks",
    "tests": "one file for each thing that is tested",
}


def main() -> None:
    """Write every page, and every part of a page."""
    for path, make in PAGES.items():
        (ROOT / path).write_text(make(), encoding="utf-8")
    for path, parts in PARTS.items():
        page = ROOT / path
        page.write_text(with_parts(page.read_text(encoding="utf-8"), parts), encoding="utf-8")


def with_parts(page: str, parts: dict[str, Callable[[], str]]) -> str:
    """`page` with the text between `<!-- NAME begins -->` and `<!-- NAME ends -->` made anew."""
    for name, make in parts.items():
        begin, end = f"<!-- {name} begins: written by `make docs` -->", f"<!-- {name} ends -->"
        if page.count(begin) != 1 or page.count(end) != 1:
            raise ValueError(f"the page must hold {begin} and {end} once each")
        before, rest = page.split(begin)
        page = f"{before}{begin}\n{make()}\n{end}{rest.split(end)[1]}"
    return page


# --- commands.md ---


def commands() -> str:
    """Every command with its options, from the classes of their options; those of many commands once."""
    from capture_cli.cli.app import app

    callbacks = {command.name: command.callback for command in app.registered_commands}
    options = {name: _options(callback) for name, callback in callbacks.items()}
    often = Counter(row for rows in options.values() for row in rows)
    common = [row for row, count in often.items() if count >= COMMON]
    lines = [_COMMANDS.strip(), "", *_OPTIONS, *common, ""]
    for name, callback in callbacks.items():
        lines += _command(name, callback, options[name], common)
    return "\n".join(lines)


def _command(name: str, callback: Callable, options: list[str], common: list[str]) -> list[str]:
    summary, _, example = inspect.getdoc(callback).partition("Example:")
    lines = [f"## capture {name}", "", " ".join(summary.split()), ""]
    if example:
        lines += ["```sh", " ".join(example.split()), "```", ""]
    own = [row for row in options if row not in common]
    if own:
        lines += [*_OPTIONS, *own, ""]
    shared = " ".join(row.split("`")[1].split()[0] for row in options if row in common)
    return [*lines, f"Common: `{shared}`", ""]


def _options(callback: Callable) -> list[str]:
    """A row for each option of a command."""
    kinds = get_type_hints(callback, include_extras=True)
    parameters = inspect.signature(callback).parameters.values()
    return [_option(*get_args(kinds[parameter.name]), parameter) for parameter in parameters]


def _option(kind, option, parameter: inspect.Parameter) -> str:
    several = get_origin(kind) is list
    if isinstance(option, ArgumentInfo):
        form = parameter.name.upper() + ("..." if several else "")
    else:
        # inside Annotated, typer.Option takes its first name for a default, and corrects that when it runs
        form = " ".join([str(option.default), *_value(kind)])
    text = option.help.removesuffix(".").replace("|", BAR)
    often = "; repeatable" if several and isinstance(option, OptionInfo) else ""
    return f"| `{form}` | {text}{often} | {_default(parameter.default)} |"


def _value(kind) -> list[str]:
    """What follows the option on the command line: nothing for a flag."""
    inner = [k for k in get_args(kind) if k is not type(None)]
    if get_origin(kind) is tuple:
        return [_value(k)[0] for k in inner]
    if inner:
        return _value(inner[0])
    return {bool: [], int: ["N"], float: ["NUMBER"], Path: ["PATH"]}.get(kind, ["TEXT"])


def _default(default: object) -> str:
    if default is inspect.Parameter.empty:
        return "required"
    if default is None or default is False or default == []:
        return ""
    return f"`{' '.join(map(str, default)) if isinstance(default, tuple) else default}`"


# --- schemas.md ---


def schemas() -> str:
    """Every store's arrays and attributes, and every key of the JSON documents."""
    from capture_cli import log, store

    lines = [_SCHEMAS.strip(), ""]
    found = [(m.name, package) for package in (log, store) for m in pkgutil.iter_modules(package.__path__)]
    for name, package in sorted(found, key=lambda f: f[0]):
        module = importlib.import_module(f"{package.__name__}.{name}")
        for schema in (v for v in vars(module).values() if isinstance(v, Schema)):
            lines += [*_schema(schema), "", f"Of another version: {schema.cure_for_other_version}.", ""]
    lines += ["## JSON documents", "", _JSON.strip(), ""]
    for name, (text, keys) in {**DOCUMENTS, **PARTS_OF_DOCUMENTS}.items():
        lines += [f"### {name}", "", text, "", "| key | meaning |", "|---|---|"]
        lines += [f"| {_alternatives(key)} | {_meaning(meaning)} |" for key, meaning in keys.items()]
        lines.append("")
    return "\n".join([*lines, *_limits()])


def _schema(schema: Schema) -> list[str]:
    lines = [f"### {schema.format}, version {schema.version}", ""]
    lines += ["| array | axes | type, unit | meaning |", "|---|---|---|---|"]
    for a in schema.arrays:
        optional = " (optional)" if a.optional else ""
        unit = "" if a.unit == "-" or a.unit.startswith("per ") else f", {a.unit}"
        lines.append(f"| `{a.path}`{optional} | {', '.join(a.dims)} | {a.dtype}{unit} | {a.meaning} |")
    lines += ["", "| attribute | meaning |", "|---|---|"]
    return [*lines, *(f"| `{name}` | {meaning} |" for name, meaning in schema.attributes.items())]


def _limits() -> list[str]:
    """What is refused of files, whoever wrote them."""
    from capture_cli.common import documents
    from capture_cli.log.readers.csv import SETTINGS as CSV
    from capture_cli.store import array_metadata, zarr_store

    of_text, of_stores = documents.SETTINGS, zarr_store.SETTINGS
    known = array_metadata.CODECS
    codecs = (f"version {n}: {', '.join(f'`{name}`' for name in known[n])}" for n in (3, 2))
    rows = {
        "a TOML file": f"at most {of_text.largest_toml // 1024} kB",
        "a JSON document, also the metadata of a store and the header of safetensors": f"at most "
        f"{of_text.largest_json >> 20} MB and {of_text.most_parts} lists and objects",
        "either": f"UTF-8; {of_text.deepest} levels; whole numbers of 64 bits; finite numbers; texts without control "
        "characters but tabs and line breaks",
        "arrays of a store": "numbers: boolean, whole, floating point; no objects, texts or structures",
        "their codecs": "; ".join(codecs),
        "their files": f"at most {of_stores.most_chunks} of an array, none larger than its numbers can be packed to",
        "memory of a store's arrays, or of a Parquet file": f"at most {zarr_store.size(of_stores.most_of_few)}, or "
        f"{of_stores.most_times} times what it takes on disk; of a log, what `--max-log-size` says",
        "a CSV or Parquet file": f"at most {zarr_store.size(of_stores.most)}, also in memory; or what "
        "`--max-log-size` says",
        "a line of a CSV file": f"fewer than {CSV.longest_line} characters",
        "names of files that are given": "UTF-8",
    }
    lines = [_LIMITS.strip(), "", "| of | what is read |", "|---|---|"]
    return [*lines, *(f"| {of} | {what} |" for of, what in rows.items()), ""]


def _alternatives(key: str) -> str:
    return ", ".join(f"`{k}`" for k in key.split(", "))


def _meaning(meaning: str | Part) -> str:
    if isinstance(meaning, str):
        return meaning
    return f"[{meaning.name}](#{meaning.name})" + (f": {meaning.note}" if meaning.note else "")


def documented(name: str) -> set[str]:
    """Every key of a document of DOCUMENTS, those of its parts too."""
    return _spelled_out(DOCUMENTS[name][1])


def _spelled_out(keys: Mapping[str, str | Part]) -> set[str]:
    found = set()
    for several, meaning in keys.items():
        for key in several.split(", "):
            inside = _spelled_out(PARTS_OF_DOCUMENTS[meaning.name][1]) if isinstance(meaning, Part) else ()
            found |= {f"{key}.{k}" for k in inside} or {key}
    return found


def keys_of(document: object, names: dict[str, str], path: str = "") -> set[str]:
    """The keys of a JSON document, as DOCUMENTS writes them. names: the name for the keys of a table, by its path."""
    if isinstance(document, list):
        inner = [keys_of(item, names, f"{path}[]") for item in document]
        return set().union(*inner) if any(inner) else {path}
    if not isinstance(document, dict) or not document:
        return {path}
    found = set()
    for key, value in document.items():
        shown = names.get(path, key)
        found |= keys_of(value, names, f"{path}.{shown}" if path else shown)
    return found


NAMES = {  # tables whose keys are names that the user chose
    "parameters": "NAME",
    "noise_floor": "OUTPUT",
    "noise_floor_source": "OUTPUT",
    "error.fit.rmse": "OUTPUT",
    "error.fit.mae": "OUTPUT",
    "error.test.rmse": "OUTPUT",
    "error.test.mae": "OUTPUT",
    "rounds[].parameters": "NAME",
    "effects": "EFFECT@SITE.PARAMETER",
    "noise_sd": "OUTPUT",
    "architecture": "NAME",
    "training": "NAME",
    "histories": "ATTRIBUTE",
    "result.mean_absolute_error": "NAME",
    "result.coverage": "NAME",
    "identifiers": "LABEL",
    "identifiers.LABEL.parameter_difference": "NAME",
    "inputs": "INPUT",
    "log.input_peaks": "INPUT",
    "packages": "PACKAGE",
    "options": "OPTION",
    "absorbed": "NAME",
    "effects[].parameters": "NAME",
    **{
        f"prediction.{part}.{name}": shown
        for part in ("fit", "test")
        for name, shown in (
            ("recordings", "RECORDING"),
            *(
                (f"{rows}.models{of}", shown)
                for rows in ("horizons[]", "recordings.RECORDING")
                for of, shown in (("", "MODEL"), (".MODEL.rmse", "OUTPUT"), (".MODEL.over_floor", "OUTPUT"))
            ),
        )
    },
    **{
        f"{stage}.{kind}": "OUTPUT"
        for stage in ("stages[].fit", "stages[].select", "stages[].test", "before.test", "after.test")
        for kind in ("rmse", "mae")
    },
    **{
        f"{fit}.{kind}": "OUTPUT"
        for fit in ("lack_of_fit", "lack_of_fit.before", "lack_of_fit.after")
        for kind in ("outputs", "output_thresholds")
    },
}


class Part(NamedTuple):
    """A part that several documents have, by its name in PARTS_OF_DOCUMENTS. note: which one it is here."""

    name: str
    note: str = ""


_FLOORS = "declared, repeats, differences, residual, outliers or resolution ([method](method.md#noise-floor))"
_LOG = {
    "log.path, log.sha256": "the log, as it was named, and the hash of its files",
}
_NOISE_FLOOR = {
    "noise_floor.OUTPUT": "standard deviation of the output's noise",
    "noise_floor_source.OUTPUT": _FLOORS,
}
_ROLLOUTS = {
    "rollouts.measured, rollouts.simulated": "episodes of the log, and windows simulated in all",
}
_NOTES = {
    "undetermined": "list of what the log leaves open, whatever the verdict: {combination (change of each parameter "
    "in its range, over the first's), sd_over_range, known (nothing, of one parameter; ratios, product or "
    "combination, of several), scaled (names of those that are known but for a factor), factor (null, or [from, to] "
    "of it; of a product the second by its inverse), ends (null, or two values of each parameter: all first ones are "
    "as good as all second ones), text}",
    "held_out": "null, or {parameters, error, text} of a fit to the whole log, where held-out data shows what the "
    "fit leaves open",
    "beyond_fitted": "null, or how held-out data differs where the model fails there: {output, unit, fitted [low, "
    "high], reached, share (of the squared error, that of windows beyond the fitted range), text}",
    "impossible_inertia": "bodies whose estimated inertia no body has: {body, moments (kg m^2), text}",
    "time_step": "null, or the model's time step in the estimate: {finer (s), parameters and error (about what they "
    "would be at such steps; error null: no less), text}",
    "time_stamps": "null, or the time-stamp jitter: {outputs (of each sd (s) and share (of its "
    "noise's variance)), explained (share of what is beyond chance; 1: all; null: nothing is beyond), text}",
    "input_timing": "null, or how inputs act between rows where the task does not say: {inputs (of each interpolate, "
    "hold, linear or n; late, s; gain in predictive log likelihood and error, its sd, or null), text}",
}
_DOCUMENT = {"version, task": "1, and the name of the task"}
PARTS_OF_DOCUMENTS: dict[str, tuple[str, dict[str, str | Part]]] = {
    "evaluated": (
        "One identifier in evaluation.json. Lists are by round.",
        {
            "identifier": "its name",
            "checkpoint, sha256": "null, or the name of the directory it was read from, and its hash",
            "search, history_rounds, history_noise": "of the histories it was trained on; L in the paper",
            "pairs_trained": "how many of them",
            "window, tokens": "rounds that it reads (k in the paper); token per trajectory or per step",
            "parameter_difference.NAME[]": "mean of \\|estimate - truth\\| over the range; also `mean` and `median`, "
            "over all parameters",
            "trajectory_difference[], trajectory_difference_sd[]": "sum over the points of the distance, mean of "
            "pairs and seeds; standard deviation of the seeds' means",
            "ratio[]": "of the trajectory difference to that of the yardstick; or null",
            "success[], success_sd[]": "share of the actions chosen for the estimate that succeed; standard "
            "deviation of the seeds' means; or null",
            "coverage": "share of the truths in the 95 % intervals, from the first round; or null",
            "simulated_rollouts[]": "mean over the pairs, summed up to the round",
            "paired": "null, or against this one, by round: `nearer`, `as_near` (within 0.001 of the range) and "
            "`further`, pairs in which capture-refined is so; `gained`, `gained_se`, by how much; `p` of the sign "
            "test",
        },
    ),
    "parameter": (
        "An estimate of one parameter.",
        {
            "value": "the estimate, in `unit`",
            "unit": "its unit",
            "low, high": "bounds",
            "sd": "standard deviation of the estimate",
            "ci95[]": "95 % interval, cut to the bounds",
            "at_bound": "whether the estimate is within 1e-4 of the range, and within 3 `sd`, of a bound",
            "identifiable": "whether the log determines it",
            "limits": "null, or what the log excludes although it does not determine it: {at_least, at_most}, null "
            "on an open side",
        },
    ),
    "error": (
        "Measured minus simulated, over windows.",
        {
            "rmse.OUTPUT": "root mean square, in the output's unit; null: it has no sample there",
            "mae.OUTPUT": "mean of the absolute value, likewise",
            "normalized": "RMSE over the noise floor, root mean square over all samples (1: only noise is left)",
        },
    ),
    "lack": (
        "Whether an error is beyond chance.",
        {
            "normalized": "error of the fit over the noise floor, degrees of freedom allowed for",
            "threshold": "what chance allows",
            "autocorrelation_time": "of the residual, in samples",
            "outputs.OUTPUT, output_thresholds.OUTPUT": "the same of one output, and what chance allows",
            "lacking": "whether all outputs together or one of them are beyond",
        },
    ),
    "horizons": (
        "Open-loop error of one part of the log.",
        {
            "horizons[].horizon": "s that each run predicts; null: whole episodes",
            "horizons[]": Part("runs"),
            "left_out": "list of sentences: which horizons are left out, and why",
            "recordings.RECORDING": Part("runs", "whole episodes of one recording"),
        },
    ),
    "runs": (
        "Open-loop simulations. MODEL: nominal (as declared), identified, or diagnosed (with the effects).",
        {
            "runs": "how many, from as many initial states",
            "longest": "s, that the longest takes",
            "models.MODEL.rmse.OUTPUT": "root mean square of measured minus simulated, in the output's unit; null: "
            "no sample, or a run diverged",
            "models.MODEL.over_floor.OUTPUT": "that over the noise floor; null likewise",
            "models.MODEL.normalized": "RMSE over the noise floor, root mean square over all samples; null: a run "
            "diverged",
            "models.MODEL.diverged": "how many runs diverged",
        },
    ),
}
DOCUMENTS: dict[str, tuple[str, dict[str, str | Part]]] = {
    "estimate.json": (
        "What `capture identify` found; also what its `--json` prints.",
        {
            "format": '"capture/estimate"',
            "version, task": "2 (of 1 `effects` is read as empty), and the name of the task",
            **_LOG,
            "log.input_peaks.INPUT": "how far from 0 each input went, in its unit: `capture propose` drives no further",
            "identifier": "who searched: least-squares, cma-es, or the learned one that proposed",
            "effects": "list of what the fitted model has beside the task's, as a learned identifier's histories had: "
            "{name, site, parameters: {NAME: {value, unit, low, high}}}",
            "parameters.NAME": Part("parameter"),
            "error.fit": Part("error", "windows that were fitted"),
            "error.test": Part("error", "windows held out"),
            "prediction.fit": Part("horizons", "what was fitted"),
            "prediction.test": Part("horizons", "what was held out; null: nothing was"),
            **_NOISE_FLOOR,
            "verdict": "explained, unexplained or not-identifiable",
            "summary": "the verdict in one sentence",
            "diverged_windows": "in how many windows the simulation diverges at the estimate",
            "lack_of_fit": Part("lack"),
            **_NOTES,
            "unmeasured_joints": "list of joints whose position at the start of a window nothing says",
            "open_loops": "{equality constraint: by how much it stays open, m or rad, where joints are as measured}",
            "correlation[][]": "of the estimates, (parameter, parameter)",
            "recordings": "null, or how the recordings agree: {names, agree, parameters, text}",
            "split.how": "how windows were divided into fit and test, in words",
            "split.fit_windows, split.test_windows": "how many were fitted, and held out",
            **_ROLLOUTS,
            "rounds[].parameters.NAME": "estimate after each round over the episodes, then best point of the fit",
            "rounds[].error": "its error over the noise floor",
            "misread": "null, or channels whose sign, unit or column leaves what no physics would: {readings (any of "
            "which would do: {kind, channels, factor, columns (to read them from; null: their own)}), before, after "
            "(share of the motion that a fit leaves), text}",
            "cut_short": "null, or after how many rounds the search was stopped before it came to rest",
            "in_context": "null, or the rounds of a learned identifier: {checkpoint, sha256, rounds, episodes, "
            "proposal, proposal_sd, share_beyond (of the training histories that lie as far out), in_family, "
            "contradicted (by the fit), fallback (to freed initial states), text}",
            "next_command": "the command to run next, with ESTIMATE for this folder; null: none, as where only "
            "held-out data is not explained, or a channel is `misread`",
        },
    ),
    "diagnosis.json": (
        "What `capture diagnose` found; also what its `--json` prints.",
        {
            "format": '"capture/diagnosis"',
            **_DOCUMENT,
            **_LOG,
            "log.first_time": "s, its first time, since which expressions count theirs",
            "verdict": "explained, effect-found, tied or unexplained",
            "summary": "the verdict in one sentence",
            "effects[].name": "an effect that the model lacks, in the order of acceptance",
            "effects[].site": 'where it sits; "": the model as a whole',
            "effects[].summary": "what it is",
            "effects[].law": "what its parameters do",
            "effects[].parameters.NAME": Part("parameter"),
            "effects[].states": "list of what it keeps that no sensor shows, as `window/start_hidden` has it",
            "effects[].first_time": "s, by the log's clock, since which it counts its time",
            "effects[].p_value": "that null fits the log as well, times the candidates and nonlinear values tried",
            "effects[].p_select": "that other data is not explained better; one-sided, paired; null if nothing judges",
            "effects[].tied_with": "list of EFFECT@SITE that this log cannot tell from it",
            "parameters.NAME": Part("parameter", "with the effects in"),
            "stages[].model": '"declared", then "+ EFFECT@SITE" for each effect',
            "stages[].refitted": "whether to all that is not held out; between the first and the last none is",
            "stages[].fit": Part("error", "windows that were fitted"),
            "stages[].select": Part(
                "error", "windows that chose, by fits that did not see them; null: none did"
            ),
            "stages[].test": Part("error", "windows held out; null: none were"),
            "before.test": Part("error", "the declared model, refitted, held out"),
            "after.test": Part("error", "with the effects, held out"),
            "prediction.fit": Part("horizons", "what was fitted"),
            "prediction.test": Part("horizons", "what was held out; null: nothing was"),
            **_NOISE_FLOOR,
            "lack_of_fit.before": Part("lack", "declared model"),
            "lack_of_fit.after": Part("lack", "with the effects"),
            ", ".join(_NOTES): "as in estimate.json",
            "out_of_time": "null, or what --time-limit ended or left out",
            "absorbed.NAME.before, absorbed.NAME.after": "a declared parameter without and with the effects, for "
            "which it stood in",
            "absorbed.NAME.unit": "its unit",
            "absorbed.NAME.shift_in_sd": "the difference over the standard deviation of `after`",
            "candidates[].effect, candidates[].site": "an effect that was tried, and where; accepted ones first, "
            "then by score",
            "candidates[].score": "expected decrease of the objective over the variance left, or null",
            "candidates[].refit_select_error": "fitted jointly: error over the noise floor where judged, or null",
            "candidates[].rejection, candidates[].why_rejected": "why it is out ({reason, facts, beside_others}), "
            "and in words; or null",
            "localisation[].output": "whose residual acceleration is meant",
            "localisation[].against, localisation[].unit": "what it is drawn against, and the unit of that",
            "localisation[].share": "of the variance of the residual acceleration that it accounts for, declared model",
            "split.how": "how windows were divided",
            "split.fit_windows, split.select_windows, split.test_windows": "how many were fitted, chose among "
            "effects (0: cross-validation on those fitted), and were held out",
            **_ROLLOUTS,
            "next_experiment": "null, or what would separate a tie: {band_hz, peaks, duration_s, seed (of the "
            "phases), separation, is_near, predicted (as in [online](online.md)), text, beyond_log (null, or "
            "likewise what separates most, wherever it takes the machine)}",
            "expression": "null, or the formula of a force that effects leave: {text, terms: [{site, coefficient, "
            "sd, unit}], values ({NAME: value} of every parameter with it, of effects and terms by "
            "NAME@SITE.PARAMETER), select, test}",
        },
    ),
    "identifier.json": (
        "What `capture train-sysid` trained; the weights are in `identifier.safetensors` beside it.",
        {
            "format": '"capture/identifier"',
            "version": "2; of 1 `histories.effects` is read as empty",
            "identifier": "what was trained: capture, capture-refined, expert-distillation, posterior or tunenet",
            "task": "name of the task",
            "architecture.NAME": "sizes of the transformer, and how trajectories become tokens",
            "training.NAME": "how it was trained: steps, batch, learning rate, seed",
            "histories.ATTRIBUTE": "what the histories say of themselves",
            "signature": "the task's parameters, actions, features and points: {task, parameters, actions, features, "
            "point_times}",
            "result.steps": "steps made",
            "result.best_step": "whose weights these are",
            "result.validation_loss": "loss there, on pairs held out",
            "result.pairs.trained, result.pairs.held_out": "histories trained on, and held out",
            "result.mean_absolute_error.NAME": "of the answer, over the range, on pairs that chose nothing",
            "result.error_by_round[]": "likewise, after so many rounds of a window",
            "result.coverage.NAME": "share of the truths that the 95 % intervals cover",
        },
    ),
    "policy.json": (
        "What `capture train-policy` trained; the weights are in `policy.safetensors` beside it, and the evaluation "
        "curve in `metrics.jsonl` and `training.png`.",
        {
            "format": '"capture/policy"',
            "version": "2; of 1 `effects` is read as empty",
            "policy": "what was trained: sac",
            "task": "name of the task",
            "parameters[], actions[]": "names of the parameters that the policy knows, and of its actions' components",
            "bounds.parameters[][], bounds.actions[][]": "low and high of each parameter, and component of an action",
            "settings.layers": "layers of the network",
            "settings.mirrored": "whether half of its actions are those of a mirrored actor in a mirrored world",
            "effects": "what the machine had, in which it was trained and judged, beside the task's model; list as in "
            "capture/histories",
            "training.NAME": "how it was trained: episodes (steps), how many at once (envs), entropy, seed",
            "result.episodes": "how many parameter sets it was judged on, all unseen",
            "result.reward, result.random.reward": "mean reward there, and that of the random policy",
            "result.success, result.random.success": "share of them in which it succeeded, and the random policy",
        },
    ),
    "evaluation.json": (
        "What `capture eval-sim2sim` measured; also what its `--json` prints. Lists by round begin before the first. "
        "With `--suite` there is one of these in a folder for each comparison, and suite.json holds them all.",
        {
            "format": '"capture/evaluation"',
            "version, task": "4 (earlier ones are read), and the name of the task",
            "effects": "what the machines have beside the task's model; list as in capture/histories",
            "world, robot": "where machines are played: plant or robosuite; and null, or by whom",
            "noise": "kind of noise in what identifiers were told was measured",
            "policy": "who chose the actions",
            "pairs": "pairs of a source and a hidden target, in each seed",
            "seeds": "how often pairs were drawn",
            "rounds": "rounds of each pair",
            "table_rounds[]": "rounds that the tables show",
            "parameters[]": "names of the parameters",
            "yardstick": "null, or the identifier that `ratio` compares with",
            "identifiers.LABEL": Part("evaluated"),
        },
    ),
    "truth.json": (
        "What `capture record` made a log with, in a file of its own beside the log.",
        {
            "format": '"capture/truth"',
            "version, task": "2, and the name of the task",
            "world, robot": "what stood in for the machine: plant or robosuite; and null, or its robot",
            "parameters.NAME": "the parameters",
            "effects.EFFECT@SITE.PARAMETER": "the effects",
            "noise_sd.OUTPUT": "standard deviation of the noise added",
            "seed": "of every random choice",
        },
    ),
    "provenance.json": (
        "In every output: what made it, from what, and how long it took.",
        {
            "format": '"capture/provenance"',
            "version": "1",
            "command": "the command",
            "options.OPTION": "its options, as resolved",
            "inputs.INPUT.path, inputs.INPUT.sha256": "each file it read, and its hash",
            "capture": "version of capture",
            "code": "sha256 of its sources: two checkouts of one version may differ",
            "python": "version of Python",
            "packages.PACKAGE": "versions of what the numbers depend on",
            "platform": "operating system and processor",
            "began": "when, UTC",
            "seconds": "how long it took",
        },
    ),
}


# --- the table of task-file.md, and the tree of README.md ---


def targets() -> str:
    """Everything a parameter can set; those that are likewise in one row."""
    from capture_cli.model.target_attributes import ATTRIBUTES

    rows: list[list[str]] = []
    for kind, attributes in ATTRIBUTES.items():
        for name, attribute in attributes.items():
            if rows and not attribute.meaning and rows[-1][1] == attribute.unit:
                rows[-1][0] += f", `{name}`"
                continue
            form = f"option:{name}" if kind == "option" else f"{kind}:NAME:{name}"
            rows.append([f"`{form}`", attribute.unit, attribute.meaning.replace("|", BAR) or "likewise"])
    lines = ["| target | unit | what it is |", "|---|---|---|"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def folders() -> str:
    """The files beside README.md and the folders, each with a caption."""
    files, within = set(), set()
    for path in kept_files(ROOT):
        if len(path.parts) == 1:
            files.add(path)
        else:
            within |= {Path(path.parts[0]), Path(*path.parts[:-1][:2])}
    listed = [path for path in [*sorted(files), *sorted(within)] if _is_listed(path)]
    lines = [
        (path, re.split(r": |(?<=[?]) ", _caption(path))[0] if len(path.parts) > 1 else _caption(path))
        for path in listed
    ]
    return "\n".join(["```", *(_line(path, caption) for path, caption in lines), "```"])


def _is_listed(path: Path) -> bool:
    """Of folders in folders, those of the package and those with a caption in CAPTIONS."""
    if path.name.startswith("."):
        return False
    is_package = path.parts[0] == "capture_cli" and (ROOT / path / "__init__.py").is_file()
    return len(path.parts) == 1 or is_package or path.as_posix() in CAPTIONS


def _line(path: Path, caption: str) -> str:
    indent = "  " * (len(path.parts) - 1)
    name = path.name + ("/" if (ROOT / path).is_dir() else "")
    return f"{indent}{name:<{18 - len(indent)}} {caption}"


def _caption(path: Path) -> str:
    """The first sentence of what `path` is for."""
    if path.as_posix() in CAPTIONS:
        return CAPTIONS[path.as_posix()]
    module = ROOT / path if path.suffix else ROOT / path / "__init__.py"
    text = ast.get_docstring(ast.parse(module.read_text(encoding="utf-8"))) if module.is_file() else None
    if not text:
        raise ValueError(
            f"{path} has no caption: give it a docstring, or a line in CAPTIONS of docs/generate.py"
        )
    return text.splitlines()[0].split(". ")[0].rstrip(".")


def rooms() -> str:
    """What each row of tests/test_architecture.py is for: the highest first."""
    tree = ast.parse((ROOT / "tests" / "test_architecture.py").read_text(encoding="utf-8"))
    assigned = {n.targets[0].id: n.value for n in tree.body if isinstance(n, ast.Assign)}
    lines = ["| may import what is below it | what it is for |", "|---|---|"]
    for row in ast.literal_eval(assigned["ROWS"]):
        for name in (n for n in row if not n.startswith("__")):
            path = Path("capture_cli", *name.split("."))
            lines.append(
                f"| `{name}` | {_caption(path if (ROOT / path).is_dir() else path.with_suffix('.py'))} |"
            )
    return "\n".join(lines)


def kept_files(folder: Path) -> list[Path]:
    """Files of the project, relative to its folder: what git keeps or could add, without what it ignores.

    A folder that is no checkout of its own, as an unpacked archive is none, is walked without NOT_KEPT.
    """
    if (folder / ".git").exists():
        # -z: names as they are; of files that were deleted and not yet committed, git says that it keeps them
        command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        try:
            listed = subprocess.run(command, cwd=folder, capture_output=True, check=True).stdout.decode()
        except (OSError, subprocess.CalledProcessError):
            pass  # git is not installed, or refuses a checkout that somebody else owns
        else:
            return [Path(name) for name in dict.fromkeys(listed.split("\0")) if (folder / name).is_file()]
    found = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return [
        path for path in found if not any(fnmatch(part, kept) for part in path.parts for kept in NOT_KEPT)
    ]


# --- figures measured ---


def measured() -> str:
    """Every figure in runs/benchmarks, and runs/fuzz.json, by benchmark."""
    results = _results()
    lines = [" or ".join(sorted({_made_with(document) for document in results.values()})) + ":", ""]
    for name, document in results.items():
        day = datetime.fromisoformat(document["provenance"]["began"]).strftime("%-d %b %Y")
        load = document["machine"]["load_before"]
        lines += [f"### `{_measured_by(name, document)}` ({day}, load {load:.1f})", ""]
        lines += ["| figure | measured | target |", "|---|---|---|"]
        for figure in document["figures"]:
            if figure["name"].startswith(" at "):  # of the figure before
                lines[-1] = lines[-1].removesuffix(" |") + f", {_number(figure)}{figure['name']} |"
                continue
            met = {None: "", True: "", False: " **(not met)**"}[figure["met"]]
            indent = "- " * figure["name"].startswith(" ")
            aim = f"{_aim(figure)}{met}"
            cells = [indent + figure["name"].strip(), _number(figure), *([aim] if aim else [])]
            lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines).rstrip()


def _made_with(document: dict) -> str:
    made = document["provenance"]
    return (
        f"capture {made['capture']}, MuJoCo {made['packages']['mujoco']}, Python {made['python']}, "
        f"{document['machine']['cpus']} cores"
    )


def _measured_by(name: str, document: dict) -> str:
    pairs = document["provenance"]["options"].get("pairs", PAIRS)
    return f"python -m benchmarks {name}" + (f" --pairs {pairs}" if pairs != PAIRS else "")


def _results() -> dict[str, dict]:
    runs = ROOT / "runs"
    files = sorted([*(runs / "benchmarks").glob("*.json"), *runs.glob("fuzz.json")], key=lambda f: f.stem)
    return {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in files}


def _number(figure: dict) -> str:
    value = figure["value"]
    text = f"{value:,.0f}" if abs(value) >= 1e4 else f"{value:.3g}"
    return text if figure["unit"] == "1" else f"{text} {figure['unit']}"


def _aim(figure: dict) -> str:
    if figure["target"] is None:
        return ""
    low, high = figure["target"]
    if low is None:
        return f"at most {high:g}"
    return f"at least {low:g}" if high is None else f"{low:g} to {high:g}"


# Logs of real machines, and of a simulated one, whose diagnoses are in runs/diagnosis.
DIAGNOSED = {
    "emps": "a linear drive (EMPS, real), mass and damping declared",
    "xl330": "a hobby servo (XL330, real), motor, friction and inertia declared",
    "air-hockey-robosuite": "a Panda at air hockey (robosuite), an ideal mallet declared",
}


def found() -> str:
    """What `diagnose` added to the models of DIAGNOSED."""
    lines = ["| log | what the model lacked | RMSE on data never fitted |", "|---|---|---|"]
    for folder, machine in DIAGNOSED.items():
        path = ROOT / "runs" / "diagnosis" / folder / "diagnosis.json"
        document = json.loads(path.read_text(encoding="utf-8"))
        lines.append(f"| {machine} | {_effects_of(document)} | {_before_and_after(document)} |")
    return "\n".join(lines)


def _effects_of(diagnosis: dict) -> str:
    from capture_cli.report.diagnosis_findings import placed

    return ", ".join(
        f"`{placed(e)}`" + (f" (or {', '.join(e['tied_with'])})" if e["tied_with"] else "")
        for e in diagnosis["effects"]
    )


def _before_and_after(diagnosis: dict) -> str:
    """Of the output that was worst by its noise floor."""
    from capture_cli.common.quantities import scaled_unit, significant

    before, after = (diagnosis[k]["test"]["rmse"] for k in ("before", "after"))
    output = max(before, key=lambda name: before[name] / diagnosis["noise_floor"][name])
    own = next(c["unit"] for c in diagnosis["localisation"] if c["against"] == output)
    factor, unit = scaled_unit(own, after[output])
    return f"{significant(before[output] * factor)} → {significant(after[output] * factor)} {unit}"


_COMMANDS = """
# Commands

This page is made from the command line itself (`make docs`).

- **stdout** has results only: tables, or exactly one JSON document with `--json`. **stderr** has progress and messages.
- **Progress** is a bar on a terminal. Elsewhere a line comes after a second, and one every ten.
- **Outputs** appear whole or not at all. Nothing is overwritten without `--force`.
- **`--config FILE`** is a TOML file with options by name (`starts = 5`): at its top for all that have it, in a table
  named after a command (`[identify]`) for that one, which goes before.
- **`--debug`**, anywhere on the line, adds a traceback to an error.

| exit code | meaning |
|---|---|
| 0 | done |
| 1 | a fault of `capture` |
| 2 | you can mend it: the message says what was found, what was expected, where, and the cure |
| 3 | it ran, and the verdict is one that `--fail-on` names |
| 130, 143 | Ctrl-C (SIGINT) or SIGTERM ended it: the message says what is kept, and how to go on |

`inspect` ends with 2 where a finding is an error; `import-log` with 0 once its log is written.

## Common options
"""

_LIMITS = """
## What is read of a file

What goes beyond this ends with exit code 2 and says where, before anything of it is unpacked or simulated.
"""

_JSON = """
NAME, OUTPUT, INPUT and the like stand for names of yours. A key that is a link has the keys of that [part](#parameter).
"""

_SCHEMAS = """
# File formats

This page is made from the tables that write and check the files (`make docs`). A measured log is `NAME.zarr`. An
estimate is a folder: `estimate.json`, the curves in `estimate.zarr`, `report.html`, figures, and `provenance.json`.

## Stores

Stores are Zarr v3 groups; measured logs are read from v2 as well. Numbers are in SI units; where no unit is given, in
that of each parameter, output or feature. Arrays that share an axis
have the same length along it. A version that the program does not read is refused with the command that mends it.
"""


PAGES: dict[str, Callable[[], str]] = {
    "docs/commands.md": commands,
    "docs/schemas.md": schemas,
    "docs/effects.md": effects_page.effects,
}
PARTS: dict[str, dict[str, Callable[[], str]]] = {
    "docs/task-file.md": {"targets": targets},
    "docs/dev/architecture.md": {"rooms": rooms},
    "docs/dev/benchmarks.md": {"figures": measured},
    "docs/dev/evaluation.md": {
        "air hockey": measured_identifiers.air_hockey,
        "scooping": measured_identifiers.scooping,
        "worlds": measured_identifiers.worlds,
    },
    "docs/in-context.md": {"goals": measured_identifiers.goals},
    "docs/worlds.md": {"closed loop": measured_identifiers.closed_loop},
    "README.md": {"found": found, "tree": folders},
}

if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    main()
