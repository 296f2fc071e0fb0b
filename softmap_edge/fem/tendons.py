"""Tendons of a finger's file, their commands, and regions of another modulus.

Tendons are given by formula or by points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, inf, radians, sin
from pathlib import Path

import numpy as np

from softmap_edge.errors import FingerError
from softmap_edge.fem.bodies import Meshed, Solid, Tapered
from softmap_edge.fem.mesh_file import read_guides
from softmap_edge.fem.numbers import (
    Pairs,
    Vector,
    at,
    check_keys,
    check_number,
    check_pairs,
    check_points,
    listed,
    names,
    rows,
    shown,
)
from softmap_edge.files.atomic import Document, finite
from softmap_edge.files.toml import quoted

Formula = tuple[float, float, list[tuple[float, float]]]


@dataclass(frozen=True)
class Tendon:
    """A tendon up to its anchor: by formula or by points.

    angle_deg: about z · route: (z, distance from the axis) pairs in mm; equal distances run
    straight, others tapered · turn_deg: uniform turn of the angle along the full length, a helix ·
    points: instead of these, guides (x, y, z) in mm of the base frame.
    """

    angle_deg: float = 0.0
    route: Pairs = ()
    turn_deg: float = 0.0
    points: tuple[Vector, ...] = ()

    def ends(self) -> tuple[float, float]:
        """Return the heights mm of the first guide and of the anchor."""
        heights = [p[2] for p in self.points] or [z for z, _ in self.route]
        return heights[0], heights[-1]

    def guides(self, count: int) -> list[Vector]:
        """Return the tendon's points, or `count` of its formula, (x, y, z) mm."""
        if self.points:
            return list(self.points)
        first, last = self.ends()
        guides = []
        for share in (k / (count - 1) for k in range(count)):
            z = first + share * (last - first)
            angle, radius = radians(self.angle_deg + share * self.turn_deg), at(self.route, z)
            guides.append((radius * cos(angle), radius * sin(angle), z))
        return guides

    def way(self) -> Formula | list[Vector]:
        """Return the tendon for the core: (angle, turn, pairs) in rad and mm, or points."""
        return list(self.points) or (
            radians(self.angle_deg),
            radians(self.turn_deg),
            list(self.route),
        )

    def check(self, field: str, solid: Solid, spreads: tuple[float, float]) -> None:
        """Check the tendon in its solid; `spreads` are mm of channel around guides and anchor.

        Raises FingerError.
        """
        if bool(self.points) == bool(self.route):
            raise FingerError(f"{field}: give route_mm with an angle, or points_mm, or points_file")
        check_number(f"{field}.angle_deg", self.angle_deg, -360, 360, "give the angle about z")
        check_number(
            f"{field}.turn_deg", self.turn_deg, -1080, 1080, "0 runs straight up, 360 turns once"
        )
        if self.points:
            check_points(f"{field}.points_mm", self.points)
        else:
            check_pairs(f"{field}.route_mm", self.route)
        name = f"{field}.{'points' if self.points else 'route'}_mm"
        low, high = self.ends()
        if solid.height_mm is not None and (low < 0 or high > solid.height_mm):
            raise FingerError(
                f"{name}: z runs {low:g} to {high:g} mm, the solid 0 to {solid.height_mm:g} mm; "
                "keep the tendon inside the solid"
            )
        if not isinstance(solid, Meshed) and any(
            b[2] <= a[2] for a, b in zip(self.points, self.points[1:])
        ):
            raise FingerError(
                f"{name}: z must ascend from the base to the anchor; a layer holds one guide"
            )
        if isinstance(solid, Tapered) and self.route:
            self._check_inside(name, solid.profile, spreads)

    def _check_inside(self, name: str, profile: Pairs, spreads: tuple[float, float]) -> None:
        first, last = self.ends()
        for z in sorted(z for z in {z for z, _ in (*self.route, *profile)} if first <= z <= last):
            inside, outer, spread = at(self.route, z), at(profile, z), spreads[z == last]
            if inside < 0 or inside + spread > outer:
                raise FingerError(
                    f"{name}: at z = {z:g} mm the tendon is {inside:.2f} mm from the axis, with "
                    f"its {spread:g} mm of channel outside the solid of radius {outer:.2f} mm; "
                    f"allowed is 0 to {outer - spread:.2f} mm, route it further inside"
                )

    def to_toml(self) -> str:
        """Return the tendon's table."""
        if self.points:
            return f"\n[[tendon]]\npoints_mm = {listed(self.points)}"
        turn = f"\nturn_deg = {float(self.turn_deg)!r}" if self.turn_deg else ""
        return (
            f"\n[[tendon]]\nangle_deg = {float(self.angle_deg)!r}{turn}\nroute_mm = "
            f"{listed(self.route)}"
        )


