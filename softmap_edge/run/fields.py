"""Define each field of a run (type, axes, range) and the one sentence that reports a fault.

A new field is one line in the table `AXES`. Ranges are wide limits of what the unit allows. The
usual mistakes (metres for mm, kelvin for °C, m/s² for a unit vector, ticks for mm) fall outside.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Required, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import RunError, differing_times
from softmap_edge.files.atomic import Document
from softmap_edge.run.output import Output, output_of

if TYPE_CHECKING:
    from softmap_edge.run.run import Run

Array = NDArray[np.float64]
Seen = Literal["vertices", "markers", "points"]
RealField = Literal[
    Seen,
    "t",
    "t_seen",
    "command",
    "present",
    "current",
    "temperature",
    "gravity",
    "load",
    "sigma",
    "marker_rest",
    "frame",
    "frame_sigma",
    "cameras",
]
FieldName = Literal[RealField, "ticks", "present_ticks", "start", "visible", "block"]


class RecordedFields(TypedDict, total=False):
    """Fields of a run by name, but for what was seen of places and its times (`Run`)."""

    t: Required[Array]
    command: Array | None
    ticks: NDArray[np.int64] | None
    present: Array | None
    present_ticks: NDArray[np.int64] | None
    current: Array | None
    temperature: Array | None
    gravity: Array | None
    load: Array | float | None
    visible: NDArray[np.bool_] | None
    sigma: Array | None
    block: NDArray[np.generic] | None
    robot: str | None
    command_unit: str
    timeless: bool
    extra: dict[str, NDArray[np.generic]]


# field: (axes, type). Axes: T command rows, C channels, K frames, N points a frame, P points in
# all, S = K + 1; A cameras; a digit is itself.
AXES: dict[FieldName, tuple[str, str]] = {
    "t": ("T", "real"),
    "t_seen": ("K", "real"),
    "command": ("TC", "real"),
    "ticks": ("TC", "integer"),
    "present": ("TC", "real"),
    "present_ticks": ("TC", "integer"),
    "current": ("TC", "real"),
    "temperature": ("T", "real"),
    "gravity": ("T3", "real"),
    "load": ("T", "real"),
    "vertices": ("KN3", "real"),
    "markers": ("KN3", "real"),
    "points": ("P3", "real"),
    "start": ("S", "integer"),
    "visible": ("KN", "boolean"),
    "sigma": ("KN", "real"),
    "block": ("K", "label"),
    "marker_rest": ("N3", "real"),
    "frame": ("34", "real"),
    "frame_sigma": ("6", "real"),
    "cameras": ("A34", "real"),
}
SEEN: tuple[Seen, ...] = ("vertices", "markers", "points")  # a run holds one of them at most
BY_ROW = tuple(name for name, (axes, _) in AXES.items() if axes[0] == "T")
BY_FRAME = tuple(name for name, (axes, _) in AXES.items() if axes[0] == "K")
PLACES: tuple[Seen, ...] = ("vertices", "markers")  # of which some may not be seen
DRIVE: tuple[RealField, ...] = ("command", "present")  # in `command_unit`
# s for each row of a log without time: the rate at which a model is learned, so that no row is left
# out
ROW_S = 0.05
_TIME = (-1e11, 1e11, "s", "convert the time to seconds")
_TICKS = (-1e7, 1e7, "ticks", "a servo turn has about 4096 ticks; give ticks counted from home")
_PLACE = (-1e4, 1e4, "mm", "convert the points to mm")
# field: (low, high, unit, what to do about a value outside)
RANGES: dict[FieldName, tuple[float, float, str, str]] = {
    "t": _TIME,
    "t_seen": _TIME,
    "ticks": _TICKS,
    "present_ticks": _TICKS,
    "current": (-1e5, 1e5, "mA", "convert it to milliampere"),
    "temperature": (
        -80.0,
        250.0,
        "°C",
        "subtract 273.15 if it is in kelvin, and leave out what a failed sensor writes (-127)",
    ),
    "gravity": (-1e3, 1e3, "", "give a unit vector in the base frame"),
    "command": (-1e12, 1e12, "", "give the command in mm of tendon or in `command_unit`"),
    "present": (-1e12, 1e12, "", "give the encoder positions in mm of tendon or in `command_unit`"),
    "load": (0.0, 1e5, "g", "give the hanging mass in grams; below 0, add an offset"),
    "vertices": _PLACE,
    "markers": _PLACE,
    "points": _PLACE,
    "marker_rest": _PLACE,
    "frame": (-1e6, 1e6, "", "give the rotation and the shift in mm"),
    "cameras": (-1e6, 1e6, "", "give each camera's rotation and shift in mm"),
    "frame_sigma": (0.0, 1e6, "", "give standard deviations in degrees and mm"),
    "sigma": (1e-9, 1e3, "mm", "give the standard deviation of a coordinate in mm"),
}
_COMMAND_LIMIT = 1000.0  # mm: more tendon than any finger has; ticks and micrometres exceed it
_LONGEST = 100  # characters of a name, as in a bundle
_SMALLEST = 1.0  # mm: a robot whose points all lie within this is a robot in metres
# no robot is that much longer or shorter than at rest; other units are ten times off
_STRETCH = 4.0
_TICK = 1e-9  # s, below the resolution of all clocks here
_SAMPLE = 200_000  # values sampled for the extent: enough for any file, fast for the largest


def convert(name: FieldName, value: object) -> NDArray[np.generic]:
    """Return a read-only copy of `value` in the type of field `name`.

    Raises:
        RunError: it cannot be converted to that type.
    """
    kind = AXES[name][1]
    hidden = mask_of(value)
    if hidden is not None and name not in PLACES:
        remedy = "give false there" if kind == "boolean" else "remove or interpolate these rows"
        raise RunError(f"{name}: {masked_text(hidden)}; {remedy}")
    if hidden is not None:
        value = unmasked(value)  # type: ignore[arg-type]
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as cause:
        raise RunError(f"{name}: is not a rectangular array; give numbers of one shape") from cause
    if kind == "label":
        if array.dtype.kind not in "iubU" and (array.size or array.dtype.kind != "f"):
            raise RunError(f"block: labels of type {array.dtype}, expected integers or text")
        return frozen(array.astype(np.int64) if array.dtype.kind != "U" else np.array(array))
    if array.dtype.kind not in "biuf":
        raise RunError(f"{name}: values of type {array.dtype}, expected {kind} numbers")
    if kind == "boolean":
        if array.dtype.kind != "b" and not np.isin(array, (0, 1)).all():
            raise RunError(f"{name}: values other than 0 and 1; give true where a point was seen")
        return frozen(array.astype(np.bool_))
    if kind == "integer":
        if array.dtype.kind == "f" and not (
            np.isfinite(array).all() and (array == np.rint(array)).all()
        ):
            raise RunError(
                f"{name}: fractions or NaN, expected whole ticks or counts; round them or give "
                "`command` in mm"
            )
        if array.size and float(np.abs(array.astype(np.float64)).max()) > 2**53:
            raise RunError(f"{name}: values beyond 2^53; give ticks counted from home")
        return frozen(array.astype(np.int64))
    return frozen(np.array(array, np.float64, order="C"))


def kept(name: str, value: object, complete: bool) -> NDArray[np.generic]:
    """Return a field of `Run.extra`, with NaN where numbers are masked or None.

    Args:
        name: of the field.
        value: as given; a plain array is returned unchanged.
        complete: whether the field must have all of its numbers.

    Raises:
        RunError: a masked value cannot be NaN, or the field holds Python objects.
    """
    if type(value) is np.ndarray and value.dtype.kind != "O":
        return value
    hidden, array = mask_of(value), np.asarray(value)
    if hidden is not None and (complete or array.dtype.kind not in "iuf"):
        what = "must be complete" if complete else f"of type {array.dtype} cannot be missing"
        raise RunError(f"extra {name}: {masked_text(hidden)}; values {what}: fill them in")
    if hidden is not None:
        return unmasked(value)  # type: ignore[arg-type]
    if array.dtype.kind == "O":
        one = (int, float, np.integer, np.floating)
        if complete or not all(x is None or isinstance(x, one) for x in array.flat):
            raise RunError(f"extra {name}: Python objects; give an array of numbers or of texts")
        return np.asarray(array, np.float64)  # None becomes NaN
    return array


def masked_text(hidden: NDArray[np.bool_]) -> str:
    """Return how many values are masked, and where the first is."""
    at = [int(i) for i in np.argwhere(hidden)[0]]
    return f"{int(hidden.sum())} values of {hidden.size} are masked, the first at {at}"


def frozen(array: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return the array, made read-only."""
    array.setflags(write=False)
    return array


