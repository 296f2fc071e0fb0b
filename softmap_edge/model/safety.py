"""Limits of a finger's commands (`safety.toml` in its bundle), in its units, each with its source.

The robot's `rig.toml` is the upper bound; these limits can only tighten it
(`robot/servo/limits.py`). `derived` computes them from the model. The window is the range of the
simulation or of the training run. Tension and strain are their largest values in it. Strain is that
of the surface's triangles relative to rest, λ − 1 of the larger principal stretch; inside a bending
body it is smaller. Limits from neither source are choices, listed in `assumes`. Pinned by
tests/model/test_safety.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import BundleError, SoftmapError
from softmap_edge.files.toml import TomlTable, parsed, quoted

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]

SCHEMA = "softmap.safety/1"
# the modulus of cast silicone is known to within a half, so tension may exceed the simulated one
MARGIN = 1.5
CROSSING = 4.0  # s in which the widest command crosses its window
START = 10.0  # 1/s: the slew rate is reached in a tenth of a second
JUMP = 0.25  # of the window: largest unreported jump of a target
MOST_LOOKS = 700  # commands of the window at which tension and strain are computed
LEAST_LOOKS = 3  # least number along each command
# largest allowed tension: times the simulated one; N without simulation
FAR, HIGHEST = 3.0, 1000.0
DAMAGED = 4.0  # mm/mm: impossible strain of a surface
STALE = 0.25  # s
HOLD = 2.0  # s
SLACKEN = 5.0  # s
RAMP = 1.0  # s
BAND = 0.02 / 32.0  # of the window (32 mm): above the noise of a hand at rest
TURNS_A_SECOND, BURST = 4.0, 4.0
# bounds of the guard itself, in s, 1/s and 1; lengths are bounded by the window
TIMES, TURNS = ("stale", "hold", "slacken", "ramp"), ("turns", "burst")
SIMULATED = ("tension_n", "strain", "modulus_mpa")
LONGEST = 300  # characters of a sentence


@dataclass(frozen=True)
class Safety:
    """Limits of a finger of C commands in `unit` (mm or another command unit).

    Attributes:
        low, high: (C,) window of the commands.
        slew, acceleration: (C,) per s and per s².
        jump: two limits of a target's jump: above the first it is reported, above the second
            refused.
        tension: largest of any tendon, N; None without a simulation.
        stale, hold, `slacken`, ramp: s, as in docs/reference/safety.md.
        band: return motion of a goal below which the servo does not reverse.
        turns, burst: reversals per second in the long run, and in a burst.
        simulated: largest tension (N) and strain in the window, and the modulus (MPa) that they
            belong to, as far as known.
        assumes: the assumptions and choices in words.
        edited: whether the file differs from the one written with the bundle.
    """

    unit: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    slew: float
    acceleration: float
    jump: tuple[float, float]
    tension: float | None
    stale: float
    hold: float
    slacken: float
    ramp: float
    band: float
    turns: float
    burst: float
    assumes: str
    simulated: Mapping[str, float] = field(default_factory=dict)
    edited: bool = field(default=False, compare=False)

    def within(self, reach: Floats) -> Safety | None:
        """Return the limits, reduced where the model's range `reach` (C, 2) is narrower.

        None if no window remains.
        """
        low, high = (_inward(side) for side in np.asarray(reach, float).T)
        low, high = np.maximum(low, self.low), np.minimum(high, self.high)
        if np.any(low >= high):
            return None
        reported, refused = (min(jump, float(np.ptp(reach, axis=1).max())) for jump in self.jump)
        return replace(
            self, low=tuple(low.tolist()), high=tuple(high.tolist()), jump=(reported, refused)
        )

    def to_toml(self) -> str:
        """Return the text of `safety.toml`."""
        lines = [
            "# Limits of this finger; rig.toml is the ceiling. May be edited.\nschema = "
            f"{quoted(SCHEMA)}",
            f"assumes = {quoted(self.assumes)}",
        ]
        if self.simulated:
            lines.append("\n[simulated]  # the largest in the window; no limits")
            lines += [
                f"{name} = {_short(self.simulated[name])}"
                for name in SIMULATED
                if name in self.simulated
            ]
        lines += [
            f"\n[command]  # in {self.unit}, s",
            f"unit = {quoted(self.unit)}",
            f"low = {[*map(_short, self.low)]}",
            f"high = {[*map(_short, self.high)]}",
            f"slew = {_short(self.slew)}",
            f"acceleration = {_short(self.acceleration)}",
            f"jump = {[*map(_short, self.jump)]}  # warned, refused",
        ]
        lines += [] if self.tension is None else [f"\n[tendon]\ntension_n = {_short(self.tension)}"]
        lines.append("\n[time]  # s")
        lines += [f"{name} = {_short(getattr(self, name))}" for name in TIMES]
        lines += [f"\n[reversal]\nband = {_short(self.band)}  # {self.unit}"]
        lines += [f"{name} = {_short(getattr(self, name))}" for name in TURNS]
        return "\n".join(lines) + "\n"


def read_safety(text: str, reach: Floats, unit: str, where: str) -> Safety:
    """Return the limits in the text of a `safety.toml`, each checked against its bounds.

    Args:
        text: of the file.
        reach: range of the model's commands, (C, 2); the window must lie in it.
        unit: of the model's commands.
        where: the file's name in errors.

    Raises:
        BundleError: invalid TOML, an unknown or missing key, or a limit out of range; nothing is
            clamped.
    """
    try:
        return _read(TomlTable(parsed(text), where), np.asarray(reach, float), unit)
    except BundleError:
        raise
    except SoftmapError as fault:
        raise BundleError(f"{fault}; mend it there, or build the bundle again") from None
    except (ValueError, RecursionError) as fault:  # invalid TOML is a ValueError
        raise BundleError(
            f"{where}: no TOML ({fault!s:.80}); mend it there, or build the bundle again"
        ) from None


def _read(top: TomlTable, reach: Floats, unit: str) -> Safety:
    top.choice("schema", (SCHEMA,), "")
    assumes = str(top.get("assumes", (str,), ""))
    if len(assumes) > LONGEST or not assumes.isprintable():
        raise BundleError(
            f"{top.where}: assumes has {len(assumes)} characters, allowed are {LONGEST} on one line"
        )
    simulated, command, tendon = top.table("simulated"), top.table("command"), top.table("tendon")
    times, reversal = top.table("time"), top.table("reversal")
    top.done()
    found = {name: simulated.number(name, None, 0.0, 1e6) for name in SIMULATED}
    command.choice("unit", (unit,), "")
    width = float(np.ptp(reach, axis=1).max())
    low, high = (command.numbers(name, (len(reach),)) for name in ("low", "high"))
    if low is None or high is None:
        raise BundleError(f"{command.where}: no low or no high; the window is needed")
    slack = 1e-5 * np.ptp(reach, axis=1)  # a file holds six digits
    for c, (least, most) in enumerate(reach):
        if not least - slack[c] <= low[c] < high[c] <= most + slack[c]:
            raise BundleError(
                f"{command.where}: window of command {c + 1} is {low[c]:g} to {high[c]:g} {unit}; "
                f"allowed is low < high within {least:g} to {most:g}, where the model has been"
            )
    reported, refused = _needed_pair(command, "jump", width)
    # the simulated values in the file may be edited too: `held_to` compares with the model
    highest = HIGHEST if found["tension_n"] is None else FAR * found["tension_n"]
    safety = Safety(
        unit=unit,
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        slew=_needed(command, "slew", 1e-4 * width, 20.0 * width),
        acceleration=_needed(command, "acceleration", 1e-4 * width, 2000.0 * width),
        jump=(reported, refused),
        tension=tendon.number("tension_n", None, 1e-3, max(1e-3, highest)),
        stale=_allowed(times, "stale"),
        hold=_allowed(times, "hold"),
        slacken=_allowed(times, "slacken"),
        ramp=_allowed(times, "ramp"),
        band=_needed(reversal, "band", 0.0, 0.1 * width),
        turns=_allowed(reversal, "turns"),
        burst=_allowed(reversal, "burst"),
        assumes=assumes,
        simulated={name: value for name, value in found.items() if value is not None},
    )
    for table in (simulated, command, tendon, times, reversal):
        table.done()
    return safety


def _needed(table: TomlTable, key: str, low: float, high: float) -> float:
    value = table.number(key, None, low, high)
    if value is None:
        raise BundleError(f"{table.where}: no {key}; give {low:g} to {high:g}")
    return value


def _allowed(table: TomlTable, key: str) -> float:
    low, high, _ = _core.limit_ranges()[key]
    return _needed(table, key, low, high)


def _needed_pair(table: TomlTable, key: str, most: float) -> tuple[float, float]:
    value = table.numbers(key, (2,))
    if value is None or not 0.0 <= value[0] <= value[1] <= most * (1 + 1e-5):
        raise BundleError(
            f"{table.where}: {key} is {None if value is None else value.tolist()}; allowed are "
            f"two numbers, 0 ≤ warned ≤ refused ≤ {most:g}"
        )
    return float(value[0]), float(value[1])


def held_to(given: Safety, model: Model) -> Safety:
    """Return the limits of a file, with the model's allowed tension if the file has none.

    Raises:
        BundleError: it allows more than FAR times the largest simulated tension of the model.
    """
    if model.channels == 0 or given.unit != "mm":
        return given
    most = _tension(
        model, _looks(*(_inward(side) for side in np.asarray(model.command_range, float).T))
    )
    if not most:
        return given
    if given.tension is None:
        return replace(given, tension=_digits(MARGIN * most))
    if given.tension > FAR * most * (1.0 + 1e-3):  # a file holds four digits
        raise BundleError(
            f"safety.toml: tension_n = {given.tension:g}, allowed is up to {FAR * most:.4g} N, "
            f"{FAR:g} times what the model was simulated with; mend it there, or build the bundle "
            "again"
        )
    return given


def derived(model: Model, modulus: float | None = None) -> Safety | None:
    """Return the limits derived from a model; None without commands.

    Args:
        model: its prior, surface and, if simulated, the tension of its tendons.
        modulus: of the simulation, MPa, if known.
    """
    if model.channels == 0:
        return None
    low, high = (_inward(side) for side in np.asarray(model.command_range, float).T)
    width = float(np.max(high - low))
    looks = _looks(low, high)
    simulated = {
        name: _digits(value)
        for name, value in (
            ("tension_n", _tension(model, looks)),
            ("strain", _strain(model, looks)),
        )
        if value is not None
    }
    tension = simulated.get("tension_n")
    if tension is not None and modulus is not None:
        simulated["modulus_mpa"] = modulus
    return Safety(
        unit=model.command_unit,
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        slew=_digits(width / CROSSING),
        acceleration=_digits(START * width / CROSSING),
        jump=(_digits(JUMP * width), float(_inward(np.array([width]))[0])),
        tension=_digits(MARGIN * tension) if tension else None,
        assumes=_assumes(model, tension, modulus),
        stale=STALE,
        hold=HOLD,
        slacken=SLACKEN,
        ramp=RAMP,
        band=_digits(BAND * width),
        turns=TURNS_A_SECOND,
        burst=BURST,
        simulated=simulated,
    )


def _assumes(model: Model, tension: float | None, modulus: float | None) -> str:
    """Return the assumptions of the limits, in words."""
    chosen = "slew, times and reversals are choices"
    if tension is not None:
        of = "an unnamed modulus" if modulus is None else f"a modulus of {modulus:g} MPa"
        return (
            f"window and tension: the sweep simulated with {of}, {MARGIN:g} times its largest "
            f"tension; a stiffer body is pulled harder in proportion; {chosen}"
        )
    by = "the run that taught it" if model.kind == "rod" else "an imported sweep"
    return (
        f"window: {by}; tensions are not known{'' if len(model.triangles) else ', nor strains'}; "
        f"{chosen}"
    )


def _inward(side: Floats) -> Floats:
    """Return numbers rounded towards 0 to at most six digits."""
    scale = 10.0 ** (5.0 - np.floor(np.log10(np.maximum(np.abs(side), 1e-9))))
    return np.asarray(np.trunc(np.round(side * scale, 6)) / scale)


def _looks(low: Floats, high: Floats) -> Floats:
    """Return commands (n, C) over the full window, including corners and sides."""
    count = len(low)
    steps = int(MOST_LOOKS ** (1.0 / count))
    steps -= 1 - steps % 2  # the middle is included
    if steps >= LEAST_LOOKS:
        return np.array(list(product(*(np.linspace(a, b, steps) for a, b in zip(low, high)))))
    # of many commands, only some corners and sides
    ends = np.random.default_rng(0).integers(0, 3, (MOST_LOOKS, count))
    return low + 0.5 * ends * (high - low)


def _tension(model: Model, looks: Floats) -> float | None:
    """Return the largest tension (N) of any tendon; None if the model has no tendon tension."""
    tensions = None if model.arrays is None else model.arrays.prior.tensions()
    if tensions is None:
        return None
    pull = np.asarray(tensions.evaluate(looks))
    return max(0.0, float(pull.max())) if pull.size else None


def _strain(model: Model, looks: Floats) -> float | None:
    """Return the largest strain of the surface; None without a surface."""
    if not len(model.triangles):
        return None
    shapes = np.asarray(model.prior.evaluate(looks)).reshape(len(looks), -1, 3)
    before, corner = _sides(model.rest[None], model.triangles), model.triangles
    square = np.einsum("...ji,...jk->...ik", before, before)[0]
    sound = np.linalg.det(square) > 1e-12 * np.trace(square, axis1=1, axis2=2) ** 2
    back = np.linalg.inv(square[sound])
    most = 0.0
    for shape in shapes:
        after = _sides(shape[None], corner[sound])[0]
        stretched = back @ np.einsum("tji,tjk->tik", after, after)
        half, product_ = 0.5 * np.trace(stretched, axis1=1, axis2=2), np.linalg.det(stretched)
        larger = half + np.sqrt(np.maximum(half**2 - product_, 0.0))
        most = max(most, float(np.sqrt(larger).max(initial=1.0)) - 1.0)
    return most if most < DAMAGED else None


def _sides(points: Floats, triangles: NDArray[np.int32]) -> Floats:
    """Return two sides of each triangle as columns, (S, F, 3, 2)."""
    corners = points[:, triangles]
    return np.stack(
        [corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]], axis=-1
    )


def _digits(value: float) -> float:
    return float(f"{value:.4g}")


def _short(value: float) -> float:
    return float(f"{value:.6g}")
