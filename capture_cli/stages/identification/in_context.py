"""Rounds over a log (paper, Algorithm 2): what a learned identifier makes of its episodes, before physics does."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import capture_cli
from capture_cli.common.frozen import frozen
from capture_cli.common.progress import Progress
from capture_cli.context.checkpoints.checkpoint_hash import checkpoint_hash
from capture_cli.context.checkpoints.identifier_checkpoint import IdentifierCheckpoint
from capture_cli.context.histories.action_library import log_sequences
from capture_cli.context.identifiers.base import Rounds, Signature, Walk, run_rounds
from capture_cli.errors import LogError, OptionError
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.model_hash import is_of_another
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.model.tasks.sequence_task import SequenceTask
from capture_cli.options.identify import IdentifyOptions
from capture_cli.simulate.engine import Engine
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.identification.chosen_identifier import ChosenIdentifier


@frozen
class SETTINGS:
    rounds: int = 10  # over a log, unless told otherwise; fewer where it has fewer episodes
    # share of the training histories that lie as far out, below which a log is like none of them
    outside: float = 0.01
    # that proposal and fit differ so much by chance, all parameters together (Bonferroni)
    contradicts_p: float = 1e-3


@dataclass(frozen=True)
class LoggedRounds:
    """What a log gives to identify in rounds with: actions (entry, action), measured (entry, point, feature).

    An entry is an episode of a task of actions, or a window of any other machine. noise_sd (feature,): of measured.
    left_out: how many windows are no entry. before: rounds that were made with an earlier log, which are read as well.
    """

    task: ActionTask
    actions: np.ndarray
    measured: np.ndarray
    noise_sd: np.ndarray
    left_out: int = 0
    before: Rounds | None = None

    def __len__(self) -> int:
        return len(self.actions)


def logged_rounds(prepared: PreparedLog, checkpoint: IdentifierCheckpoint, where: str | Path) -> LoggedRounds:
    """The rounds of the windows in `prepared`, as the identifier was trained to see them.

    Raises OptionError where the checkpoint is of another task, LogError where the log cannot give what it needs.
    """
    task = task_of(prepared.task, checkpoint, where)
    checkpoint.check(Signature.of(task), where)
    noise = dict(zip((c.name for c in prepared.task.outputs), prepared.noise.sd, strict=True))
    noise_sd = np.array([noise.get(f.name, 0.0) for f in task.features])
    if isinstance(task, SequenceTask):
        sequences = log_sequences(prepared, task.point_times)
        return LoggedRounds(task, sequences.actions, sequences.outputs, noise_sd, sequences.left_out)
    if prepared.log.actions is None:
        raise LogError(
            f"{prepared.log.path} has no actions (meta/actions), which an identifier of {task.name!r} needs",
            cure="log the action of every episode, or identify with --identifier least-squares",
        )
    episodes = np.unique(prepared.windows.episode)
    trajectories = np.stack([_trajectory(prepared.log, int(e), task) for e in episodes])
    return LoggedRounds(task, prepared.log.actions[episodes], task.observe(trajectories), noise_sd)


def task_of(task: Task, checkpoint: IdentifierCheckpoint, where: str | Path) -> ActionTask:
    """The task as one of actions: itself, or a machine of the user's own with the sequences that were trained on."""
    if isinstance(task, ActionTask):
        return task
    signature = checkpoint.model.signature
    outputs = tuple(c.name for c in task.outputs)
    if signature.task != task.name or tuple(f.name for f in signature.features) != outputs:
        raise OptionError(
            f"{where} was trained for the task {signature.task!r} with outputs "
            f"({', '.join(f.name for f in signature.features)}); this one is {task.name!r} with ({', '.join(outputs)})",
            cure="choose a checkpoint of this task, or train one with `capture gen-histories` and `train-sysid`",
        )
    points = len(signature.point_times)
    if len(signature.actions) == points * len(task.inputs):
        raise OptionError(
            f"{where} was trained on episodes that a policy drives from the model's initial state; a log has windows",
            cure="train one on windows: `capture gen-histories` without --policy",
        )
    library = np.stack([signature.actions.low, signature.actions.high])
    return SequenceTask(task, signature.point_times, library, [f.scale for f in signature.features])


def _trajectory(log: MeasuredLog, episode: int, task: ActionTask) -> np.ndarray:
    """Outputs (point, output) of an episode at the task's points. Raises LogError where it ends before."""
    steps = log.episodes[episode]
    time = log.time[steps] - log.time[steps.start]
    interval = float(np.median(np.diff(time)))
    if time[-1] < task.point_times[-1] - interval:
        raise LogError(
            f"{log.path}: episode {episode} lasts {time[-1]:.3g} s; a trajectory of {task.name!r} "
            f"{task.point_times[-1]:g} s",
            cure="record longer, or identify with --identifier least-squares",
        )
    return np.stack([np.interp(task.point_times, time, y) for y in log.outputs[steps].T], axis=1)


