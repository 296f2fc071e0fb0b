"""The results of a diagnosis as frozen records.

The document softmap.diagnosis/2 stores them.

Units: mm, s. Pinned by tests/diagnosis/test_document.py.
"""

from __future__ import annotations

import math
import types
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from softmap_edge.errors import ReportError
from softmap_edge.files.printable import one_line
from softmap_edge.model.learned_in import Certainty
from softmap_edge.run.conditions import Bin

T = TypeVar("T")
_LARGEST = 1e300  # of any number: an error that ran away is shown; sums stay finite
BEYOND = 6  # largest reported power of ten of an e-value


@dataclass(frozen=True)
class Number:
    """A fitted parameter: value, one standard deviation, unit, bound flag, meaning in words."""

    value: float
    sigma: float | None = None
    unit: str = ""
    at_bound: bool = False
    meaning: str | None = None


@dataclass(frozen=True)
class Displacement:
    """Effect size in mm RMS over the places, on the fitted run and on a held-out run."""

    fitted: float | None = None
    held_out: float | None = None


@dataclass(frozen=True)
class Refitted:
    """Model parameters fitted with an effect, and the error (F,) mm of the fit."""

    params: dict[str, Number]
    error_mm: tuple[float, ...] = ()


@dataclass(frozen=True)
class Certificate:
    """Evidence for a claim, from blocks withheld from its fit.

    `log10_e` is the decimal logarithm of its e-value; the claim is `certified` if it is at least
    `log10_needed`. `reason` explains a missing e-value.
    """

    log10_e: float | None = None
    log10_needed: float | None = None
    frames: int = 0  # withheld
    blocks: int = 0
    certified: bool = False
    reason: str = ""

    @property
    def refuted(self) -> bool:
        """Whether the claim was tested on the withheld blocks and not confirmed."""
        return self.log10_e is not None and not self.certified

    def __str__(self) -> str:
        if self.log10_e is None or self.log10_needed is None:
            return f"not tested on withheld blocks: {self.reason}"
        how = "confirmed" if self.certified else "not confirmed"
        return (
            f"{how} on the withheld blocks (e-value {power(self.log10_e)}; needed "
            f"{power(self.log10_needed)})"
        )


def power(log10: float) -> str:
    """Return a number from its decimal logarithm.

    It is limited to BEYOND powers of ten: no noise model is more exact.
    """
    if abs(log10) > BEYOND:
        return f"{'more' if log10 > 0.0 else 'less'} than 10^{'' if log10 > 0.0 else '-'}{BEYOND}"
    if not -2.0 <= log10 < 4.0:
        return f"10^{log10:.2g}"
    return f"{10.0**log10:.3g}" if log10 < 2.0 else f"{10.0**log10:.0f}"


@dataclass(frozen=True)
class Finding:
    """An effect that the model lacks, or a fault of the measurement.

    `probability` is the probability that this effect, or an equivalent one, is present. Below one
    half it is a candidate. `share` is its share of the explained error.
    """

    name: str
    params: dict[str, Number]
    family: str = ""
    stage: str = ""
    displacement_mm: Displacement = Displacement()
    share: float | None = None
    probability: float | None = None
    refitted: Refitted | None = None
    certificate: Certificate | None = None


@dataclass(frozen=True)
class Alternative:
    """An equally good set of effects in place of `member`, and why it cannot be excluded."""

    effects: tuple[str, ...] = ()
    why: str = ""
    member: str = ""
    family: str = ""


@dataclass(frozen=True)
class FamilyFinding:
    """A family of effects that was detected.

    `law` is "identified" (`effects` name it), "open" or "unknown". If it is open, `effects` and
    `generic` list laws that fit equally well. If it is unknown, no known law explains as much as
    the family; `effects` holds the one that explains most of it, if any. `share` is its share of
    the explained loss; `law_share` is the part of that share that the best known law explains.
    """

    name: str
    kind: str
    law: Certainty
    effects: tuple[str, ...]
    share: float
    moved_mm: float
    law_share: float | None = None
    generic: tuple[str, ...] = ()
    alternatives: tuple[str, ...] = ()  # other families that cannot be distinguished here
    # of a family without a law; a law has it in its effect
    certificate: Certificate | None = None


@dataclass(frozen=True)
class Untestable:
    """An effect that this run cannot show or separate: the reason, and what to record.

    If it is a limit `of_model`, no recording can show it with this model.
    """

    name: str
    why: str = ""
    experiment: str = ""
    minutes: float = 0.0
    of_model: bool = False


@dataclass(frozen=True)
class Rung:
    """A step of the error ladder: an added effect, and the held-out error with it."""

    added: str
    value: float


