"""List a run's contents: channels, units, rows, frames, blocks, time span, conditions, origin."""

from __future__ import annotations

import numpy as np

from softmap_edge.files.atomic import Document
from softmap_edge.files.printable import listed, one_line
from softmap_edge.run.fields import ROW_S
from softmap_edge.run.pieces import spans
from softmap_edge.run.run import OURS, Run

DECLARED = {"temperature": "°C", "load": "g"}
MOST = 12  # blocks or pieces that a text lists at most


def contents(run: Run) -> Document:
    """Return the contents of a run, with units in the keys.

    Returns:
        dict: `blocks` is a list of `{label, frames, from_s, to_s}` in order of appearance. `origin`
        is a list of `{recording, rows, frames, from_s, to_s, at_s}`: hash and time span of each
        recording on its own clock, and its start time in this run.
    """
    return {
        "robot": run.robot,
        "hash": run.hash(),
        "channels": run.channels,
        "command_unit": "ticks" if run.ticks is not None else run.command_unit,
        "command_range": command_ranges(run),
        "encoders": run.present is not None or run.present_ticks is not None,
        "rows": len(run.t),
        "from_s": rounded(run.t[0]),
        "to_s": rounded(run.t[-1]),
        "timeless": run.timeless,
        "frames": run.frames,
        "seen": run.seen,
        "names": run.marker_names,
        "output_unit": None if run.output is None else run.output.unit,
        "declared": _declared(run),
        "aligned": run.frame is not None or run.frame_sigma is not None,
        "blocks": _blocks(run),
        "origin": _origin(run),
        "kept": sorted(set(run.extra) - OURS),
    }


def _declared(run: Run) -> Document:
    """Return the range of each declared condition."""
    found: Document = {}
    if run.gravity is not None:
        rows = np.unique(np.round(np.atleast_2d(run.gravity), 3), axis=0) + 0.0
        found["gravity"] = rows[:4].tolist()
    for name, value in (("temperature", run.temperature), ("load", run.load)):
        if value is not None and value.size:
            found[name] = [rounded(value.min()), rounded(value.max())]
    if run.sigma is not None:
        found["sigma_mm"] = rounded(np.median(run.sigma))
    return found


def _blocks(run: Run) -> list[Document]:
    """Return the blocks in the order in which they appear."""
    if run.block is None:
        return []
    labels, first, which = np.unique(run.block, return_index=True, return_inverse=True)
    times = [run.t_seen[which.reshape(-1) == k] for k in range(len(labels))]
    return [
        {
            "label": str(labels[k]),
            "frames": len(times[k]),
            "from_s": rounded(times[k][0]),
            "to_s": rounded(times[k][-1]),
        }
        for k in np.argsort(first)
    ]


def _origin(run: Run) -> list[Document]:
    """Return the pieces of recordings that form the run."""
    found = spans(run)
    ends = [(part.row, part.frame) for part, _, _ in found[1:]] + [(len(run.t), run.frames)]
    return [
        {
            "recording": part.origin,
            "rows": row - part.row,
            "frames": frame - part.frame,
            "from_s": rounded(low),
            "to_s": rounded(high),
            "at_s": rounded(low + part.shift_s),
        }
        for (part, low, high), (row, frame) in zip(found, ends)
    ]


def command_ranges(run: Run) -> list[list[float]]:
    """Return each channel's lowest and highest command or ticks; [] of a run without commands."""
    rows = run.command if run.command is not None else run.ticks
    return [] if rows is None else [[rounded(c.min()), rounded(c.max())] for c in rows.T]


def rounded(value: float) -> float:
    """Return a number rounded to six digits, as documents store it."""
    return float(f"{float(value):.6g}")


def lines(document: Document) -> list[str]:
    """Return the contents as lines for a terminal."""
    d, unit = document, document["command_unit"]
    over = "without time" if d["timeless"] else f"from {d['from_s']:g} to {d['to_s']:g} s"
    found = [
        f"robot     {d['robot'] or 'not named'}",
        f"commands  {d['channels']} channels in {unit}, {d['rows']} rows {over}"
        + ", encoders" * d["encoders"],
        *(
            f"          channel {c}: {low:g} to {high:g} {unit}"
            for c, (low, high) in enumerate(d["command_range"])
        ),
        f"seen      {d['frames']} frames of {_seen(d)}" + ", aligned to the base" * d["aligned"],
        f"declared  {_conditions(d['declared'])}",
    ]
    found += _listed("blocks", [_block(one, d["timeless"]) for one in d["blocks"]])
    found += _listed("origin", [_piece(one, d["hash"], d["timeless"]) for one in d["origin"]])
    found += [f"kept      {listed(d['kept'], MOST)} (not known here, ignored)"] if d["kept"] else []
    return [one_line(line) for line in [*found, f"hash      {d['hash']}"]]


def _seen(document: Document) -> str:
    names, unit = document["names"], document["output_unit"]
    if unit is not None:
        return f"{', '.join(names)} ({unit})"
    return (
        f"{len(names)} markers: {', '.join(names)}" if names else str(document["seen"] or "nothing")
    )


def _conditions(declared: Document) -> str:
    texts = (
        [f"gravity {' and '.join(map(str, declared['gravity']))}"] if "gravity" in declared else []
    )
    for name, unit in DECLARED.items():
        if name in declared:
            low, high = declared[name]
            texts.append(f"{name} {low:g}{'' if low == high else f' to {high:g}'} {unit}")
    texts += [f"sigma {declared['sigma_mm']:g} mm"] if "sigma_mm" in declared else []
    return ", ".join(texts) or "nothing"


def _block(one: Document, timeless: bool) -> str:
    return f"{listed([one['label']], 1)}: {one['frames']} frames from {_between(one, timeless)}"


def _between(one: Document, timeless: bool) -> str:
    """Return the span of a block or a piece: times, or rows of a log without time."""
    low, high = one["from_s"], one["to_s"]
    return f"row {low / ROW_S:.0f} to {high / ROW_S:.0f}" if timeless else f"{low:g} to {high:g} s"


def _piece(one: Document, own: str, timeless: bool) -> str:
    what = "this recording" if one["recording"] == own else f"recording {one['recording'][:12]}"
    at = f"row {one['at_s'] / ROW_S:.0f}" if timeless else f"{one['at_s']:g} s"
    where = "" if one["at_s"] == one["from_s"] else f", here at {at}"
    return f"{what}: {one['rows']} rows, {one['frames']} frames, {_between(one, timeless)}{where}"


def _listed(name: str, texts: list[str]) -> list[str]:
    more = [f"… and {len(texts) - MOST} more"] if len(texts) > MOST else []
    return [f"{'' if k else name:<10}{text}" for k, text in enumerate([*texts[:MOST], *more])]