def text(name: str, value: NDArray[np.generic]) -> str:
    """Return a stored 0-d text field.

    Raises:
        RunError: it is not one text.
    """
    if value.dtype.kind not in "US" or value.size != 1:
        raise RunError(f"{name}: {value.dtype} of shape {value.shape}, expected one text")
    item = value.reshape(-1)[0]
    return plain(name, item.decode("utf-8", "replace") if isinstance(item, bytes) else str(item))


def plain(name: str, found: str) -> str:
    """Return the text of a field.

    Raises:
        RunError: it has characters that do not print, or more than a bundle can hold.
    """
    if not found.isprintable():
        from softmap_edge.files.printable import one_line

        raise RunError(
            f"{name}: '{one_line(found[:60])}' holds unprintable characters; give a plain name"
        )
    if len(found) > _LONGEST:
        raise RunError(
            f"{name}: {len(found)} characters, at most {_LONGEST} are allowed; give a shorter name"
        )
    return found


def cut_rows(run: Run, rows: slice) -> Document:
    """Return the fields that have a row for each command, cut."""
    values = {name: run.array(name) for name in BY_ROW}
    return {
        name: value[rows]
        for name, value in values.items()
        if value is not None and value.ndim == len(AXES[name][0])
    }


def outputs_from(stored: dict[str, NDArray[np.generic]]) -> Document:
    """Replace the fields of outputs in a file by those of a run, and return these.

    A file may hold `output` (K, Q) in `output_unit`, written by a person, in place of markers and
    their scale.

    Raises:
        RunError: a field is missing or has the wrong kind.
    """
    found: Document = {}
    if "timeless" in stored:
        found["timeless"] = bool(np.all(convert("visible", stored.pop("timeless"))))
    unit = text("output_unit", stored.pop("output_unit")) if "output_unit" in stored else None
    names = tuple(
        str(name) for name in np.atleast_1d(stored.pop("output_names", np.zeros(0, "U1")))
    )
    scale = stored.pop("output_mm_per_unit", None)
    values = None if unit is None else stored.pop("output", None)
    if unit is None:
        return found
    if values is not None:
        rows = convert("markers", values)
        output = output_of(rows, unit, names)
        visible = {} if np.isfinite(rows).all() else {"visible": np.isfinite(rows)}
        return found | visible | {"markers": output.markers(rows), "output": output}
    if scale is None or scale.size != 1 or scale.dtype.kind not in "iuf":
        raise RunError(
            "output_mm_per_unit: missing, expected one number; or give `output` (K, Q) in "
            "`output_unit`"
        )
    return found | {"output": Output(names, unit, float(scale.reshape(-1)[0]))}


