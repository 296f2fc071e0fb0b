"""The description of a finger: solid, material, tendons, mounting, commands (`finger.toml`).

`Finger.builtin()` is the finger with the MOE dimensions; its file, with a comment on every value,
is the template. Solids are in `bodies.py`, tendons, commands and regions in `tendons.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib.resources import files
from pathlib import Path

from softmap_edge.errors import FingerError, brief
from softmap_edge.fem.bodies import Meshed, Solid, solid_from
from softmap_edge.fem.numbers import (
    Pairs,
    Vector,
    check_count,
    check_keys,
    check_number,
    check_vector,
    listed,
    names,
    sequence,
    shown,
)
from softmap_edge.fem.tendons import (
    Region,
    Tendon,
    check_commands,
    region_from,
    tendon_from,
    unit_of,
)
from softmap_edge.files.atomic import Document, finite, own_text
from softmap_edge.files.toml import parsed, quoted

__all__ = ["Finger", "Region", "Tendon"]

_MATERIAL = ("young_mpa", "poisson", "density_kg_m3")
_CABLE = {
    "stiffness_n_mm": "cable_stiffness_n_mm",
    "guide_ring_mm": "guide_ring_mm",
    "anchor_disc_mm": "anchor_disc_mm",
}
# parameters that [fit] may give bounds for
_FITTED = ("young_mpa", "cable_stiffness_n_mm", "pretension_mm")


@dataclass(frozen=True)
class Finger:
    """A finger, checked on construction: a bad field raises FingerError with the allowed values.

    solid: its body and cells · young_mpa · poisson · density_kg_m3 · gravity: (3,) multiples of g
    in the base frame · tendons · pairs: for each command the tendon it shortens (or pulls) and, if
    any, the one it pays out (or pulls where it is negative) · command_range: (low, high) for each
    command, in command_unit: "mm" of shortening or "N" of tension · cable_stiffness_n_mm ·
    guide_ring_mm, anchor_disc_mm: over what a tendon's forces are spread · regions of another
    modulus · pretension_mm: by how much every tendon is too short at command 0, below zero how
    slack · load_at_mm: where a load at the tip hangs at rest, None for the middle of the last tenth
    · handles: how many of the template's vertices are handles, None for all · bounds: which numbers
    a fit to a run may change, and how far (low, high).
    """

    name: str
    solid: Solid
    young_mpa: float
    poisson: float
    density_kg_m3: float
    gravity: tuple[float, float, float]
    tendons: tuple[Tendon, ...] = ()
    pairs: tuple[tuple[int, ...], ...] = ()
    command_range: Pairs = ()
    command_unit: str = "mm"
    cable_stiffness_n_mm: float = 20.0
    guide_ring_mm: float = 1.5
    anchor_disc_mm: float = 2.0
    regions: tuple[Region, ...] = ()
    pretension_mm: float = 0.0
    load_at_mm: Vector | None = None
    handles: int | None = None
    bounds: tuple[tuple[str, tuple[float, float]], ...] = ()

    @property
    def fit(self) -> dict[str, tuple[float, float]]:
        """Bounds (low, high) of the parameters that a fit to a run may change."""
        return dict(self.bounds)

    def __post_init__(self) -> None:
        if (
            not self.name
            or not isinstance(self.name, str)
            or len(self.name) > 100
            or not self.name.isprintable()
        ):
            raise FingerError(
                "name: expected a name of 1 to 100 printable characters; give the finger a name"
            )
        for field, low, high, remedy in _RANGES:
            check_number(field, getattr(self, field), low, high, remedy)
        if self.load_at_mm is not None:
            check_vector(
                "load_at_mm",
                self.load_at_mm,
                -2000.0,
                2000.0,
                "give the place in mm where the load hangs",
            )
        if self.handles is not None:
            check_count(
                "template.handles",
                self.handles,
                1,
                _MOST_HANDLES,
                "without [template] all vertices are",
            )
        if len(self.gravity) != 3 or not all(map(finite, self.gravity)):
            raise FingerError(
                f"gravity_g: {shown(self.gravity)}; expected three numbers of g, as [0, 0, 1]"
            )
        if (strength := sum(g * g for g in self.gravity) ** 0.5) > 3:
            raise FingerError(
                f"gravity_g: {shown(self.gravity)} is {strength:.3g} g; count in g, not in m/s2: "
                "[0, 0, 1] hangs"
            )
        if 0 < self.density_kg_m3 < 10:
            unit, factor = next(
                (u, f) for u, f in _DENSITIES.items() if self.density_kg_m3 * f >= 100 or f == 1e12
            )
            raise FingerError(
                f"density_kg_m3: {self.density_kg_m3:g} looks like {unit}; multiply by {factor:g}"
            )
        if len(self.tendons) > 16 or len(self.regions) > 100:
            raise FingerError(
                f"{len(self.tendons)} tendons and {len(self.regions)} regions, allowed are at "
                "most 16 and 100"
            )
        for number, tendon in enumerate(self.tendons):
            tendon.check(f"tendon[{number}]", self.solid, (self.guide_ring_mm, self.anchor_disc_mm))
        for number, region in enumerate(self.regions):
            region.check(f"region[{number}]")
            if region.name is not None and not isinstance(self.solid, Meshed):
                raise FingerError(
                    f"region[{number}].name: only the cells of a [mesh] file have names; give a "
                    "box in mm"
                )
        check_commands(
            self.pairs,
            self.command_range,
            self.command_unit,
            len(self.tendons),
            self.solid.height_mm,
        )
        self._check_bounds()

    @classmethod
    def builtin(cls) -> Finger:
        """Return the built-in finger with the MOE dimensions."""
        return cls.from_toml(_template())

    @classmethod
    def load(cls, path: str | Path) -> Finger:
        """Read a `finger.toml`; raises FingerError that names the file and the field."""
        try:
            text = own_text(path, _MOST_TEXT)
        except (OSError, UnicodeDecodeError) as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise FingerError(
                f"{path}: cannot be read as a finger file ({why}); give a finger.toml; a copy of "
                "softmap_edge/data/finger.toml is a start"
            ) from None
        try:
            return cls.from_toml(text, Path(path).parent)
        except FingerError as error:
            raise FingerError(f"{path}: {error}") from None

    @classmethod
    def from_toml(cls, text: str, folder: Path = Path()) -> Finger:
        """Return the finger of a file's text; relative file names start at `folder`.

        Raises FingerError.
        """
        if len(text) > _MOST_TEXT:
            raise FingerError(f"longer than {_MOST_TEXT} characters; give a finger.toml")
        try:
            document = parsed(text)
        # a number of thousands of digits is a plain ValueError
        except (ValueError, RecursionError) as error:
            raise FingerError(
                f"not valid TOML ({brief(error)}); compare with the built-in finger's file"
            ) from None
        return _from_document(document, folder)

    def replace(self, **changes: object) -> Finger:
        """Return the finger with some fields changed and checked; raises FingerError.

        They are its own fields or those of its solid.
        """
        own, solid = ({field.name for field in fields(part)} for part in (self, self.solid))
        if unknown := set(changes) - own - solid:
            raise FingerError(f"no field {names(unknown)}; a finger has {names(own | solid)}")
        inside: Document = {key: value for key, value in changes.items() if key in solid}
        outside: Document = {key: value for key, value in changes.items() if key not in solid}
        return replace(
            self, **{"solid": replace(self.solid, **inside), **outside} if inside else outside
        )

    def other_mesh(self) -> Finger:
        """Return the same finger on another mesh, finer where allowed, for the model-form error."""
        return replace(self, solid=self.solid.other_mesh())

    def to_toml(self) -> str:
        """Return the finger as a file's text, which `from_toml` reads to the same finger."""
        top, tables = self.solid.to_toml()
        lines = [f"name = {quoted(self.name)}", *([top] if top else []), tables]
        lines += [
            f"\n[material]\nyoung_mpa = {float(self.young_mpa)!r}\npoisson = "
            f"{float(self.poisson)!r}",
            f"density_kg_m3 = {float(self.density_kg_m3)!r}",
        ]
        lines += [region.to_toml() for region in self.regions]
        lines += [
            f"\n[cable]\nstiffness_n_mm = {float(self.cable_stiffness_n_mm)!r}",
            f"guide_ring_mm = {float(self.guide_ring_mm)!r}\nanchor_disc_mm = "
            f"{float(self.anchor_disc_mm)!r}",
            f"pretension_mm = {float(self.pretension_mm)!r}",
            f"\n[mounting]\ngravity_g = {listed(self.gravity)}",
            *([] if self.load_at_mm is None else [f"load_at_mm = {listed(self.load_at_mm)}"]),
        ]
        lines += [] if self.handles is None else [f"\n[template]\nhandles = {self.handles}"]
        lines += [tendon.to_toml() for tendon in self.tendons]
        for pair, limits in zip(self.pairs, self.command_range):
            ranged = f"range_{self.command_unit.lower()} = {listed(limits)}"
            lines.append(f"\n[[command]]\ntendons = {list(pair)!r}\n{ranged}")
        if self.bounds:
            lines.append("\n[fit]")
            lines += [f"{name} = {listed(limits)}" for name, limits in self.bounds]
        return "\n".join(lines) + "\n"

    def _check_bounds(self) -> None:
        allowed = {name: (low, high) for name, low, high, _ in _RANGES}
        for name, limits in self.bounds:
            if len(limits) != 2 or not all(map(finite, limits)):
                raise FingerError(
                    f"fit.{name}: {shown(list(limits))}; expected [low, high], as [0.05, 1.0]"
                )
            least, most = allowed[name]
            if not least <= limits[0] < getattr(self, name) < limits[1] <= most:
                raise FingerError(
                    f"fit.{name}: {list(limits)!r} around {getattr(self, name):g}; expected low < "
                    f"value < high within {least:g} to {most:g}"
                )


