"""A finger as a file describes it: shape, mesh, material, tendons, mounting and commands (`finger.toml`).

`Finger.builtin()` is the finger with the MOE dimensions; its file, with a comment on every number, is the template.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from softmap_edge.errors import FingerError, brief

Pairs = tuple[tuple[float, float], ...]

# Allowed keys of the file: table -> keys. "" is the top level.
_KEYS = {
    "": {"name", "profile_mm", "mesh", "material", "cable", "mounting", "tendon", "command"},
    "mesh": {"core", "rings", "layers"},
    "material": {"young_mpa", "poisson", "density_kg_m3"},
    "cable": {"stiffness_n_mm", "guide_ring_mm", "anchor_disc_mm"},
    "mounting": {"gravity_g"},
    "tendon": {"angle_deg", "route_mm"},
    "command": {"tendons", "range_mm"},
}


@dataclass(frozen=True)
class Tendon:
    """A tendon's angle about z (degrees) and its route as (z, distance from the axis) pairs in mm, up to the anchor."""

    angle_deg: float
    route: Pairs


@dataclass(frozen=True)
class Finger:
    """A finger; every field is checked when it is made, and a bad one raises FingerError with what is allowed.

    profile: (z, radius) pairs in mm from z = 0 · core, rings, layers: cells of the mesh · young_mpa · poisson ·
    density_kg_m3 · cable_stiffness_n_mm · gravity: (3,) multiples of g in the base frame · tendons · pairs: for each
    command the tendon it shortens and, if any, the one it pays out · command_range: (low, high) mm for each command ·
    guide_ring_mm, anchor_disc_mm: over what a tendon's forces are spread.
    """

    name: str
    profile: Pairs
    core: int
    rings: int
    layers: int
    young_mpa: float
    poisson: float
    density_kg_m3: float
    cable_stiffness_n_mm: float
    gravity: tuple[float, float, float]
    tendons: tuple[Tendon, ...]
    pairs: tuple[tuple[int, ...], ...]
    command_range: Pairs
    guide_ring_mm: float = 1.5
    anchor_disc_mm: float = 2.0

    def __post_init__(self) -> None:
        if not self.name or not isinstance(self.name, str) or len(self.name) > 100 or not self.name.isprintable():
            raise FingerError("name: expected a name of 1 to 100 printable characters; give the finger a name")
        _check_pairs("profile_mm", self.profile)
        if self.profile[0][0] != 0.0 or min(radius for _, radius in self.profile) <= 0:
            raise FingerError("profile_mm: z must start at 0 and each radius above 0 mm; measure from the base")
        for field, least, most in _COUNTS:
            _check_count(field, getattr(self, field), least, most)
        for field, low, high, remedy in _RANGES:
            _check_number(field, getattr(self, field), low, high, remedy)
        if len(self.gravity) != 3 or not all(_finite(g) and abs(g) <= 10 for g in self.gravity):
            raise FingerError(
                f"gravity_g: {_shown(self.gravity)}; expected three numbers of g within ±10, as [0, 0, 1]"
            )
        self._check_tendons()
        self._check_commands()

    @property
    def height_mm(self) -> float:
        """Height from the clamped base to the tip, mm."""
        return self.profile[-1][0]

    @classmethod
    def builtin(cls) -> Finger:
        """Return the built-in finger with the MOE dimensions."""
        return cls.from_toml(_template())

    @classmethod
    def load(cls, path: str | Path) -> Finger:
        """Read a `finger.toml`; raises FingerError that names the file and the field."""
        try:
            with Path(path).open(encoding="utf-8") as file:
                text = file.read(_MOST_TEXT + 1)
        except (OSError, UnicodeDecodeError) as error:
            raise FingerError(
                f"{path}: cannot be read as a finger file ({error}); give a finger.toml; a copy of "
                "softmap_edge/data/finger.toml is a start"
            ) from None
        try:
            return cls.from_toml(text)
        except FingerError as error:
            raise FingerError(f"{path}: {error}") from None

    @classmethod
    def from_toml(cls, text: str) -> Finger:
        """Return the finger of a file's text; raises FingerError."""
        if len(text) > _MOST_TEXT:
            raise FingerError(f"longer than {_MOST_TEXT} characters; give a finger.toml")
        try:
            document = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # a number of thousands of digits is a plain ValueError
            raise FingerError(f"not valid TOML ({brief(error)}); compare with the built-in finger's file") from None
        return _from_document(document)

    def replace(self, **changes: Any) -> Finger:
        """Return the finger with some fields changed, checked again; raises FingerError."""
        unknown = set(changes) - set(self.__dataclass_fields__)
        if unknown:
            raise FingerError(f"no field {_names(unknown)}; a finger has {_names(self.__dataclass_fields__)}")
        return replace(self, **changes)

    def other_mesh(self) -> Finger:
        """Return the same finger on another mesh, finer where allowed: the second opinion of the form error."""
        core = self.core + 1 if self.core < _MOST_CORE else self.core - 1
        return self.replace(core=core, layers=max(1, round(self.layers * 0.9)))

    def to_toml(self) -> str:
        """Return the finger as the text of a file that `from_toml` reads back to the same finger."""
        lines = [
            f"name = {_quoted(self.name)}",
            f"profile_mm = {_listed(self.profile)}",
            f"\n[mesh]\ncore = {self.core}\nrings = {self.rings}\nlayers = {self.layers}",
            f"\n[material]\nyoung_mpa = {float(self.young_mpa)!r}\npoisson = {float(self.poisson)!r}",
            f"density_kg_m3 = {float(self.density_kg_m3)!r}",
            f"\n[cable]\nstiffness_n_mm = {float(self.cable_stiffness_n_mm)!r}",
            f"guide_ring_mm = {float(self.guide_ring_mm)!r}\nanchor_disc_mm = {float(self.anchor_disc_mm)!r}",
            f"\n[mounting]\ngravity_g = {[float(g) for g in self.gravity]!r}",
        ]
        for tendon in self.tendons:
            lines.append(f"\n[[tendon]]\nangle_deg = {float(tendon.angle_deg)!r}\nroute_mm = {_listed(tendon.route)}")
        for pair, (low, high) in zip(self.pairs, self.command_range):
            lines.append(f"\n[[command]]\ntendons = {list(pair)!r}\nrange_mm = [{float(low)!r}, {float(high)!r}]")
        return "\n".join(lines) + "\n"

    def _check_tendons(self) -> None:
        if not 1 <= len(self.tendons) <= 16:
            raise FingerError(f"tendon: {len(self.tendons)} given, allowed are 1 to 16; add [[tendon]] tables")
        for number, tendon in enumerate(self.tendons):
            field = f"tendon[{number}]"
            _check_number(f"{field}.angle_deg", tendon.angle_deg, -360, 360, "give the angle about z")
            _check_pairs(f"{field}.route_mm", tendon.route)
            if tendon.route[0][0] < 0 or tendon.route[-1][0] > self.height_mm:
                raise FingerError(
                    f"{field}.route_mm: z runs {tendon.route[0][0]:g} to {tendon.route[-1][0]:g} mm, the solid 0 to "
                    f"{self.height_mm:g} mm; keep the tendon inside the solid"
                )
            breaks = {z for z, _ in (*tendon.route, *self.profile) if z <= tendon.route[-1][0]}
            for z in sorted(z for z in breaks if z >= tendon.route[0][0]):
                inside, outer = _at(tendon.route, z), _at(self.profile, z)
                spread = self.anchor_disc_mm if z == tendon.route[-1][0] else self.guide_ring_mm
                if inside < 0 or inside + spread > outer:
                    raise FingerError(
                        f"{field}.route_mm: at z = {z:g} mm the tendon is {inside:.2f} mm from the axis, with its "
                        f"{spread:g} mm of channel outside the solid of radius {outer:.2f} mm; allowed is 0 to "
                        f"{outer - spread:.2f} mm, route it further inside"
                    )

    def _check_commands(self) -> None:
        if not 1 <= len(self.pairs) <= 3:
            raise FingerError(f"command: {len(self.pairs)} given, allowed are 1 to 3; a sweep is a grid over them")
        if len(self.pairs) != len(self.command_range):
            ranges, commands = len(self.command_range), len(self.pairs)
            raise FingerError(f"command_range: {ranges} ranges for {commands} commands; give one (low, high) each")
        used: set[int] = set()
        for number, (pair, limits) in enumerate(zip(self.pairs, self.command_range)):
            field = f"command[{number}]"
            known = len(pair) in (1, 2) and all(type(t) is int and 0 <= t < len(self.tendons) for t in pair)
            if not known or len(set(pair)) != len(pair) or used & set(pair):
                raise FingerError(
                    f"{field}.tendons: {_shown(list(pair))}; expected one tendon or two, counted from 0 to "
                    f"{len(self.tendons) - 1}, each in one command only"
                )
            used |= set(pair)
            if len(limits) != 2 or not all(map(_finite, limits)) or not limits[0] < limits[1]:
                raise FingerError(
                    f"{field}.range_mm: {_shown(list(limits))}; expected [low, high] in mm, as [-16.0, 16.0]"
                )
            if max(abs(limits[0]), abs(limits[1])) > self.height_mm / 2:
                raise FingerError(
                    f"{field}.range_mm: {list(limits)!r}; allowed is half the height, ±{self.height_mm / 2:g} mm"
                )


