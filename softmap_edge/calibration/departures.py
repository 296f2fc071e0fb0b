"""Departures from an affine map of ticks: bends, kinks, once-per-turn errors, and memory.

Each alternative is the affine map with a few more columns, tested on withheld held commands:

    quadratic  r_i r_j              a bend: a spool that fills, a lever
    kink       |r_c − q|            slack, a stop, a loose tendon, at one of a few ticks q
    period     sin, cos 2π r_c / P  an eccentric pulley, with a period of P ticks
    memory     sign of the last motion of each servo, or of each command: play, friction,
               hysteresis; no map can describe it
    turn       rotation of all shapes about the base's axis, fitted with the map (`map_fit.py`);
               errors in mm, size in degrees

r = ticks − home. An alternative counts if the held-out error falls by more than WORTH and by CLEAR
of its standard errors. Limit: departures of other forms, or below the scatter of the matches.
    Pinned
by tests/calibration/test_calibration.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softmap_edge.calibration.affine import AffineFit, fit
from softmap_edge.calibration.held_out import HeldOut
from softmap_edge.files.atomic import Document
from softmap_edge.model.servo_calibration import TURN

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# quantiles of the ticks at which a kink is tried, in addition to home
PLACES = (0.2, 0.35, 0.5, 0.65, 0.8)
FOLDS = 5
WORTH, CLEAR = 0.15, 3.0
# of the best gain: an alternative of another kind with this gain explains the data as well
ALSO = 0.8
# kinds that keep the map affine: A and b are fitted together with them
FITTED_ALONGSIDE = ("memory", "turn")
WRONG = 5.0  # standard deviations from every prediction at which a held command is an outlier
SPARE = 4  # held commands for each coefficient that an alternative must have


@dataclass(frozen=True)
class Departure:
    """A way in which the map is not affine; `better` is the fall of the held-out error (share).

    `affine` and `error` are these errors, RMS in the commands' unit; `size` the largest part that
    is not affine, at the place `ticks` (C,). `sentence` describes it. `columns` (n, m) of the held
    commands are those of a memory.
    """

    kind: str
    better: float
    affine: float
    error: float
    size: float
    ticks: list[float]
    sentence: str
    columns: Floats | None = field(default=None, repr=False, compare=False)

    def to_dict(self) -> Document:
        """Return a plain dictionary."""
        return {
            "kind": self.kind,
            "better": self.better,
            "affine_error": self.affine,
            "error": self.error,
            "size": self.size,
            "ticks": self.ticks,
            "sentence": self.sentence,
        }


def departures(held: HeldOut, home: Floats, unit: str) -> list[Departure]:
    """Return the ways in which commands do not follow ticks as an affine map, the best first.

    Args:
        held: one row for each place and `direction` (n, 2C) from which it was met, of the servos,
            then of the commands that an affine map makes of them. home: (C,) ticks.
    """
    away = held.ticks - home
    plain = np.column_stack([away, np.ones(len(away))])
    parts = _folds(held.place)
    scatter = fit(plain, held.u, held.covariance, held.observed).scatter
    base = _distances(plain, held, parts, scatter)
    found: list[tuple[float, float, float, str, str, Floats]] = []
    if base is None:
        return []
    for kind, what, columns in _alternatives(held, away):
        design = np.column_stack([plain, columns])
        if (
            held.observed.sum(axis=0).min() < SPARE * design.shape[1]
            or np.linalg.cond(design / np.linalg.norm(design, axis=0)) > 1e6
        ):
            continue
        own = _distances(design, held, parts, scatter)
        if own is None:
            continue
        sound = np.minimum(own, base) < WRONG  # (n,)
        gain = np.minimum(base[sound], WRONG) ** 2 - np.minimum(own[sound], WRONG) ** 2
        before, after = (
            float(np.sqrt(np.mean(np.minimum(d[sound], WRONG) ** 2))) for d in (base, own)
        )
        clear = float(np.mean(gain)) > CLEAR * float(np.std(gain)) / np.sqrt(max(len(gain), 1))
        better = 1.0 - after / max(before, 1e-300)
        if clear and better > WORTH:
            found.append((better, before, after, kind, what, design))
    found.sort(key=lambda one: -one[0])
    best: dict[str, Departure] = {}
    for better, before, after, kind, what, design in found:
        if kind not in best and better > ALSO * found[0][0]:
            size = float(np.sqrt(np.mean(scatter**2)))
            best[kind] = _departure(
                kind, what, better, size * before, size * after, design, held, away, unit
            )
    return list(best.values())


def _alternatives(held: HeldOut, away: Floats) -> Iterator[tuple[str, str, Floats]]:
    """Yield kind, words and columns (n, m) of each alternative."""
    channels = away.shape[1]
    pairs = [(i, j) for i in range(channels) for j in range(i, channels)]
    size = np.maximum(np.ptp(away, axis=0), 1.0)
    scaled = away / size
    yield "quadratic", "a bend", np.column_stack([scaled[:, i] * scaled[:, j] for i, j in pairs])
    inside = [
        [q for q in (0.0, *np.quantile(r, PLACES)) if r.min() + 0.1 * w < q < r.max() - 0.1 * w]
        for r, w in zip(away.T, size)
    ]
    for c in range(channels):
        for at in inside[c]:
            yield (
                "kink",
                f"a kink of servo {c} at {at:+.0f} ticks from home",
                np.abs(away[:, c : c + 1] - at) / size[c],
            )
    if channels > 1 and all(0.0 in row for row in inside):
        yield "kink", "a kink of all servos at home", np.abs(away) / size
    turning = np.flatnonzero(size > 0.5 * TURN)
    for some in [[c] for c in turning] + ([list(turning)] if len(turning) > 1 else []):
        phase, named = 2.0 * np.pi * away[:, some] / TURN, ", ".join(map(str, some))
        yield (
            "period",
            f"once a turn ({TURN} ticks) of servo {named}",
            np.column_stack([np.sin(phase), np.cos(phase)]),
        )
    for way in (held.direction[:, :channels], held.direction[:, channels:]):
        if np.ptp(way, axis=0).all():
            yield "memory", "the way on which a command was reached", way


def _folds(place: NDArray[np.int64]) -> list[Mask]:
    """Return masks (n,) of the rows held out together: complete places, in turn."""
    order = {p: k for k, p in enumerate(dict.fromkeys(place.tolist()))}
    fold = np.array([order[p] for p in place.tolist()]) % FOLDS
    return [fold == k for k in range(min(FOLDS, len(order)))]


def _distances(design: Floats, held: HeldOut, parts: list[Mask], scatter: Floats) -> Floats | None:
    """Return the distance of each row (n,) from its prediction by the others.

    It is in standard deviations of an observed command; None if too few rows remain to fit.
    """
    off = np.zeros(held.u.shape)
    for test in parts:
        train = ~test
        if held.observed[train].sum(axis=0).min() <= design.shape[1]:
            return None
        found = fit(design[train], held.u[train], held.covariance[train], held.observed[train])
        off[test] = held.u[test] - found(design[test])
    squares = np.where(held.observed, (off / scatter) ** 2, 0.0).sum(axis=1)
    return np.asarray(np.sqrt(squares / np.maximum(held.observed.sum(axis=1), 1)))


def _departure(
    kind: str,
    what: str,
    better: float,
    before: float,
    after: float,
    design: Floats,
    held: HeldOut,
    away: Floats,
    unit: str,
) -> Departure:
    """Describe the size and place of the departure of an alternative from affine."""
    found: AffineFit = fit(design, held.u, held.covariance, held.observed)
    count = away.shape[1] + 1
    extra = design[:, count:] @ found.coefficients[:, count:].T
    plain = design[:, :count]
    # the part that an affine map cannot describe
    extra -= plain @ np.linalg.lstsq(plain, extra, rcond=None)[0]
    size = np.linalg.norm(extra, axis=1)
    row = int(np.argmax(size))
    place = ", ".join(f"{r:+.0f}" for r in away[row])
    gain = f"held-out error {before:.2g} → {after:.2g} {unit} RMS, {100 * better:.0f} % less"
    if kind == "memory":
        apart = 2.0 * np.linalg.norm(found.coefficients[:, count:], axis=0).max()
        late = "" if held.still else ", or a delay, since frames are taken in motion"
        sentence = (
            f"memory: the same ticks act {apart:.2g} {unit} apart on the way up and on the way "
            f"down ({gain}): play, friction or hysteresis{late}. No map of ticks remembers: A and "
            "b are those between the two ways, and `softmap diagnose` with the new bundle names "
            "it"
        )
    else:
        sentence = (
            f"not affine: {what} ({gain}), up to {size[row]:.2g} {unit} off at ({place}) ticks "
            "from home"
        )
    columns = design[:, count:] if kind == "memory" else None
    return Departure(
        kind, better, before, after, float(size[row]), away[row].tolist(), sentence, columns
    )
