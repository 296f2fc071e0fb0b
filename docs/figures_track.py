"""Make the picture of docs/do/track.md.

Track an S on an emulated finger with hidden backlash and creep, without and with compensation.

`python docs/figures_track.py` writes track_s.svg into `docs/pictures/`; `--out` names another
folder. It runs in real time, a minute, on emulated servos: a busy computer may end it. tests/robot/test_track.py
checks the numbers.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from softmap_edge import Model, Run, builtin_model, diagnose
from softmap_edge.commands.robot import plain_map
from softmap_edge.report.figures import AFTER, BEFORE, INK, STYLE, WIDE, svg
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.drive.track import Course, Tracked, course, track
from softmap_edge.robot.emulated.finger import emulated_robot, hidden_laws
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.servo.loop_limits import ACCELERATION, SLEW
from softmap_edge.run.protocol import standard_protocol

HIDDEN = ["backlash", "creep"]
SEED, SIZE = 3, 0.6  # of what is hidden


def found(model: Model, laws: Sequence[Any]) -> Model:
    """Return the model with what a diagnosis of a recording of that finger names."""
    plan = standard_protocol(model.channels)
    acting = plan.command
    for law in laws:
        acting = law.command(plan.t, acting)
    at_frames = np.stack([np.interp(plan.t_seen, plan.t, column) for column in acting.T], axis=1)
    points = np.asarray(model.prior.evaluate(at_frames)).reshape(len(at_frames), -1, 3)
    points = points + np.random.default_rng(0).normal(0, 0.1, points.shape)
    answer = diagnose(
        model, Run(t=plan.t, command=plan.command, t_seen=plan.t_seen, vertices=points)
    )
    print(answer.sentence)
    return answer.added(model, [entry.name for entry in answer.effects])


def tracked(model: Model, laws: Sequence[Any]) -> tuple[Course, Tracked]:
    """Track an S on an emulated finger through the effects of a model."""
    kinematics, map_ = Kinematics(model, axes="xy"), plain_map(model)
    limits: dict[str, Any] = {
        "slew": [SLEW] * model.channels,
        "acceleration": [ACCELERATION] * model.channels,
    }
    made = course(
        kinematics, "S", amplitude=8.0, duration=12.0, rate=50.0, calibration=map_, **limits
    )
    with (
        tempfile.TemporaryDirectory() as folder,
        emulated_robot(model, map_, laws, rate=100.0) as (_, rig, limits, finger),
        Controller(
            rig, map_, limits, kinematics=kinematics, record=Path(folder) / "s.mcap"
        ) as robot,
    ):
        return made, track(robot, kinematics, made, finger.seen)


def main(argv: Sequence[str] | None = None) -> int:
    """Diagnose, track twice, and draw both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(__file__).with_name("pictures"),
        help="folder for the picture",
    )
    args = parser.parse_args(argv)
    model = builtin_model()
    laws = hidden_laws(HIDDEN, model.channels, SEED, SIZE)
    shown = [
        ("effects not compensated", BEFORE, model),
        ("effects compensated", AFTER, found(model, laws)),
    ]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 4.0), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.4))
        for number, (name, colour, one) in enumerate(shown):
            made, seen = tracked(one, laws)
            target = made.plan.targets[made.counts]
            if number == 0:
                left.plot(target[:, 0], target[:, 1], color=INK, linewidth=2.4, label="target")
            left.plot(seen.tip[:, 0], seen.tip[:, 1], color=colour, linewidth=1.2, label=name)
            label = f"{name}: {seen.error.mean():.2f} ± {seen.error.std():.2f} mm"
            right.plot(seen.t, seen.error, color=colour, linewidth=1.2, label=label)
            print(label)
        left.set(xlabel="x, mm", ylabel="y, mm", aspect="equal")
        right.set(xlabel="time, s", ylabel="tip error, mm")
        right.set_ylim(bottom=0.0)
        for axes in (left, right):
            axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=1, frameon=False)
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / "track_s.svg").write_bytes(svg(figure))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