_MOST_TEXT = 1_000_000  # characters of a file; the template has 3000
_MOST_CORE = 16
_COUNTS = [("core", 1, _MOST_CORE), ("rings", 1, 16), ("layers", 1, 400)]
_RANGES = [
    ("young_mpa", 1e-4, 1e5, "soft silicones have 0.1 to 0.6 MPa"),
    ("poisson", 0.01, 0.495, "silicones solve best at 0.45 to 0.48"),
    ("density_kg_m3", 0.0, 2e4, "silicones have about 1070 kg/m3"),
    ("cable_stiffness_n_mm", 1e-3, 1e4, "cable and drive together have about 20 N/mm"),
    ("guide_ring_mm", 0.0, 50.0, "1.5 mm is usual"),
    ("anchor_disc_mm", 0.0, 50.0, "2 mm is usual"),
]


def _from_document(document: Mapping[str, Any]) -> Finger:
    _check_keys("", document)
    mesh, material = _table(document, "mesh"), _table(document, "material")
    cable, mounting = _table(document, "cable"), _table(document, "mounting")
    tendons, commands = _tables(document, "tendon"), _tables(document, "command")
    return Finger(
        name=document["name"],
        profile=_pairs("profile_mm", document["profile_mm"]),
        **mesh,
        **material,
        cable_stiffness_n_mm=cable["stiffness_n_mm"],
        guide_ring_mm=cable["guide_ring_mm"],
        anchor_disc_mm=cable["anchor_disc_mm"],
        gravity=_sequence("gravity_g", mounting["gravity_g"]),
        tendons=tuple(Tendon(t["angle_deg"], _pairs("route_mm", t["route_mm"])) for t in tendons),
        pairs=tuple(_sequence("tendons", c["tendons"]) for c in commands),
        command_range=tuple(_sequence("range_mm", c["range_mm"]) for c in commands),
    )