# other units, and their factors to kg/m3
_DENSITIES = {"g/cm3": 1e3, "g/mm3": 1e6, "kg/mm3": 1e9, "t/mm3": 1e12}
_MOST_TEXT = 1_000_000  # characters of a file; the template has 3000
_MOST_HANDLES = 50_000  # limit of the vertices of a bundle
_RANGES = [
    ("young_mpa", 1e-4, 1e5, "soft silicones have 0.1 to 0.6 MPa"),
    ("poisson", 0.01, 0.495, "silicones solve best at 0.45 to 0.48"),
    ("density_kg_m3", 0.0, 2e4, "silicones have about 1070 kg/m3"),
    ("cable_stiffness_n_mm", 1e-3, 1e4, "cable and drive together have about 20 N/mm"),
    ("guide_ring_mm", 0.0, 50.0, "1.5 mm is usual"),
    ("anchor_disc_mm", 0.0, 50.0, "2 mm is usual"),
    ("pretension_mm", -5.0, 5.0, "tendons that are just straight have 0"),
]


def _from_document(document: Document, folder: Path) -> Finger:
    needed, optional = (
        ("name", "material", "mounting"),
        ("profile_mm", "block", "mesh", "cable", "fit", "template"),
    )
    check_keys("", document, needed, (*optional, "region", "tendon", "command"))
    solid = solid_from(document, folder)
    material = _table(document, "material", _MATERIAL)
    mounting = _table(document, "mounting", ("gravity_g",), ("load_at_mm",))
    tendons, commands = _tables(document, "tendon"), _tables(document, "command")
    cable = {}
    if tendons or "cable" in document:
        cable = dict(_table(document, "cable", tuple(_CABLE), ("pretension_mm",)))
    fit = _table(document, "fit", (), _FITTED) if "fit" in document else {}
    template = _table(document, "template", ("handles",)) if "template" in document else {}
    unit = unit_of(commands)
    return Finger(
        name=document["name"],
        solid=solid,
        **material,
        **{_CABLE.get(key, key): value for key, value in cable.items()},
        gravity=sequence("gravity_g", mounting["gravity_g"]),
        load_at_mm=sequence("load_at_mm", mounting["load_at_mm"])
        if "load_at_mm" in mounting
        else None,
        **template,
        tendons=tuple(tendon_from(table, solid, folder) for table in tendons),
        pairs=tuple(sequence("tendons", c["tendons"]) for c in commands),
        command_range=tuple(sequence("range", c[f"range_{unit.lower()}"]) for c in commands),
        command_unit=unit,
        regions=tuple(region_from(table) for table in _tables(document, "region")),
        bounds=tuple((name, sequence(f"fit.{name}", limits)) for name, limits in fit.items()),
    )


def _table(
    document: Mapping[str, object], name: str, keys: tuple[str, ...], optional: tuple[str, ...] = ()
) -> Document:
    table = document.get(name)
    if not isinstance(table, dict):
        raise FingerError(f"{name}: expected a table [{name}] with {names(keys)}")
    check_keys(name, table, keys, optional)
    return table


def _tables(document: Mapping[str, object], name: str) -> list[Document]:
    tables = document.get(name, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise FingerError(
            f"{name}: expected tables [[{name}]]; compare with the built-in finger's file"
        )
    return tables


def _template() -> str:
    return files("softmap_edge").joinpath("data", "finger.toml").read_text(encoding="utf-8")
