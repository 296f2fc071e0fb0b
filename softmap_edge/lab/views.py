"""What the page shows of a run: errors by frame and section, classes of frames, loops, shapes.

    squared error of a frame = Σ |predicted − seen|² over its visible points, mm²
    RMS of any set of frames = sqrt(Σ squared / Σ visible points): exact for every selection

Units: mm, s. Pinned by tests/lab/test_views.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.comparison.comparison import TIMED, aligned, template, tips
from softmap_edge.comparison.series import tip_loops
from softmap_edge.errors import LabError
from softmap_edge.files.atomic import Document
from softmap_edge.model.model import Model
from softmap_edge.run.conditions import cells, conditions
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Mask = NDArray[np.bool_]

TRY_FRAMES = 400  # frames on which a change of parameters is tried while a slider moves


@dataclass(frozen=True, eq=False)
class Prediction:
    """A model on a run: points (K, N, 3), squared errors by section (K, S), tip (K, 3)."""

    points: Singles
    squared: Floats
    tip: Floats


@dataclass(frozen=True, eq=False)
class View:
    """A run as the page shows it, with one model before and perhaps one after the steps."""

    run: Run
    seen: Singles  # (K, N, 3), zero where hidden
    visible: Mask  # (K, N)
    sections: NDArray[np.int64]  # (N,) section of each point, from 0
    counts: Floats  # (K, S) visible points
    tip: Floats  # (K, 3), NaN where hidden
    command: Floats  # (K, C)
    classes: dict[str, tuple[list[str], Singles]]  # labels, and each frame's class or -1, (K,)
    rest: Floats  # (N, 3) template, or mean places of markers
    triangles: NDArray[np.int64]  # (F, 3)
    section_names: list[str]
    before: Prediction
    sample: NDArray[np.int64]  # indices of at most TRY_FRAMES frames
    gravity: Floats | None  # (K, 3) unit vectors in the base frame, None if not declared


def view_of(model: Model, run: Run) -> View:
    """Return the view of a run, with all points that it marks as visible.

    Raises:
        SoftmapError: prediction and measurement do not match.
    """
    predicted, seen, visible = aligned(model, run)
    markers = model.markers or len(model.rest) != seen.shape[1]
    labels = np.arange(seen.shape[1]) if markers else np.asarray(model.sections)
    kinds, sections = np.unique(labels, return_inverse=True)
    sections = sections.reshape(-1).astype(np.int64)
    state = conditions(run, model.commands(run))
    classes = {}
    for name, row in cells(state, model.command_unit).items():
        if run.timeless and name in TIMED:
            continue
        index = np.full(len(seen), -1.0, np.float32)
        for number, cell in enumerate(row):
            index[cell.frames] = number
        classes[name] = ([cell.label for cell in row], index)
    rest = template(model, seen)
    shown = rest is not None and len(model.triangles) > 0
    count = np.maximum(visible.sum(axis=0), 1)
    ends = {0: " base", len(kinds) - 1: " tip"}
    names = run.marker_names if markers else []
    step = max(1, -(-len(seen) // TRY_FRAMES))
    return View(
        run=run,
        seen=seen.astype(np.float32),
        visible=visible,
        sections=sections,
        counts=_by_section(visible.astype(float), sections),
        tip=tips(model, predicted, seen, visible)[0],
        command=state.command,
        classes=classes,
        rest=rest if shown and rest is not None else seen.sum(axis=0) / count[:, None],
        triangles=np.asarray(model.triangles, np.int64) if shown else np.zeros((0, 3), np.int64),
        section_names=names or [f"{k + 1}{ends.get(k, '')}" for k in range(len(kinds))],
        before=_prediction(model, predicted, seen, visible, sections),
        sample=np.arange(0, len(seen), step),
        gravity=state.gravity,
    )


def predicted_by(model: Model, view: View) -> Prediction:
    """Return another model's prediction of a view."""
    predicted, seen, visible = aligned(model, view.run)
    return _prediction(model, predicted, seen, visible, view.sections)


def _prediction(
    model: Model, predicted: Floats, seen: Floats, visible: Mask, sections: NDArray[np.int64]
) -> Prediction:
    squared = np.where(visible, np.sum((predicted - seen) ** 2, axis=2), 0.0)
    tip = tips(model, predicted, seen, visible)[1]
    return Prediction(predicted.astype(np.float32), _by_section(squared, sections), tip)


def _by_section(values: Floats, sections: NDArray[np.int64]) -> Floats:
    """Return sums (K, S) of values (K, N) over the points of each section."""
    total = np.zeros((len(values), int(sections.max()) + 1))
    for section in range(total.shape[1]):
        total[:, section] = values[:, sections == section].sum(axis=1)
    return total


def rms_of(prediction: Prediction, view: View) -> float:
    """Return the RMS error over all visible points, mm."""
    return float(np.sqrt(prediction.squared.sum() / view.counts.sum()))


def frames_of(view: View, after: Prediction | None) -> tuple[Document, dict[str, Singles]]:
    """Return the header and the arrays of a run for the page."""
    loops = tip_loops(view.command, view.tip, view.before.tip, after.tip if after else None)
    arrays: dict[str, NDArray[np.generic]] = {
        "t": view.run.t_seen,
        "counts": view.counts,
        "before": view.before.squared,
        "rest": view.rest,
        "triangles": view.triangles,
        "sections": view.sections,
        "command": view.command,
    }
    arrays |= {} if after is None else {"after": after.squared}
    arrays |= {} if view.gravity is None else {"gravity": view.gravity}
    arrays |= {f"class_{name}": index for name, (_, index) in view.classes.items()}
    for number, loop in enumerate(loops):
        arrays |= {f"loop{number}_command": loop.command, f"loop{number}_seen": loop.seen}
        arrays |= {f"loop{number}_before": loop.before}
        arrays |= {} if loop.after is None else {f"loop{number}_after": loop.after}
    header = {
        "frames": len(view.seen),
        "points": view.seen.shape[1],
        "section_names": view.section_names,
        "classes": {name: labels for name, (labels, _) in view.classes.items()},
        "loops": [loop.name for loop in loops],
        "timeless": view.run.timeless,
        "try_frames": view.sample.tolist(),
    }
    return header, {name: np.asarray(array, np.float32) for name, array in arrays.items()}


def shape_of(view: View, after: Prediction | None, frame: int) -> dict[str, Singles]:
    """Return measured and predicted points (N, 3) of a frame, and which were seen (N,)."""
    frame = _checked(view, frame)
    shapes = {
        "seen": view.seen[frame],
        "visible": view.visible[frame].astype(np.float32),
        "before": view.before.points[frame],
    }
    return shapes | ({} if after is None else {"after": after.points[frame]})


def tried(model: Model, view: View, frame: int) -> tuple[float, dict[str, Singles]]:
    """Return the error of a model on the sample of a run, RMS mm, and its shape in one frame."""
    chosen = np.union1d(view.sample, [_checked(view, frame)])
    predicted, seen, visible = aligned(model, view.run.at(chosen))
    counted = visible & np.isin(chosen, view.sample)[:, None]
    squared = np.sum((predicted - seen) ** 2, axis=2)[counted]
    here = predicted[int(np.searchsorted(chosen, frame))]
    return float(np.sqrt(squared.mean())), {"points": here.astype(np.float32)}


def _checked(view: View, frame: int) -> int:
    if not 0 <= frame < len(view.seen):
        raise LabError(f"there is no frame {frame}; there are 0 to {len(view.seen) - 1}")
    return frame
