"""One case from beginning to end: made once and stored, diagnosed, scored, one small JSON.

The processes call this.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benches.bank.store import JUDGING, Kept, Task, name_of

if TYPE_CHECKING:
    from softmap_edge.run.run import Run

# a case, the folders of cases and of rows, the digest of the scoring code
Job = tuple[Task, str, str, str]


def kept(task: Task, out: Path) -> Path:
    """Return the file of a scored case."""
    return out / f"{name_of(task)}.json"


def code() -> str:
    """Return a digest of diagnosis and scoring: cases of other code are scored again."""
    import softmap_edge

    digest = hashlib.sha256()
    package = Path(softmap_edge.__file__).parent
    paths = [
        Path(__file__).with_name(name)
        for name in JUDGING
        if Path(__file__).with_name(name).exists()
    ]
    paths += sorted(package.glob("**/*.[ps][yo]")) + sorted((package / "data").glob("**/*.*"))
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def decided(constants: str) -> None:
    """Set constants of the decision in this process, `FORM=0.1,LEFT=0.2`.

    Raises:
        ValueError: decision.py has no such constant, or its value is not a number.
    """
    from softmap_edge.diagnosis import decision

    for one in filter(None, constants.split(",")):
        name, _, value = one.partition("=")
        if not name.isupper() or not isinstance(getattr(decision, name, None), float):
            raise ValueError(
                f"decision.py has no constant '{name}'; give NAME=VALUE, as in FORM=0.1"
            )
        try:
            setattr(decision, name, float(value))
        except ValueError:
            raise ValueError(
                f"{name} is '{value}', which is not a number; give NAME=VALUE, as in FORM=0.1"
            ) from None


def make(job: Job) -> dict[str, Any]:
    """Make a case if it is missing; return its name, and the failure if any."""
    from benches.bank.make import made

    task, cases = job[0], Path(job[1])
    try:
        case = Kept(cases / name_of(task))
        case = case if case.is_current else made(task, cases)
    except Exception as error:  # one case must not stop a thousand others
        return {"case": name_of(task), "failed": f"{type(error).__name__}: {error}"[:300]}
    return {
        "case": name_of(task),
        "hidden": case.truth["hidden"],
        "seconds": case.truth["truth_seconds"],
    }


def work(job: Job) -> dict[str, Any]:
    """Make a case if it is missing, and score it.

    A failure is written into its row, and the case is tried again.
    """
    row = make(job)
    return written(row, job) if "failed" in row else judge(job)


def judge(job: Job) -> dict[str, Any]:
    """Score a case that was made, and write its row."""
    task, cases = job[0], Path(job[1])
    try:
        row = judge_case(Kept(cases / name_of(task)))
    except Exception as error:  # one case must not stop a thousand others
        row = {"case": name_of(task), "failed": f"{type(error).__name__}: {error}"[:300]}
    return written(row, job)


def written(row: dict[str, Any], job: Job) -> dict[str, Any]:
    """Write a row, marked with the digest of the scoring code, and return it."""
    task, _, out, judged_by = job
    row = row | dict(zip(("seeds", "slice", "level", "kind", "number"), task)) | {"code": judged_by}
    path = kept(task, Path(out))
    half = path.with_suffix(f".{os.getpid()}.part")
    half.write_text(json.dumps(row) + "\n", encoding="utf-8")
    half.replace(path)
    return row


def judge_case(case: Kept) -> dict[str, Any]:
    """Diagnose a case that was made, and score the diagnosis."""
    if case.truth["slice"] == "learned":
        from benches.bank.judge_learned import judge_learned

        return judge_learned(case)
    return judge_modelled(case)


def judge_modelled(case: Kept) -> dict[str, Any]:
    """Diagnose a case with the model of its body, and score it."""
    from benches.bank.bodies import body_of
    from benches.bank.judge import alike, judged
    from benches.bank.judge_family import by_family, names_alike
    from softmap_edge import _core
    from softmap_edge.diagnosis.diagnose import diagnose

    truth, run = case.truth, case.run()
    hidden, kind = truth["hidden"], truth["kind"]
    model = body_of(truth["slice"]).model()
    registry = _core.effects()
    library = [e["name"] for e in registry if kind != "removed" or e["name"] not in hidden]
    expressible = {e["name"] for e in registry if not model.missing_for(e["name"])}
    started = time.process_time()
    first = diagnose(model, run, effects=library)
    seconds = time.process_time() - started
    one, several = (
        names_alike(alike(registry, orientations, roll=not truth["clouds"]), truth)
        for orientations in (1, 2)
    )
    like = several if len(np.unique(run.gravity, axis=0)) > 1 else one
    verdict = judged(hidden, first.to_dict(), like, expressible, truth["also"])
    last = first
    if kind == "rivals":
        last = diagnose(model, [run, case.run("whole")], effects=library)
        verdict = judged(hidden, last.to_dict(), several, expressible, truth["also"]) | {
            "at_first": verdict
        }
        like = several
    error, fall = (None, None) if "judge" not in case.runs else fallen(case, model, first.model)
    return {
        **truth,
        **verdict,
        **by_family(last.to_dict(), truth, like),
        "error_mm": error,
        "fall": fall,
        "frames": int(run.t_seen.size),
        "sentence": last.sentence,
        "ladder": last.to_dict()["error"],
        "unexplained": last.to_dict()["unexplained"],
        "seconds": round(seconds, 2),
    }


def off(model: Any, run: Run) -> float:
    """Return the RMS error (mm) of a model on the points of a run."""
    from benches.bank.watch import rms

    points = run.vertices if run.vertices is not None else run.markers
    return rms(model.predict(run) - points, run.visible)


def fallen(case: Kept, before: Any, after: Any) -> tuple[dict[str, float], float | None]:
    """Return errors (mm) on a run of another kind, and the removed share of the error.

    It is the share of the removable error.
    """
    judge = case.run("judge")
    error = {
        "before": off(before, judge),
        "after": off(after, judge),
        "floor": off(before, case.run("twin")),
    }
    removable = error["before"] - error["floor"]
    return error, (error["before"] - error["after"]) / removable if removable > 0.05 else None