@dataclass(frozen=True)
class InContext:
    """What the rounds gave. used (round,): which entries of the log they were.

    proposal, sd (parameter,): after the last round; sd None where the identifier's says nothing of the target.
    share_beyond: of the histories held out of training that lie as far out as these rounds.
    """

    checkpoint: IdentifierCheckpoint
    path: Path
    walk: Walk
    used: np.ndarray
    logged: LoggedRounds
    share_beyond: float

    @property
    def entries(self) -> int:
        """Of the log."""
        return len(self.logged)

    @property
    def proposal(self) -> np.ndarray:
        return self.walk.estimates[0, -1]

    @property
    def sd(self) -> np.ndarray | None:
        known = self.walk.sd is not None and self.checkpoint.kind.likelihood
        return self.walk.sd[0, -1] if known else None

    @property
    def in_family(self) -> bool:
        return self.share_beyond >= SETTINGS.outside

    def contradicted_by(self, value: np.ndarray, sd: np.ndarray) -> bool | None:
        """Whether a fit, value and sd (parameter,), differs from the proposal beyond chance; None: not known."""
        from scipy.special import ndtr

        if self.sd is None:
            return None
        z = np.abs(value - self.proposal) / np.sqrt(np.square(self.sd) + np.square(sd))
        return bool(2 * ndtr(-z.max()) * len(z) < SETTINGS.contradicts_p)

    def document(self, *, contradicted: bool | None, fallback: bool, elsewhere: bool) -> dict[str, Any]:
        """`in_context` of estimate.json.

        contradicted: by the fit. fallback: the fit from the proposal did not explain the log, and the initial states of
        its windows were fitted as well. elsewhere: that did not either, and fits began in other places.
        """
        names = self.checkpoint.model.signature.space.names
        sd = self.sd
        return {
            "checkpoint": named(self.path),
            "sha256": checkpoint_hash(self.path),
            "rounds": len(self.used),
            "episodes": self.entries,
            "proposal": dict(zip(names, self.proposal.tolist(), strict=True)),
            "proposal_sd": None if sd is None else dict(zip(names, sd.tolist(), strict=True)),
            "share_beyond": self.share_beyond,
            "in_family": self.in_family,
            "contradicted": contradicted,
            "fallback": fallback,
            "text": self._text(contradicted, fallback, elsewhere),
        }

    def _text(self, contradicted: bool | None, fallback: bool, elsewhere: bool) -> str | None:
        said = []
        if len(self.used) > self.entries:
            said.append(
                f"{len(self.used)} rounds were made with {self.entries} episodes, taken in turn again."
            )
        if left_out := self.logged.left_out:
            said.append(
                f"{left_out} of {left_out + self.entries} fitted windows begin no round, which lasts "
                f"{self.logged.task.point_times[-1]:g} s: it would go "
                "beyond what is fitted, or the one before goes on there."
            )
        if effects := self.logged.task.effects:
            names = ", ".join(placed.name for placed, _ in effects)
            said.append(f"The model has {names} as in the histories of the identifier, in the fit as well.")
        if is_of_another(self.checkpoint.record.histories, self.logged.task.model):
            said.append(
                "The identifier was trained on histories of another model, or of this one before it was changed: what "
                "it proposes is of that."
            )
        if not self.in_family:
            said.append(
                "The log lies outside of what the identifier was trained on: other actions, a machine beyond its "
                "ranges, or something that the model lacks."
            )
        elif contradicted:
            said.append("The fit contradicts what the identifier proposed.")
        if elsewhere:
            said.append(
                "Physics was asked from several places: the proposal led to no fit that explains the log."
            )
        elif fallback:
            said.append(
                "No fit with the initial states that the actions give explained the log, so these were fitted as well."
            )
        elif not self.in_family or contradicted:
            said.append("The fit through the simulator, which explains the log, has the say.")
        return " ".join(said) or None


def named(path: Path) -> str:
    """A checkpoint's path as it was given, or of one that is shipped, in the package."""
    package = Path(capture_cli.__file__).parent
    return path.relative_to(package.parent).as_posix() if path.is_relative_to(package) else str(path)


def walk_log(
    chosen: ChosenIdentifier,
    logged: LoggedRounds,
    start: np.ndarray,
    options: IdentifyOptions,
    engine: Engine,
    progress: Progress,
) -> InContext:
    """Identify in rounds over the log from start (parameter,); its entries are taken in turn, again if they are few."""
    checkpoint, before = chosen.checkpoint, logged.before
    rounds = min(len(logged), SETTINGS.rounds) if options.rounds is None else options.rounds
    used = np.arange(rounds) % len(logged)
    simulator = Simulator(logged.task, engine=engine)
    signature = Signature.of(logged.task)
    identifier = checkpoint.kind(
        signature,
        start[None],
        model=checkpoint.model,
        rough=True,
        simulate=simulator.trajectories,
        seed=options.seed,
    )
    if before is not None:
        _check_readable(before, signature, chosen.path)
        identifier.recall(before)
    walk = run_rounds(
        identifier,
        rounds,
        act=lambda number, _: logged.actions[used[number], None],
        measure=lambda number, _: logged.measured[used[number], None],
        simulate=simulator.trajectories,
        on_round=lambda number: progress.part("round in context", number, rounds),
    )
    family = checkpoint.model.family.with_noise(checkpoint.noise_beyond(logged.noise_sd))
    made = walk.rounds if before is None else before.followed_by(walk.rounds)
    beyond = float(family.share_beyond(made)[0])
    return InContext(checkpoint, chosen.path, walk, used, logged, beyond)


def _check_readable(earlier: Rounds, signature: Signature, path: Path) -> None:
    """Raise OptionError where the rounds made before are of other actions or points than the identifier reads."""
    found = (earlier.actions.shape[2], *earlier.measured.shape[2:])
    wanted = (len(signature.actions), *signature.trajectory_shape)
    if found != wanted:
        raise OptionError(
            f"--resume: the rounds before have (actions, points, features) = {found}, and {path} reads {wanted}",
            cure="go on with the identifier they were made with, or identify anew with --force",
        )
