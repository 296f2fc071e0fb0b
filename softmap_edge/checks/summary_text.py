"""Text for a terminal (100 columns): the summary of a run, for `softmap check`."""

from __future__ import annotations

from softmap_edge.checks.advice_text import advice_lines
from softmap_edge.checks.summary import RunSummary
from softmap_edge.files.numbers import folded
from softmap_edge.files.printable import listed, one_line, plain_line

MANY = 20  # unknown fields that are named


def sentences(summary: RunSummary) -> list[str]:
    """Return a summary as plain sentences, one a line."""
    d = summary
    unit = d.command_unit
    lines = [f"robot     {d.robot or 'not named'}"]
    rate = "" if d.rate_hz is None else f" at {d.rate_hz:g} Hz"
    over = ", no time recorded" if d.timeless else f" over {d.duration_s:g} s{rate}"
    lines.append(f"commands  {d.channels} channels, {d.rows} rows{over}")
    if d.calibrated:
        lines.append("          ticks, as commands by the calibration of the bundle")
    for c, (low, high) in enumerate(d.command_range):
        lines.append(f"          channel {c}: {low:g} to {high:g} {unit}")
    rate = "" if d.frame_rate_hz is None else f" at {d.frame_rate_hz:g} Hz"
    each = "" if d.points_per_frame is None else f" of {d.points_per_frame} {d.seen}"
    part = "" if d.visible_share == 1.0 else f", {100 * d.visible_share:.1f} % visible"
    roll = "" if d.roll_seen else ", roll not measured"
    if (output := d.output) is not None:
        each = f" of {len(output.names)} output{'s' * (len(output.names) != 1)}"
    rate = "" if d.timeless else rate
    lines.append(f"seen      {d.frames} frames{each}{rate}{part}{roll}")
    if output is not None:
        lines += [
            f"          {name}: {low:.4g} to {high:.4g} {output.unit}"
            for name, (low, high) in zip(output.names, output.range)
        ]
    if d.points_mm:
        ranges = ", ".join(
            f"{axis} {low:.4g} to {high:.4g}" for axis, (low, high) in zip("xyz", d.points_mm)
        )
        lines.append(f"          {ranges} mm in the base frame")
    if d.base_markers:
        lines.append(
            f"          and {d.base_markers} markers on the base (`softmap run align --base b0 "
            "b1 …`)"
        )
    visits = d.home_visits if d.home_known else "not known"
    lines.append(
        f"repeats   visits of home: {visits}, other places visited again: {d.places_revisited}"
    )
    declared = [f"gravity {d.gravity}"] if d.gravity else []
    spans = (("load", d.load_g, "g"), ("temperature", d.temperature_c, "°C"))
    declared += [f"{name} {_span(span)} {u}" for name, span, u in spans if span is not None]
    declared += ["encoder positions"] if d.encoders else []
    lines.append(f"declared  {', '.join(declared) or 'nothing'}")
    if d.blocks:
        lines.append(
            f"blocks    {len(d.blocks)}: {listed(d.blocks[:8], 8)}{' …' * (len(d.blocks) > 8)}"
        )
    if d.unknown_fields:
        kept = listed(d.unknown_fields, MANY)
        lines.append(f"kept      {kept} (not known here, ignored)")
    lines += [line for text in d.not_seen for line in _hung("look at", text)]
    lines += [line for text in d.missing for line in _hung("missing", text)]
    lines += [line for text in d.warnings for line in _hung("look at", text)]
    lines += [line for one in d.collinear for line in _hung("alike", str(one))]
    known_to = [] if d.unanswered else d.can_tell  # such a run shows nothing of its drive
    lines += advice_lines([*known_to, *d.cannot_tell])
    return [one_line(line) for line in lines]  # names of fields and blocks are of the file


def _hung(name: str, text: str) -> list[str]:
    return folded(f"{name:<10}{plain_line(text)}", 0, 10)


def _span(pair: list[float]) -> str:
    return f"{pair[0]:g}" if pair[0] == pair[1] else f"{pair[0]:g} to {pair[1]:g}"