def _table(document: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = document[name]
    if not isinstance(table, dict):
        raise FingerError(f"{name}: expected a table [{name}] with {_names(_KEYS[name])}")
    _check_keys(name, table)
    return table


def _tables(document: Mapping[str, Any], name: str) -> list[Mapping[str, Any]]:
    tables = document[name]
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise FingerError(f"{name}: expected tables [[{name}]] with {_names(_KEYS[name])}")
    for table in tables:
        _check_keys(name, table)
    return tables


def _check_keys(table: str, document: Mapping[str, Any]) -> None:
    where = f"[{table}]" if table else "the file"
    if unknown := set(document) - _KEYS[table]:
        raise FingerError(f"{where}: unknown key {_names(unknown)}; allowed are {_names(_KEYS[table])}")
    if missing := _KEYS[table] - set(document):
        raise FingerError(f"{where}: {_names(missing)} is missing; compare with the built-in finger's file")


def _sequence(field: str, value: Any) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise FingerError(f"{field}: {_shown(value)}; expected a list")
    return tuple(value)


def _pairs(field: str, value: Any) -> Pairs:
    return tuple(_sequence(field, pair) for pair in _sequence(field, value))


def _check_pairs(field: str, pairs: Sequence[Sequence[float]]) -> None:
    good = 2 <= len(pairs) <= 1000 and all(len(pair) == 2 and all(map(_finite, pair)) for pair in pairs)
    if not good or any(b[0] <= a[0] for a, b in zip(pairs, pairs[1:])) or pairs[-1][0] > 2000:
        raise FingerError(f"{field}: expected 2 to 1000 [z, radius] pairs in mm with z ascending, up to 2000 mm")


def _check_count(field: str, value: Any, low: int, high: int) -> None:
    if type(value) is not int or not low <= value <= high:
        raise FingerError(
            f"mesh.{field}: {_shown(value)}; allowed are whole numbers {low} to {high}; 3, 1, 42 is usual"
        )


def _check_number(field: str, value: Any, low: float, high: float, remedy: str) -> None:
    if not _finite(value) or not low <= value <= high:
        raise FingerError(f"{field}: {_shown(value)}; allowed is {low:g} to {high:g}; {remedy}")


def _finite(value: Any) -> bool:
    # numpy numbers are floats or have __float__; bool is an int but never meant as a number here
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e300 and math.isfinite(value)


def _at(pairs: Pairs, z: float) -> float:
    """Interpolate (z, radius) pairs, held constant beyond their ends."""
    for (z0, r0), (z1, r1) in zip(pairs, pairs[1:]):
        if z0 <= z <= z1:
            return r0 + (r1 - r0) * (z - z0) / (z1 - z0)
    return pairs[0][1] if z < pairs[0][0] else pairs[-1][1]


def _shown(value: Any) -> str:
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # integers beyond 4300 digits have no decimal form
        return "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


def _names(names: Any) -> str:
    return ", ".join(map(_shown, sorted(names)))


def _quoted(text: str) -> str:
    escaped = "".join(f"\\u{ord(c):04X}" if ord(c) < 32 or ord(c) == 127 or c in '"\\' else c for c in text)
    return f'"{escaped}"'


def _listed(pairs: Pairs) -> str:
    return "[" + ", ".join(f"[{float(a)!r}, {float(b)!r}]" for a, b in pairs) + "]"


def _template() -> str:
    return files("softmap_edge").joinpath("data", "finger.toml").read_text(encoding="utf-8")
