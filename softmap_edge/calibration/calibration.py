"""Find the map from servo ticks to the model's commands, from a run with ticks and shapes.

    frames ─nearest shape─> u* (`matching.py`) ─held commands─> rows (`held.py`) ─robust fit─> u = A
    (ticks − home) + b (`affine.py`, as a start) ─fit to the shapes─> A, b, and a rotation about the
    base's axis if the data show it (`map_fit.py`); departures from an affine map
    (`departures.py`); the error on withheld blocks

Home is given (the ticks in the rig file), or it is the place of the most dwells; of several, the
one where the model's command is smallest. Another home changes only b. Ticks are those of the
encoders if the model takes positions and the run has them, else the commanded ones. Left out are
commands at the end of the model's range, slack commands, frames in motion if dwells suffice, and
outlier rows (Tukey). Units: ticks, mm. Limit: a constant error of all shapes (a wrong frame, a
wrong length) distorts A and b; check the misfit of the shapes. Pinned by
tests/calibration/test_calibration.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.base_in_clouds import base_stood_off, in_base
from softmap_edge.alignment.register import register
from softmap_edge.calibration.affine import AffineFit, fit
from softmap_edge.calibration.departures import Departure, departures
from softmap_edge.calibration.found import Calibrated
from softmap_edge.calibration.held_out import (
    HeldOut,
    SeenMarkers,
    directions,
    gather,
    places,
    visits,
)
from softmap_edge.calibration.map_fit import Sights, fit_map, turned_shapes
from softmap_edge.calibration.matching import Matches, linearised, match
from softmap_edge.errors import CalibrationError
from softmap_edge.files.atomic import Document
from softmap_edge.geometry.rigid import RigidPose
from softmap_edge.model.orientation import gravity_seen, other_orientation
from softmap_edge.model.servo_calibration import LARGEST, Calibration, held_in_ticks
from softmap_edge.model.training_range import out_of_reach, shape_mismatch
from softmap_edge.run.run import Run, known

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SPARE = 2  # held commands for each coefficient of a channel, at least
LINE = 0.03  # of their spread: closer to a line, held commands show nothing across
KNOWN = 3.0  # standard deviations of its smallest singular value that A must have to be inverted
# of the robot's length: shapes with a larger mean absolute error do not belong to this model
FAR = 0.1
# parts of the held commands, in order of first visit, if a run labels no blocks
BLOCKS = 5
LEANING = 5.0  # deg between the orientations of run and model that cause a warning
BASE_ROUNDS = 4  # alternations between finding the base and the map
# times the residual of the matches: a larger held-out error causes a warning
UNEXPLAINED = 1.5
SET_ASIDE = 0.2  # share of outlier held commands that causes a warning


def calibrate(
    model: Model,
    run: Run,
    home: Sequence[float] | None = None,
    window: tuple[float, float] | None = None,
    refine: bool = True,
) -> Calibrated:
    """Find the map from the ticks of a run to commands of a model.

    If the base of a run of clouds is clearly displaced, its pose is removed first and reported.

    Args:
        model: of this robot, without effects: they come after the calibration.
        run: with `ticks` (T, C) and vertices, markers or clouds at K frames, best at rest, on both
            sides of home.
        home: (C,) ticks; the run's rest by default. window: (low, high) ticks about home that each
            servo may take.
        refine: match between the shapes of a grid, and fit the map to the shapes; without, as the
            paper.

    Returns:
        Calibrated: the model with its calibration, the pairs, and the evidence against an affine
        map.

    Raises:
        CalibrationError: no ticks, too few or no independent held commands, shapes that are not
            this model's.
    """
    recorded, run = run, held_in_ticks(run)
    found, there = _calibrated(model, run, home, window, refine), run
    # a displaced base bends the map, which then hides some of it
    for _ in range(BASE_ROUNDS if refine else 0):
        there, off = in_base(there, found.model)
        if off is None:
            break
        found = _calibrated(model, there, home, window, refine)
    if there is run or there.frame is None:
        return _named(found, recorded)
    before = (
        RigidPose(np.eye(3), np.zeros(3))
        if run.frame is None
        else RigidPose(run.frame[:, :3], run.frame[:, 3])
    )
    remark = base_stood_off(
        RigidPose(there.frame[:, :3], there.frame[:, 3]).after(before.inverse())
    )
    return _named(replace(found, warnings=[remark, *found.warnings]), recorded)


def _named(found: Calibrated, run: Run) -> Calibrated:
    """Return a calibration that refers to the run by its hash as recorded."""
    calibration = replace(found.calibration, run=run.hash())
    made: Document = {**found.model.made_from, "calibration": run.hash()}
    calibrated = replace(found.model, calibration=calibration, made_from=made)
    return replace(found, model=calibrated, calibration=calibration)


def _calibrated(
    model: Model,
    run: Run,
    home: Sequence[float] | None,
    window: tuple[float, float] | None,
    refine: bool,
) -> Calibrated:
    """Calibrate with a run in the base frame."""
    _check(model, run)
    shown = run if run.points is None else register(model, run).run(run)
    ticks, notes = _ticks(model, shown), list[str]()
    matches = match(model, shown, refine)
    usable = np.isfinite(matches.mae_mm) & ~matches.edge
    notes += out_of_reach(model, shown) + _doubts(model, shown, matches)
    seen = places(shown, ticks, usable)
    held = gather(seen, matches)
    origin = (
        _home(shown, ticks, seen, held) if home is None else np.asarray(home, float).reshape(-1)
    )
    if origin.shape != (model.channels,):
        raise CalibrationError(
            f"--home: {len(origin)} numbers, {model.channels} servos; give the ticks of each"
        )
    if not np.all(np.abs(origin) <= LARGEST):
        raise CalibrationError(
            f"--home: {origin.tolist()} ticks, allowed are numbers within ±{LARGEST:g}"
        )
    _check_design(held, int(matches.edge.sum()), int(len(usable)))
    found, turned, plain = _fit(held, origin), list[Departure](), matches
    if refine:
        sights, start = Sights(model, shown, held, seen, origin), found.coefficients
        turned = turned_shapes(sights, start, _blocks(shown, held))
        there = fit_map(sights, start, bool(turned), np.ones(len(held), bool))
        matches = linearised(
            model, shown, matches, seen.frame, there(_design(seen.ticks, origin)), there.turn
        )
        found = _fit(gather(seen, matches), origin)
    _check_known(found)
    way = directions(shown, np.column_stack([ticks, found(_design(ticks, origin))]))
    ways = gather(seen, matches, way)
    against = turned + departures(ways, origin, model.command_unit)
    columns = (
        next((one.columns for one in against if one.columns is not None), None) if refine else None
    )
    rows = gather(seen, matches) if columns is None else ways
    found = _fit(rows, origin, columns)
    matched = gather(seen, plain, None if columns is None else way).u
    calibration = Calibration(
        found.coefficients[:, :-1],
        found.coefficients[:, -1],
        origin,
        found.sigma[:, :-1],
        found.sigma[:, -1],
        _held_out(model, shown, rows, matched, found, origin, columns),
        run.hash(),
        len(seen.frame),
        len(rows),
        window,
        model.command_unit,
    )
    calibration.usable(model.command_range)  # or says why nothing is
    notes += (
        [one.sentence for one in against]
        + ([] if against else _unexplained(calibration))
        + _remarks(model, rows, found, matches, calibration)
    )
    mae = float(np.median(matches.mae_mm[seen.frame]))
    made = dict(model.made_from) | {"calibration": run.hash()}
    calibrated = replace(model, calibration=calibration, made_from=made)
    return Calibrated(calibrated, calibration, rows, found.weight, mae, against, notes)


def _check(model: Model, run: Run) -> None:
    if run.ticks is None and run.present_ticks is None:
        raise CalibrationError(
            "the run has no ticks; import the columns of the servos as `ticks` or "
            "`present_ticks`, or as `command` "
            'with command_unit = "ticks"'
        )
    if run.channels != model.channels or not model.channels:
        raise CalibrationError(
            f"the run has {run.channels} servos, the model of '{model.robot}' takes "
            f"{model.channels} commands; one servo for each command is expected"
        )
    if model.chain_names:
        raise CalibrationError(
            f"the model has {', '.join(model.chain_names)}, which would be counted twice; "
            "calibrate the bundle without effects (`softmap model remove`), then diagnose"
        )
    if not run.frames:
        raise CalibrationError(
            "the run has no seen frames (K = 0); record shapes together with the ticks"
        )


def _ticks(model: Model, run: Run) -> Floats:
    """Return the ticks (T, C) that drive the model."""
    if run.present_ticks is not None and (model.input != "goal" or run.ticks is None):
        return np.asarray(run.present_ticks, float)
    return np.asarray(run.ticks, float)


def _home(run: Run, ticks: Floats, seen: SeenMarkers, held: HeldOut) -> Floats:
    """Return the ticks of the place with the most dwells.

    Of several, it is the one with the smallest command of the model.
    """
    if not len(held):
        return np.zeros(ticks.shape[1])
    count = visits(run, ticks, seen) if seen.still else np.zeros(int(held.place.max()) + 1)
    often = np.flatnonzero(count[held.place] == count[held.place].max())
    return np.asarray(held.ticks[often[np.argmin(np.linalg.norm(held.u[often], axis=1))]])


def _doubts(model: Model, run: Run, matches: Matches) -> list[str]:
    """Return doubts about the matches; raise CalibrationError if no shape belongs to this model."""
    found = matches.mae_mm[np.isfinite(matches.mae_mm)]
    if not len(found):
        raise CalibrationError(
            f"none of {len(matches.mae_mm)} frames shows enough of the robot; show more of it"
        )
    length = float(np.linalg.norm(model.rest, axis=1).max())
    mae = float(np.median(found))
    if mae > FAR * length:
        raise CalibrationError(
            f"the nearest shapes of '{model.robot}' are {mae:.3g} mm off (median of {len(found)} "
            f"frames), {FAR * length:.3g} mm is the most that can be of this robot; align the run "
            "to the base (`softmap run align --base`), or give the bundle of this robot"
        )
    notes = shape_mismatch(model, found)
    if run.gravity is not None:
        lean = np.degrees(
            np.arccos(np.clip(np.atleast_2d(run.gravity) @ model.gravity_reference, -1.0, 1.0))
        )
        if lean.max() > LEANING and not other_orientation(model, run):
            notes.append(
                f"the robot leans {lean.max():.0f} deg from where the model was made, and its "
                "shapes are matched as if it did not; calibrate a run in a few orientations, "
                "with a model that knows its weight"
            )
    if run.load is not None and np.any(run.load):
        notes.append(
            f"a load of up to {np.max(run.load):.3g} g was on, which the matched shapes have not"
        )
    return notes


def _check_design(held: HeldOut, edge: int, frames: int) -> None:
    """Reject held commands that cannot determine A and b."""
    channels = held.ticks.shape[1] if len(held) else 1
    required = SPARE * (channels + 1)
    observed = held.observed.sum(axis=0) if len(held) else np.zeros(1, int)
    if min(observed) < required:
        cut = f"; {edge} of {frames} frames lie at the end of the model's range" if edge else ""
        slack = (
            f", of which {', '.join(map(str, observed))} determine command "
            f"{', '.join(map(str, range(len(observed))))}"
        )
        raise CalibrationError(
            f"{len(held)} different held commands{slack if len(held) else ''}{cut}: at least "
            f"{required} are needed for {channels + 1} numbers a command; hold {2 * required} or "
            "more, on both sides of home, each channel alone and together"
        )
    for c in range(channels):
        rows = held.ticks[held.observed[:, c]]
        size = np.linalg.svd(rows - rows.mean(axis=0), compute_uv=False) / np.sqrt(len(rows))
        if channels > 1 and size[-1] < LINE * size[0] or size[0] < 1.0:
            raise CalibrationError(
                f"the {len(rows)} held commands that determine command {c} lie on a line: "
                f"{size[0]:.0f} ticks RMS along, {size[-1] if channels > 1 else 0.0:.0f} across; "
                "move each servo alone, and both against each other"
            )


def _check_known(found: AffineFit) -> None:
    """Reject a matrix that is too uncertain to be inverted."""
    a, sigma = found.coefficients[:, :-1], found.sigma[:, :-1]
    least, worst = float(np.linalg.svd(a, compute_uv=False)[-1]), float(np.linalg.norm(sigma, 2))
    if least < KNOWN * worst:
        raise CalibrationError(
            f"A is not known: its least stretch is {least:.2g} a tick, known to ± {worst:.2g}; "
            "the shapes hardly follow the ticks, or two servos do the same. Look at the order "
            "and the clock of the frames, move more"
        )


def _design(ticks: Floats, home: Floats) -> Floats:
    return np.column_stack([ticks - home, np.ones(len(ticks))])


def _fit(
    held: HeldOut, home: Floats, columns: Floats | None = None, use: Mask | slice = slice(None)
) -> AffineFit:
    """Fit A and b to the rows `use` of held commands; `columns` (n, m) are fitted with them."""
    design = _design(held.ticks, home)
    extended = design if columns is None else np.column_stack([design, columns])
    return fit(extended[use], held.u[use], held.covariance[use], held.observed[use]).first(
        design.shape[1]
    )


def _held_out(
    model: Model,
    run: Run,
    held: HeldOut,
    matched: Floats,
    found: AffineFit,
    home: Floats,
    columns: Floats | None,
) -> dict[str, float]:
    """Return the RMS error on held-out blocks: of a command, and of its shape (mm).

    Also return the residual of the same shapes at the `matched` commands (n, C), a lower bound for
    every map.
    """
    sound, at, first = found.weight > 0, np.full(held.u.shape, np.nan), _first(held)
    count = _design(held.ticks, home).shape[1] + (0 if columns is None else columns.shape[1])
    for test in _blocks(run, held):
        if min(held.observed[~test].sum(axis=0)) > count:
            at[test] = _fit(held, home, columns, ~test)(_design(held.ticks[test], home))
    off = held.u - at
    good = sound & np.isfinite(at).all(axis=1)
    if not good.any():
        raise CalibrationError(
            f"{len(held)} held commands in blocks of which none can be left out; hold more commands"
        )
    order = np.flatnonzero(good)[np.argsort(first[good])]
    some = run.at(first[order])
    seen, t = np.asarray(model.points_in_mm(some), float), np.arange(len(order), dtype=np.float64)
    visible = known(some, seen)

    lean = gravity_seen(some) if other_orientation(model, run) else None

    def shape_error(u: Floats) -> float:
        still = replace(
            some,
            t=t,
            t_seen=t,
            command=u,
            ticks=None,
            present=None,
            present_ticks=None,
            current=None,
            temperature=None,
            gravity=lean,
            load=None,
            command_unit=model.command_unit,
        )
        distance = np.linalg.norm(model.predict(still) - seen, axis=2)[visible]
        return float(np.sqrt(np.mean(distance**2)))

    observed = off[good][held.observed[good]]
    return {
        "command": float(np.sqrt(np.mean(observed**2))),
        "shape_mm": shape_error(at[order]),
        "matched_shape_mm": shape_error(matched[order]),
    }


def _first(held: HeldOut) -> NDArray[np.int64]:
    """Return one frame of each held command, from its middle."""
    return np.array([part[len(part) // 2] for part in held.frames])


def _blocks(run: Run, held: HeldOut) -> list[NDArray[np.bool_]]:
    """Return masks of the held commands left out together: run labels, or parts of the run."""
    frame = _first(held)
    labels = None if run.block is None else np.asarray(run.block)[frame]
    if labels is None or not 3 <= len(np.unique(labels)) <= len(labels) // 3:
        labels = np.arange(len(frame)) * min(BLOCKS, len(frame)) // max(len(frame), 1)
    return [labels == label for label in np.unique(labels)]


def _unexplained(calibration: Calibration) -> list[str]:
    """Report a map with a large error that no alternative explains.

    Its stated uncertainty is then too small.
    """
    error = calibration.held_out
    if error["shape_mm"] < UNEXPLAINED * error["matched_shape_mm"]:
        return []
    return [
        f"the map is {error['command']:.2g} {calibration.unit} off on blocks that were left out, "
        "and no bend, kink, period or memory explains it: friction, a lean or a load that the "
        "model has not, another finger; A and b are less sure than their ± says"
    ]


def _remarks(
    model: Model, held: HeldOut, found: AffineFit, matches: Matches, calibration: Calibration
) -> list[str]:
    notes = []
    if not held.still:
        notes.append(
            "too few dwells: frames are taken in motion, where delays and play are in A and b; "
            "hold commands"
        )
    few, enough = int(held.observed.sum(axis=0).min()), 2 * SPARE * (held.ticks.shape[1] + 1)
    if few < enough:
        notes.append(
            f"{few} held commands are few: A and b may be farther off than their ± says; hold "
            f"{enough} or more"
        )
    wrong = int((found.weight == 0).sum())
    if wrong > SET_ASIDE * len(held):
        notes.append(
            f"{wrong} of {len(held)} held commands do not belong to the map that the others make"
        )
    if matches.edge.any():
        notes.append(
            f"{int(matches.edge.sum())} of {len(matches.edge)} frames lie at the end of the "
            "model's range and are left out; build it with a wider one, or move less"
        )
    slack = int((~held.observed).sum())
    if slack:
        notes.append(
            f"{slack} of {held.observed.size} commands hang slack where they were held, and are "
            "left out"
        )
    outside = np.any(
        (calibration.b < model.command_range[:, 0]) | (calibration.b > model.command_range[:, 1])
    )
    if outside:
        notes.append("at home the model is outside the range of its commands: is home right?")
    return notes
