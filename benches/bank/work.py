"""One case from beginning to end: make it, diagnose it, judge it, write one small JSON. What the processes call."""

from __future__ import annotations

import hashlib
import json
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from softmap_edge.run import Run

Task = tuple[str, str, str, str, int]  # seeds, slice, level, kind, number


def run_case(task: Task) -> dict[str, Any]:
    """Make one case, diagnose it, judge it."""
    from benches.bank.case import case, judge_protocol, protocol_of
    from benches.bank.clouds import registered, thinned
    from benches.bank.judge import alike, judged
    from benches.bank.watch import rms
    from softmap_edge import _core
    from softmap_edge.diagnosis.diagnose import diagnose

    seeds, slice_, level, kind, number = task
    started = time.process_time()
    mine = case(*task)
    model = mine.body.model()

    def recorded(told: str) -> Run:
        protocol = protocol_of(told, mine.hidden, number)
        if mine.level.clouds:
            return registered(model, mine.run(thinned(protocol)), mine.seed)
        return mine.run(protocol)

    run = recorded(kind)
    whole = recorded("single") if kind == "rivals" else None
    made = time.process_time()
    registry = _core.effects()
    library = [e["name"] for e in registry if kind != "removed" or e["name"] not in mine.hidden]
    expressible = {e["name"] for e in registry if not model.lacking(e["name"])}
    first = diagnose(model, run, effects=library)
    finished = time.process_time()
    one, several = (alike(registry, orientations, roll=not mine.level.clouds) for orientations in (1, 2))
    turned = len(np.unique(run.gravity, axis=0)) > 1
    also = [name for law in mine.laws for name in law.ALSO]
    verdict = judged(mine.hidden, first.to_dict(), several if turned else one, expressible, also)
    last = first
    if whole is not None:
        last = diagnose(model, [run, whole], effects=library)
        verdict = judged(mine.hidden, last.to_dict(), several, expressible, also) | {"at_first": verdict}

    def off(predicted: Any, seen: Any) -> float:
        points = seen.vertices if seen.vertices is not None else seen.markers
        return rms(predicted.predict(seen) - points, seen.visible)

    error, fall = None, None
    if kind == "single":
        judge = judge_protocol(number)
        other, twin = mine.run(judge), mine.run(judge, ())
        error = {"before": off(model, other), "after": off(first.model, other), "floor": off(model, twin)}
        removable = error["before"] - error["floor"]
        fall = (error["before"] - error["after"]) / removable if removable > 0.05 else None
    return {
        "slice": slice_, "level": level, "kind": kind, "number": number, "seeds": seeds, **mine.to_dict(), **verdict,
        "hidden": list(mine.hidden), "error_mm": error, "fall": fall,
        "frames": int(run.t_seen.size), "sentence": last.sentence,
        "ladder": last.error, "unexplained": last.unexplained,
        "truth_seconds": round(made - started, 2), "seconds": round(finished - made, 2),
    }  # fmt: skip


def kept(task: Task, out: Path) -> Path:
    """Return the file of a case."""
    seeds, slice_, level, kind, number = task
    return out / f"{seeds}-{slice_}-{level}-{kind}-{number:04d}.json"


def code() -> str:
    """Return a digest of the bank and of what it judges: a case that other code made is made again."""
    import softmap_edge

    digest = hashlib.sha256()
    package = Path(softmap_edge.__file__).parent
    for folder, pattern in ((Path(__file__).parent, "*.py"), (package, "**/*.[ps][yo]"), (package / "data", "**/*.*")):
        for path in sorted(folder.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def work(job: tuple[Task, str, str]) -> dict[str, Any]:
    """Run one case and write its file, marked with `code`; one that fails says so there, and is tried again."""
    task, out, made_by = job
    try:
        row = run_case(task)
    except Exception as error:  # one case must not stop a thousand others
        row = dict(zip(("seeds", "slice", "level", "kind", "number"), task)) | {
            "case": kept(task, Path(out)).stem, "failed": f"{type(error).__name__}: {error}"[:300],
        }  # fmt: skip
    row["code"] = made_by
    path = kept(task, Path(out))
    half = path.with_suffix(f".{os.getpid()}.part")
    half.write_text(json.dumps(row) + "\n", encoding="utf-8")
    half.replace(path)
    return row