@dataclass(frozen=True)
class Region:
    """A region with another modulus.

    A box in mm (None: all along an axis), or its half that faces `side_deg`, or the part of these
    in the cells of group `name` of a mesh file (a physical volume, a material id).

    Where regions overlap, the last one applies.
    """

    young_mpa: float
    x: tuple[float, float] | None = None
    y: tuple[float, float] | None = None
    z: tuple[float, float] | None = None
    side_deg: float | None = None
    name: str | None = None

    def check(self, field: str) -> None:
        """Raises FingerError."""
        check_number(
            f"{field}.young_mpa", self.young_mpa, 1e-4, 1e5, "soft silicones have 0.1 to 0.6 MPa"
        )
        for axis in "xyz":
            limits = getattr(self, axis)
            if limits is not None and not (
                len(limits) == 2 and all(map(finite, limits)) and limits[0] < limits[1]
            ):
                raise FingerError(
                    f"{field}.{axis}_mm: {shown(limits)}; expected [low, high] in mm, as [20.0, "
                    "40.0]"
                )
        if self.side_deg is not None:
            check_number(
                f"{field}.side_deg",
                self.side_deg,
                -360,
                360,
                "give the angle about z that the side faces",
            )
        if self.name is not None and not (isinstance(self.name, str) and 0 < len(self.name) <= 100):
            raise FingerError(
                f"{field}.name: {shown(self.name)}; expected the name of a group of the mesh "
                "file's cells"
            )
        if all(limit is None for limit in (self.name, self.side_deg, self.x, self.y, self.z)):
            raise FingerError(
                f"{field}: give at least one of x_mm, y_mm, z_mm, side_deg, name; or set "
                "material.young_mpa"
            )

    def check_meets(self, field: str, low: Sequence[float], high: Sequence[float]) -> None:
        """Reject a region outside a solid from corner `low` to `high` mm.

        Raises FingerError.
        """
        for axis, least, most in zip("xyz", low, high):
            limits = getattr(self, axis)
            if limits is not None and not (limits[0] < most and limits[1] > least):
                raise FingerError(
                    f"{field}.{axis}_mm: {shown(limits)}; the solid lies from {least:g} to "
                    f"{most:g} mm, so that the region holds nothing"
                )

    def boxed(
        self, cells: list[bool] | None = None
    ) -> tuple[Vector, Vector, float | None, float, list[bool] | None]:
        """Return the region for the core: corners mm, side rad, modulus MPa, cells if named.

        The corners are (low, high).
        """
        (x0, x1), (y0, y1), (z0, z1) = (
            limits or (-inf, inf) for limits in (self.x, self.y, self.z)
        )
        side = None if self.side_deg is None else radians(self.side_deg)
        return (x0, y0, z0), (x1, y1, z1), side, self.young_mpa, cells

    def to_toml(self) -> str:
        """Return the region's table."""
        lines = [f"\n[[region]]\nyoung_mpa = {float(self.young_mpa)!r}"]
        lines += [] if self.name is None else [f"name = {quoted(self.name)}"]
        lines += [
            f"{a}_mm = {listed(getattr(self, a))}" for a in "xyz" if getattr(self, a) is not None
        ]
        return "\n".join(
            lines + ([f"side_deg = {float(self.side_deg)!r}"] if self.side_deg is not None else [])
        )


