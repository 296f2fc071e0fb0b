"""Describe the memory that a search found: a record of each effect, and remarks.

Pinned by tests/rod/test_learned_memory.py and tests/model/test_learned_in.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from softmap_edge.model.effect_info import registry
from softmap_edge.model.learned_in import Alternative, LearnedIn
from softmap_edge.rod.memory.chain_fit import ChainFit
from softmap_edge.rod.memory.evidence import LEFT, Evidence
from softmap_edge.rod.memory.free_chain import FreeChain
from softmap_edge.rod.memory.memory import Memory
from softmap_edge.rod.memory.progress import Progress, SearchData
from softmap_edge.rod.memory.step import FittedEffect, FittedFamily, Step
from softmap_edge.rod.reference_run import ReferenceFrames
from softmap_edge.rod.static_map import StaticMap


def memory_of(
    data: SearchData, steps: Sequence[Step], unknown: Sequence[LearnedIn], notes: Sequence[str]
) -> Memory:
    """Return the memory of a search.

    Args:
        data: the data of the search.
        steps: its steps; none if the chain stays empty.
        unknown: records of families without a law.
        notes: remarks.
    """
    noise = data.evidence.noise_mm
    if not steps:
        return Memory(learned_in=tuple(unknown), noise_mm=noise, notes=tuple(notes))
    last = steps[-1].fitted
    numbers = data.fit.fitted_numbers(last)
    rest = data.evidence.above(last.losses) > LEFT * data.evidence.above(steps[0].before)
    records = []
    for step in (replace(step, rest=rest) for step in steps):
        others = tuple(_alternative(other, data.evidence) for other in step.alternatives)
        before, after = data.evidence.rms(step.before), data.evidence.rms(step.fitted.losses)
        for name in step.names:
            alike = tuple(Alternative(twin, step.family.name, after) for twin in _twins(name))
            params = tuple(
                number for label, number in numbers.items() if label.startswith(f"{name}.")
            )
            records.append(
                LearnedIn(
                    name,
                    step.family.name,
                    step.certainty,
                    before,
                    after,
                    params,
                    (*others, *alike),
                )
            )
    return Memory(last.chain.names, last.params, (*records, *unknown), noise, tuple(notes))


def unknown_law(progress: Progress, near: Sequence[FittedFamily]) -> LearnedIn:
    """Return the record of families that the run shows, but whose law is unknown."""
    evidence = progress.data.evidence
    first, *others = (_alternative(one, evidence) for one in near)
    before, after = evidence.rms(progress.losses), evidence.rms(near[0].losses)
    return LearnedIn("", first.family, "unknown", before, after, (), tuple(others))


def only_seen(progress: Progress, near: Sequence[FittedFamily], forbidden: bool) -> str:
    """Return a remark on families that the run shows, but that do not join the chain."""
    names = " or ".join(one.family.name for one in near)
    evidence = progress.data.evidence
    before, after = evidence.rms(progress.losses), evidence.rms(near[0].losses)
    why = "is left to the diagnosis" if forbidden else "has no law in the library that reaches it"
    return (
        f"the run shows {names} besides the static map (held-out error {before:.2f} "
        f"to {after:.2f} mm RMS), which {why}: it is not in the model"
    )


def not_confirmed(progress: Progress, step: Step, why: str) -> str:
    """Return a remark on a step that lowers the loss, but is not confirmed."""
    evidence = progress.data.evidence
    before, after = evidence.rms(progress.losses), evidence.rms(step.fitted.losses)
    return (
        f"{' and '.join(step.names)} lowers the held-out error from {before:.2f} "
        f"to {after:.2f} mm RMS, but {why}; this does not prove a memory, so the law is not in "
        "the model"
    )


def refined_memory(memory: Memory, seen: ReferenceFrames, static: StaticMap, seed: int) -> Memory:
    """Refit the numbers of the memory with another map of the same targets."""
    if not memory.names:
        return memory
    labels = [label for record in memory.learned_in for label in _labels(record)]
    split = sorted({label.split(".")[0] for label in labels if "[" in label})
    chain = FreeChain.of_effects(memory.names, seen.drive, split)
    fit = ChainFit(seen.drive, static, seed, seen.unit)
    fitted = fit.refined(chain, chain.at(memory.params)[None])
    numbers = fit.fitted_numbers(fitted)
    records = tuple(
        replace(one, params=tuple(numbers[label] for label in _labels(one) if label in numbers))
        for one in memory.learned_in
    )
    return replace(memory, params=fitted.params, learned_in=records)


def _alternative(other: FittedEffect | FittedFamily, evidence: Evidence) -> Alternative:
    name = other.name if isinstance(other, FittedEffect) else ""
    return Alternative(name, other.family.name, evidence.rms(other.losses))


def _twins(name: str) -> list[str]:
    """Return the effects that no run can distinguish from the effect `name`."""
    return [info.name for info in registry().values() if info.alike.get(name) == "never"]


def _labels(record: LearnedIn) -> list[str]:
    return [number.label for number in record.params]
