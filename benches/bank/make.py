"""Make a case once: its runs and the truth about it (`store.py` keeps them).

Units: mm, s. A case that cannot be made reports the reason when it is requested. Pinned by
tests/benches/test_bank_store.py.
"""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benches.bank.answers import LAW_OPEN, Answer
from benches.bank.case import Case, case, judge_protocol, protocol_of
from benches.bank.clouds import registered, thinned
from benches.bank.learned import learned_case, uncubed_mm
from benches.bank.odd import odd_case
from benches.bank.shop import shop_case
from benches.bank.store import Kept, Task, keep
from softmap_edge.run.run import Run

SCORED = 2.0  # times its background by which a single must move the finger to be scored


def made(task: Task, root: Path) -> Kept:
    """Make a case and keep it under `root`."""
    seeds, slice_, level, kind, number = task
    started = time.process_time()
    if slice_ == "learned":
        mine, runs = learned_case(seeds, level, kind, number)
    else:
        mine = _case(task)
        runs = _runs(mine, kind, number)
    truth = truth_of(
        mine, uncubed_mm(mine, number) if slice_ == "learned" else mine.background_mm()
    )
    return keep(
        task, root, truth | {"truth_seconds": round(time.process_time() - started, 2)}, runs
    )


def _case(task: Task) -> Case:
    """Return a case of a slice whose model is known in advance."""
    seeds, slice_, level, kind, number = task
    if slice_ == "shop":
        return shop_case(seeds, level, kind, number)
    return odd_case(seeds, level, kind, number) if slice_ == "odd" else case(*task)


def _runs(mine: Case, kind: str, number: int) -> dict[str, Run]:
    """Return the runs of a case: diagnosed run, a requested second, validation run, twin."""

    def recorded(told: str) -> Run:
        protocol = protocol_of(told, mine.hidden, number)
        if mine.level.clouds:
            return registered(mine.body.model(), mine.run(thinned(protocol)), mine.seed)
        return mine.run(protocol)

    runs = {"first": recorded(kind)}
    if kind == "rivals":
        runs["whole"] = recorded("single")
    if kind == "single":
        judge = judge_protocol(number)
        runs |= {"judge": mine.run(judge), "twin": mine.run(judge, ())}
    return runs


def truth_of(mine: Case, background_mm: float) -> dict[str, Any]:
    """Return the hidden laws of a case and the right answers."""
    moved = [float(mm) for mm in mine.moved_mm]
    return {
        **mine.to_dict(),
        "also": [
            *mine.to_dict()["also"],
            *(name for answer in mine.answers for name in answer.also),
        ],
        "hidden": list(mine.hidden),
        "moved_mm": [round(mm, 4) for mm in moved],
        "background_mm": round(background_mm, 4),
        "scored": all(mm >= SCORED * background_mm for mm in moved),
        "answers": [answer.to_dict() for answer in mine.answers],
        "expected": [list(answer.families) for answer in mine.answers],
        "verdicts": list(verdicts(mine.kind, mine.answers)),
        "clouds": mine.level.clouds,
        "camera": asdict(mine.level),
    }


def verdicts(kind: str, answers: tuple[Answer, ...]) -> tuple[str, ...]:
    """Return the verdicts that are right for the complete run."""
    if not answers:
        return ("nothing", "cannot_tell")
    if kind in ("untestable", "removed"):
        return ("ambiguous", "cannot_tell", "nothing", "partly_explained")
    if len(answers) == 1:
        return answers[0].verdicts
    known = all(answer.names for answer in answers)
    return ("identified", "ambiguous") if known else LAW_OPEN
