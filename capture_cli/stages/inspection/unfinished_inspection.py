"""What a run that was interrupted has left beside its output (`.NAME.unfinished`), and how to go on."""

from pathlib import Path

from capture_cli.context.checkpoints.training_state import METRICS, read_state
from capture_cli.errors import StoreError
from capture_cli.log.checks.base import warning
from capture_cli.stages.evaluation.evaluation_run import PARTS, RECIPE
from capture_cli.stages.search_checkpoint import STEPS
from capture_cli.store.histories import HistoriesWriter
from capture_cli.store.inspection import Inspection
from capture_cli.store.output import NEW, UNFINISHED

GO_ON = "go on with the command that began it and --resume, or begin anew with --force"
ANEW = "begin anew with the command that began it and --force"


def is_unfinished(path: Path) -> bool:
    """Whether the folder at `path` is that of an unfinished run."""
    return path.is_dir() and path.name.startswith(".") and path.name.endswith(UNFINISHED)


def inspect_unfinished(path: Path, seen: Inspection) -> None:
    """Fill the inspection of the folder at `path` in. Raises StoreError where what it holds is damaged."""
    out = path.with_name(path.name.removeprefix(".").removesuffix(UNFINISHED))
    seen.result = {"out": str(out)}
    for described in (_training, _evaluation, _diagnosis, _histories):
        found = described(path, seen)
        if found is not None:
            break
    else:
        found = "run, which has kept nothing", ANEW
    what, cure = found
    seen.findings.append(warning(path.name, f"an unfinished {what}", cure))


def _training(path: Path, seen: Inspection) -> tuple[str, str] | None:
    """What it is, and the cure; None where it is no training. The functions below do the same for other runs."""
    state = read_state(path)
    if state is None:
        return ("training, which has kept nothing yet", ANEW) if (path / METRICS).is_file() else None
    recipe, counters, _ = state
    try:
        last, steps = counters["metrics"][-1], recipe["training"]["steps"]
        seen.task = recipe["task"]
        seen.result |= {
            "command": "train-sysid" if "identifier" in recipe else "train-policy",
            "recipe": recipe,
            "last_evaluation": last,
        }
        return f"training, kept up to step {last['step']} of {steps}", GO_ON
    except (KeyError, IndexError, TypeError) as error:
        raise StoreError(f"{path} cannot be read: {type(error).__name__}: {error}", cure=ANEW) from error


def _evaluation(path: Path, seen: Inspection) -> tuple[str, str] | None:
    if not (path / RECIPE).is_file():
        return None
    kept = [p.name for p in sorted((path / PARTS).glob("*")) if p.is_dir() and p.suffix != NEW]
    seen.result |= {"command": "eval-sim2sim", "parts": kept}
    return f"evaluation, of which {len(kept)} parts are kept", GO_ON


def _diagnosis(path: Path, seen: Inspection) -> tuple[str, str] | None:
    if not (path / STEPS).is_dir():
        return None
    kept = len(list((path / STEPS).glob("*.safetensors")))
    seen.result |= {"command": "diagnose", "steps_kept": kept}
    return f"diagnosis, of which {kept} steps are kept", GO_ON


def _histories(path: Path, seen: Inspection) -> tuple[str, str] | None:
    writer = HistoriesWriter(str(path))
    attributes = writer.attributes()
    if attributes is None:
        return None
    marked = writer.is_written()
    seen.task = attributes["task"]
    seen.header(attributes)
    shards = {"shards": len(marked), "shards_kept": int(marked.sum())}
    seen.result |= {"command": "gen-histories", "pairs": attributes["pairs"], **shards}
    done = f"{shards['shards_kept']} of {len(marked)} shards"
    return f"gen-histories, of whose {attributes['pairs']} histories {done} are kept", GO_ON
