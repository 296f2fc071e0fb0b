"""The run: commands and measurements, with every field checked (mm, s, ticks, mA, °C, g).

`Run.load` and `Run.save` read and write the plain `.npz` form. A Run is valid by construction, so
code that receives one need not check it again. T command rows, C channels, K seen frames, N
vertices or M markers; C = 0 and K = 0 are valid. The unit of `command` and `present` is mm of
tendon unless `command_unit` names another (a robot without a spool radius). Known limit: a file in
metres is recognised by its extent (< 1 mm in total), so a smaller robot is refused.
tests/run/test_runs.py pins this and each message.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.atomic import Document
from softmap_edge.files.npz import MAX_BYTES, read_npz, write_npz
from softmap_edge.run import fields
from softmap_edge.run.fields import (
    FieldName,
    RealField,
    RecordedFields,
    Seen,
    mask_of,
    unmasked,
)
from softmap_edge.run.output import Output, output_of
from softmap_edge.run.plane import PLANE

Array = NDArray[np.float64]
Source = Literal["goal", "present"]
MAX_NUMBERS = 1 << 26  # numbers in a run: 40 000 frames of 548 vertices
# field of an import: markers (K, B, 3) mm that are fixed to the base
BASE_MARKERS = "base_markers"
ROLL_SEEN = "roll_seen"  # field: whether a run shows the body's rotation about its own axis
# field of an import: radius of the spools in its mapping
SPOOL_RADIUS = "spool_radius_mm"
SPOOLS_MM = (1e-3, 1e4)  # radii that a mapping may declare
# field: the search for places that stand for "not seen" is done or switched off
NOT_SEEN = "not_seen"
# fields of a run that was cut or joined
PIECES = ("piece_origin", "piece_row", "piece_frame", "piece_shift_s")
# smallest change of a command, in any unit: a nanometre in metres, far below any servo's step
_NO_CHANGE = 1e-9
NO_COMMANDS = (  # reasons why a run of markers alone cannot be used
    "a run without commands can be shown, cut and joined, but no model can be learned from it, "
    "compared with it or diagnosed; name the columns of the commands (or encoders) as `command` "
    "or `ticks` in the mapping"
)
# field: ticks at home (C,) of a run whose commands count from there
HOME_TICKS = "home_ticks"
# field: the map (JSON) with which a control loop converted commands to `ticks`
CALIBRATION = "calibration"
DAMAGE = "damage"  # field: a sentence on what the source recording lacks
# fields of `extra` that our own commands write
OURS = {
    BASE_MARKERS,
    SPOOL_RADIUS,
    ROLL_SEEN,
    NOT_SEEN,
    PLANE,
    HOME_TICKS,
    "made_by",
    "made_from",
    "marker_labels",
}
OURS |= {CALIBRATION, DAMAGE, *PIECES}


def spool_radius(extra: Mapping[str, NDArray[np.generic]]) -> float | None:
    """Return the radius (mm) of the spools from `Run.extra`, where a mapping declared it.

    None if it is absent or not plausible.
    """
    value = np.asarray(extra.get(SPOOL_RADIUS, 0.0))
    plain = value.ndim == 0 and value.dtype.kind in "fiu"
    return float(value) if plain and SPOOLS_MM[0] <= float(value) <= SPOOLS_MM[1] else None


def text_in(extra: Mapping[str, NDArray[np.generic]], name: str) -> str | None:
    """Return the text of a `Run.extra` field; None if absent, or an array of another program."""
    field = extra.get(name)
    return (
        None
        if field is None or field.dtype.kind != "U" or field.size != 1
        else str(field.reshape(-1)[0])
    )


def _load(path: str | os.PathLike[str], limit: int = MAX_BYTES) -> Run:
    """Read a run from `.npz`.

    Args:
        path: the file.
        limit: largest unpacked size, bytes.

    Raises:
        RunError: the file is damaged, too large, or a field is wrong.
    """
    # each number takes eight bytes, several times, whatever its stored type
    archive = read_npz(Path(path), RunError, limit, MAX_NUMBERS)
    try:
        stored: dict[str, NDArray[np.generic]] = dict(archive)
        known: Document = {name: stored.pop(name) for name in fields.AXES if name in stored}
        for name in ("robot", "command_unit"):
            if name in stored:
                known[name] = fields.text(name, stored.pop(name))
        known |= fields.outputs_from(stored)
        if "t" not in known:
            if "t_seen" not in known or "command" in known or "ticks" in known:
                raise RunError("t: missing; a run needs the time of its commands (T,) in s")
            known["t"] = known["t_seen"]
        fields.check_frames(known)
        return Run(**known, extra=stored)
    except RunError as fault:
        raise RunError(f"{path}: {fault}") from None
    except MemoryError:
        raise RunError(
            f"{path}: larger than this machine's free memory; cut the recording into shorter runs"
        ) from None


def _without_jitter(command: Array) -> Array:
    """Return commands (T, C) in which every channel that hardly changes is constant.

    A change below `_NO_CHANGE` is not a motion in any unit; dividing by it overflows.
    """
    if command.ndim != 2 or not command.size:
        return command
    with np.errstate(over="ignore", invalid="ignore"):
        still = np.flatnonzero(np.ptp(command, axis=0) < _NO_CHANGE)
    level = np.where(np.abs(command[0]) < _NO_CHANGE, 0.0, command[0])
    if (command[:, still] == level[still]).all():
        return command
    constant = command.copy()
    constant[:, still] = level[still]
    constant.setflags(write=False)
    return constant


class _Load:
    """Share one name between `run.load` (the column of grams) and `Run.load(path)` (the reader)."""

    @overload
    def __get__(self, run: None, owner: type[Run]) -> Callable[..., Run]: ...
    @overload
    def __get__(self, run: Run, owner: type[Run]) -> Array | None: ...
    def __get__(self, run: Run | None, owner: type[Run]) -> Callable[..., Run] | Array | None:
        return _load if run is None else run.__dict__["load"]

    def __set__(self, run: Run, value: object) -> None:
        run.__dict__["load"] = None if value is _load else value  # the default is the reader itself


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """One recording. Arrays are copied, float64 (ticks int64) and read-only.

    Attributes:
        t: (T,) s, strictly increasing.
        t_seen: (K,) s, strictly increasing, on the clock of `t`.
        command, ticks: (T, C) commands, in `command_unit` (mm of shortening) or in servo ticks;
            exactly one of the two. A channel that changes by less than 1e-9 is made constant.
        present, present_ticks: (T, C) encoder positions, in `command_unit` or in ticks.
        current, temperature, load: (T, C) mA, (T,) °C, (T,) g; the last two may be given as one
            number.
        gravity: (3,) or (T, 3) unit vector in the base frame.
        vertices, markers: (K, N, 3) mm.
        points: (P, 3) mm, in place of these; cloud k is `points[start[k]:start[k + 1]]`.
        visible: (K, N) bool.
        sigma: () or (K, N) mm, one standard deviation.
        block: (K,) integer or text labels.
        marker_rest: (M, 3) mm, the markers of the straight robot.
        robot: its name.
        frame: (3, 4) [R | mm], transform of the points from the recorded frame to the base frame
            (`softmap run align`).
        frame_sigma: (6,) standard deviations of `frame`, deg and mm, about the axes of the base
            frame.
        cameras: (A, 3, 4) [R | mm], transform from the base frame to each camera, which looks
            along z.
        output: meaning of the markers if they are forces, angles or levels, not positions
            (`of_outputs`).
        timeless: whether `t` counts rows because the log has no time; nothing about rates can then
            be learned.
        extra: unknown fields, kept unchanged; masked numbers and None become NaN.

    Raises:
        RunError: a field is invalid; the message gives its name, its value and the expected one.
    """

    t: Array
    command: Array | None = None
    t_seen: Array = field(default_factory=lambda: np.zeros(0))
    vertices: Array | None = None
    markers: Array | None = None
    points: Array | None = None
    start: NDArray[np.int64] | None = None
    ticks: NDArray[np.int64] | None = None
    present: Array | None = None
    present_ticks: NDArray[np.int64] | None = None
    current: Array | None = None
    temperature: Array | None = None
    gravity: Array | None = None
    load: _Load = _Load()
    visible: NDArray[np.bool_] | None = None
    sigma: Array | None = None
    block: NDArray[np.generic] | None = None
    marker_rest: Array | None = None
    frame: Array | None = None
    frame_sigma: Array | None = None
    cameras: Array | None = None
    robot: str | None = None
    command_unit: str = "mm"
    output: Output | None = None
    timeless: bool = False
    extra: dict[str, NDArray[np.generic]] = field(default_factory=dict)

    @classmethod
    def of_outputs(
        cls,
        values: ArrayLike,
        unit: str,
        names: Sequence[str] = (),
        *,
        t_seen: ArrayLike,
        **recorded: Unpack[RecordedFields],
    ) -> Run:
        """Return a run of outputs other than positions: forces, angles, levels.

        Args:
            values: measured values, shape (K, Q), in `unit`; NaN where an output has no value.
            unit: of all outputs, as reports print it.
            names: of the outputs; numbered by default.
            t_seen: times of the frames, (K,) s.
            recorded: the other fields of a run: `t`, `command`, `command_unit`, `timeless`, …

        Raises:
            RunError: no output moves, or a field is wrong.
        """
        rows = unmasked(values)
        output = output_of(rows, unit, tuple(names))
        shown = np.isfinite(rows)
        if not shown.all():
            recorded.setdefault("visible", shown)
        return cls(
            markers=output.markers(rows),
            t_seen=unmasked(t_seen),
            output=output,
            **recorded,
        )

    def __post_init__(self) -> None:
        self._hide_masked()
        extra = {
            name: fields.kept(name, value, name in (HOME_TICKS, SPOOL_RADIUS))
            for name, value in self.extra.items()
        }
        object.__setattr__(self, "extra", extra)
        for name in fields.AXES:
            value = self.array(name)
            if value is not None:
                object.__setattr__(self, name, fields.convert(name, value))
        for name in fields.DRIVE:
            rows = self.array(name)
            if rows is not None:
                object.__setattr__(self, name, _without_jitter(rows))
        for name, rows in (("temperature", self.temperature), ("load", self.load)):
            if rows is not None and rows.ndim == 0 and self.t.ndim == 1:
                object.__setattr__(self, name, fields.frozen(np.full(len(self.t), float(rows))))
        if self.command is None and self.ticks is None and self.t.ndim == 1:
            object.__setattr__(self, "command", fields.frozen(np.zeros((len(self.t), 0))))
        self.validate()

    def _hide_masked(self) -> None:
        """Mark points with a masked coordinate as not seen."""
        for name in fields.PLACES:
            hidden = mask_of(self.array(name))
            if hidden is not None and hidden.ndim == 3:
                shown = ~hidden.any(axis=2)
                if self.visible is not None and np.shape(self.visible) == shown.shape:
                    shown &= fields.convert("visible", self.visible).astype(bool)
                object.__setattr__(self, "visible", shown)

    def validate(self) -> None:
        """Check every field: shape, finiteness, order of time, plausible units.

        A Run is already checked when it is created.

        Raises:
            RunError: the first fault, with the expected value.
        """
        fields.check(self)

    # --- files ---------------------------------------------------------------------------
    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return the fields that are set as stored (texts as 0-d arrays), unknown ones last."""
        known = {name: self.array(name) for name in fields.AXES}
        stored: dict[str, NDArray[np.generic]] = {
            name: np.asarray(value) for name, value in known.items() if value is not None
        }
        stored |= {"command_unit": np.asarray(self.command_unit)}
        stored |= {} if self.robot is None else {"robot": np.asarray(self.robot)}
        stored |= fields.stored_outputs(self)
        return stored | {name: self.extra[name] for name in sorted(self.extra)}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the run as `.npz`; equal runs give equal bytes.

        Raises:
            RunError: the name does not end in .npz.
        """
        if Path(path).suffix != ".npz":
            raise RunError(f"{path}: a run is saved as .npz; give a name that ends so")
        write_npz(Path(path), self.arrays())

    def hash(self) -> str:
        """Return the SHA-256 of the content in hex: names, types, shapes and values."""
        digest = hashlib.sha256()
        for name, array in sorted(self.arrays().items()):
            digest.update(f"{name}|{array.dtype.str}|{array.shape}|".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    # --- what it holds -------------------------------------------------------------------
    @overload
    def array(self, name: RealField) -> Array | None: ...
    @overload
    def array(self, name: FieldName) -> NDArray[np.generic] | None: ...
    def array(self, name: FieldName) -> NDArray[np.generic] | None:
        """Return the array of a field; None where the run has none.

        Args:
            name: of the field, such as `command`.
        """
        value: NDArray[np.generic] | None = getattr(self, name)
        return value

    @property
    def seen(self) -> Seen | None:
        """The field that holds what was seen; None where nothing was."""
        return next((name for name in fields.SEEN if self.array(name) is not None), None)

    @property
    def places(self) -> Array | None:
        """(K, N, 3) mm: the vertices or the markers, whichever the run holds; None of clouds."""
        return self.vertices if self.vertices is not None else self.markers

    @property
    def channels(self) -> int:
        """The number of command channels, C."""
        for rows in (self.command, self.ticks):
            if rows is not None:
                return int(rows.shape[1])
        return 0

    @property
    def frames(self) -> int:
        """The number of seen frames, K."""
        return len(self.t_seen)

    @property
    def marker_names(self) -> list[str]:
        """The names of the markers: `marker_labels` of an import, else numbers from 1."""
        if self.output is not None:
            return list(self.output.names)
        count = 0 if self.markers is None else self.markers.shape[1]
        numbered = [f"marker {m + 1}" for m in range(count)]
        labels = self.extra.get("marker_labels")
        if labels is None or labels.dtype.kind != "U" or labels.shape != (count,):
            return numbered
        names = ["".join(c for c in str(label)[:40] if c.isprintable()) for label in labels]
        return names if all(names) and len(set(names)) == count else numbered

    @property
    def outputs(self) -> Array:
        """The measured values (K, Q), in `output.unit`; NaN where an output has no value.

        Raises:
            RunError: the run holds positions.
        """
        if self.output is None or self.markers is None:
            raise RunError("output: the run holds places, not outputs; its markers are `markers`")
        return np.where(known(self, self.markers), self.output.values(self.markers), np.nan)

    @property
    def seen_points(self) -> Array:
        """The vertices or the markers, whichever the run holds, (K, N, 3) mm.

        Raises:
            RunError: the run holds point clouds, or no points.
        """
        if self.places is not None:
            return self.places
        if self.points is not None:
            raise RunError(
                "points: clouds have no correspondence yet; lay a template onto them with "
                "`softmap run register`"
            )
        raise RunError("vertices, markers: the run holds neither; record or import what was seen")

    def commands(self, source: Source | None = None) -> Array:
        """Return the commands (T, C) that drive the model, in `command_unit`.

        Args:
            source: "goal" (commanded) or "present" (measured by the encoders); None: present
                positions if the run has them, else goals.

        Raises:
            RunError: the run does not hold it, or holds only ticks.
        """
        if source not in (None, "goal", "present"):
            raise RunError(f"source: '{source}', expected goal or present")
        if source == "present" or (source is None and self.present is not None):
            if self.present is None:
                raise RunError(
                    "present: the run has no encoder positions in mm; use the goal (--input goal)"
                )
            return self.present
        if self.command is None:
            raise RunError(
                "command: the run holds ticks, and the model takes another unit without a "
                "calibration; `softmap learn RUN --out DIR` makes a model in ticks from a run "
                "with markers, `softmap model calibrate RUN --bundle DIR --out DIR2` calibrates a "
                "model of this robot; then give --bundle DIR or DIR2"
            )
        return self.command

    def command_at(self, t: ArrayLike, source: Source | None = "goal") -> Array:
        """Return the commands (n, C) at times t (n,) s: linear between rows, held outside."""
        rows = self.commands(source)
        times = np.atleast_1d(unmasked(t))
        columns = [np.interp(times, self.t, rows[:, c]) for c in range(rows.shape[1])]
        return np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))

    # --- parts ---------------------------------------------------------------------------
    def at(self, select: ArrayLike) -> Run:
        """Return the run with some of its frames.

        All commands are kept, to preserve memory.

        Args:
            select: (K,) bool, or indices of frames in increasing order.

        Raises:
            RunError: the selection does not fit the frames.
        """
        if (hidden := mask_of(select)) is not None:
            raise RunError(
                f"select: {fields.masked_text(hidden)}; give true or false for each frame"
            )
        chosen = np.asarray(select)
        if chosen.dtype == bool and chosen.shape != (self.frames,):
            raise RunError(
                f"select: shape {chosen.shape}, expected ({self.frames},) for {self.frames} frames"
            )
        if chosen.dtype != bool and chosen.size and chosen.dtype.kind not in "iu":
            raise RunError(f"select: {chosen.dtype}, expected booleans or indices of frames")
        index = (
            np.flatnonzero(chosen) if chosen.dtype == bool else chosen.astype(np.int64).reshape(-1)
        )
        if index.size and (index.min() < -self.frames or index.max() >= self.frames):
            raise RunError(f"select: frame {index.max()}, the run has {self.frames}")
        change: Document = {}
        for name in fields.BY_FRAME:
            value = self.array(name)
            if value is not None and value.ndim:
                change[name] = value[index]
        if self.points is not None and self.start is not None:
            clouds = [self.points[self.start[k] : self.start[k + 1]] for k in index]
            change["points"] = np.concatenate(clouds) if clouds else np.zeros((0, 3))
            change["start"] = np.concatenate(
                [[0], np.cumsum([len(cloud) for cloud in clouds])]
            ).astype(np.int64)
        base = self.extra.get(BASE_MARKERS)
        if base is not None and base.ndim and len(base) == self.frames:
            change["extra"] = self.extra | {BASE_MARKERS: base[index]}
        return dataclasses.replace(self, **change)

    def slice_time(self, t0: float, t1: float) -> Run:
        """Return rows and frames with t0 <= time < t1 (s), and the row whose command holds at t0.

        Memory of earlier rows is lost; use `at` if memory matters.

        Raises:
            RunError: the interval is empty or holds no row.
        """
        first = max(int(np.searchsorted(self.t, t0, side="right")) - 1, 0)
        last = int(np.searchsorted(self.t, t1))
        if not t0 < t1 or last <= first:
            raise RunError(
                f"slice_time: no rows in [{t0:g}, {t1:g}) s; the run lasts from {self.t[0]:g} to "
                f"{self.t[-1]:g} s"
            )
        part = self.at((self.t_seen >= t0) & (self.t_seen < t1))
        return dataclasses.replace(part, **fields.cut_rows(self, slice(first, last)))

    def cut(
        self,
        start: float | None = None,
        end: float | None = None,
        *,
        block: str | int | None = None,
        lead_s: float = 0.0,
    ) -> Run:
        """Return a piece of the run: a time span or a block (`run_cut.cut`).

        Args:
            start: s; frames with start <= time < end are kept. None: from the first frame.
            end: s. None: to the last frame.
            block: a label, in place of times.
            lead_s: s of commands kept before the first frame, to preserve memory.

        Raises:
            RunError: the piece is empty, or there is no such block.
        """
        from softmap_edge.run.cut import cut

        return cut(self, start, end, block=block, lead_s=lead_s)

    def __repr__(self) -> str:
        seen: str = self.seen or "nothing"
        if self.output is not None:
            seen = f"{', '.join(self.output.names)} ({self.output.unit})"
        rows = f"{len(self.t)} rows, {self.channels} channels, {self.frames} frames of {seen}"
        return f"Run({self.robot or 'unnamed'}: {rows})"


def as_runs(runs: Run | Sequence[Run] | None) -> list[Run]:
    """Return one run, several, or none as a list."""
    if runs is None:
        return []
    return list(runs) if isinstance(runs, Sequence) else [runs]


def known(run: Run, points: Array) -> NDArray[np.bool_]:
    """Return which points (K, N, 3) of a run were seen, (K, N): finite and not marked hidden."""
    finite = np.asarray(np.isfinite(points).all(axis=2), np.bool_)
    return finite if run.visible is None else np.logical_and(finite, run.visible)
