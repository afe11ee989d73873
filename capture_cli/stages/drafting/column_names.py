"""Which column of a log is which channel? By the words in their names alone, one column for one channel."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    least: float = 0.5  # of the words of a channel's name, how many a column has to have


COMMAND, EFFORT, POSITION, VELOCITY = "command", "effort", "position", "velocity"
# Words by which loggers say what a column is
WORDS = {
    COMMAND: "action cmd command commanded control ctrl des desired goal input ref reference setpoint target u",
    EFFORT: "amp amps current effort force mnm nm pwm tau torque trq volt voltage volts",
    POSITION: "angle actual enc encoder measured meas pos position q qpos state theta",
    VELOCITY: "dq gyro omega qd qvel rate rpm speed vel velocity",
}
ROLE_OF = {word: role for role, words in WORDS.items() for word in words.split()}
AXES = "wxyz"
TIMES = ("t", "time", "timestamp", "stamp", "datetime", "sec", "secs", "seconds")
# Of columns that no other word tells of, by the units that their names end in: per s, or as it is
PER_SECOND, OF_POSITIONS = ("s", "sec"), ("deg", "degrees", "m", "mm", "rad")
# Words that say nothing: units, and what every channel is of
IDLE = "a actuator deg joint m motor mm ms n observation rad s sensor servo us v"


@dataclass(frozen=True)
class Wanted:
    """A value that looks for its column. names: of what it belongs to. roles: a column that says what it is says one of
    these; of several the first is the best. axis: of several values, which it is, as the end of a name.
    """

    names: tuple[str, ...]
    roles: tuple[str, ...]
    axis: str = ""


def words(name: str) -> list[str]:
    """The words of a name, in lower case, and its numbers: jointPos1_rad has joint, pos, 1, rad."""
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    return re.findall(r"[a-z]+|\d+", parted.lower())


def time_column(columns: Sequence[str]) -> str | None:
    """The column that says the time, in its first word if one does; None where none does."""
    first = next((c for c in columns if (words(c) or [""])[0] in TIMES), None)
    return first or next((c for c in columns if any(w in TIMES[1:] for w in words(c))), None)


def matched(wanted: Sequence[Wanted], columns: Sequence[str]) -> list[str | None]:
    """The column of each channel that is wanted, None where none looks like it."""
    from scipy.optimize import linear_sum_assignment

    found: list[str | None] = [None] * len(wanted)
    scores = np.array([[_score(w, column, wanted, columns) for column in columns] for w in wanted])
    if not scores.size:
        return found
    for row, column in zip(*linear_sum_assignment(scores, maximize=True), strict=True):
        if scores[row, column] > 0:
            found[row] = columns[column]
    return found


def _score(wanted: Wanted, column: str, others: Sequence[Wanted], columns: Sequence[str]) -> float:
    """How much a column looks like a channel; 0 where it is another thing."""
    roles = _roles(column)
    if roles and (not roles & set(wanted.roles) or (COMMAND in roles and COMMAND not in wanted.roles)):
        return 0.0
    rank = min(
        (wanted.roles.index(role) for role in roles if role in wanted.roles), default=len(wanted.roles)
    )
    said = 1 / (2 + rank)
    if any(column == name for name in wanted.names):
        return 2 + said
    shared = max((_shared(own, set(words(column))) for own in map(_own_words, wanted.names)), default=0.0)
    if shared >= SETTINGS.least:
        return shared + said
    alone = sum(w.roles == wanted.roles for w in others) == 1
    is_only = bool(roles) and sum(_roles(c) == roles for c in columns) == 1
    here, elsewhere = _places(words(column)), [_places(words(name)) for name in wanted.names]
    is_other = here and all(own and own != here for own in elsewhere)
    return said if alone and is_only and not is_other else 0.0


def _shared(own: set[str], of_column: set[str]) -> float:
    """The share of a channel's `own` words that a column has; 0 where they have other numbers or axes."""
    if not own or _places(own) != _places(of_column):
        return 0.0
    return len(own & of_column) / len(own)


def _own_words(name: str) -> set[str]:
    """The words of a name that tell it from others."""
    return {w for w in words(name) if w not in ROLE_OF and w not in IDLE.split()}


def _places(some: Iterable[str]) -> set[str]:
    """Numbers and axes."""
    return {word for word in some if word.isdigit() or word in AXES}


def _roles(column: str) -> set[str]:
    """By the words of its name, or the unit that it ends in."""
    own = words(column)
    if roles := {ROLE_OF[word] for word in own if word in ROLE_OF}:
        return roles
    is_rate = len(own) > 2 and own[-1] in PER_SECOND
    unit = own[-2] if is_rate else (own or [""])[-1]
    named = len(own) > 1 + is_rate  # `m` alone may be the name of a motor
    return {VELOCITY if is_rate else POSITION} if unit in OF_POSITIONS and named else set()