def stored_outputs(run: Run) -> dict[str, NDArray[np.generic]]:
    """Return the fields that store the meaning of the markers, and whether the run has no time."""
    found: dict[str, NDArray[np.generic]] = {"timeless": np.asarray(True)} if run.timeless else {}
    if run.output is None:
        return found
    return found | {
        "output_names": np.array(run.output.names),
        "output_unit": np.asarray(run.output.unit),
        "output_mm_per_unit": np.asarray(run.output.mm_per_unit),
    }


def check(run: Run) -> None:
    """Check a complete run: shapes, then values, then how the fields fit together."""
    for name, text_of in (("robot", run.robot), ("command_unit", run.command_unit)):
        plain(name, str(text_of or ""))
    sizes = _sizes(run)
    for name, (axes, _) in AXES.items():
        value = run.array(name)
        if value is not None:
            _shape(name, value, axes, sizes)
            _values(name, value, run)
            if name in PLACES and value.shape[1] == 0:
                raise RunError(
                    f"{name}: shape {value.shape} holds no point; give at least one, or drop "
                    f"`{name}` and `t_seen`"
                )
    _times("t", run.t)
    _times("t_seen", run.t_seen)
    _together(run)
    _units(run)


def check_frames(stored: Document) -> None:
    """Reject a file that gives what was seen without any frame or point.

    Raises:
        RunError: such an array is empty.
    """
    for name in SEEN:
        value = stored.get(name)
        if isinstance(value, np.ndarray) and value.size == 0:
            raise RunError(
                f"{name}: shape {value.shape} is empty, so nothing was seen; record frames, or "
                f"drop `{name}` and `t_seen`"
            )


