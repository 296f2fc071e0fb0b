"""Confirm new effects of a memory: their loss must not fall by chance, nor by a bad map.

First, their numbers are fitted again without each fold. Then they read the run backward. A memory
depends on the past alone. A law that fits as well on the future only bends the static map. Pinned
by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.rod.memory.chain_fit import ChainFit
from softmap_edge.rod.memory.free_chain import FreeChain
from softmap_edge.rod.memory.progress import Progress
from softmap_edge.rod.memory.step import Step
from softmap_edge.rod.regression import Drive, standard_error

Floats = NDArray[np.float64]

# of a law's fall: least part that is lost if it reads the run backward. True laws lose 0.44 or
# more, laws that stand in for the form of a static map 0.15.
PAST = 0.3


def unconfirmed(progress: Progress, step: Step) -> str:
    """Return why a step may lower the loss by chance or by a bad map, or ''."""
    evidence = progress.data.evidence
    refitted = progress.data.fit.refitted_losses(step.fitted)
    if not progress.falls(refitted):
        return f"with numbers from the other blocks only to {evidence.rms(refitted):.2f} mm"
    backward = _backward(progress, step)
    lost = backward - step.fitted.losses
    fall = float((progress.losses - step.fitted.losses).sum())
    if float(lost.sum()) < max(PAST * fall, standard_error(lost)):
        return f"with the run read backward to {evidence.rms(backward):.2f} mm as well"
    return ""


def _backward(progress: Progress, step: Step) -> Floats:
    """Return the held-out loss (folds,) mm² of the new effects that read the run backward."""
    last, there = progress.last, progress.names
    records = [
        replace(record, u=record.u if last is None else last.effective(record), backward=True)
        for record in progress.data.seen.drive.records
    ]
    names = [name for name in step.names if name not in there]
    known = progress.data.fit
    fit = ChainFit(Drive(*records), known.static, known.seed, known.unit)
    scanned = fit.scanned(FreeChain.of_effects(names, fit.drive), {})
    split = [name for name in step.fitted.chain.split if name in names]
    chain = FreeChain.of_effects(names, fit.drive, split)
    starts = np.stack([chain.at(scanned.numbers), chain.at(step.fitted.numbers)])
    return min(scanned, fit.refined(chain, starts), key=lambda fitted: fitted.loss).losses
