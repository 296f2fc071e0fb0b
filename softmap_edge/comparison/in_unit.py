"""Convert comparisons and series of outputs other than positions to their own unit for reports.

Pinned by tests/run/test_output.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from softmap_edge.run.in_unit import lengths_in_unit, output_of, renamed_maps

if TYPE_CHECKING:
    from softmap_edge.comparison.comparison import Comparison
    from softmap_edge.comparison.series import Series
    from softmap_edge.run.conditions import Bin


def comparison_in_unit(comparison: Comparison) -> Comparison:
    """Return a comparison with its figures in the unit of its output; unchanged for positions."""
    output = output_of(comparison.made_from)
    if output is None:
        return comparison
    floor, worst = comparison.noise_floor_mm, lengths_in_unit(comparison.worst, output)
    bins = [
        row | {"where": next(iter(renamed_maps({row["where"]: 0})))}
        for row in worst.get("bins") or []
    ]

    def bin_of(row: Bin) -> Bin:
        return replace(row, rms_mm=output.value(row.rms_mm))

    lowest = comparison.memoryless
    if lowest is not None:
        error = None if lowest.error_mm is None else output.value(lowest.error_mm)
        lowest = replace(lowest, mm=output.value(lowest.mm), error_mm=error)
    return replace(
        comparison,
        memoryless=lowest,
        error={key: output.value(value) for key, value in comparison.error.items()},
        noise_floor_mm=None if floor is None else output.value(floor),
        where=renamed_maps(
            {name: [bin_of(row) for row in rows] for name, rows in comparison.where.items()}
        ),
        worst=worst | {"bins": bins},
    )


def series_in_unit(series: Series) -> Series:
    """Return the series of a run of outputs with errors in their unit; unchanged for positions."""
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