def _sizes(run: Run) -> dict[str, tuple[int, str]]:
    """Return the length of each axis and the field that sets it."""
    sizes = {axis: (int(axis), "") for axis in "346"}
    if run.t.ndim == 1:
        sizes["T"] = (len(run.t), "t")
    if run.t_seen.ndim == 1:
        sizes["K"] = (len(run.t_seen), "t_seen")
        sizes["S"] = (len(run.t_seen) + 1, "t_seen plus one")
    for name, rows in (("command", run.command), ("ticks", run.ticks)):
        if rows is not None and rows.ndim == 2:
            sizes["C"] = (rows.shape[1], name)
            break
    for place in PLACES:
        points = run.array(place)
        if points is not None and points.ndim == 3:
            sizes["N"] = (points.shape[1], place)
    return sizes


def _shape(
    name: str, value: NDArray[np.generic], axes: str, sizes: dict[str, tuple[int, str]]
) -> None:
    if name == "sigma" and value.ndim == 0:
        return
    if name == "gravity" and value.ndim == 1:
        axes = "3"
    fits = value.ndim == len(axes) and all(
        sizes.get(axis, (size, ""))[0] == size for axis, size in zip(axes, value.shape)
    )
    if fits:
        return
    written = ", ".join(axes) + ("," if len(axes) == 1 else "")
    known = [
        f"{a} = {sizes[a][0]} from {sizes[a][1]}"
        for a in axes
        if sizes.get(a, (0, ""))[1] not in ("", name)
    ]
    hint = ""
    if name in ("command", "ticks", "present", "present_ticks") and value.ndim == 1:
        hint = "; one channel is a column, shape (T, 1)"
    elif (
        value.ndim == len(axes) == 2
        and value.shape[1] == sizes.get(axes[0], (-1,))[0] != value.shape[0]
    ):
        hint = "; it looks transposed"
    elif value.ndim == len(axes) and axes.endswith("3") and value.shape[-1] != 3:
        hint = "; the last axis is x, y, z"
    expected = f"expected ({written})" + (f" with {', '.join(known)}" if known else "")
    raise RunError(
        f"{name}: shape {value.shape}, {expected}{hint}; change the array or its time column"
    )


def _values(name: FieldName, value: NDArray[np.generic], run: Run) -> None:
    if value.dtype.kind != "f" and name not in RANGES:
        return
    if value.dtype.kind == "f":
        bad = ~np.isfinite(value)
        if (
            name in ("vertices", "markers")
            and run.visible is not None
            and run.visible.shape == value.shape[:2]
        ):
            bad &= run.visible[..., None]
        if bad.any():
            where = tuple(int(i) for i in np.argwhere(bad)[0])
            remedy = (
                "mark unseen points in `visible`"
                if name in ("vertices", "markers")
                else "remove or interpolate these rows"
            )
            raise RunError(
                f"{name}: {int(bad.sum())} values are not finite, the first at {list(where)}; "
                f"{remedy}"
            )
    if name in RANGES and value.size:
        low, high, unit, remedy = RANGES[name]
        value = shown_only(name, value, run)
        finite = value[np.isfinite(value)] if value.dtype.kind == "f" else value
        if finite.size and (finite.min() < low or finite.max() > high):
            worst = finite.min() if finite.min() < low else finite.max()
            raise RunError(
                f"{name}: {worst:g}{unit and ' ' + unit}, expected {low:g} to "
                f"{high:g}{unit and ' ' + unit}; {remedy}"
            )


