"""Effects learned together with a static map, because the robot had them while it was recorded.

`softmap learn` writes one record for each effect that it adds to the chain. The records are in a
bundle's manifest, under `made_from.learned_in`, and are checked on reading like any untrusted file.
`Model.learned_in` returns them. Pinned by tests/model/test_learned_in.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Literal, get_args

from softmap_edge.errors import SoftmapError
from softmap_edge.files.atomic import Document, finite

Certainty = Literal["identified", "ambiguous", "open", "unknown"]
MOST = 32  # records, numbers or alternatives in a list
LONGEST = 100  # characters of a name
LARGEST = 1e9


@dataclass(frozen=True)
class LearnedNumber:
    """A fitted parameter: `value` ± `sigma` (one standard deviation) in `unit`."""

    label: str
    value: float
    sigma: float
    unit: str
    at_bound: bool = False

    def __str__(self) -> str:
        bound = ", at its bound" if self.at_bound else ""
        unit = self.unit.replace("1", "")
        return f"{self.label} = {self.value:.4g} ± {self.sigma:.2g} {unit}".rstrip() + bound


@dataclass(frozen=True)
class Alternative:
    """Another effect, or a family without a law (empty `name`); its held-out error in mm RMS."""

    name: str
    family: str
    error_mm: float

    def __str__(self) -> str:
        return f"{self.name or 'an unknown law'} ({self.family}, {self.error_mm:.2f} mm RMS)"


@dataclass(frozen=True)
class LearnedIn:
    """An effect that was learned with a model.

    Attributes:
        name: the effect in the chain; empty if `law` is `unknown`.
        law: `identified`: no alternative fits. `ambiguous`: the evidence is weak, or an alternative
            of another family, or with as few numbers, fits as well. `open`: a number is at its
            bound, or no law of the library fits as well as the family. `unknown`: no effect of the
            library explains the detected family, and the chain does not contain it.
        before_mm, after_mm: held-out errors without and with the effect, RMS.
    """

    name: str
    family: str
    law: Certainty
    before_mm: float
    after_mm: float
    params: tuple[LearnedNumber, ...] = ()
    alternatives: tuple[Alternative, ...] = ()

    def __str__(self) -> str:
        if not self.name:
            families = " or ".join(
                dict.fromkeys([self.family, *(one.family for one in self.alternatives)])
            )
            fall = f"from {self.before_mm:.2f} to {self.after_mm:.2f} mm RMS"
            return (
                f"unknown law of {families}, not in the model; its family lowers the held-out "
                f"error {fall}"
            )
        errors = f"held-out error {self.before_mm:.2f} to {self.after_mm:.2f} mm RMS"
        lines = [
            f"{self.name}: {self.family}, law {self.law}, {errors}",
            *(f"  {number}" for number in self.params),
        ]
        if self.alternatives:
            lines.append(f"  alternatives: {', '.join(map(str, self.alternatives))}")
        return "\n".join(lines)

    def to_dict(self) -> Document:
        """Return the record as stored in a manifest."""
        return asdict(self)

    @classmethod
    def from_dict(cls, document: Mapping[str, object]) -> LearnedIn:
        """Read a record of a manifest.

        Raises:
            SoftmapError: a key is unknown or missing, or a value has the wrong type or range.
        """
        values = _checked(cls, document)
        if values["law"] not in get_args(Certainty):
            raise SoftmapError(
                f"learned_in: law is {values['law']!r:.40}, expected one of "
                f"{', '.join(get_args(Certainty))}"
            )
        values["params"] = tuple(
            LearnedNumber(**_checked(LearnedNumber, part)) for part in values["params"]
        )
        values["alternatives"] = tuple(
            Alternative(**_checked(Alternative, part)) for part in values["alternatives"]
        )
        return cls(**values)


def read_learned_in(document: object) -> tuple[LearnedIn, ...]:
    """Return the records of a manifest's `made_from.learned_in`; empty if it is missing.

    Raises:
        SoftmapError: it is not a list of at most 32 valid records.
    """
    if document is None:
        return ()
    if not isinstance(document, Sequence) or isinstance(document, str) or len(document) > MOST:
        raise SoftmapError(
            f"learned_in: expected a list of at most {MOST} records, got {document!r:.40}"
        )
    return tuple(LearnedIn.from_dict(part) for part in document)


def _checked(kind: type, document: object) -> Document:
    """Return the values of a table whose keys are fields of `kind`, with their types checked."""
    declared = {field.name: str(field.type) for field in fields(kind)}
    if not isinstance(document, Mapping) or set(document) != set(declared):
        raise SoftmapError(
            f"learned_in: expected a table with {', '.join(declared)}, got {document!r:.60}"
        )
    values = dict(document)
    for name, of in declared.items():
        if not _fits(values[name], of):
            raise SoftmapError(
                f"learned_in: {name} is {values[name]!r:.40}, expected {_EXPECTED.get(of, of)}"
            )
    return values


_EXPECTED = {
    "str": f"a printable text of at most {LONGEST} characters",
    "Certainty": f"a printable text of at most {LONGEST} characters",
    "float": f"a number within ±{LARGEST:g}",
    "bool": "true or false",
}


def _fits(value: object, of: str) -> bool:
    if of == "bool":
        return isinstance(value, bool)
    if of == "float":
        return finite(value, LARGEST)
    if of in ("str", "Certainty"):
        return isinstance(value, str) and len(value) <= LONGEST and value.isprintable()
    return isinstance(value, list | tuple) and len(value) <= MOST
