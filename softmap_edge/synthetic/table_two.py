"""The paper's Table II: letters S, H, O, E by one solved sequence each.

The sequences run on a simulator and on a virtual finger.

    targets ──inverse kinematics of a model──> commands ──> simulator of the finger
        (paper: simulation)
                                                       └──> virtual finger  (paper: hardware)

The virtual finger (`synthetic/virtual_finger.py`) replaces hardware and is simulated. It has what
the model lacks: other elements and material, turned tendons, friction, a lean. A bundle calibrated
on it sends ticks. Without a calibration, as for the alternative, the servos follow the commands by
their true map. A figure is centred at the tip at rest: the model's tip while solving, the executed
finger's tip for evaluation. So a different rest position does not count. The tip is the middle of
the vertices that move most, of the alternative's own points while it is solved. Errors are
distances in mm in the plane of the figure, at the waypoints. The paper's figures are of another
finger, simulator, letters and amplitude. Pinned by tests/synthetic/test_table_two.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.files.atomic import Document
from softmap_edge.model.model import Model
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.drive.track import Course, course, spread
from softmap_edge.robot.emulated.laws import rotation
from softmap_edge.robot.emulated.published_map import PUBLISHED
from softmap_edge.robot.motion.kinematics import AXES, Kinematics
from softmap_edge.robot.servo.loop_limits import ACCELERATION, SLEW
from softmap_edge.run.protocol import HANGING, Protocol
from softmap_edge.synthetic.virtual_finger import VirtualFinger, virtual_finger

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

LETTERS = ("S", "H", "O", "E")
PLANE = "xy"
OURS, COMPENSATED, ALTERNATIVE = "ours", "ours, effects compensated", "rival"
WHERE = ("simulator", "stand_in")
# Table II: mean, standard deviation and largest in mm, in simulation and on hardware; the paper's
# own data.
PUBLISHED_ERRORS = {
    ("S", OURS): ((1.124, 0.617, 1.95), (3.458, 2.976, 15.38)),
    ("H", OURS): ((1.214, 0.652, 2.55), (3.569, 2.343, 10.3)),
    ("O", OURS): ((1.184, 0.182, 1.499), (1.387, 0.831, 3.839)),
    ("E", OURS): ((1.174, 0.755, 2.509), (2.616, 1.777, 8.05)),
    ("S", ALTERNATIVE): ((2.685, 1.109, 3.646), (5.917, 5.12, 23.154)),
    ("H", ALTERNATIVE): ((2.766, 0.999, 4.319), (5.854, 3.816, 14.7)),
    ("O", ALTERNATIVE): ((1.336, 0.918, 1.582), (3.164, 1.683, 6.887)),
    ("E", ALTERNATIVE): ((1.889, 0.92, 3.015), (4.791, 3.174, 14.76)),
}


@dataclass(frozen=True)
class Row:
    """One letter, tracked with one model.

    Errors (T,) mm at the waypoints: `expected` by the model, on the `simulator` and on the
    `stand_in`. `unreachable` mm is the largest distance of a waypoint from its solution.
    """

    figure: str
    model: str
    expected: Floats
    simulator: Floats
    stand_in: Floats
    unreachable: float

    def to_dict(self) -> Document:
        """Return means, standard deviations and the largest, with those of the paper."""
        found: Document = {
            "figure": self.figure,
            "model": self.model,
            "unreachable_mm": self.unreachable,
        }
        found |= {f"{name}_mm": spread(getattr(self, name)) for name in ("expected", *WHERE)}
        published = PUBLISHED_ERRORS.get((self.figure, self.model))
        if published is None:
            return found | {"paper": None}
        figures = (dict(zip(("mean", "sd", "max"), of)) for of in published)
        return found | {
            "paper": dict(zip(("simulation_mm", "hardware_mm"), figures)) | {"on": "other data"}
        }


@dataclass(frozen=True)
class Contender:
    """A model by its name in the table, its conditions, and the map of its servos.

    The conditions are `gravity` (3,) g, None for hanging.
    """

    name: str
    model: Model
    gravity: Floats | None
    calibration: Calibration | None


def contenders(model: Model, alternative: Model | None, finger: VirtualFinger) -> list[Contender]:
    """Return the models compared: without effects, with them if any, and the alternative.

    A residual is included with the effects; effects are compensated in the orientation that the
    stand-in declares.

    Raises:
        SoftmapError: a model of another finger.
    """
    for one in (model, alternative):
        if one is not None and (
            one.robot != finger.finger.name or one.channels != len(PUBLISHED.home)
        ):
            raise SoftmapError(
                f"the bundle is of '{one.robot}', {one.channels} commands; the table is of "
                f"'{finger.finger.name}', {len(PUBLISHED.home)}: it is solved there"
            )
    map_, found = model.calibration, []
    plain = model.bare()
    found.append(Contender(OURS, plain, None, map_))
    if model.chain_names:
        leaning = np.asarray(HANGING) @ rotation((*finger.declared_deg, 0.0)).T
        found.append(Contender(COMPENSATED, model, leaning, map_))
    if alternative is not None:
        found.append(Contender(ALTERNATIVE, alternative, None, map_))
    return found


def table_two(
    model: Model,
    alternative: Model | None,
    *,
    seed: int = 1,
    amplitude: float = 8.0,
    duration: float = 20.0,
    rate: float = 3.0,
    method: str = "paper",
    figures: Sequence[str] = LETTERS,
    progress: Progress | None = None,
) -> list[Row]:
    """Solve all letters with all models, and replay each sequence on both fingers.

    Args:
        model: ours.
        alternative: another model, as `softmap train prior --model deepsoro` makes it.
        seed: seed of the stand-in; calibrate the bundle on the stand-in of the same seed.
        amplitude: size of the letters, mm.
        duration: duration of a letter, s.
        rate: waypoints per second.
        method: method of the inverse kinematics.
        progress: called with the current task and the completed share.

    Raises:
        SoftmapError: a model of another finger, or as for `course`.
    """
    finger = virtual_finger(seed)
    simulator, tip = Simulator(Finger.builtin()), model.tip_indices
    todo = [(figure, one) for figure in figures for one in contenders(model, alternative, finger)]
    rows = []
    for k, (figure, one) in enumerate(todo):
        if progress is not None:
            progress(f"{figure}, {one.name}", k / len(todo))
        kinematics = Kinematics(
            replace(one.model, calibration=one.calibration), gravity=one.gravity, axes=PLANE
        )
        planned = course(
            kinematics,
            figure,
            amplitude=amplitude,
            duration=duration,
            rate=rate,
            slew=[SLEW] * 2,
            acceleration=[ACCELERATION] * 2,
            calibration=one.calibration or _servo_map(),
            method=method,
        )
        plan = planned.plan
        seen = np.flatnonzero(np.append(True, planned.counts[1:]))  # at rest, then the figure
        simulated = simulator.path(plan.commands[seen])
        stood = _stand_in(finger, planned, one.calibration, seen)
        on_both = (
            _off(planned, shapes[:, tip].mean(axis=1), seen) for shapes in (simulated, stood)
        )
        one_error, other_error = on_both
        expected, farthest = plan.distance[planned.counts], plan.unreachable[planned.counts].max()
        rows.append(Row(figure, one.name, expected, one_error, other_error, float(farthest)))
    return rows


def _servo_map() -> Calibration:
    """Return the true map of the servos, for commands of a model without calibration."""
    return Calibration.stated(
        PUBLISHED.slope, PUBLISHED.shift, PUBLISHED.home, "the servos' own map"
    )


def _stand_in(
    finger: VirtualFinger, planned: Course, calibration: Calibration | None, seen: NDArray[np.int64]
) -> Floats:
    """Return the true points (K, N, 3) mm of the virtual finger at waypoints `seen` (K,).

    Servos turn in integer ticks.
    """
    plan = planned.plan
    ticks = (
        PUBLISHED.to_ticks(plan.commands)
        if calibration is None
        else calibration.ticks(plan.commands)
    )
    gravity = np.tile(HANGING, (len(plan.t), 1))
    block = np.full(len(seen), "figure")
    return finger.shapes(
        Protocol("table", plan.t, finger.servos.to_mm(ticks), gravity, plan.t[seen], block)
    )


def _off(planned: Course, tip: Floats, seen: NDArray[np.int64]) -> Floats:
    """Return the distances (T,) mm of a tip (1 + T, 3) from its figure.

    Its rows are the rest position and the waypoints; the figure is centred at rest.
    """
    target = planned.plan.targets[seen] - planned.plan.targets[0]
    counts = [axis in PLANE for axis in AXES]
    return np.asarray(np.linalg.norm(((tip - tip[0]) - target)[1:, counts], axis=1))


def text_of(document: Document) -> str:
    """Return the table as text, with the paper's columns."""

    def numbers(document: Document | None) -> str:
        return "–" if document is None else "{mean:.2f} ± {sd:.2f}, {max:.2f}".format(**document)

    head = (
        "",
        "",
        "the model itself",
        "simulator",
        "stand-in",
        "paper: simulation",
        "paper: hardware",
    )
    lines = [head]
    for row in document["rows"]:
        paper = row["paper"] or {}
        columns = [row[f"{name}_mm"] for name in ("expected", *WHERE)]
        columns += [paper.get(name) for name in ("simulation_mm", "hardware_mm")]
        name = document["rival"] or ALTERNATIVE if row["model"] == ALTERNATIVE else row["model"]
        lines.append((row["figure"], name, *map(numbers, columns)))
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    text = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip() for line in lines
    ]
    effects = ", ".join(document["effects"]) or "none"
    text += [
        f"mm in the plane: mean ± standard deviation, largest, at {document['waypoints']} "
        f"waypoints a letter, half a side {document['amplitude_mm']:g} mm; solved by method "
        f"'{document['method']}'; effects of the bundle: {effects}.",
        f"The stand-in is the virtual finger of seed {document['seed']}: simulated, no hardware. "
        "The paper's columns are of other data: its own finger, letters, sizes.",
    ]
    far = max(row["unreachable_mm"] for row in document["rows"])
    if far > 0.01:
        text.append(
            "Some waypoints are out of reach of a model, or missed by that method, by up to "
            f"{far:.2f} mm."
        )
    return "\n".join(text)
