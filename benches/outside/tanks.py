"""The official cascaded-tanks benchmark: pump voltage in, level of the lower tank out.

It has a table only, without a diagnosis.

ẋ₁ = −k₁ √x₁ + k₄ u,  ẋ₂ = k₂ √x₁ − k₃ √x₂ (+ k₅ u while x₁ = 10: the upper tank overflows),  y = x₂
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from benches.outside.case import Case, Floats, along_x, text
from softmap_edge import Run, learn_model

STEP_S, FULL, SUBSTEPS = 4.0, 10.0, 4
STARTS = (0.05, 0.12)  # starts of the flows, 1/s in the root of the level


def case(folder: Path) -> Case:
    """Return the case of the official file."""
    table = np.genfromtxt(folder / "dataBenchmark.csv", delimiter=",", skip_header=1)[:, :4]
    t = STEP_S * np.arange(len(table))
    fit, held = (
        Run.of_outputs(
            table[:, k + 2, None],
            "V",
            ["level"],
            t=t,
            t_seen=t,
            command=table[:, k, None],
            command_unit="V",
            robot="tanks",
        )
        for k in (0, 1)
    )

    def law() -> dict[str, Floats]:
        return {"held": fitted_levels(table[:, 0], table[:, 2], table[:, 1], table[:, 3])[:, None]}

    return Case(
        name="Cascaded tanks",
        about=text("tanks", std=float(np.std(table[:, 3]))),
        values=along_x,
        fit=fit,
        held={"held": held},
        model=lambda: learn_model(fit),
        law=law,
        law_name="two tanks with overflow, 7 numbers",
        unit="NRMSE",
        expected="– (table only)",
        diagnose=False,
    )


def fitted_levels(u: Floats, y: Floats, u_held: Floats, y_held: Floats) -> Floats:
    """Return the level on held-out voltages.

    Five flows and the initial level of the upper tank are fitted to the first record.

    The initial level of the held-out record is fitted to its first 50 samples, as the benchmark
    allows.
    """
    tries = [
        least_squares(
            lambda x: levels(u, y[0], *x) - y,
            [flow, flow, flow, flow, 0.2 * flow, 5.0],
            bounds=(0.0, [1.0] * 5 + [FULL]),
            max_nfev=60,
        )
        for flow in STARTS
    ]
    best = min(tries, key=lambda one: float(one.cost)).x
    first = least_squares(
        lambda x: levels(u_held[:50], y_held[0], *best[:5], x[0]) - y_held[:50],
        [5.0],
        bounds=(0.0, FULL),
        max_nfev=30,
    )
    return levels(u_held, y_held[0], *best[:5], float(first.x[0]))


def levels(
    u: Floats, low: float, k1: float, k2: float, k3: float, k4: float, k5: float, high: float
) -> Floats:
    """Return the lower level (T,) for voltages u (T,), from levels `high` and `low`."""
    found, step = np.empty(len(u)), STEP_S / SUBSTEPS
    for k, volts in enumerate(u.tolist()):
        found[k] = low
        for _ in range(SUBSTEPS):
            over = high >= FULL
            flow = max(high, 0.0) ** 0.5
            low += step * (k2 * flow - k3 * max(low, 0.0) ** 0.5 + (k5 * volts if over else 0.0))
            high = min(high + step * (k4 * volts - k1 * flow), FULL)
            low = min(max(low, 0.0), FULL)
    return found
