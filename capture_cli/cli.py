"""The `capture` command: options in, one stage call, results and errors out. No logic.

stdout carries results only (tables, or with --json exactly one JSON document); progress and messages go to stderr.
Exit codes: 0 done; 1 our fault; 2 the user can mend it; 3 it ran, and the verdict is one named by --fail-on.
"""

from __future__ import annotations

import inspect as reflection
import json
import math
import os
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from capture_cli import __version__
from capture_cli.errors import CaptureError, OptionError, did_you_mean


class _PassedOn(Exception):
    """Carries an exception that typer would turn into an exit code of its own to `main`."""


class _Commands(TyperGroup):
    def invoke(self, ctx):
        arguments = list(ctx.args)  # of the command; they are taken from there
        try:
            try:
                return super().invoke(ctx)
            finally:
                sys.stdout.flush()
        except (KeyboardInterrupt, BrokenPipeError) as error:
            raise _PassedOn from error
        except typer.BadParameter as error:
            raise _wrong_number(error, arguments) or error from None


class _Command(TyperCommand):
    def invoke(self, ctx):
        if ctx.params.get("config") is not None:
            from capture_cli.stores.output import refuse_inputs

            for name in ("out", "truth"):
                if ctx.params.get(name) is not None:
                    refuse_inputs(ctx.params[name], [ctx.params["config"]], option=f"--{name}")
        return super().invoke(ctx)


def _wrong_number(error: typer.BadParameter, arguments: Sequence[str]) -> OptionError | None:
    """What is wrong with an option that takes numbers: typer says neither what it found nor all of the range."""
    if error.param is None or error.ctx is None:
        return None
    name, command = error.param.name, error.ctx.command
    parts = _parts(get_type_hints(reflection.unwrap(command.callback), include_extras=True)[name])
    kind = next((text for kind, text in _NUMBERS.items() if kind in parts), None)
    given, _, _ = command.make_parser(error.ctx).parse_args(args=list(arguments))
    where = "" if name in given else f"--config {error.ctx.params.get('config')}: "
    value = given.get(name, (error.ctx.default_map or {}).get(name))
    if kind is None or value is None:
        return None
    several = isinstance(value, list | tuple)
    found = " ".join(map(str, value)) if several else value
    low, high = next((p.min, p.max) for p in parts if hasattr(p, "min") and hasattr(p, "max"))
    cure = f"give {len(value)} numbers" if several else f"give a {kind}{_range(low, high)}"
    return OptionError(f"{where}{error.param.opts[0]} {found}", cure=cure)


_NUMBERS = {int: "whole number", float: "number"}


def _parts(hint: Any) -> list[Any]:
    """A type hint and what it is made of."""
    return [hint, *(part for piece in get_args(hint) for part in _parts(piece))]


