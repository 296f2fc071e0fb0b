"""Detect gravity declared with a wrong sign, or a load of a wrong size.

It is tested if gravity is implausible in a diagnosis.

With another effect present, a wrong sign is not visible before a fit (`checks/match.py` tests that). A
weight or backlash hides it, and the effect `gravity` then ends at its bounds. So the run is
diagnosed again under the signs that fit best with a free weight at the tip,

    min over m >= 0 of |seen - predicted(signs * g) - m d(signs * g)| d the effect of one weight,

and the declaration is wrong if the held-out error under these signs is at most WORSE of its own. A
load is scaled to fit best before a search, and the search must confirm it. Units: mm RMS, held out.
Limit: exchanged axes and runs relative to a reference are not tested. Pinned by
tests/diagnosis/test_wrongly_declared.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.records import record_of

if TYPE_CHECKING:
    from softmap_edge.run.run import Run

FRAMES = 100  # frames for comparing signs before the search
# times the error of the best signs: a hanging body hardly distinguishes the sign of its axis
CLOSE = 1.3
POOR, MUCH = 0.5, 10.0  # of the held-out error, and chi² per value: limits for a true dead load
ABSENT = 0.2  # of a declared load: nearer to zero, or to all of it, it is rounded
WORSE = 0.8  # of the held-out error: most that other signs may leave
SIGNS = tuple(signs for signs in product((1.0, -1.0), repeat=3) if min(signs) < 0)


def strange(found: Diagnosis, loaded: bool = False) -> bool:
    """Return whether gravity is implausible in a diagnosis; runs may declare a load or not.

    It is implausible if its parameters end at their bounds. It is so if the unexplained error
    depends on the orientation. It is so if a dead load leaves most of the error, or has no law of
    the library. It is also so if a run that declares a load shows any effect.
    """
    at_bound = any(
        entry.name == "gravity" and any(p.at_bound for p in entry.params.values())
        for entry in found.effects
    )
    left, error = found.unexplained, found.error
    turned = found.verdict == "partly_explained" and "orientation" in str(left.predicted_by)
    weights = {"gravity", "payload"} & {
        *(entry.name for entry in found.effects),
        *found.made_from["demoted"],
    }
    poor = (
        (loaded or bool(weights))
        and error.after > POOR * error.before
        and left.chi2_per_n is not None
        and left.chi2_per_n > MUCH
    )
    lawless = any(family.name == "load" and family.law != "identified" for family in found.families)
    return at_bound or turned or poor or lawless or (loaded and found.verdict != "nothing")


def wrong_sign(record: Record, error: float, again: Callable[[Sequence[Run]], float]) -> str | None:
    """Report whether gravity of other signs leaves a smaller held-out error than declared.

    Args:
        record: the diagnosed record.
        error: its held-out error, mm RMS.
        again: returns the held-out error of a search on other runs.
    """
    runs = [part.run for part in record.parts]
    if record.replay is not None or any(run.gravity is None for run in runs):
        return None
    first = {s: _left(record, [_turned(_thin(run), s) for run in runs]) for s in SIGNS}
    close = sorted(
        (s for s in SIGNS if first[s] <= CLOSE * min(first.values())), key=lambda s: first[s]
    )[:2]
    found = {s: again([_turned(run, s) for run in runs]) for s in close}
    signs, other = min(found.items(), key=lambda pair: pair[1])
    if not other < WORSE * error:
        return None
    axes = [name for name, sign in zip("xyz", signs) if sign < 0]
    which = "upside down" if len(axes) == 3 else f"with the wrong sign of its {' and '.join(axes)}"
    return (
        f"The measurement is at fault: `gravity` is declared {which}. So turned, what would be "
        f"found leaves {other:.2f} mm RMS instead of {error:.2f} mm (both held out). No effect is "
        "named: give the direction in which things fall, in the base frame, and diagnose again."
    )


def wrong_load(record: Record, error: float, again: Callable[[Sequence[Run]], float]) -> str | None:
    """Report whether another size of the declared loads leaves a smaller held-out error.

    The arguments are those of the function above.
    """
    runs = [part.run for part in record.parts]
    if record.replay is not None or not any(
        run.load is not None and np.any(run.load) for run in runs
    ):
        return None
    thin = [_thin(run) for run in runs]
    loaded, bare = (
        record_of(record.model, those) for those in (thin, [_loaded(r, 0.0) for r in thin])
    )
    off, shift = (
        np.nan_to_num(
            loaded.seen - declared.predict(record.model.chain_names, declared.own()[None])[0]
        )
        for declared in (loaded, bare)
    )
    does = shift - off  # of all declared loads
    share = float(np.sum(shift * does)) / max(float(np.sum(does**2)), 1e-12)
    share = 0.0 if share < ABSENT else share
    if abs(share - 1.0) < ABSENT:
        return None
    other = again([_loaded(run, share) for run in runs])
    if not other < WORSE * error:
        return None
    most = max(float(np.max(run.load)) for run in runs if run.load is not None)
    fits = "no load at all" if share == 0.0 else f"{share * most:.3g} g"
    return (
        f"The measurement is at fault: `load` is declared as up to {most:.4g} g, and {fits} fits. "
        f"So declared, what would be found leaves {other:.2f} mm RMS instead of {error:.2f} mm "
        "(both held out). No effect is named: give what hangs at the tip, in grams, and diagnose "
        "again."
    )


def _loaded(run: Run, share: float) -> Run:
    return replace(run, load=None if run.load is None else share * np.asarray(run.load, float))


def _turned(run: Run, signs: Sequence[float]) -> Run:
    return replace(run, gravity=np.asarray(run.gravity, float) * np.array(signs))


def _thin(run: Run) -> Run:
    return run.at(np.unique(np.linspace(0, run.frames - 1, min(run.frames, FRAMES)).astype(int)))


def _left(record: Record, runs: list[Run]) -> float:
    """Return the error of a model on runs with any weight at the tip, mm RMS."""
    other = record_of(record.model, runs)
    own, names = (
        record.model.chain_names,
        tuple(dict.fromkeys((*record.model.chain_names, "payload"))),
    )
    off = other.seen - other.predict(own, other.own()[None])[0]
    layout = other.layout(names)
    params = dict(zip(layout.labels, layout.start)) | other.own_values()
    moved = other.seen - other.predict(names, layout.values(params)[None])[0]
    shift = np.nan_to_num(off - moved)
    share = max(
        0.0, float(np.sum(np.nan_to_num(off) * shift)) / max(float(np.sum(shift**2)), 1e-12)
    )
    return other.rms_mm(off - share * (off - moved))
