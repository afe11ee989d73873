"""What the paper reports, to stand beside what was measured here.

Xilun Zhang, Shiqi Liu, et al.: Dynamics as Prompts: In-Context Learning for Sim-to-Real System Identifications,
Table II (air hockey, sim-to-sim, trajectory difference in m over three seeds), Tables III and IV (sim-to-real, which
stand beside worlds) and the text of Section IV-C. The figures have no numbers of their own, and are not read off.
"""

from collections.abc import Mapping
from typing import Any

_PAPER = "Zhang, Liu et al., Dynamics as Prompts"
SOURCE = {  # of what stands beside machines in the plant, and in a world
    "plant": f"{_PAPER}, Table II",
    "robosuite": f"{_PAPER}, Table IV: 15 runs on a real table",
}
SUCCESS_SOURCE = f"{_PAPER}, Table III: mean of three real objects, ten runs each"
ROUNDS = (5, 10, 15, 20, 30)
REAL_ROUNDS = (1, 3, 5, 7, 9)

# (identifier, search of its histories) -> (mean, sd) of the trajectory difference at ROUNDS, m
_AIR_HOCKEY = {
    ("expert-distillation", None): ((0.25, 0.01), (0.26, 0.03), (0.27, 0.02), (0.27, 0.01), (0.26, 0.01)),
    ("domain-randomization", None): ((0.34, 0.03), (0.31, 0.02), (0.34, 0.04), (0.31, 0.03), (0.33, 0.00)),
    ("tunenet", None): ((0.29, 0.02), (0.27, 0.01), (0.27, 0.01), (0.26, 0.01), (0.25, 0.02)),
    ("capture", "linear-interpolation"): (
        (0.22, 0.02),
        (0.23, 0.01),
        (0.26, 0.03),
        (0.24, 0.02),
        (0.22, 0.01),
    ),
    ("capture", "binary"): ((0.20, 0.01), (0.17, 0.01), (0.16, 0.02), (0.17, 0.01), (0.18, 0.01)),
    ("capture", "randomized-binary"): ((0.20, 0.01), (0.16, 0.01), (0.14, 0.01), (0.14, 0.01), (0.15, 0.01)),
}
# Table IV: identifier -> (mean, sd) on the real table at REAL_ROUNDS, m
_REAL_AIR_HOCKEY = {
    "expert-distillation": ((0.40, 0.19), (0.34, 0.14), (0.51, 0.44), (0.34, 0.15), (0.34, 0.14)),
    "domain-randomization": ((0.41, 0.27), (0.40, 0.10), (0.37, 0.33), (0.42, 0.42), (0.43, 0.40)),
    "tunenet": ((0.47, 0.22), (0.40, 0.11), (0.32, 0.21), (0.38, 0.16), (0.34, 0.15)),
    "capture": ((0.47, 0.18), (0.35, 0.14), (0.35, 0.12), (0.29, 0.10), (0.27, 0.10)),
}
# Table III: identifier -> success at REAL_ROUNDS with eggplant, celery and carrot
_REAL_SCOOPING = {
    "expert-distillation": ((0.8, 0.5, 0.3, 0.2, 0.1), (0.0, 0.1, 0.3, 0.1, 0.2), (0.0, 0.8, 0.5, 0.5, 0.6)),
    "domain-randomization": ((0.9, 0.9, 1.0, 0.9, 0.9), (0.0, 0.2, 0.0, 0.1, 0.0), (0.0, 0.1, 0.0, 0.1, 0.0)),
    "tunenet": ((0.9, 0.9, 0.7, 0.6, 0.4), (0.0, 0.1, 0.3, 0.1, 0.1), (0.0, 0.9, 0.8, 0.5, 0.4)),
    "capture": ((0.3, 0.6, 0.9, 0.9, 0.9), (0.0, 0.4, 0.6, 0.7, 0.7), (0.3, 0.7, 0.9, 0.9, 0.9)),
}
# in words, by task
SAID = {
    "air-hockey": "The paper, Section IV-C: capture at a normalised parameter difference of about 0.2 after 7 rounds, "
    "baselines at 0.35 for most parameters",
    "scooping": "The paper, Section IV-C: capture finds the centre of mass after around 4 rounds, and succeeds 50 % "
    "more often than other identifiers, 70 % more often than domain randomisation",
}


def trajectory_difference(
    task: str, noise: str, about: Mapping[str, Any], world: str = "plant"
) -> dict[int, tuple[float, float]] | None:
    """The paper's (mean, sd) by round for an identifier of evaluation.json; None where it has none."""
    if task != "air-hockey" or noise != "none" or not _as_in_paper(about):
        return None
    if world != "plant":
        found = _REAL_AIR_HOCKEY.get(about["identifier"])
        return found and dict(zip(REAL_ROUNDS, found, strict=True))
    for key in ((about["identifier"], about.get("search")), (about["identifier"], None)):
        if key in _AIR_HOCKEY:
            return dict(zip(ROUNDS, _AIR_HOCKEY[key], strict=True))
    return None


def success(task: str, noise: str, about: Mapping[str, Any], world: str) -> dict[int, float] | None:
    """The paper's, mean of its objects, by round for an identifier in a world; None where it has none."""
    if (task, noise) != ("scooping", "none") or world == "plant" or not _as_in_paper(about):
        return None
    found = _REAL_SCOOPING.get(about["identifier"])
    if found is None:
        return None
    means = (sum(values) / len(values) for values in zip(*found, strict=True))
    return dict(zip(REAL_ROUNDS, means, strict=True))


def _as_in_paper(about: Mapping[str, Any]) -> bool:
    return about.get("history_rounds", 7) == 7 and about.get("window", 4) in (1, 4)
