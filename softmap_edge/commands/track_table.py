"""What `softmap track` prints without moving anything.

Table II (`--table`), what a tip can reach (`--workspace`).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softmap_edge.commands.own import open_model
from softmap_edge.commands.progress import Bar
from softmap_edge.errors import SoftmapError
from softmap_edge.files.atomic import Document, write_atomically
from softmap_edge.model.model import Model
from softmap_edge.robot.motion.figures import WIDEST
from softmap_edge.robot.motion.kinematics import AXES, Kinematics
from softmap_edge.synthetic.table_two import table_two, text_of

if TYPE_CHECKING:
    from softmap_edge.commands.track import TrackOptions


def table(args: TrackOptions, model: Model) -> int:
    """Print the table."""
    rival = None if args.alternative is None else open_model(args.alternative)
    seed = 1 if args.seed is None else args.seed
    with Bar(args.json) as bar:
        rows = table_two(
            model,
            rival,
            seed=seed,
            amplitude=args.amplitude,
            duration=args.duration,
            rate=3.0 if args.rate is None else args.rate,
            method=args.method or "paper",
            progress=bar,
        )
    document = {
        "schema": "softmap.table2/1",
        "bundle": args.bundle,
        "rival": None if args.alternative is None else Path(args.alternative).name,
        "kind": model.kind,
        "calibrated": model.calibration is not None,
        "effects": list(model.chain_names),
        "seed": seed,
        "amplitude_mm": args.amplitude,
        "method": args.method or "paper",
        "waypoints": len(rows[0].expected),
        "rows": [row.to_dict() for row in rows],
    }
    print(json.dumps(document) if args.json else text_of(document))
    return 0


def workspace(args: TrackOptions, kinematics: Kinematics) -> int:
    """Say what the tip can reach, whether a point is in it, and draw it."""
    target = None if args.reach is None else np.asarray(args.reach, float)
    rest = np.asarray(kinematics.tip.evaluate(kinematics.home[None]))[0]
    if target is not None and not (np.abs(target) <= WIDEST).all():
        raise SoftmapError(f"--reach {target.tolist()}; numbers of up to {WIDEST:g} mm are allowed")
    places = kinematics.reach.samples[0]
    solved = None if target is None else kinematics.solve(target[None])
    unit = kinematics.model.command_unit
    document: Document = {
        "schema": "softmap.workspace/1",
        "axes": kinematics.axes,
        "command_unit": unit,
        f"commands_{unit}": kinematics.acting_bounds.tolist(),
        "rest_mm": rest.tolist(),
        "range_mm": {axis: [float(v.min()), float(v.max())] for axis, v in zip(AXES, places.T)},
        "target": None,
        "picture": args.picture,
    }
    if target is not None and solved is not None:
        document["target"] = {
            "target_mm": target.tolist(),
            "reached": bool(kinematics.reaches(target[None])[0]),
            "distance_mm": float(solved.distance[0]),
            "nearest_mm": solved.tip[0].tolist(),
            f"acting_{unit}": solved.acting[0].tolist(),
        }
    if args.picture:
        from softmap_edge.report.track_figure import workspace_figure

        write_atomically(
            args.picture,
            workspace_figure(kinematics, rest, target, None if solved is None else solved.tip[0]),
        )
    print(json.dumps(document) if args.json else _text(document))
    return 0


def _text(summary: Document) -> str:
    def point(numbers: list[float]) -> str:
        return "(" + ", ".join(f"{v:.2f}" for v in numbers) + ")"

    reach = ", ".join(
        f"{axis} {low:.1f} to {high:.1f}" for axis, (low, high) in summary["range_mm"].items()
    )
    lines = [f"the tip rests at {point(summary['rest_mm'])} mm and reaches {reach} mm"]
    if target := summary["target"]:
        where = f"{point(target['target_mm'])} mm, along {summary['axes']}"
        if target["reached"]:
            unit = summary["command_unit"]
            lines.append(
                f"{where}: within reach, where {point(target[f'acting_{unit}'])} {unit} acts"
            )
        else:
            lines.append(
                f"{where}: out of reach by {target['distance_mm']:.2f} mm; nearest is "
                f"{point(target['nearest_mm'])} mm"
            )
    lines += [f"{summary['picture']}: written"] if summary["picture"] else []
    return "\n".join(lines)
