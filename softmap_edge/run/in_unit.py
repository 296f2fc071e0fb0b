"""Convert documents about outputs other than positions to the output's own unit, for reports.

A comparison or diagnosis computes in the model's mm; `made_from.output` holds the mm per unit.
Command values (`1.39 mm on servo 1`) keep their unit. In sentences, only values in mm RMS are
outputs. Pinned by tests/run/test_output.py.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from softmap_edge.files.atomic import Document, finite
from softmap_edge.files.numbers import mm
from softmap_edge.run.output import Output

PLACES = "mm"  # unit of a run of positions
_RMS = re.compile(r"((?:\d+\.?\d* (?:to|and|of) )?)(\d+\.?\d*) mm RMS")
_NUMBER = re.compile(r"\d+\.?\d*")


def output_of(made_from: Document) -> Output | None:
    """Return the output of a document from its `made_from`; None for positions."""
    document = made_from.get("output")
    return None if document is None else Output.from_dict(document)


def unit_of(made_from: Document) -> str:
    """Return the unit of a document's figures after `in_unit` or `comparison_in_unit`."""
    output = output_of(made_from)
    return PLACES if output is None else output.unit


def words_in_unit(text: str, output: Output | None) -> str:
    """Return a sentence with its values in mm RMS converted to the output's unit."""
    if output is None:
        return text

    def turned(found: re.Match[str]) -> str:
        first, second = (
            _NUMBER.sub(lambda number: mm(output.value(float(number.group()))), part)
            for part in found.groups()
        )
        return f"{first}{second} {output.unit} RMS"

    return _RMS.sub(turned, text)


def in_unit(document: Document) -> Document:
    """Return a diagnosis document with figures in its output's unit; unchanged for positions."""
    output = output_of(document.get("made_from") or {})
    if output is None:
        return dict(document)
    found: Document = lengths_in_unit(dict(document), output)
    error = dict(document.get("error") or {})
    figures = {key: value for key, value in error.items() if finite(value) and key not in _PLAIN}
    error |= {key: output.value(value) for key, value in figures.items()}
    error["ladder"] = [
        {**row, "value": _value(row.get("value"), output)} for row in error.get("ladder") or []
    ]
    where = {moment: renamed_maps(maps) for moment, maps in (found.get("where") or {}).items()}
    return found | {"error": error | {"unit": output.unit}, "where": where}


def renamed_maps(maps: Document) -> Document:
    """Return error maps with one entry per output in place of the body's sections."""
    return {"output" if name == "section" else name: rows for name, rows in maps.items()}


_PLAIN = ("frames", "folds", "numbers")  # entries of `error` that are not lengths


def lengths_in_unit(value: object, output: Output, key: str = "") -> Any:
    """Return a part of a document with its lengths and sentences converted.

    Fitted numbers keep their unit.
    """
    if key in ("params", "refitted", "made_from", "servo"):
        return value
    if isinstance(value, Mapping):
        lengths = key == "displacement_mm"
        return {
            k: _value(v, output) if lengths else lengths_in_unit(v, output, str(k))
            for k, v in value.items()
        }
    if isinstance(value, list):
        return [lengths_in_unit(item, output, key) for item in value]
    if isinstance(value, str):
        return words_in_unit(value, output)
    return _value(value, output) if key.endswith("_mm") else value


def _value(value: object, output: Output) -> object:
    return output.value(value) if finite(value) else value