def check_commands(
    pairs: Sequence[Sequence[int]], ranges: Pairs, unit: str, tendons: int, height: float | None
) -> None:
    """Check the tendons and range of each command: mm of shortening, or N of tension.

    Raises FingerError.
    """
    if len(pairs) > 16:
        raise FingerError(f"command: {len(pairs)} given, allowed are at most 16")
    if unit not in ("mm", "N"):
        raise FingerError(f"command: unit {shown(unit)}; allowed are mm (range_mm) and N (range_n)")
    if len(pairs) != len(ranges):
        raise FingerError(
            f"command_range: {len(ranges)} ranges for {len(pairs)} commands; give one (low, high) "
            "each"
        )
    used: set[int] = set()
    for number, (pair, limits) in enumerate(zip(pairs, ranges)):
        field = f"command[{number}]"
        known = len(pair) in (1, 2) and all(type(t) is int and 0 <= t < tendons for t in pair)
        if not known or len(set(pair)) != len(pair) or used & set(pair):
            raise FingerError(
                f"{field}.tendons: {shown(list(pair))}; expected one tendon or two, counted from "
                f"0 to {tendons - 1}, each in one command only"
            )
        used |= set(pair)
        name = f"{field}.range_{unit.lower()}"
        if len(limits) != 2 or not all(map(finite, limits)) or not limits[0] < limits[1]:
            raise FingerError(
                f"{name}: {shown(list(limits))}; expected [low, high] in {unit}, as [-16.0, 16.0]"
            )
        if unit == "N":
            most, what = 1000.0, "1000 N"
        elif height is None:
            most, what = 500.0, "500 mm"
        else:
            most, what = height / 2, f"half the height, ±{height / 2:g} mm"
        if max(abs(limits[0]), abs(limits[1])) > most:
            raise FingerError(f"{name}: {list(limits)!r}; allowed is {what}")
        if unit == "N" and len(pair) == 1 and limits[0] < 0:
            raise FingerError(
                f"{name}: {list(limits)!r}; a single tendon cannot push: start at 0 N, or give it "
                "a partner"
            )


def tendon_from(table: Document, solid: Solid, folder: Path) -> Tendon:
    """Return the tendon of a table; a file of guides is read in the frame of the mesh file.

    Raises FingerError.
    """
    if "points_file" in table:
        check_keys("tendon", table, ("points_file",))
        if (
            not isinstance(solid, Meshed)
            or not isinstance(table["points_file"], str)
            or "\0" in table["points_file"]
        ):
            raise FingerError(
                "points_file: the name of a JSON list of [x, y, z] in the frame of a [mesh] file"
            )
        guides = solid.place(np.array(read_guides(folder / table["points_file"])))
        return Tendon(points=tuple((float(x), float(y), float(z)) for x, y, z in guides))
    if "points_mm" in table:
        check_keys("tendon", table, ("points_mm",))
        return Tendon(points=rows("points_mm", table["points_mm"]))
    check_keys("tendon", table, ("angle_deg", "route_mm"), ("turn_deg",))
    return Tendon(
        table["angle_deg"], rows("route_mm", table["route_mm"]), table.get("turn_deg", 0.0)
    )


def region_from(table: Document) -> Region:
    """Return the region of a table. Raises FingerError."""
    check_keys("region", table, ("young_mpa",), ("x_mm", "y_mm", "z_mm", "side_deg", "name"))
    limits = {
        axis: rows("region", [table[f"{axis}_mm"]])[0] for axis in "xyz" if f"{axis}_mm" in table
    }
    return Region(
        table["young_mpa"], side_deg=table.get("side_deg"), name=table.get("name"), **limits
    )


def unit_of(tables: Sequence[Mapping[str, object]]) -> str:
    """Return the unit of the commands: mm or N, the same for all. Raises FingerError."""
    for table in tables:
        given = [key for key in ("range_mm", "range_n") if key in table]
        check_keys("command", table, ("tendons", *(given or ["range_mm"])))
        if len(given) != 1:
            raise FingerError(f"command: {names(given)} given; a command is in mm or in N")
    units = {"N" if "range_n" in table else "mm" for table in tables} or {"mm"}
    if len(units) > 1:
        raise FingerError(
            "command: range_mm and range_n are mixed; drive all tendons by length or all by tension"
        )
    return units.pop()