def _range(low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return ""
    if high is None:
        return f" of {low} or more"
    return f" of {high} at most" if low is None else f" from {low} to {high}"


app = typer.Typer(
    name="capture",
    cls=_Commands,
    help="Find the parameters of a MuJoCo model from a measured log, and what the model lacks.",
    epilog="Add --debug to any command for a traceback.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
)
_command = partial(app.command, cls=_Command)


def main() -> None:
    """Run the command line; every way out has an exit code and, if it is an error, one message."""
    # small matrices by the thousand: more than one thread of linear algebra only spins
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # nothing is rendered, and to look for a window system takes MuJoCo a third of its import
    os.environ.setdefault("MUJOCO_GL", "disable")
    debug = "--debug" in sys.argv
    arguments = [a for a in sys.argv[1:] if a != "--debug"]
    try:
        try:
            app(arguments, prog_name="capture")
        except _PassedOn as passed:
            raise passed.__cause__ from None
    except CaptureError as error:
        _fail(f"error: {error}", 2, debug)
    except KeyboardInterrupt:
        _fail("interrupted: nothing was written\n  cure: run the same command again", 2, debug)
    except BrokenPipeError:
        # the reader of our pipe went away: nothing is wrong, and the rest of stdout goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except MemoryError:
        _fail(
            "error: out of memory\n  cure: use a shorter --window, fewer --starts, or a shorter log", 2, debug
        )
    except Exception as error:
        _fail(
            f"internal error: {type(error).__name__}: {error}\n  this is a fault of `capture`; --debug shows where",
            1,
            debug,
        )


def _fail(message: str, code: int, debug: bool) -> None:
    if debug:
        import traceback

        traceback.print_exc()
    print(message, file=sys.stderr)
    sys.exit(code)


# --- options that several commands share ---


def _read_config(context: typer.Context, path: Path | None) -> Path | None:
    """Make the keys of a TOML the defaults of this command's options."""
    if path is None or context.resilient_parsing:
        return path
    import tomllib

    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise OptionError(f"--config {path}: {error}", cure="give a readable TOML file") from error
    section = table.get(context.info_name)
    table = section if isinstance(section, dict) else table
    known = {p.name: p for p in context.command.params if p.name not in ("config", "help")}
    flags = {option.lstrip("-").replace("-", "_"): name for name, p in known.items() for option in p.opts}
    defaults: dict[str, Any] = {}
    for key, value in table.items():
        name = flags.get(key.replace("-", "_"))
        if name is None:
            options = sorted(k.replace("_", "-") for k in flags)
            raise OptionError(
                f"--config {path}: `capture {context.info_name}` has no option {key!r}",
                cure=did_you_mean(key, options),
            )
        defaults[name] = [str(v) for v in value] if isinstance(value, list) else value
    context.default_map = defaults
    return path


Config = Annotated[
    Path | None,
    typer.Option(
        "--config", help="TOML with values for any of these options.", callback=_read_config, is_eager=True
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace --out if it exists.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress, no tables.")]
LARGEST_SEED = 2**32 - 1  # that every generator of random numbers takes
Seed = Annotated[int, typer.Option("--seed", min=0, max=LARGEST_SEED, help="Seed of every random choice.")]
Threads = Annotated[int | None, typer.Option("--threads", min=1, help="Threads; all cores by default.")]
TaskOption = Annotated[str | None, typer.Option("--task", help="Built-in task, or path of a task.toml.")]
RealLog = Annotated[Path, typer.Option("--real-log", help="Measured log (.zarr).")]
Test = Annotated[
    str | None,
    typer.Option("--test", help="Recordings to hold out (names or patterns, comma-separated), or none."),
]
Window = Annotated[float | None, typer.Option("--window", help="Seconds between restarts of the state.")]
Starts = Annotated[int, typer.Option("--starts", min=1, help="Descents from different places.")]


def _print_json(document: Any) -> None:
    print(json.dumps(document, indent=2, allow_nan=False))


def _console():
    from rich.console import Console

    return Console(highlight=False)


def _finite(text: str) -> float:
    """Raises ValueError."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError
    return number


def _pairs(texts: list[str], option: str) -> dict[str, float]:
    """NAME=VALUE texts as a dict. Raises OptionError."""
    result = {}
    for text in texts:
        name, equals, value = text.partition("=")
        try:
            if not equals:
                raise ValueError
            result[name] = _finite(value)
        except ValueError:
            raise OptionError(
                f"{option} {text!r} is not NAME=NUMBER", cure=f"for example {option} x=0.5"
            ) from None
    return result


def _ranges(texts: list[str], option: str) -> dict[str, tuple[float, float]]:
    """NAME=VALUE or NAME=LOW:HIGH texts as a dict of ranges. Raises OptionError."""
    result = {}
    for text in texts:
        name, _, value = text.partition("=")
        low, _, high = value.partition(":")
        try:
            result[name] = (_finite(low), _finite(high or low))
            if result[name][0] > result[name][1]:
                raise ValueError
        except ValueError:
            raise OptionError(
                f"{option} {text!r} is not NAME=VALUE or NAME=LOW:HIGH",
                cure=f"for example {option} x=-0.1:0.1",
            ) from None
    return result


# --- commands ---


@_command()
def identify(
    real_log: RealLog,
    task: TaskOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Estimate directory; default LOG.estimate.")
    ] = None,
    identifier: Annotated[
        str | None,
        typer.Option(
            "--identifier",
            help="least-squares, cma-es, or a directory of train-sysid; default the task's own, or least-squares.",
        ),
    ] = None,
    test: Test = None,
    window: Window = None,
    starts: Starts = 3,
    rounds: Annotated[
        int | None,
        typer.Option(
            "--rounds",
            min=1,
            help="Most rounds: an episode each if the identifier is learned, else a batch of simulations each.",
        ),
    ] = None,
    fail_on: Annotated[
        str | None,
        typer.Option("--fail-on", help="Exit with 3 on these verdicts: unexplained, not-identifiable."),
    ] = None,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Take up the estimate at --out: its log has new episodes.")
    ] = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Identify a model's parameters from a measured log.

    Example: capture identify --real-log run.zarr --task task.toml --out run.estimate
    """
    from capture_cli.stages.identify import identify as stage

    verdicts = _verdicts(fail_on)
    out = out or Path(f"{real_log.stem}.estimate")
    estimate = stage(
        real_log=real_log,
        out=out,
        task=task,
        identifier=identifier,
        test=test,
        window=window,
        starts=starts,
        rounds=rounds,
        seed=seed,
        threads=threads,
        resume=resume,
        force=force,
        quiet=quiet,
    )
    if json_:
        _print_json(estimate.document)
    elif not quiet:
        from capture_cli.reports.terminal import print_estimate

        print_estimate(estimate, _console(), out)
    if estimate.document["verdict"] in verdicts:
        raise typer.Exit(3)


@_command()
def diagnose(
    real_log: RealLog,
    estimate: Annotated[
        Path | None, typer.Option("--estimate", help="Estimate directory of the same log.")
    ] = None,
    task: TaskOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Diagnosis directory; default LOG.diagnosis.")
    ] = None,
    test: Annotated[
        str | None, typer.Option("--test", help="Recordings to hold out; default those of the estimate.")
    ] = None,
    window: Window = None,
    starts: Starts = 3,
    most_effects: Annotated[
        int, typer.Option("--most-effects", min=1, help="Stop when so many effects are found.")
    ] = 6,
    expression: Annotated[
        bool, typer.Option("--expression", help="Look for a formula of what no effect explains.")
    ] = False,
    fail_on: Annotated[
        str | None, typer.Option("--fail-on", help="Exit with 3 on this verdict: unexplained.")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed",
            min=0,
            max=LARGEST_SEED,
            help="Seed of every random choice; default that of the estimate, or 0.",
        ),
    ] = None,
    threads: Threads = None,
    force: Force = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Find what the model lacks, add it, and report the error before and after.

    Example: capture diagnose --real-log run.zarr --estimate run.estimate --out run.diagnosis
    """
    from capture_cli.stages.diagnose import diagnose as stage

    verdicts = _verdicts(fail_on)
    out = out or Path(f"{real_log.stem}.diagnosis")
    diagnosis = stage(
        real_log=real_log,
        out=out,
        estimate=estimate,
        task=task,
        test=test,
        window=window,
        starts=starts,
        most_effects=most_effects,
        expression=expression,
        seed=seed,
        threads=threads,
        force=force,
        quiet=quiet,
    )
    if json_:
        _print_json(diagnosis.document)
    elif not quiet:
        from capture_cli.reports.terminal import print_diagnosis

        print_diagnosis(diagnosis, _console(), out)
    if diagnosis.document["verdict"] in verdicts:
        raise typer.Exit(3)


def _verdicts(text: str | None) -> set[str]:
    possible = {"unexplained", "not-identifiable"}
    verdicts = {v.strip() for v in (text or "").split(",") if v.strip()}
    for verdict in verdicts - possible:
        raise OptionError(f"--fail-on {verdict!r}", cure=did_you_mean(verdict, possible))
    return verdicts


@_command(name="import-log")
def import_log(
    files: Annotated[
        list[Path], typer.Argument(help="CSV or Parquet files, one recording each, or measured logs.")
    ],
    task: Annotated[str, typer.Option("--task", help="Path of the task.toml that names the columns.")],
    out: Annotated[Path, typer.Option("--out", help="Measured log to write (.zarr).")],
    drop_nan: Annotated[
        bool, typer.Option("--drop-nan", help="Drop rows with missing values, inputs and all.")
    ] = False,
    drop_repeats: Annotated[
        bool,
        typer.Option("--drop-repeats", help="Drop rows that say the same as the row before, time and all."),
    ] = False,
    append: Annotated[
        bool, typer.Option("--append", help="Add the episodes to the log at --out, which exists.")
    ] = False,
    force: Force = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Read CSV or Parquet files into a measured log.

    Example: capture import-log run1.csv run2.csv --task task.toml --out runs.zarr
    """
    from capture_cli.stages.import_log import import_log as stage

    dropped = {"drop_nan": drop_nan, "drop_repeats": drop_repeats}
    stage(files=files, task=task, out=out, append=append, force=force, **dropped)
    _show_inspection(out, task, json_, quiet)


@_command()
def inspect(
    path: Annotated[Path, typer.Argument(help="A log, or any other output of `capture`.")],
    task: TaskOption = None,
    json_: Json = False,
    config: Config = None,
) -> None:
    """Say what a file is and how healthy it is: gaps, NaN, rate, saturation, excitation.

    Example: capture inspect run.zarr --task task.toml
    """
    _show_inspection(path, task, json_, quiet=False)


def _show_inspection(path: Path, task: str | None, json_: bool, quiet: bool) -> None:
    """The inspection on stdout; if `quiet`, what must not go unseen on stderr."""
    from capture_cli.stages.inspect import inspect as stage

    document = stage(path, task)
    if json_:
        _print_json(document)
    elif quiet:
        from capture_cli.reports.inspection import complaints

        for message in complaints(document):
            print(message, file=sys.stderr)
    else:
        from capture_cli.reports.inspection import render

        render(document, _console())


@_command()
def record(
    task: Annotated[str, typer.Option("--task", help="Built-in task, or path of a task.toml.")],
    out: Annotated[Path, typer.Option("--out", help="Measured log to write (.zarr).")],
    world: Annotated[
        str, typer.Option("--world", help="plant, or robosuite: the whole scene, driven by its robot.")
    ] = "plant",
    param: Annotated[list[str], typer.Option("--param", help="NAME=VALUE; others are nominal.")] = [],  # noqa: B006
    random_parameters: Annotated[
        bool, typer.Option("--random-parameters", help="Draw the others at random.")
    ] = False,
    effect: Annotated[list[str], typer.Option("--effect", help="NAME@SITE.PARAMETER=VALUE.")] = [],  # noqa: B006
    noise: Annotated[list[str], typer.Option("--noise", help="SD for all outputs, or OUTPUT=SD.")] = [],  # noqa: B006
    episodes: Annotated[int, typer.Option("--episodes", min=1, help="Number of episodes.")] = 1,
    policy: Annotated[
        str | None,
        typer.Option("--policy", help="Who chooses the actions of a task that has some; default random."),
    ] = None,
    belief: Annotated[
        str,
        typer.Option(
            "--belief", help="What the policy takes the parameters for: nominal, or random each time."
        ),
    ] = "nominal",
    actions_from: Annotated[
        Path | None, typer.Option("--actions-from", help="Proposal whose action every episode takes.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option("--duration", help="Seconds per episode; default 10.")
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option("--rate", help="Samples per second; default the model's own, of actions 100."),
    ] = None,
    inputs_from: Annotated[
        Path | None, typer.Option("--inputs-from", help="Log, or proposal, whose inputs to replay.")
    ] = None,
    amplitude: Annotated[list[str], typer.Option("--amplitude", help="INPUT=PEAK of the multisine.")] = [],  # noqa: B006
    band: Annotated[
        tuple[float, float],
        typer.Option(
            "--band", help="Lowest and highest Hz of the multisine; default --band 0.1 3.", show_default=False
        ),
    ] = (0.1, 3.0),
    start: Annotated[list[str], typer.Option("--start", help="JOINT=POSITION or JOINT=LOW:HIGH.")] = [],  # noqa: B006
    start_velocity: Annotated[
        list[str], typer.Option("--start-velocity", help="JOINT=VELOCITY or LOW:HIGH.")
    ] = [],  # noqa: B006
    truth: Annotated[
        Path | None, typer.Option("--truth", help="Where the truth goes; default OUT.truth.json.")
    ] = None,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Record a log from a simulated machine, with noise and effects of your choice.

    Example: capture record --task task.toml --effect coulomb-friction@x=3 --noise 0.0005 --out run.zarr
    """
    from capture_cli.stages.record import record as stage

    recording = stage(
        task=task,
        out=out,
        world=world,
        parameters=_pairs(param, "--param"),
        random_parameters=random_parameters,
        effects=effect,
        noise=_sd(noise, "--noise"),
        episodes=episodes,
        policy=policy,
        belief=belief,
        actions_from=actions_from,
        duration=duration,
        rate=rate,
        inputs_from=inputs_from,
        amplitude=_pairs(amplitude, "--amplitude"),
        band=band,
        start=_ranges(start, "--start"),
        start_velocity=_ranges(start_velocity, "--start-velocity"),
        truth=truth,
        seed=seed,
        threads=threads,
        force=force,
    )
    if json_:
        _print_json(recording.truth)
    elif not quiet:
        steps, episodes_ = len(recording.log.time), len(recording.log.episode_ends)
        print(
            f"{out}: {steps} steps in {episodes_} episode(s); truth in {truth or out.with_suffix('.truth.json')}"
        )


def _sd(texts: list[str], option: str) -> dict[str, float] | float:
    if len(texts) == 1 and "=" not in texts[0]:
        try:
            return float(texts[0])
        except ValueError:
            raise OptionError(f"{option} {texts[0]!r} is not a number", cure="give SD, or NAME=SD") from None
    return _pairs(texts, option) if texts else 0.0


@_command(name="train-policy")
def train_policy(
    task: Annotated[str, typer.Option("--task", help="Built-in task with a reward.")],
    out: Annotated[Path, typer.Option("--out", help="Checkpoint directory to write.")],
    policy: Annotated[str, typer.Option("--policy", help="What to train: sac.")] = "sac",
    steps: Annotated[int, typer.Option("--steps", help="Episodes.")] = 150_000,
    envs: Annotated[int, typer.Option("--envs", help="Episodes simulated at once.")] = 64,
    updates: Annotated[int, typer.Option("--updates", help="Gradient steps after each of these.")] = 16,
    batch: Annotated[int, typer.Option("--batch", help="Episodes per gradient step.")] = 256,
    learning_rate: Annotated[
        float, typer.Option("--lr", help="Learning rate at the start; it falls linearly to 0.")
    ] = 1e-3,
    entropy: Annotated[
        float | None, typer.Option("--entropy", help="Weight of the entropy; the task's own by default.")
    ] = None,
    width: Annotated[int, typer.Option("--width", help="Width of the networks.")] = 64,
    layers: Annotated[int, typer.Option("--layers", help="Hidden layers of the networks.")] = 2,
    evaluations: Annotated[
        int, typer.Option("--evaluations", help="Points of the evaluation curve; what --resume goes on from.")
    ] = 30,
    device: Annotated[str, typer.Option("--device", help="Of the networks: cpu, cuda or auto.")] = "cpu",
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a training that ended early.")] = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Train a policy that knows the parameters: for `gen-histories --policy`, where `random` needs no training.

    Example: capture train-policy --task air-hockey --out runs/policy
    """
    from capture_cli.stages.train_policy import train_policy as stage

    document = stage(
        task=task,
        out=out,
        policy=policy,
        steps=steps,
        envs=envs,
        updates=updates,
        batch=batch,
        learning_rate=learning_rate,
        entropy=entropy,
        width=width,
        layers=layers,
        evaluations=evaluations,
        device=device,
        seed=seed,
        threads=threads,
        force=force,
        resume=resume,
        quiet=quiet,
    )
    if json_:
        _print_json(document)
    elif not quiet:
        from capture_cli.reports.policy_training import print_policy

        print_policy(document, _console(), out)


@_command(name="gen-histories")
def gen_histories(
    task: Annotated[str, typer.Option("--task", help="Built-in task, or path of a task.toml.")],
    out: Annotated[str, typer.Option("--out", help="Histories to write (.zarr): a path, or a URL.")],
    policy: Annotated[
        str, typer.Option("--policy", help="Who chooses actions: random, or a checkpoint directory.")
    ] = "random",
    search: Annotated[
        str,
        typer.Option(
            "--search", help="Strategy: randomized-binary, binary, linear-interpolation or scattered."
        ),
    ] = "randomized-binary",
    pairs: Annotated[int, typer.Option("--pairs", min=1, help="Number of histories.")] = 1000,
    rounds: Annotated[int, typer.Option("--rounds", min=2, help="Entries of a history (the paper's L).")] = 7,
    alpha: Annotated[
        float | None, typer.Option("--alpha", help="Shape of the symmetric Beta; 5 by default.")
    ] = None,
    noise: Annotated[
        str, typer.Option("--noise", help="On what is measured: none, scale or label, as in the paper.")
    ] = "none",
    noise_sd: Annotated[
        list[str], typer.Option("--noise-sd", help="White noise besides: SD for all features, or FEATURE=SD.")
    ] = [],  # noqa: B006
    inputs_from: Annotated[
        Path | None, typer.Option("--inputs-from", help="For a task.toml: log whose windows are the actions.")
    ] = None,
    window: Annotated[
        float | None, typer.Option("--window", help="For a task.toml: seconds per episode.")
    ] = None,
    points: Annotated[
        int | None, typer.Option("--points", help="For a task.toml: points of a trajectory; 20 by default.")
    ] = None,
    amplitude: Annotated[
        list[str], typer.Option("--amplitude", help="For a task.toml: INPUT=PEAK of the multisines.")
    ] = [],  # noqa: B006
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--band", help="For a task.toml: lowest and highest Hz of the multisines, say --band 0.1 3."
        ),
    ] = None,
    executor: Annotated[
        str, typer.Option("--executor", help="Where to simulate: local, or ray for a cluster.")
    ] = "local",
    address: Annotated[
        str | None, typer.Option("--address", help="Address of the Ray cluster; one is started without.")
    ] = None,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run that ended early.")] = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Generate adaptation histories: walks from random parameters to a target, with what both would show.

    Example: capture gen-histories --task air-hockey --pairs 1000 --out histories.zarr
    """
    from capture_cli.stages.gen_histories import gen_histories as stage

    document = stage(
        task=task,
        out=out,
        policy=policy,
        search=search,
        pairs=pairs,
        rounds=rounds,
        alpha=alpha,
        noise=noise,
        noise_sd=_sd(noise_sd, "--noise-sd"),
        inputs_from=inputs_from,
        window=window,
        points=points,
        amplitude=_pairs(amplitude, "--amplitude"),
        band=band,
        seed=seed,
        threads=threads,
        executor=executor,
        address=address,
        force=force,
        resume=resume,
        quiet=quiet,
    )
    if json_:
        _print_json(document)
    elif not quiet:
        new = f"{document['shards_made']} of {document['shards']} shards are new"
        print(f"{out}: {document['pairs']} histories of {rounds} rounds; {new}")


@_command(name="train-sysid")
def train_sysid(
    histories: Annotated[
        str, typer.Option("--histories", help="Histories to learn from (.zarr): a path, or a URL.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Checkpoint directory to write.")],
    identifier: Annotated[
        str,
        typer.Option(
            "--identifier",
            help="capture, capture-refined, expert-distillation, posterior or tunenet.",
        ),
    ] = "capture",
    tokens: Annotated[
        str,
        typer.Option("--tokens", help="trajectory: one token each; step: one per state, as in the paper."),
    ] = "trajectory",
    window: Annotated[
        int | None,
        typer.Option(
            "--window",
            min=1,
            help="Rounds it reads (the paper's k); 4, or all for posterior and capture-refined.",
        ),
    ] = None,
    width: Annotated[int, typer.Option("--width", min=1, help="Width of the transformer.")] = 128,
    layers: Annotated[int, typer.Option("--layers", min=1, help="Its layers.")] = 3,
    heads: Annotated[int, typer.Option("--heads", min=1, help="Its attention heads.")] = 4,
    dropout: Annotated[
        float, typer.Option("--dropout", min=0, max=0.9, help="Share of activations dropped.")
    ] = 0.0,
    steps: Annotated[int, typer.Option("--steps", min=1, help="Optimiser steps at most.")] = 20_000,
    batch: Annotated[int, typer.Option("--batch", min=1, help="Windows per step.")] = 256,
    learning_rate: Annotated[float, typer.Option("--lr", help="Highest learning rate.")] = 1e-3,
    warmup: Annotated[int, typer.Option("--warmup", min=0, help="Steps until it is reached.")] = 200,
    weight_decay: Annotated[float, typer.Option("--weight-decay", min=0, help="Of AdamW.")] = 0.01,
    validation: Annotated[float, typer.Option("--validation", help="Share of the pairs held out.")] = 0.1,
    patience: Annotated[
        int,
        typer.Option(
            "--patience",
            min=1,
            help="Stop after so many evaluations, of 50, without a gain since the warm-up.",
        ),
    ] = 10,
    precision: Annotated[
        str, typer.Option("--precision", help="float32, bfloat16, or auto: bfloat16 on a GPU.")
    ] = "auto",
    device: Annotated[
        str, typer.Option("--device", help="cpu, cuda, or auto: a GPU if there is one.")
    ] = "auto",
    threads: Annotated[
        int, typer.Option("--threads", min=1, help="CPU threads; another number rounds otherwise.")
    ] = 1,
    seed: Seed = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run that ended early.")] = False,
    force: Force = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Train an in-context identifier on histories.

    Example: capture train-sysid --histories histories.zarr --identifier capture --out runs/capture
    """
    from capture_cli.stages.train_sysid import train_sysid as stage

    document = stage(
        histories=histories,
        out=out,
        identifier=identifier,
        tokens=tokens,
        window=window,
        width=width,
        layers=layers,
        heads=heads,
        dropout=dropout,
        steps=steps,
        batch=batch,
        learning_rate=learning_rate,
        warmup=warmup,
        weight_decay=weight_decay,
        validation=validation,
        patience=patience,
        precision=precision,
        device=device,
        threads=threads,
        seed=seed,
        resume=resume,
        force=force,
        quiet=quiet,
    )
    if json_:
        _print_json(document)
    elif not quiet:
        from capture_cli.reports.training import print_training

        print_training(document, _console(), out)


@_command(name="eval-sim2sim")
def eval_sim2sim(
    out: Annotated[Path, typer.Option("--out", help="Evaluation directory to write.")],
    identifier: Annotated[
        list[str],
        typer.Option("--identifier", help="A name, a checkpoint directory, or NAME=DIRECTORY."),
    ],
    task: Annotated[str | None, typer.Option("--task", help="Built-in task with actions.")] = None,
    policy: Annotated[
        str, typer.Option("--policy", help="Who chooses actions: random, or a checkpoint directory.")
    ] = "random",
    suite: Annotated[
        str | None,
        typer.Option(
            "--suite",
            help="paper: all its comparisons; --identifier and --policy take folders of checkpoints.",
        ),
    ] = None,
    cell: Annotated[
        list[str] | None,
        typer.Option("--cell", help="Of the suite, this comparison alone; may be given several times."),
    ] = None,
    pairs: Annotated[
        int, typer.Option("--pairs", min=1, help="Pairs of a source and a hidden target.")
    ] = 100,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Times that the pairs are drawn.")] = 3,
    rounds: Annotated[int, typer.Option("--rounds", min=1, help="Rounds, one measured rollout each.")] = 30,
    noise: Annotated[
        str, typer.Option("--noise", help="On what is measured: none, scale or label, as in the paper.")
    ] = "none",
    known_noise: Annotated[
        bool, typer.Option("--known-noise", help="Tell identifiers which labels are random.")
    ] = False,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run that ended early.")] = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Evaluate identifiers on simulated truths: errors, success and cost by round, the paper's numbers beside.

    Example: capture eval-sim2sim --task air-hockey --identifier runs/capture --out evaluation
    """
    from capture_cli.stages.eval_sim2sim import eval_sim2sim as stage

    document = stage(
        suite=suite,
        cells=cell or [],
        noise=noise,
        known_noise=known_noise,
        task=task,
        identifiers=identifier,
        out=out,
        policy=policy,
        pairs=pairs,
        seeds=seeds,
        rounds=rounds,
        seed=seed,
        threads=threads,
        force=force,
        resume=resume,
        quiet=quiet,
    )
    if json_:
        _print_json(document)
    elif not quiet:
        from capture_cli.reports.evaluation_tables import print_evaluation, print_suite

        show = print_suite if suite else print_evaluation
        show(document, _console(), out)


@_command()
def propose(
    result: Annotated[Path, typer.Argument(help="Estimate or diagnosis directory.")],
    task: TaskOption = None,
    policy: Annotated[
        str | None, typer.Option("--policy", help="Let this policy choose, rather than what tells most.")
    ] = None,
    candidates: Annotated[
        int, typer.Option("--candidates", min=1, help="Random actions that are compared.")
    ] = 48,
    amplitude: Annotated[
        list[str], typer.Option("--amplitude", help="INPUT=VALUE: how far an input may be driven.")
    ] = [],  # noqa: B006
    out: Annotated[Path | None, typer.Option("--out", help="File to write; default stdout.")] = None,
    seed: Seed = 0,
    threads: Threads = None,
    force: Force = False,
    config: Config = None,
) -> None:
    """Propose what to run on the machine next, as JSON.

    Example: capture propose run.estimate --out proposal.json
    """
    from capture_cli.stages.propose import propose as stage
    from capture_cli.stores.output import new_file, refuse_existing
    from capture_cli.stores.provenance import write_json

    if out is not None:
        refuse_existing(out, force=force)
    document = stage(
        result=result,
        task=task,
        policy=policy,
        candidates=candidates,
        amplitude=_pairs(amplitude, "--amplitude"),
        seed=seed,
        threads=threads,
        out=out,
    )
    if out is None:
        _print_json(document)
        return
    with new_file(out, force=force) as file:
        write_json(file, document)


@_command()
def export(
    result: Annotated[Path, typer.Argument(help="Estimate or diagnosis directory.")],
    out: Annotated[Path, typer.Option("--out", help="MJCF file to write.")],
    task: TaskOption = None,
    force: Force = False,
    json_: Json = False,
    quiet: Quiet = False,
    config: Config = None,
) -> None:
    """Write the model with its identified values and effects as an MJCF that MuJoCo loads.

    Effects for which MuJoCo has no feature go to a Python module beside it, STEM_effects.py.

    Example: capture export run.estimate --out identified.xml
    """
    from capture_cli.stages.export import export as stage

    written = stage(result=result, out=out, task=task, force=force)
    if json_:
        beside = {"companion": str(written.companion)} if written.companion else {}
        _print_json({"model": str(written.model), **beside})
    elif not quiet:
        print(f"{out}: written; load it with mujoco.MjModel.from_xml_path({str(out)!r})")
        if written.companion:
            print(
                f"{written.companion}: written; it applies {', '.join(written.effects)} (see its first lines)"
            )
        if written.left_out:
            print(f"left out: {written.left_out}")


@_command()
def tasks(task: TaskOption = None, json_: Json = False) -> None:
    """List the built-in tasks, or the parameters, inputs and outputs of one.

    Example: capture tasks --task task.toml
    """
    from capture_cli.stages.tasks import describe

    document = describe(task)
    if json_:
        _print_json(document)
    else:
        from capture_cli.reports.listing import print_tasks

        print_tasks(document, _console())


@_command()
def effects(task: TaskOption = None, json_: Json = False) -> None:
    """List the effects that a model may lack, with parameters, units and ranges.

    Example: capture effects --task task.toml
    """
    from capture_cli.stages.effects import describe

    document = describe(task)
    if json_:
        _print_json(document)
    else:
        from capture_cli.reports.listing import print_effects

        print_effects(document, _console())


def _version(wanted: bool) -> None:
    if wanted:
        print(f"capture {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass
