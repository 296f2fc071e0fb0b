"""The two bodies of the bank with one interface.

The Cosserat rod (slices A, shop, odd), and finite elements (slice B).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol

from benches.bank import body_rod, model_rod
from benches.bank.body_solid import SolidBody
from benches.bank.law import Floats, Law, Past
from benches.bank.laws_body import BODY
from benches.bank.laws_drive import DRIVE
from benches.bank.laws_unknown import UNKNOWN
from benches.bank.section import finger

if TYPE_CHECKING:
    from softmap_edge.model.model import Model


class Body(Protocol):
    """The requirements of a case for a body.

    Name, channels, `place` (N,) mm of its points, and the laws that it `can` have.

    On `every`-th frames of the standard protocol it is found out how far a law moves it.
    """

    name: str
    channels: int
    every: int
    can: frozenset[str]

    @property
    def place(self) -> Floats: ...

    def points(
        self,
        laws: Sequence[Law],
        pull: Floats,
        gravity: Floats,
        marked: bool,
        past: Past | None = None,
    ) -> Floats:
        """Return points (K, N, 3) mm under pulls (K, 2C) mm and declared gravity (K, 3) g.

        `past` is how the cables came there; a body without friction along its cables needs none.
        """
        ...

    def rough(self, laws: Sequence[Law], pull: Floats, gravity: Floats, marked: bool) -> Floats:
        """Return about the same, quickly, for laws that leave the body as it is."""
        ...

    def rest(self, marked: bool) -> Floats:
        """Return the points (N, 3) mm without load."""
        ...

    def model(self) -> Model:
        """Return the model that is diagnosed."""
        ...


class RodBody:
    """Slice A."""

    name, channels, every = body_rod.NAME, 2, 4
    can = frozenset({*DRIVE, *BODY, *UNKNOWN})

    @property
    def place(self) -> Floats:
        return body_rod.template()[0]

    def points(
        self,
        laws: Sequence[Law],
        pull: Floats,
        gravity: Floats,
        marked: bool,
        past: Past | None = None,
    ) -> Floats:
        where = body_rod.markers() if marked else body_rod.template()
        return body_rod.solved(laws, pull, gravity, past).points(finger(1), *where)

    def rough(self, laws: Sequence[Law], pull: Floats, gravity: Floats, marked: bool) -> Floats:
        where = body_rod.markers() if marked else body_rod.template()
        return body_rod.guessed(pull).points(finger(1), *where)

    def rest(self, marked: bool) -> Floats:
        return body_rod.rest(body_rod.markers() if marked else body_rod.template())

    def model(self) -> Model:
        return model_rod.model()


@lru_cache(maxsize=4)
def body_of(slice_: str) -> Body:
    """Return the body of a slice. Raises KeyError for an unknown one."""
    return {"A": RodBody, "B": SolidBody, "shop": RodBody, "odd": RodBody}[slice_]()
