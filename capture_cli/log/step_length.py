"""A time step that suits a log: neither so long that a window holds few of them, nor so short that none would wait."""

from capture_cli.common.frozen import frozen
from capture_cli.log.windows import SETTINGS as WINDOWS


@frozen
class SETTINGS:
    most_per_sample: int = 10_000  # steps: a simulation of a minute at 100 Hz takes as many minutes


def unsuitable_step(timestep: float, interval: float, lasts: float) -> tuple[str, str] | None:
    """The fault of steps of `timestep` s, and its cure; None where there is none.

    interval: s, between samples of the log. lasts: s, a window, or the longest episode where there are no windows.
    """
    if timestep * WINDOWS.fewest_in_window > lasts:
        return (
            f"the model steps by {timestep:g} s, and what is simulated at a time lasts {lasts:.3g} s",
            f"set a timestep of {interval:.2g} s, the log's own interval, or less in the model's <option>",
        )
    if timestep * SETTINGS.most_per_sample < interval:
        return (
            f"the model steps by {timestep:g} s, {interval / timestep:.3g} times from one sample of the log to the "
            f"next, {interval:.3g} s on",
            f"set a timestep of more than {interval / SETTINGS.most_per_sample:.2g} s in the model's <option>; "
            "machines have 1e-4 to 0.01",
        )
    return None
