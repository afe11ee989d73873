"""What an effect is: something the model lacks, at a site of the model, with parameters that can be null.

An effect acts in one of four places, and overrides the one method of that place:

    model        `write`    sets fields of the model, as a native MuJoCo feature
    force        `force`    adds a state-dependent force at every step, over the whole batch
    control      `drive`    changes the controls before they reach the actuators
    measurement  `measure`  changes what the sensors report

Its parameters are amplitudes and shapes. At the null values of the amplitudes the simulation is exactly the
one without the effect, bit by bit, whatever the shapes are. An effect without parameters is there or is not.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from inspect import cleandoc
from typing import ClassVar, Self

import mujoco
import numpy as np

from capture_cli.errors import ModelError, did_you_mean
from capture_cli.log.fastest import fastest
from capture_cli.model.effects._kernel import Companion
from capture_cli.model.fields import ModelFields
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.world import Force

PLACES = ("model", "force", "control", "measurement")
GLOBAL = ""  # the site of an effect that concerns the model as a whole


@dataclass(frozen=True)
class JointMotion:
    """What a log saw of a joint: from where to where it went, and how fast; m or rad, and per s.

    path (step,): where it was at each step of the log, nan where that was not measured; stretches: of those steps,
    episodes or, as nobody knows what drove it in a gap, what is between gaps of one; noise: of the path, standard
    deviation. time (step,): s; controls: of actuators, by their numbers, (step,). begun, begun_sd (stretch,): how fast
    it was where each stretch was first measured, and how well that is known.
    """

    low: float
    high: float
    speed: float
    path: np.ndarray = field(default_factory=lambda: np.zeros(0))
    stretches: Sequence[slice] = ()
    noise: float = 0.0
    time: np.ndarray = field(default_factory=lambda: np.zeros(0))
    controls: Mapping[int, np.ndarray] = field(default_factory=dict)
    begun: np.ndarray = field(default_factory=lambda: np.zeros(0))
    begun_sd: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def travel(self) -> float:
        """Half of how far it went."""
        return (self.high - self.low) / 2


@dataclass(frozen=True)
class Recordings:
    """Which of a log's recordings each of its steps is of, (step,), and when it was, time (step,), s, by the clock of
    simulations. reference: the recording that most of what is fitted is of.
    """

    of_step: np.ndarray
    time: np.ndarray
    reference: int

    @cached_property
    def several(self) -> bool:
        """Whether there is more than one."""
        return bool(np.ptp(self.of_step))

    @cached_property
    def began(self) -> np.ndarray:
        """s: when the recording that each step is of did, (step,)."""
        _, first, which = np.unique(self.of_step, return_index=True, return_inverse=True)
        return self.time[first][which]


@dataclass(frozen=True)
class Driven:
    """What a log drives: time (step,), s; controls of actuators, by their numbers, (step,); episodes: of its steps."""

    time: np.ndarray
    controls: Mapping[int, np.ndarray]
    episodes: Sequence[slice]

    def episode_of(self, step: np.ndarray) -> np.ndarray:
        """The number of the episode that each step of the log is of."""
        return np.searchsorted([e.stop for e in self.episodes], step, side="right")

    def of_episode(self, number: int, actuator: int) -> tuple[np.ndarray, np.ndarray]:
        """Time since the episode began, s, and the control of the actuator, 0 where the log has none, (step,) each."""
        own = self.episodes[number]
        time = self.time[own]
        controls = self.controls.get(actuator)
        return time - time[0], np.zeros(len(time)) if controls is None else controls[own]


@dataclass(frozen=True)
class Reports:
    """What a log has of sensors: time (step,), s; values (step, column of sensordata), nan where there is none.

    stretches: as of JointMotion; noise (column,): of the values, standard deviation.
    """

    time: np.ndarray
    values: np.ndarray
    stretches: Sequence[slice]
    noise: np.ndarray

    @cached_property
    def speeds(self) -> np.ndarray:
        """The largest speed of each column, per s, (column,); 0 where there is none."""
        columns = zip(self.values.T, self.noise, strict=True)
        return np.array([fastest(path, self.time, self.stretches, sd) for path, sd in columns])


@dataclass(frozen=True)
class SeenLog:
    """The log that effects are looked for in. window: s, for how long it is followed at a time; longest: s, of the
    longest episode; logged: the columns of sensordata that it has; seen: the motion of each joint, by its number, whose
    position they say; reports: what is in those columns; driven: its controls. recordings: None where nobody says, as
    if all were one.
    """

    window: float
    longest: float
    logged: frozenset[int]
    seen: Mapping[int, JointMotion]
    recordings: Recordings | None = None
    reports: Reports | None = None
    driven: Driven | None = None


class Effect(ABC):
    """An effect at `site` of `model`. Class attributes:

    place: one of PLACES. summary, where: one line each for tables: what it is, and which sites there are.
    shapes: names of the parameters that say what the effect looks like (a period, a position). They mean
        nothing while the amplitudes, which are all the others, are null: a score at null has to be taken at
        several of their values.
    shares: names of parameters at whose ends a machine may be: those that are shares of a whole are none or all of it.
    mixes: whether next to null several of it, each of one amplitude and a shape of its own, do what one does: it has a
        `mixture`, and is scored with an amplitude at each shape of the grid at once, too.
    vague_at_end: names of shapes at whose ends it imitates what it is not: a fit that ends there says nothing, however
        well it does.
    narrow_shape: whether a score at null has peaks along its one shape that a handful of values would miss: those of a
        PeriodicForce are as narrow as one over the span of the log.
    shows_at_rest: whether what it does shows where joints rest, of which the force balance has no rows.
    has_threshold: whether next to null it may do nothing, or next to nothing: a limit that little comes near.
    difference_step: the least share of a parameter's range that finite differences take where the effect is in the
        model; 0 where its motion does not jump at the smallest change.
    substeps: steps that the model takes, where the effect is in it, for each of its own.
    states: names of what the effect keeps from step to step that no sensor shows: how far a spring is wound up. At
        the start of a simulation each is 0 where nothing else is said, and commonly within 1.
    kernel_keeps: of place "force": attributes of its kernel that go from step to step, numbers each; "a.b" is one of
        an attribute. With these and the state of the model a step is the same as in the midst of a simulation.
    states_mean: what each of them is at 1, with its unit, for docs/effects.md.
    remembers: of place "control": the controls before a window that still show in it, as `memory` has them, for
        docs/effects.md; empty where none do.
    states_before: whether the states are what was before an episode began: known where a simulation begins inside one.
    reads_acceleration: whether its force follows the acceleration. Of several forces such are added last, so that, as a
        simulation begins, they know what the others do, in whatever order the effects are named.
    reads_actuators: whether it has a `pick_up`, for which a simulation keeps what its actuators give.
    reports_late: whether it has a `lateness`, for which a simulation begins before its window.
    number_by_number: whether it has a parameter for each of a sensor's numbers, of those alone that a log has.
    formula_term: its text where it is a term of a formula: terms at one joint are no places of one law.
    window, longest, logged: of the log that it is looked for in, see `SeenLog`; None where in no log.
    states_tried: points (point, state) among which those that a simulation began with are looked for, where a descent
        from 0 can miss them; none where it finds them.
    states_anywhere: whether 0 is no better a guess of its states than any other: a fit begins with the best of those
        tried.
    states_scored: points (point, state), the same in all windows, at which a score at null is taken: what an integral
        held before the log began shows more than what it did since.
    """

    place: ClassVar[str]
    summary: ClassVar[str]
    where: ClassVar[str]
    shapes: ClassVar[tuple[str, ...]] = ()
    shares: ClassVar[tuple[str, ...]] = ()
    mixes: ClassVar[bool] = False
    vague_at_end: ClassVar[tuple[str, ...]] = ()
    narrow_shape: ClassVar[bool] = False
    shows_at_rest: ClassVar[bool] = False
    has_threshold: ClassVar[bool] = False
    difference_step: ClassVar[float] = 0.0
    states: tuple[str, ...] = ()
    kernel_keeps: ClassVar[tuple[str, ...]] = ()
    states_mean: ClassVar[str] = ""
    remembers: ClassVar[str] = ""
    states_before: ClassVar[bool] = False
    states_tried: np.ndarray = np.zeros((0, 0))
    states_anywhere: ClassVar[bool] = False
    formula_term: str = ""
    states_scored: ClassVar[np.ndarray] = np.zeros((1, 0))
    reads_acceleration: ClassVar[bool] = False
    reads_actuators: ClassVar[bool] = False
    reports_late: ClassVar[bool] = False
    number_by_number: ClassVar[bool] = False
    substeps: int = 1
    window: float | None = None
    longest: float | None = None
    logged: frozenset[int] | None = None

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        """Raises ModelError, naming those there are, where `site` is no site of this effect."""
        sites = self.sites(model)
        if site not in sites:
            kind = type(self).__name__
            if not sites:
                raise ModelError(f"the model has no place for {kind}", cure=f"it sits at {self.where}")
            raise ModelError(f"{kind} cannot sit at {site!r}", cure=did_you_mean(site, sites))
        self.model = model
        self.site = site

    @classmethod
    def law(cls) -> str:
        """What its parameters do, as a formula where it has one: its own docstring."""
        return cleandoc(cls.__doc__ or "")

    def look_in(self, log: SeenLog) -> None:
        """What the log that it is looked for in is like, from which ranges of parameters follow."""
        self.window, self.longest, self.logged = log.window, log.longest, log.logged

    @property
    def variant_of(self) -> str:
        """The site of which its own is one variant, by which sensors show what; its own where there is none."""
        return self.site

    @property
    def shows(self) -> bool:
        """Whether it could show in the log that it looks in: not where that lacks the sensors that it changes.

        One that changes the motion, too, needs all of those: without them it is another place of it.
        """
        return (
            bool(self.logged & self.reported) if self.place == "measurement" else self.reported <= self.logged
        )

    @classmethod
    @abstractmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        """Where in `model` the effect can sit; [GLOBAL] where it concerns the model as a whole.

        Names of joints, tendons, bodies, geoms, actuators or sensors; "#3" is the fourth of its kind where that has no
        name.
        """

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters, each with the null value as its nominal."""

    @property
    def space(self) -> ParameterSpace:
        return ParameterSpace(self.parameters)

    def shape_grid(self, count: int = 5) -> np.ndarray:
        """Points (point, parameter) with null amplitudes and `count` values of each shape: where to score.

        Values of a shape that is positive are spread evenly in its logarithm.
        """
        if not self.parameters:
            return np.zeros((1, 0))
        axes = [spread(p, count) if p.name in self.shapes else [p.nominal] for p in self.parameters]
        return np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=-1)

    def mixture(self, shapes: np.ndarray, amplitudes: np.ndarray) -> np.ndarray | None:
        """Values (parameter,) that do what several at `shapes` (point, parameter) do whose `amplitudes` (point,) are
        these, in units of their range; None where none do.
        """
        return None

    @classmethod
    def of_one_recording(cls, name: str) -> bool:
        """Whether the parameter `name` says how one recording of a log began: it means nothing without that log."""
        return False

    def coefficients(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """What the effect's kernel, where it has one, takes by keyword, (simulation,) each, from `values` (simulation,
        parameter).
        """
        return dict(zip(self.space.names, values.T, strict=True))

    def numbers(self, values: np.ndarray) -> dict[str, np.ndarray | float]:
        """The same of one simulation, from `values` (parameter,)."""
        return {name: v[0] for name, v in self.coefficients(values[None]).items()}

    def doubt(self, values: np.ndarray, duration: float) -> str | None:
        """Why `values` (parameter,) cannot be believed from episodes of `duration` s, or None."""
        return None

    def write(self, fields: ModelFields, values: np.ndarray) -> None:  # noqa: B027
        """Place "model": set fields from `values` (simulation, parameter), on top of what is there."""

    def force(
        self,
        values: np.ndarray,
        timestep: float,
        *,
        states: np.ndarray | None = None,
        began: np.ndarray | float = 0.0,
        first: np.ndarray | None = None,
        late: np.ndarray | None = None,
    ) -> Force | None:
        """Place "force": a fresh force with the coefficients `values` (simulation, parameter).

        The force is called on chunks: it indexes its coefficients, and any state it keeps, with `world.rows`.
        states (simulation, state): what its own states begin with; 0 where None. began (simulation,): when the episodes
        did, s, by the clock of the simulation. first (simulation,): the step of the log that each begins at; None where
        there is no log. late (simulation, nv): how long after that, s, the log shows each coordinate as it is then; not
        at all where None.
        """
        return None

    def states_sd(self, first: np.ndarray) -> np.ndarray:
        """How far from 0 its states commonly are where simulations begin at the steps `first` of the log, (simulation,
        state): a standard deviation, 0 of one that cannot matter there.
        """
        return np.ones((len(first), len(self.states)))

    def eased(self) -> Self | None:
        """The effect with states that are less bound to the log before, for a descent to come from farther; None where
        they are free.
        """
        return None

    def fitted_to(self, first: np.ndarray) -> Self:
        """The effect with what is known of it where it was fitted to simulations that begin at the steps `first`
        (simulation,) of the log: itself.
        """
        return self

    def first_step(self) -> int:
        """The step of the log that its time counts from."""
        return 0

    def by_recording(self, sensitivity: np.ndarray, values: np.ndarray, first: np.ndarray) -> np.ndarray:
        """What a score at null is taken of, (simulation, row, amplitudes), those of the reference first: `sensitivity`
        (simulation, row, amplitude), or several times as many where recordings have amplitudes of their own.

        values (parameter,); first (simulation,): the step of the log that each begins at.
        """
        return sensitivity

    def drive(
        self,
        controls: np.ndarray,
        values: np.ndarray,
        timestep: float,
        *,
        elapsed: np.ndarray | float = 0.0,
        first: np.ndarray | None = None,
    ) -> np.ndarray:
        """Place "control": ctrl (simulation, grid, nu), on the model's grid, as the actuators receive it.

        elapsed (simulation,): s, since the episode began, at the first control. first (simulation,): the step of the
        log that each simulation begins at; None where there is no log.
        """
        return controls

    def memory(self, values: np.ndarray) -> float:
        """Place "control": for how long, in s, a control still shows at `values` (simulation, parameter)."""
        return 0.0

    def before(self, states: np.ndarray) -> np.ndarray | float:
        """By how much controls before an episode began, which no log has, differed from its first.

        (simulation, nu), at `states` (simulation, state); it is taken to have been for ever.
        """
        return 0.0

    def pick_up(self, sensors: np.ndarray, values: np.ndarray, actuator_force: np.ndarray) -> np.ndarray:
        """Place "measurement": sensordata (simulation, grid, column) with what sensors show of the forces of actuators
        (simulation, grid, actuator), N or N m, before any effect on what is reported.
        """
        return sensors

    @property
    def most_picked_up(self) -> np.ndarray:
        """The largest size of what `pick_up` adds to each column of sensordata, (column,): an initial state that was
        read off the sensor may be as far off, for `true_motion` does not know the force.
        """
        return np.zeros(self.model.nsensordata)

    def measure(
        self,
        sensors: np.ndarray,
        values: np.ndarray,
        timestep: float,
        *,
        states: np.ndarray | None = None,
        elapsed: np.ndarray | float = 0.0,
        first: np.ndarray | None = None,
    ) -> np.ndarray:
        """Place "measurement": sensordata (simulation, grid, column), on that grid, as it is reported.

        states (simulation, state): what its own states begin with; 0 where None. elapsed (simulation,): s, since the
        episode began, at the first point of the grid. first (simulation,): the step of the log that each begins at;
        None where there is no log.
        """
        return sensors

    @property
    def reported(self) -> frozenset[int]:
        """The columns of sensordata that it changes, apart from the motion."""
        return frozenset()

    def drift(self, values: np.ndarray, elapsed: np.ndarray) -> np.ndarray:
        """Place "measurement": how far in s, (simulation,), the sensors' clock is behind that of the controls.

        elapsed (simulation,): s, since the episode began, by the sensors' clock.
        """
        return np.zeros(len(values))

    def lateness(self, values: np.ndarray, elapsed: np.ndarray | float = 0.0) -> np.ndarray | float:
        """Place "measurement": how late, in s, each column of sensordata is reported, (simulation, column), and no more
        than MOST_LATE either way: below 0 where it is ahead. What else the effect does to the numbers it does not say
        here. elapsed (simulation,): s, since the episode began.
        """
        return 0.0

    def true_motion(
        self, derivatives: np.ndarray, values: np.ndarray, elapsed: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Place "measurement": how the sensors' numbers moved in truth where they were reported with `derivatives`.

        derivatives (simulation, 3, column): value, slope and curvature of each column of sensordata at the start of a
        simulation, per s and s^2; elapsed (simulation,): s, since the episode began. A start that was read off the
        sensors is corrected by it. As it is where the effect does not shift what is reported, or not in a way that can
        be undone.
        """
        return derivatives

    def companion(self, name: str, values: np.ndarray) -> Companion:
        """Places other than "model": how a plain loop applies the effect at `values` (parameter,).

        name: what the effect is called at its site. Raises ModelError where it can only be simulated here.
        """
        raise ModelError(
            f"{name} acts on the {self.place} and cannot be exported: it has no companion",
            cure="simulate it with `capture record --effect`, or export a diagnosis without it",
        )

    @classmethod
    def exported_as(cls) -> str:
        """How `capture export` writes the effect: "MJCF", "companion", or "" where it cannot."""
        if cls.place == "model":
            return "MJCF"
        return "" if cls.companion is Effect.companion else "companion"


def spread(parameter: Parameter, count: int) -> np.ndarray:
    """`count` values inside the range of `parameter`, none at its ends."""
    at = (np.arange(count) + 0.5) / count
    if parameter.low > 0:
        return parameter.low * (parameter.high / parameter.low) ** at
    return parameter.low + at * parameter.span


def raised(own: np.ndarray, change: np.ndarray) -> np.ndarray:
    """own + change, kept from passing below zero: friction and damping never drive."""
    return np.maximum(own + change, np.minimum(own, 0.0))


AtValues = tuple[Effect, np.ndarray]  # an effect, and its values (parameter,)
