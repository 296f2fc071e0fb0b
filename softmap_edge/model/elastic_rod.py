"""The elastic-tendon rod in Python: layout, numbers, free numbers, and load fields.

The rod itself is rust/rod/elastic.rs: segments of constant curvature, and tendons that stretch and
may go slack. Its numbers form one vector, labelled by the core: slack · angle, radius, pretension
of each tendon · stiffness, length, rest bending (2) of each segment · base (3) · tilt (2); rad, mm,
stiffness in mm².
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.files.npz import Arrays
from softmap_edge.model.model import TIP_PER_NEWTON

Floats = NDArray[np.float64]

# loads, modulus along the body, curvature at rest; arcs have neither sides nor a twist
FIELDS = (*_core.LOADS, *(f"stiff_{k}" for k in range(7)), "curve_x", "curve_y")
ROUTING = tuple(name for name in _core.FIELDS if name.startswith("routing_"))
MOST_NUMBERS = 4096  # numbers in any array of a rod's file


@dataclass(frozen=True)
class RodLayout:
    """The fixed properties of a rod.

    `segments` S and `channels` C; for each tendon the segment where it ends and its command (both
    from 0), with the mm per unit; `at`: position of each marker, in segments from the base (3 is
    the end of the third).
    """

    segments: int
    channels: int
    ends: tuple[int, ...]
    channel: tuple[int, ...]
    pull: tuple[float, ...]
    at: tuple[float, ...]

    def compiled(self, numbers: Floats) -> _core.ElasticRod:
        """Return the compiled rod with these numbers (P,)."""
        return _core.ElasticRod(
            self.segments, self.channels, self.ends, self.channel, self.pull, self.at, numbers
        )

    def counts(self) -> dict[str, int]:
        """Return the count of each kind of number, in order."""
        n, s = len(self.ends), self.segments
        tendon, segment = (
            dict.fromkeys(("angle", "radius", "pretension"), n),
            {"stiffness": s, "length": s},
        )
        return {"slack": 1} | tendon | segment | {"rest": 2 * s, "base": 3, "tilt": 2}

    def places(self) -> dict[str, slice]:
        """Return the slice of each kind of number."""
        ends = np.cumsum(list(self.counts().values())).tolist()
        return {
            kind: slice(end - count, end) for (kind, count), end in zip(self.counts().items(), ends)
        }


@dataclass(frozen=True)
class Change:
    """A change of a group of numbers within bounds.

    It is a factor (1 is no change), or an added angle or length (0 is no change).
    """

    label: str
    group: int
    unit: str
    null: float
    low: float
    high: float
    factor: bool


@dataclass(frozen=True, eq=False)
class ElasticRodArrays:
    """A rod with its numbers (P,) and the nominal `flexibility` (mm per N) of its tendons.

    The flexibility scales its load fields. `free` holds, for each number, the group in which a fit
    changed it; -1 for known numbers that stayed fixed.
    """

    layout: RodLayout
    numbers: Floats
    flexibility: float
    free: tuple[int, ...] = ()

    @classmethod
    def nominal(
        cls, layout: RodLayout, numbers: Floats, free: tuple[int, ...] = ()
    ) -> ElasticRodArrays:
        """Return a rod whose resting tip moves by a tenth of its length under 1 N across."""
        unscaled = cls(layout, numbers, 1.0, free)
        fields, home = unscaled.fields(), np.zeros((1, layout.channels))
        moved = [fields[f"tip_force_{axis}"].evaluate(home)[0, -3:] for axis in "xy"]
        length = float(numbers[layout.places()["length"]].sum())
        return replace(
            unscaled,
            flexibility=TIP_PER_NEWTON * length / float(np.linalg.norm(moved, axis=1).mean()),
        )

    def compiled(self) -> _core.ElasticRod:
        """Return the compiled rod: commands (n, C) to markers (n, 3M) mm."""
        return self.layout.compiled(self.numbers)

    def fields(self) -> dict[str, _core.ElasticField]:
        """Return its fields by name (`_core.FIELDS`), for a nominal weight of 1 N.

        Units: mm per N of tip force, mm per g.
        """
        rod = self.compiled()
        channels = self.layout.channels
        names = (*FIELDS, *(ROUTING[:channels] if channels <= len(ROUTING) else ()))
        return {name: _core.ElasticField(rod, name, self.flexibility) for name in names}

    def to_npz(self) -> Arrays:
        """Return the arrays of `prior.npz`."""
        layout = self.layout
        return {
            "segments": np.array([layout.segments]),
            "channels": np.array([layout.channels]),
            "ends": np.array(layout.ends, np.int64),
            "channel": np.array(layout.channel, np.int64),
            "pull": np.array(layout.pull, float),
            "at": np.array(layout.at, float),
            "numbers": self.numbers,
            "flexibility": np.array([self.flexibility]),
        } | ({"free": np.array(self.free, np.int64)} if self.free else {})

    @classmethod
    def from_npz(cls, arrays: Mapping[str, NDArray[np.generic]]) -> ElasticRodArrays:
        """Read the arrays of `prior.npz`.

        Raises:
            SoftmapError: an array is missing, has the wrong shape, or holds values invalid for a
                rod.
        """
        lists: dict[str, list[float]] = {}
        optional = ("free",) if "free" in arrays else ()
        for name in (
            "segments",
            "channels",
            "ends",
            "channel",
            "pull",
            "at",
            "numbers",
            "flexibility",
            *optional,
        ):
            if name not in arrays or np.ndim(arrays[name]) != 1 or len(arrays[name]) > MOST_NUMBERS:
                got = f"of shape {np.shape(arrays[name])}" if name in arrays else "missing"
                raise SoftmapError(
                    f"elastic rod: array '{name}' is {got}, expected a list; learn the bundle again"
                )
            lists[name] = np.asarray(arrays[name], float).tolist()
        for name in ("segments", "channels", "flexibility"):
            if len(lists[name]) != 1:
                raise SoftmapError(
                    f"elastic rod: '{name}' holds {len(lists[name])} numbers, expected one; learn "
                    "the bundle again"
                )
        for name in ("segments", "channels", "ends", "channel"):
            if not all(0 <= value <= 64 and value == int(value) for value in lists[name]):
                raise SoftmapError(
                    f"elastic rod: '{name}' is not whole numbers from 0 to 64; learn the bundle "
                    "again"
                )
        layout = RodLayout(
            segments=int(lists["segments"][0]),
            channels=int(lists["channels"][0]),
            ends=tuple(map(int, lists["ends"])),
            channel=tuple(map(int, lists["channel"])),
            pull=tuple(lists["pull"]),
            at=tuple(lists["at"]),
        )
        free = lists.get("free", [])
        if free and (
            len(free) != len(lists["numbers"])
            or not all(-1 <= f < len(free) and f == int(f) for f in free)
        ):
            raise SoftmapError(
                "elastic rod: 'free' is not one whole number from -1 a number; learn the bundle "
                "again"
            )
        return cls(
            layout, np.array(lists["numbers"]), lists["flexibility"][0], tuple(map(int, free))
        )

    def changeable(self) -> list[Change]:
        """Return the numbers that were fitted to a run, as changes from their present values."""
        first: dict[int, int] = {}
        for i, group in enumerate(self.free):
            if group >= 0:
                first.setdefault(group, i)
        kinds = {
            i: kind
            for kind, place in self.layout.places().items()
            for i in range(place.start, place.stop)
        }
        found = []
        for group, i in sorted(first.items()):
            kind, place = KINDS[kinds[i]], self.layout.places()[kinds[i]]
            if kinds[i] == "slack":
                continue
            several = self.free.count(group) > 1
            label = kinds[i] if several else f"{kinds[i]}[{i - place.start}]"
            low, high = (
                (np.exp(kind.low), np.exp(kind.high)) if kind.factor else (kind.low, kind.high)
            )
            turn = 180.0 / np.pi if kind.unit == "deg" else 1.0
            unit = "times" if kind.factor else kind.unit
            found.append(
                Change(label, group, unit, float(kind.factor), low * turn, high * turn, kind.factor)
            )
        return found

    def with_numbers(self, numbers: Floats) -> ElasticRodArrays:
        """Return the rod with other numbers.

        Raises:
            SoftmapError: their count differs.
        """
        if np.shape(numbers) != np.shape(self.numbers):
            raise SoftmapError(
                f"elastic rod: {np.shape(numbers)} numbers of before, it has "
                f"{np.shape(self.numbers)}; learn again"
            )
        return replace(self, numbers=numbers)

    def changed(self, values: Mapping[str, float]) -> ElasticRodArrays:
        """Return the rod with changes by label; all other numbers stay.

        Raises:
            SoftmapError: the rod has no such changeable number, or the value is out of bounds.
        """
        numbers, known = np.array(self.numbers, float), {c.label: c for c in self.changeable()}
        for label, value in values.items():
            if label not in known or not np.isfinite(value):
                raise SoftmapError(
                    f"elastic rod: no change of '{label}' by {value:g}; there are "
                    f"{', '.join(known)}"
                )
            change, mine = known[label], np.array(self.free) == known[label].group
            by = value * np.pi / 180.0 if change.unit == "deg" else value
            numbers[mine] = numbers[mine] * by if change.factor else numbers[mine] + by
        return replace(self, numbers=numbers)

    def __str__(self) -> str:
        """Return a one-line description."""
        layout, slack = self.layout, float(self.numbers[0])
        law = {0.0: "cables (slack 0)", 1.0: "two-sided (slack 1)"}.get(slack, f"slack {slack:.3f}")
        return f"elastic rod of {layout.segments} segments and {len(layout.ends)} tendons, {law}"


# --- which numbers are free ---------------------------------------------------------------------


@dataclass(frozen=True)
class Kind:
    """How one kind of number is fitted, between `low` and `high`.

    It is a factor of its start, or added to it. `doubt` is the error of a plausible guess: a fit
        with
    a larger uncertainty has learned nothing. `scatter` is the distance of other starts from the
    first. Factors count in natural logarithms, angles in rad, the rest in mm.
    """

    unit: str
    factor: bool
    low: float
    high: float
    doubt: float
    scatter: float


KINDS = {
    "slack": Kind("", False, -1.0, 1.0, 0.25, 0.0),
    "angle": Kind("deg", False, -1.6, 1.6, 0.5, 0.35),
    "radius": Kind("mm", True, -1.6, 1.6, 0.5, 0.3),
    "pretension": Kind("mm", False, -10.0, 10.0, 2.0, 0.0),
    "stiffness": Kind("mm2", True, -7.0, 7.0, 0.7, 1.0),
    "length": Kind("mm", True, -0.7, 0.7, 0.2, 0.05),
    "rest": Kind("deg", False, -1.5, 1.5, 0.3, 0.0),
    "base": Kind("mm", False, -1000.0, 1000.0, 20.0, 0.0),
    "tilt": Kind("deg", False, -0.8, 0.8, 0.3, 0.0),
}
MODES = {
    **dict.fromkeys(
        ("angle", "radius", "pretension", "stiffness", "length"), ("known", "shared", "each")
    ),
    **dict.fromkeys(("slack", "rest", "tilt"), ("known", "fitted")),
    "base": ("known", "height", "fitted"),
}


class Coordinates:
    """The free numbers of a rod as x (D,), 0 at the start; all others keep their start values."""

    def __init__(self, layout: RodLayout, start: Floats, modes: Mapping[str, str]) -> None:
        """Free the numbers of `layout` listed in `modes` (kind → mode), around `start` (P,)."""
        self.layout, self.start, places = layout, np.asarray(start, float), layout.places()
        self.labels: list[str] = []
        self.kinds: list[str] = []
        moved: list[list[int]] = []
        for kind, mode in modes.items():
            indices = list(range(places[kind].start, places[kind].stop))
            if mode == "shared":
                self._add(kind, [kind], moved, [indices])
            elif mode == "height":
                self._add(kind, ["base[2]"], moved, [indices[2:]])
            elif mode in ("each", "fitted"):
                names = [kind] if kind == "slack" else [f"{kind}[{i}]" for i in range(len(indices))]
                self._add(kind, names, moved, [[i] for i in indices])
        self.moved = moved
        self.spread = np.zeros((len(self.start), len(moved)))
        for column, indices in enumerate(moved):
            self.spread[indices, column] = 1.0
        self.factor = np.array([KINDS[kind].factor for kind in self.kinds], bool)
        self.log = (self.spread @ self.factor) > 0  # (P,)
        first = np.array([self.start[indices[0]] for indices in moved])
        slack = np.array([kind == "slack" for kind in self.kinds], bool)
        low, high = (
            np.array([getattr(KINDS[kind], end) for kind in self.kinds]) for end in ("low", "high")
        )
        self.low, self.high = np.where(slack, -first, low), np.where(slack, 1.0 - first, high)
        self.doubt = np.array([KINDS[kind].doubt for kind in self.kinds])
        self.scatter = np.array([KINDS[kind].scatter for kind in self.kinds])

    @property
    def groups(self) -> tuple[int, ...]:
        """The coordinate that changes each number (P,); -1 if none does."""
        found = np.full(len(self.start), -1)
        for column, indices in enumerate(self.moved):
            found[indices] = column
        return tuple(found.tolist())

    def _add(
        self, kind: str, labels: Sequence[str], moved: list[list[int]], indices: list[list[int]]
    ) -> None:
        self.labels += labels
        self.kinds += [kind] * len(labels)
        moved += indices

    def numbers(self, x: Floats) -> Floats:
        """Return all numbers (P,) of a rod at x."""
        step = self.spread @ x
        return np.where(
            self.log, self.start * np.exp(np.where(self.log, step, 0.0)), self.start + step
        )

    def slopes(self, x: Floats, by_number: Floats) -> Floats:
        """Return slopes (..., D) over x from slopes (..., P) over the numbers."""
        scale = np.where(self.log, self.numbers(x), 1.0)
        return np.asarray((by_number * scale) @ self.spread)

    def fitted_numbers(self, x: Floats, sigma: Floats) -> list[tuple[float, float, str]]:
        """Return value, standard deviation and unit of each free number, as in a robot's file.

        A free number that changes several different ones is given as their factor, or as their
        change in deg or mm.
        """
        numbers, fitted = self.numbers(x), []
        for i, (kind, indices) in enumerate(zip(self.kinds, self.moved)):
            unit, alike = KINDS[kind].unit, bool(np.ptp(self.start[indices]) == 0)
            if self.factor[i]:
                value = float(numbers[indices[0]] if alike else np.exp(x[i]))
                fitted.append((value, value * float(sigma[i]), unit if alike else "times"))
            else:
                turn = 180.0 / np.pi if unit == "deg" else 1.0
                value = float(numbers[indices[0]] if alike else x[i])
                fitted.append((value * turn, float(sigma[i]) * turn, unit))
        return fitted
