"""Score the answer with a learned model of a robot whose law was always present.

The model is learned from its recordings.

The named effects are those that `learn` added to the chain, then those that the diagnosis of
another run adds. For a memory that was always present, both are right. Units: mm, s. Pinned by
tests/benches/test_bank_learned.py.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from benches.bank.judge import alike, judged
from benches.bank.judge_family import by_family, names_alike
from benches.bank.store import Kept
from benches.bank.work import off

if TYPE_CHECKING:
    from softmap_edge.model.learned_in import LearnedIn
    from softmap_edge.model.model import Model


def judge_learned(case: Kept) -> dict[str, Any]:
    """Learn a model from a case's reference runs, diagnose another run, and score both.

    Both are scored together.
    """
    from softmap_edge import _core
    from softmap_edge.diagnosis.diagnose import diagnose

    truth, run, registry = case.truth, case.run(), _core.effects()
    started = time.process_time()
    model = taught(case)
    learned = time.process_time()
    found = diagnose(model, run)
    finished = time.process_time()
    document = together(model.learned_in, found.to_dict())
    expressible = {e["name"] for e in registry if not model.missing_for(e["name"])}
    like = names_alike(alike(registry, 1), truth)
    verdict = judged(truth["hidden"], document, like, expressible, truth["also"])
    judge = case.run("judge")
    error = {
        "learned": off(model, judge),
        "after": off(found.model, judge),
        "noise": truth["camera"]["point_mm"] * 3**0.5,
    }
    absorbed = bool(truth["hidden"]) and not verdict["named"] and "nothing" in truth["verdicts"]
    return {
        **truth,
        **verdict,
        **by_family(document, truth, like),
        "first": verdict["first"] or absorbed,
        "chain": list(model.chain_names),
        "error_mm": error,
        "fall": None,
        "frames": int(run.t_seen.size),
        "sentence": found.sentence,
        "ladder": found.to_dict()["error"],
        "unexplained": found.to_dict()["unexplained"],
        "learn_seconds": round(learned - started, 2),
        "seconds": round(finished - learned, 2),
    }


def taught(case: Kept) -> Model:
    """Return the model that is learned from the reference runs of a case."""
    from softmap_edge.rod.learn import learn_model

    runs = [case.run(name) for name in case.runs if name.startswith("taught")]
    return learn_model(runs[0]) if len(runs) == 1 else learn_model(runs)  # type: ignore[arg-type]


def together(learned: Sequence[LearnedIn], document: dict[str, Any]) -> dict[str, Any]:
    """Return a diagnosis with the effects that `learn` put into the chain before its own.

    If the diagnosis finds nothing more, the verdict is that of `learn` on its laws. `learn` gives
    no probabilities, so a law that is not identified counts as a claim of one half.
    """
    laws = [one for one in learned if one.name]
    doubted = [one for one in laws if one.law != "identified"]
    rows = [
        {"name": one.name, "share": 2.0 - 0.01 * k, "probability": 0.5 if one in doubted else 1.0}
        for k, one in enumerate(laws)
    ]
    families = [{"name": one.family} for one in laws]
    others = [(one.name, other.name) for one in doubted for other in one.alternatives if other.name]
    silent = not document["effects"] and document["verdict"] in ("nothing", "cannot_tell")
    return {
        **document,
        "effects": [*rows, *document["effects"]],
        "families": [*families, *(document.get("families") or [])],
        "alternatives": [
            *({"effects": [o], "why": "", "member": n} for n, o in others),
            *document["alternatives"],
        ],
        "verdict": ("ambiguous" if doubted else "identified")
        if laws and silent
        else document["verdict"],
    }