def shown_only(name: str, value: NDArray[Any], run: Run) -> NDArray[Any]:
    """Return a field of the run, with NaN at points that `visible` marks as not seen."""
    shown = run.visible
    if name not in PLACES or shown is None or shown.shape != value.shape[:2] or shown.all():
        return value
    return np.where(shown[..., None], value, np.nan)


def _times(name: str, t: NDArray[np.float64]) -> None:
    step = np.diff(t)
    late = step < _TICK
    if not late.any():
        return
    row = int(np.flatnonzero(late)[0]) + 1
    what = "goes backwards" if step[row - 1] < 0 else "stands still"
    now, before = differing_times(float(t[row]), float(t[row - 1]))
    raise RunError(
        f"{name}: time {what} at row {row} ({now} s after {before} s), "
        f"{int(late.sum())} such rows; "
        "sort the rows and drop repeated ones"
    )


def _together(run: Run) -> None:
    seen = [name for name in SEEN if run.array(name) is not None]
    if len(run.t) == 0:
        raise RunError("t: empty; a run needs at least one command row")
    if len(seen) > 1:
        raise RunError(
            f"{' and '.join(seen)}: a run holds one of vertices, markers, points; save them as "
            "separate runs"
        )
    if run.command is not None and run.ticks is not None:
        raise RunError(
            "command and ticks: a run holds one of the two; drop the one that was derived"
        )
    if (run.points is None) != (run.start is None):
        missing = "start" if run.start is None else "points"
        raise RunError(f"{missing}: missing; clouds need points (P, 3) and start (K + 1,)")
    if run.start is not None and run.points is not None:
        _clouds(run.start, len(run.points))
    for name, value in (("visible", run.visible), ("sigma", run.sigma)):
        if value is not None and value.ndim and run.places is None:
            raise RunError(
                f"{name}: given for each point, but the run holds no vertices or markers; give "
                "them or drop it"
            )
    for name, present in (("command", run.present), ("ticks", run.present_ticks)):
        if present is not None and run.channels == 0 and present.shape[1]:
            raise RunError(
                f"present: {present.shape[1]} channels, but `{name}` has none; give what was "
                "commanded"
            )
    if run.command_unit == "" or len(run.command_unit) > 32:
        raise RunError(
            f"command_unit: '{run.command_unit[:40]}', expected a short unit such as mm, deg or "
            "ticks"
        )
    if run.output is not None and (
        run.markers is None or run.markers.shape[1] != len(run.output.names)
    ):
        there = "none" if run.markers is None else str(run.markers.shape[1])
        raise RunError(
            f"output: {len(run.output.names)} outputs need as many markers, the run has {there}"
        )
    if run.marker_rest is not None and run.vertices is not None:
        raise RunError("marker_rest: belongs to markers, but the run holds vertices; drop it")


def _clouds(start: NDArray[np.int64], count: int) -> None:
    if start[0] != 0 or start[-1] != count or (np.diff(start) < 0).any():
        raise RunError(
            f"start: runs from {start[0]} to {start[-1]}, expected to rise from 0 to P = {count}; "
            "cloud k is points[start[k]:start[k + 1]]"
        )


