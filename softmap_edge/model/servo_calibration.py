"""Servo ticks ↔ a model's commands: a bundle's affine calibration, and runs converted with it.

    u = A (ticks − home) + b  ticks = home + round(A⁻¹ (u − b))  (Data Alignment, the SoftMap paper)

A is in command units per tick; b is the command while the servos are at `home`. home belongs to the
rig, and b to that home. A calibration is an untrusted file: shapes, finiteness, size and
invertibility of A are checked each time. Only `converted` turns the ticks of a run into commands.
Pinned by tests/calibration/test_ticks.py.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import CalibrationError
from softmap_edge.files.atomic import Document
from softmap_edge.run.fields import mask_of, masked_text, unmasked
from softmap_edge.run.rest_command import home_command
from softmap_edge.run.run import CALIBRATION, HOME_TICKS, Run, text_in

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]

SCHEMA = "softmap.calibration/1"
ERRORS = ("command", "shape_mm", "matched_shape_mm")
TICKS = "ticks"  # unit of commands in ticks
LARGEST = 1e7  # ticks, mm: beyond any servo, as for a run
MOST_SERVOS = 64
TURN = 4096  # ticks per turn of the horn
# of a spool of 2.33 mm: for an emulated robot whose bundle holds no calibration
TICKS_PER_MM = 280.0
SINGULAR = 1e6  # condition number above which A counts as singular


def tendon_mm(unit: str) -> float:
    """Return the mm of tendon that an emulated robot winds per unit of command.

    Units other than ticks count as mm.
    """
    return 1.0 / TICKS_PER_MM if unit == TICKS else 1.0


@dataclass(frozen=True, eq=False)
class Calibration:
    """u = A (ticks − home) + b, and its uncertainty.

    Attributes:
        A, b: (C, C) in `unit` per tick, and (C,) in `unit`.
        home: (C,) ticks.
        sigma_A, sigma_b: standard deviations of A and b.
        held_out: `{command, shape_mm, matched_shape_mm}`: RMS errors on withheld blocks, and the
            residual of the matches.
        run: hash of the run that it was fitted to.
        frames, held: number of frames and of held commands.
        window: allowed (low, high) ticks of a servo about home; None if not given.

    Raises:
        CalibrationError: a field is invalid.
    """

    A: Floats
    b: Floats
    home: Floats
    sigma_A: Floats
    sigma_b: Floats
    held_out: dict[str, float]
    run: str
    frames: int
    held: int
    window: tuple[float, float] | None = None
    unit: str = "mm"

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(np.asarray(self.b)))
        if not 1 <= count <= MOST_SERVOS:
            raise CalibrationError(
                f"calibration: b of {count} numbers, allowed are 1 to {MOST_SERVOS}"
            )
        shapes = dict(
            A=(count, count), b=(count,), home=(count,), sigma_A=(count, count), sigma_b=(count,)
        )
        for name, shape in shapes.items():
            array = _numbers(name, getattr(self, name))
            if array.shape != shape:
                raise CalibrationError(
                    f"calibration: {name} of shape {array.shape}, expected {shape}"
                )
            if name.startswith("sigma") and array.min() < 0:
                raise CalibrationError(
                    f"calibration: {name} holds {array.min():g}; a standard deviation is not "
                    "below 0"
                )
            object.__setattr__(self, name, array)
        if not self.condition < SINGULAR:
            raise CalibrationError(
                f"calibration: A has condition {self.condition:.3g}, below {SINGULAR:.0e} is "
                "needed: no ticks belong to a command; calibrate again with every servo moved"
            )
        if self.window is not None:
            low, high = (
                _numbers("window", self.window).reshape(-1).tolist()
                if len(self.window) == 2
                else (0.0, 0.0)
            )
            if not low < 0.0 < high:
                raise CalibrationError(
                    f"calibration: window {list(self.window)!r:.60}, expected LOW < 0 < HIGH in "
                    "ticks about home"
                )
            object.__setattr__(self, "window", (low, high))

    @classmethod
    def stated(
        cls,
        A: ArrayLike,
        b: ArrayLike,
        home: ArrayLike,
        source: str,
        window: tuple[float, float] | None = None,
        unit: str = "mm",
    ) -> Calibration:
        """Return an exact map that was not measured: of an emulated robot or a user-described rig.

        It has no uncertainty, error or frames; `source` takes the place of the run.
        """
        slope, shift = unmasked(A), unmasked(b)
        none = dict.fromkeys(ERRORS, 0.0)
        return cls(
            slope,
            shift,
            unmasked(home),
            0 * slope,
            0 * shift,
            none,
            source,
            0,
            0,
            window,
            unit,
        )

    @property
    def condition(self) -> float:
        """Condition number of A: 1 if all servos pull equally and orthogonally."""
        size = np.linalg.svd(self.A, compute_uv=False)
        return float(size[0] / size[-1]) if size[-1] > 0 else np.inf

    def commands(self, ticks: ArrayLike) -> Floats:
        """Return the commands (n, C) in `unit` for ticks (n, C); NaN for a row that lacks ticks."""
        return np.asarray((unmasked(ticks) - self.home) @ self.A.T + self.b)

    def ticks(self, commands: ArrayLike) -> NDArray[np.int64]:
        """Return the ticks (n, C) for commands (n, C), rounded to integers.

        Raises:
            CalibrationError: a command is masked or not finite.
        """
        away = np.linalg.solve(self.A, (_finite("commands", commands) - self.b).T).T
        return np.rint(self.home + away).astype(np.int64)

    def within(self, command: ArrayLike, low: ArrayLike, high: ArrayLike) -> Floats:
        """Return the effective `command` (C,) with servos limited to `low`, `high` (C,) ticks."""
        away = np.linalg.solve(self.A, _finite("command", command) - self.b)
        ticks = np.clip(self.home + away, low, high)
        return np.asarray(self.A @ (ticks - self.home) + self.b)

    def turned(self, home: ArrayLike) -> Calibration:
        """Return the map with its home moved by full turns, within half a turn of `home` (C,).

        Servos lose their turn count when their power is off.
        """
        turns = np.rint((_finite("home", home) - self.home) / TURN)
        return replace(self, home=self.home + TURN * turns) if turns.any() else self

    def holding(self, reach: ArrayLike) -> tuple[float, float]:
        """Return the window (low, high) of ticks about home that contains `reach` (C, 2)."""
        away = self.ticks(list(product(*_finite("reach", reach)))) - self.home
        return float(away.min()), float(away.max())

    def usable(self, reach: ArrayLike) -> Floats:
        """Return `reach` (C, 2) shrunk so that all combinations of commands lie in the window.

        It shrinks by one factor towards the command at home until its corners are inside. Without a
        window it is unchanged.

        Raises:
            CalibrationError: home lies outside `reach`.
        """
        box = _finite("reach", reach)
        if self.window is None:
            return box
        if np.any(self.b < box[:, 0]) or np.any(self.b > box[:, 1]):
            raise CalibrationError(
                f"at home {np.round(self.b, 2).tolist()} {self.unit} act, outside the model's "
                f"range {np.round(box, 2).tolist()}: no range of commands about home is usable; "
                "choose another --home"
            )
        back, away = np.linalg.inv(self.A), box - self.b[:, None]
        # (2, servo, C): ticks required by each end of the range
        sides = np.stack([back * away[:, 0], back * away[:, 1]])
        highest, lowest = sides.max(axis=0).sum(axis=1), sides.min(axis=0).sum(axis=1)
        low, high = self.window
        share = min(
            1.0, float(high / max(highest.max(), 1e-300)), float(low / min(lowest.min(), -1e-300))
        )
        return np.asarray(self.b[:, None] + share * away)

    def to_dict(self) -> Document:
        """Return the document softmap.calibration/1, stored in a bundle as `calibration.json`."""
        return {
            "schema": SCHEMA,
            "unit": "ticks",
            "command_unit": self.unit,
            "A": self.A.tolist(),
            "b": self.b.tolist(),
            "home": self.home.tolist(),
            "sigma": {"A": self.sigma_A.tolist(), "b": self.sigma_b.tolist()},
            "condition": self.condition,
            "held_out": dict(self.held_out),
            "run": self.run,
            "frames": self.frames,
            "held_commands": self.held,
            "tick_window": None if self.window is None else list(self.window),
        }

    @classmethod
    def from_dict(cls, document: object) -> Calibration:
        """Read a document softmap.calibration/1.

        Raises:
            CalibrationError: another schema or unit, or a missing or invalid entry.
        """
        schema = document.get("schema") if isinstance(document, dict) else None
        if not isinstance(document, dict) or schema != SCHEMA:
            raise CalibrationError(
                f"calibration: schema {schema!r:.60}, expected {SCHEMA!r}; make it with `softmap "
                "model calibrate`"
            )
        try:
            if document["unit"] != "ticks":
                raise CalibrationError(f"calibration: of {document['unit']!r:.40}, expected ticks")
            unit, run, window = document["command_unit"], document["run"], document["tick_window"]
            if not all(
                isinstance(text, str) and 0 < len(text) <= 100 and text.isprintable()
                for text in (unit, run)
            ):
                raise CalibrationError(
                    "calibration: command_unit and run are texts of at most 100 characters"
                )
            counts: tuple[int, int] = document["frames"], document["held_commands"]
            if not all(
                isinstance(n, int) and not isinstance(n, bool) and 0 <= n < 1 << 53 for n in counts
            ):
                raise CalibrationError(
                    "calibration: frames and held_commands are whole numbers from 0 on"
                )
            error = {name: float(_numbers(name, document["held_out"][name])) for name in ERRORS}
            values = [
                *(document[name] for name in ("A", "b", "home")),
                *(document["sigma"][name] for name in "Ab"),
            ]
            a, b, home, *sigma = values
            return cls(
                a,
                b,
                home,
                sigma[0],
                sigma[1],
                error,
                run,
                *counts,
                None if window is None else window,
                unit,
            )
        except (KeyError, TypeError, ValueError, OverflowError) as fault:
            raise CalibrationError(
                f"calibration: an entry is missing or of another form ({type(fault).__name__} "
                f"{fault!s:.60}); make it again with `softmap model calibrate`"
            ) from None


def converted(model: Model | None, run: Run) -> Run:
    """Return the run with its ticks converted to commands by the model's calibration.

    It is unchanged without ticks or calibration.

    Args:
        model: with a `calibration`. Without one, or if None, the calibration of the control loop
            that recorded the run applies, if stored. A model in ticks takes ticks as commands.
        run: `ticks` become `command`; `present_ticks` become `present` unless already given. The
            measured points are the same array.

    Raises:
        CalibrationError: the run and the calibration differ in the number of servos, or the run's
            own calibration is invalid.
    """
    calibration, unit = (None, "mm") if model is None else (model.calibration, model.command_unit)
    if calibration is None and unit == TICKS:
        return commanded_in_ticks(run)
    calibration = calibration or _driven_by(run, unit)
    if calibration is None:
        return run
    run = held_in_ticks(run)
    if run.ticks is None and (run.present_ticks is None or run.present is not None):
        return run
    if run.channels != len(calibration.b):
        raise CalibrationError(
            f"the run has {run.channels} servos, the calibration of '{(model or run).robot}' is of "
            f"{len(calibration.b)}; it is a run of another robot"
        )
    return _commanded(run, calibration)


def _driven_by(run: Run, unit: str) -> Calibration | None:
    """Return the map that drove the robot, if a run in ticks stores it and it gives `unit`."""
    kept = text_in(run.extra, CALIBRATION)
    if kept is None or (run.ticks is None and run.present_ticks is None):
        return None
    try:
        found = Calibration.from_dict(json.loads(kept))
    except (ValueError, RecursionError):
        raise CalibrationError(
            f"the field `{CALIBRATION}` of the run is not a calibration; leave it out"
        ) from None
    return found if found.unit == unit else None


def _commanded(run: Run, calibration: Calibration) -> Run:
    """Return a run with its ticks converted to commands."""
    encoded = run.present_ticks is not None and run.present is None
    drive = Run(
        t=run.t,
        command=run.command if run.ticks is None else calibration.commands(run.ticks),
        present=calibration.commands(run.present_ticks)
        if encoded and run.present_ticks is not None
        else run.present,
        command_unit=calibration.unit if run.ticks is not None else run.command_unit,
    )
    driven = _driven(run, drive)
    if calibration.unit == TICKS:
        object.__setattr__(driven, "extra", {**run.extra, HOME_TICKS: np.asarray(calibration.home)})
    return driven


def from_home(runs: Sequence[Run]) -> tuple[list[Run], Calibration | None]:
    """Return runs in ticks with commands that count ticks from home, for models that need no mm.

    Args:
        runs: of one robot. Home is 0 if their ranges hold it, else the middle of the ranges
            (`home_command`).

    Returns:
        tuple: the runs, and the map that counts from home. If any run is not in ticks: the runs
        unchanged, and None.
    """
    held = [held_in_ticks(run) for run in runs]
    goals = [run.ticks for run in held if run.ticks is not None]
    if (
        not goals
        or len(goals) < len(runs)
        or len({goal.shape[1] for goal in goals}) > 1
        or not goals[0].shape[1]
    ):
        return list(runs), None
    rows = np.concatenate(goals)
    home = np.rint(home_command(np.stack([rows.min(axis=0), rows.max(axis=0)], axis=1)))
    counted = Calibration.stated(np.eye(len(home)), 0.0 * home, home, "ticks from home", unit=TICKS)
    return [_commanded(run, counted) for run in held], counted


def commanded_in_ticks(run: Run) -> Run:
    """Return a run that holds only ticks with its ticks as commands, for models that need no mm."""
    if run.command is not None or run.ticks is None:
        return run
    encoded = run.present_ticks is not None and run.present is None
    present = np.asarray(run.present_ticks, float) if encoded else run.present
    return _driven(
        run, Run(t=run.t, command=np.asarray(run.ticks, float), present=present, command_unit=TICKS)
    )


def held_in_ticks(run: Run) -> Run:
    """Return a run with commands in ticks as one that holds `ticks`.

    Commands that count from home are unchanged.
    """
    if run.command is None or run.command_unit != TICKS or HOME_TICKS in run.extra:
        return run
    goal = np.rint(run.command).astype(np.int64)
    encoded = run.present is not None and run.present_ticks is None
    present = (
        np.rint(run.present).astype(np.int64)
        if encoded and run.present is not None
        else run.present_ticks
    )
    return _driven(run, Run(t=run.t, ticks=goal, present_ticks=present))


def _driven(run: Run, drive: Run) -> Run:
    """Return a run with the commands of another."""
    driven = copy(run)  # `replace` would check the measured points again at every prediction
    for name in ("command", "present", "ticks", "present_ticks", "command_unit"):
        object.__setattr__(driven, name, getattr(drive, name))
    return driven


def _finite(name: str, value: ArrayLike) -> Floats:
    """Return numbers that must all be finite, since no tick stands for a missing command."""
    numbers = unmasked(value)
    if not np.isfinite(numbers).all():
        at = [int(i) for i in np.argwhere(~np.isfinite(numbers))[0]]
        raise CalibrationError(
            f"{name}: {int((~np.isfinite(numbers)).sum())} of {numbers.size} numbers are masked or "
            f"not finite, the first at {at}; remove or interpolate them"
        )
    return numbers


def _numbers(name: str, value: object) -> Floats:
    """Return finite numbers of a plausible size."""
    if (hidden := mask_of(value)) is not None:
        raise CalibrationError(
            f"calibration: {name}: {masked_text(hidden)}; give all of its numbers"
        )
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise CalibrationError(f"calibration: {name} holds {array.dtype}, expected numbers")
    array = np.array(array, np.float64)
    if not np.isfinite(array).all() or (array.size and np.abs(array).max() > LARGEST):
        raise CalibrationError(f"calibration: {name} is not all finite numbers within ±{LARGEST:g}")
    array.setflags(write=False)
    return array
