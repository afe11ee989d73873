"""`capture export`: its options, and what it prints."""

from dataclasses import dataclass
from pathlib import Path

from capture_cli.cli._results import print_json
from capture_cli.common.warn import warn
from capture_cli.options.base import option
from capture_cli.options.shared import OptionalTask, Result, Writing


@dataclass(frozen=True, kw_only=True)
class ExportOptions(Writing):
    """task: where it is now, if it was moved since."""

    result: Result
    out: Path = option(..., "MJCF file to write.")
    task: OptionalTask = None


def export(options: ExportOptions) -> None:
    """Write the model with its identified values and effects as an MJCF that MuJoCo loads.

    Effects for which MuJoCo has no feature, and terms of a formula, go to a Python module beside it, STEM_effects.py.

    Example: capture export run.estimate --out identified.xml
    """
    from capture_cli.stages.export import export as stage

    result, out, quiet = options.result, options.out, options.quiet
    written = stage(result=result, out=out, task=options.task, force=options.force)
    if written.verdict in ("unexplained", "not-identifiable") and not quiet:
        warn(f"{result} is {written.verdict!r}. {written.summary}")
    if options.json_:
        beside = {"companion": str(written.companion)} if written.companion else {}
        print_json({"model": str(written.model), **beside})
    elif not quiet:
        print(f"{out}: written; load it with mujoco.MjModel.from_xml_path({str(out)!r})")
        if written.companion:
            print(
                f"{written.companion}: written; it applies {', '.join(written.effects)} (see its first lines)"
            )
