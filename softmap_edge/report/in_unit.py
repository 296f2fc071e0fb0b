"""Documents about outputs other than places, with their figures in the output's own unit for a report.

A comparison or diagnosis counts in the model's mm; `made_from.output` holds the mm for one unit. Numbers of commands
(`1.39 mm on servo 1`) keep their unit. In sentences only values in mm RMS are outputs. Pinned by tests/test_output.py.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from softmap_edge.files.numbers import mm
from softmap_edge.run.output import Output

if TYPE_CHECKING:
    from softmap_edge.comparison.comparison import Comparison
    from softmap_edge.comparison.series import Series
    from softmap_edge.diagnosis.findings import Bin

PLACES = "mm"  # the unit of a run of places
_RMS = re.compile(r"((?:\d+\.?\d* (?:to|and|of) )?)(\d+\.?\d*) mm RMS")
_NUMBER = re.compile(r"\d+\.?\d*")


def output_of(made_from: Mapping[str, Any]) -> Output | None:
    """Return the output that a document is about, from its `made_from`; None for places."""
    document = made_from.get("output")
    return None if document is None else Output.from_dict(document)


def unit_of(made_from: Mapping[str, Any]) -> str:
    """Return the unit of the figures of a document after `in_unit` or `comparison_in_unit`."""
    output = output_of(made_from)
    return PLACES if output is None else output.unit


def words_in_unit(text: str, output: Output | None) -> str:
    """Return a sentence with its values in mm RMS converted to the output's unit."""
    if output is None:
        return text

    def turned(found: re.Match[str]) -> str:
        first, second = (
            _NUMBER.sub(lambda number: mm(output.value(float(number.group()))), part) for part in found.groups()
        )
        return f"{first}{second} {output.unit} RMS"

    return _RMS.sub(turned, text)


def in_unit(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a diagnosis document with its figures in the unit of its output; unchanged for places."""
    output = output_of(document.get("made_from") or {})
    if output is None:
        return dict(document)
    found: dict[str, Any] = _turned(dict(document), output)
    error = dict(document.get("error") or {})
    figures = {key: value for key, value in error.items() if isinstance(value, (int, float)) and key not in _PLAIN}
    error |= {key: output.value(value) for key, value in figures.items()}
    error["ladder"] = [{**row, "value": _value(row.get("value"), output)} for row in error.get("ladder") or []]
    where = {moment: _renamed(maps) for moment, maps in (found.get("where") or {}).items()}
    return found | {"error": error | {"unit": output.unit}, "where": where}


def _renamed(maps: Mapping[str, Any]) -> dict[str, Any]:
    """Return maps of the error with one entry for each output in place of the sections of a body."""
    return {"output" if name == "section" else name: rows for name, rows in maps.items()}


_PLAIN = ("frames", "folds", "numbers")  # entries of `error` that are no lengths


def _turned(value: Any, output: Output, key: str = "") -> Any:
    """Return a part of a document with its lengths and sentences converted; fitted numbers keep their unit."""
    if key in ("params", "refitted", "made_from", "servo"):
        return value
    if isinstance(value, Mapping):
        lengths = key == "displacement_mm"
        return {k: _value(v, output) if lengths else _turned(v, output, str(k)) for k, v in value.items()}
    if isinstance(value, list):
        return [_turned(item, output, key) for item in value]
    if isinstance(value, str):
        return words_in_unit(value, output)
    return _value(value, output) if key.endswith("_mm") else value


def _value(value: Any, output: Output) -> Any:
    known = isinstance(value, (int, float)) and not isinstance(value, bool)
    return output.value(value) if known else value


def comparison_in_unit(comparison: Comparison) -> Comparison:
    """Return a comparison with its figures in the unit of its output; unchanged for places."""
    output = output_of(comparison.made_from)
    if output is None:
        return comparison
    floor, worst = comparison.noise_floor_mm, _turned(comparison.worst, output)
    bins = [row | {"where": next(iter(_renamed({row["where"]: 0})))} for row in worst.get("bins") or []]

    def bin_of(row: Bin) -> Bin:
        return replace(row, rms_mm=output.value(row.rms_mm))

    return replace(
        comparison,
        error={key: output.value(value) for key, value in comparison.error.items()},
        noise_floor_mm=None if floor is None else output.value(floor),
        where=_renamed({name: [bin_of(row) for row in rows] for name, rows in comparison.where.items()}),
        worst=worst | {"bins": bins},
    )


def series_in_unit(series: Series) -> Series:
    """Return the series of a run of outputs with its errors in their unit; unchanged for places."""
    output = series.output
    if output is None:
        return series
    floor, scale = series.noise_floor_mm, output.mm_per_unit
    return replace(
        series,
        before=series.before / scale,
        after=None if series.after is None else series.after / scale,
        point_before=series.point_before / scale,
        point_after=None if series.point_after is None else series.point_after / scale,
        noise_floor_mm=None if floor is None else output.value(floor),
    )