def _units(run: Run) -> None:
    if run.gravity is not None and run.gravity.size:
        length = np.linalg.norm(np.atleast_2d(run.gravity), axis=1)
        worst = float(length[np.argmax(np.abs(length - 1.0))])
        if abs(worst - 1.0) > 1e-3:
            remedy = "divide it by its length" if worst else "leave it out if it is not known"
            raise RunError(
                f"gravity: length {worst:.4g}, expected a unit vector in the base frame; {remedy}"
            )
    if run.frame is not None:
        turn = run.frame[:, :3]
        if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-6 or np.linalg.det(turn) < 0:
            raise RunError(
                "frame: its first three columns are no rotation; make it with `softmap run align`"
            )
    if run.cameras is not None and run.cameras.size:
        turns = run.cameras[:, :, :3]
        if (
            np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max() > 1e-6
            or np.linalg.det(turns).min() < 0
        ):
            raise RunError(
                "cameras: their first three columns are no rotations; give poses [R | t] base to "
                "camera"
            )
    for name in DRIVE:
        value = run.array(name)
        if (
            run.command_unit == "mm"
            and value is not None
            and value.size
            and np.abs(value).max() > _COMMAND_LIMIT
        ):
            raise RunError(
                f"{name}: up to {np.abs(value).max():.4g} mm of tendon, at most "
                f"{_COMMAND_LIMIT:g} is plausible; give ticks as `ticks`, or name the unit in "
                "`command_unit`"
            )
    if len(run.t) and len(run.t_seen) and (run.t_seen[-1] < run.t[0] or run.t_seen[0] > run.t[-1]):
        first, last, begin, end = differing_times(
            *(float(t) for t in (*run.t_seen[[0, -1]], *run.t[[0, -1]]))
        )
        raise RunError(
            f"t_seen: {first} to {last} s lies outside the commands' {begin} to {end} s; bring "
            "both to one clock"
        )
    if run.markers is not None and run.marker_rest is not None:
        hidden = None if run.visible is None else ~run.visible[..., None]
        seen = run.markers if hidden is None else np.where(hidden, np.nan, run.markers)
        _same_units(seen, run.marker_rest)
    in_mm: tuple[RealField, ...] = (*SEEN, "marker_rest")
    for name in in_mm:
        value = run.array(name)
        if value is None or value.size < 6 or (value.ndim == 3 and value.shape[1] < 2):
            continue
        value = shown_only(name, value, run)
        sample = value.reshape(-1, 3)[:: max(1, value.size // _SAMPLE)]
        sample = sample[np.isfinite(sample).all(axis=1)]
        extent = float(np.ptp(sample, axis=0).max()) if len(sample) > 1 else _SMALLEST
        if extent < _SMALLEST:
            raise RunError(
                f"{name}: all points lie within {extent:.3g} mm, which looks like metres; "
                "multiply by 1000"
            )


def _same_units(markers: NDArray[np.float64], rest: NDArray[np.float64]) -> None:
    """Compare the spread of the markers with that at rest: bending halves it at most."""
    if len(rest) < 2 or not len(markers):
        return
    frames = markers[:: max(1, len(markers) // 50)]
    spread = np.sqrt(np.var(frames, axis=1).sum(axis=1))  # an incomplete frame has no spread
    spread = spread[np.isfinite(spread)]
    at_rest = float(np.sqrt(np.var(rest, axis=0).sum()))
    if not len(spread) or at_rest <= 0:
        return
    ratio = float(np.median(spread)) / at_rest
    if not 1.0 / _STRETCH < ratio < _STRETCH:
        raise RunError(
            f"marker_rest: the markers are spread {ratio:.3g} times as far as their places at "
            f"rest, at most {_STRETCH:g} times (or 1/{_STRETCH:g}) is plausible; give both in mm, "
            "in the same order"
        )


def unmasked(values: ArrayLike) -> NDArray[np.float64]:
    """Return real numbers, with NaN where a numpy masked array is masked.

    `np.asarray` drops the mask, so a filler such as 99999 would count as a value.
    """
    if isinstance(values, np.ma.MaskedArray):
        return np.where(np.ma.getmaskarray(values), np.nan, np.ma.getdata(values)).astype(float)
    return np.asarray(values, np.float64)


def mask_of(values: object) -> NDArray[np.bool_] | None:
    """Return the mask of a numpy masked array; None if it has none."""
    if not isinstance(values, np.ma.MaskedArray):
        return None
    mask = np.asarray(np.ma.getmaskarray(values), np.bool_)
    return mask if mask.any() else None