@dataclass(frozen=True)
class ErrorLadder:
    """Held-out RMS errors: the model, a static baseline, each effect, both; and the floors."""

    model: float | None = None
    static_residual: float | None = None
    ladder: tuple[Rung, ...] = ()
    with_static_residual: float | None = None
    per_fold: tuple[float, ...] = ()
    kind: str = "held-out rms"
    unit: str = "mm"
    noise_floor: float | None = None
    model_floor: float | None = None
    floor: float | None = None
    floor_kind: str = ""
    held_out_on: str = ""

    @property
    def after(self) -> float:
        """The error with all effects added; NaN if unknown."""
        return self.ladder[-1].value if self.ladder else self.before

    @property
    def before(self) -> float:
        """The error of the model alone; NaN if unknown."""
        return math.nan if self.model is None else self.model


@dataclass(frozen=True)
class Unexplained:
    """The unexplained error beyond the noise, mm RMS; chi²/n; conditions that predict it.

    Prediction is tested on held-out blocks.
    """

    rms_mm: float | None = None
    chi2_per_n: float | None = None
    blocked_r2: float | None = None
    predicted_by: str | None = None
    # ordinary static imperfections of the robot, which are not findings
    ordinary_mm: float | None = None


@dataclass(frozen=True)
class Where:
    """The error by condition, before and after."""

    before: dict[str, tuple[Bin, ...]] = field(default_factory=dict)
    after: dict[str, tuple[Bin, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class NextBlock:
    """What to record next: its minutes, the questions that it resolves, and its separation.

    The separation is simulated; None without a simulation.
    """

    block: str
    minutes: float | None = None
    settles: tuple[str, ...] = ()
    separation: float | None = None


@dataclass(frozen=True)
class ServoEffect:
    """An effect between command and encoder."""

    name: str
    params: dict[str, Number]


@dataclass(frozen=True)
class ServoError:
    """Held-out RMS error of a servo against its command, and with its effects."""

    model: float
    value: float


@dataclass(frozen=True)
class ServoFinding:
    """Effects between command and encoder of a channel, with held-out error before and after."""

    channel: int
    unit: str
    effects: tuple[ServoEffect, ...]
    error: ServoError


def plain(value: object) -> Any:
    """Return records as dictionaries and lists for JSON; omit absent entries (default None)."""
    if is_dataclass(value) and not isinstance(value, type):
        return {
            f.name: plain(getattr(value, f.name))
            for f in fields(value)
            if not (f.name in ("refitted", "meaning") and getattr(value, f.name) is None)
        }
    if isinstance(value, Mapping):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(one) for one in value]
    return value


def read(kind: type[T], document: object, where: str) -> T:
    """Read a record from a part of a document; ignore unknown keys.

    Raises:
        ReportError: a key is missing or mistyped; `where` names the place.
    """
    if not isinstance(document, Mapping):
        raise ReportError(
            f"damaged diagnosis: {where} is {type(document).__name__}, expected an object; "
            "diagnose again"
        )
    hints, values = get_type_hints(kind), {}
    for f in fields(kind):  # type: ignore[arg-type]
        if f.name in document:
            values[f.name] = _value(hints[f.name], document[f.name], f"{where}.{f.name}")
        elif f.default is MISSING and f.default_factory is MISSING:
            raise ReportError(f"damaged diagnosis: {where} has no '{f.name}'; diagnose again")
    return kind(**values)


def _value(hint: object, value: object, where: str) -> Any:
    """Convert a value of a document to its annotated type."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in inner:
            return None
        return _value(next(kind for kind in inner if kind is not type(None)), value, where)
    if origin is Literal:
        if value not in inner:
            raise ReportError(
                f"damaged diagnosis: {where} is {value!r:.40}, expected one of "
                f"{', '.join(inner)}; diagnose again"
            )
        return value
    if origin is tuple:
        rows = _typed(list, value, where)
        return tuple(_value(inner[0], row, f"{where}[{i}]") for i, row in enumerate(rows))
    if origin is dict:
        return {
            one_line(str(key)): _value(inner[1], one, f"{where}.{key}")
            for key, one in _typed(Mapping, value, where).items()
        }
    if isinstance(hint, type) and is_dataclass(hint):
        return read(hint, value, where)
    if hint is float:
        found = float(_typed((int, float), value, where))
        if not abs(found) <= _LARGEST:  # also not for NaN
            raise ReportError(
                f"damaged diagnosis: {where} is {found:g}, no finite value within "
                f"±{_LARGEST:g}; diagnose again"
            )
        return found
    if hint is str:  # a document may come from anywhere
        return one_line(_typed(str, value, where))
    return value if hint is Any else _typed(hint, value, where)


def _typed(kind: Any, value: Any, where: str) -> Any:
    wrong = isinstance(value, bool) and kind is not bool
    if wrong or not isinstance(value, kind):
        raise ReportError(f"damaged diagnosis: {where} is {type(value).__name__}; diagnose again")
    return value
