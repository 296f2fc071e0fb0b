"""Types of the compiled core; the bindings in rust/python/ implement them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import CoreError as CoreError

Floats = NDArray[np.float64]

class NoEquilibriumError(CoreError): ...

class Shape:
    channels: int
    size: int
    def evaluate(self, u: Floats) -> Floats: ...
    def jacobian(self, u: Floats) -> Floats: ...

class Rod(Shape):
    def __init__(
        self, base: Floats, centre: Floats, scale: Floats, degree: int, angles: Floats, lengths: Floats
    ) -> None: ...

class RodField(Shape):
    def __init__(self, rod: Rod, name: str, compliance: float, lock: float = 0.0) -> None: ...

def monomials(x: Floats, degree: int) -> Floats: ...
def monomial_degrees(variables: int, degree: int) -> list[int]: ...

class Table(Shape):
    def __init__(self, axes: Sequence[Floats], coefficients: Floats, mean: Floats, modes: Floats) -> None: ...
    @property
    def axes(self) -> list[Floats]: ...
    @property
    def coefficients(self) -> Floats: ...
    @property
    def mean(self) -> Floats: ...
    @property
    def modes(self) -> Floats: ...
    def project(self, weights: Floats, offset: Floats) -> Table: ...

FIELDS: list[str]

def effects() -> list[dict[str, Any]]: ...

class Chain:
    def __init__(self, names: Sequence[str], channels: int) -> None: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def channels(self) -> int: ...
    @property
    def state_size(self) -> int: ...
    @property
    def labels(self) -> list[str]: ...
    @property
    def units(self) -> list[str]: ...
    @property
    def null(self) -> Floats: ...
    @property
    def start(self) -> Floats: ...
    @property
    def low(self) -> Floats: ...
    @property
    def high(self) -> Floats: ...
    @property
    def log(self) -> NDArray[np.bool_]: ...
    def rollout(
        self,
        params: Floats,
        u: Floats,
        t: Floats,
        gravity: Floats | None = None,
        load: Floats | None = None,
        temperature: Floats | None = None,
        state: Floats | None = None,
    ) -> Floats: ...
    def advance(
        self,
        params: Floats,
        u: Floats,
        t: Floats,
        gravity: Floats | None = None,
        load: Floats | None = None,
        temperature: Floats | None = None,
        state: Floats | None = None,
    ) -> tuple[Floats, Floats]: ...
    def init(self, params: Floats, u0: Floats) -> Floats: ...
    def step(
        self,
        params: Floats,
        state: Floats,
        u: Floats,
        dt: float,
        t: float,
        gravity: Floats | None = None,
        load: float | None = None,
        temperature: float | None = None,
    ) -> tuple[Floats, Floats]: ...
    def peek(
        self,
        params: Floats,
        state: Floats,
        u: Floats,
        dt: float,
        t: float,
        gravity: Floats | None = None,
        load: float | None = None,
        temperature: float | None = None,
    ) -> Floats: ...
    def coefficients(
        self,
        params: Floats,
        gravity: Floats,
        load: Floats | None = None,
        temperature: Floats | None = None,
    ) -> Floats: ...

class Predictor:
    def __init__(
        self,
        prior: Shape,
        fields: dict[str, Shape],
        positions: NDArray[np.bool_],
        gravity_reference: Floats,
    ) -> None: ...
    def predict(
        self,
        chain: Chain,
        params: Floats,
        u: Floats,
        t: Floats,
        t_seen: Floats,
        gravity: Floats | None = None,
        load: Floats | None = None,
        temperature: Floats | None = None,
    ) -> Floats: ...

class Solid:
    def __init__(
        self,
        profile: list[tuple[float, float]],
        core: int,
        rings: int,
        layers: int,
        young: float,
        poisson: float,
        density: float,
        cable_stiffness: float,
        ring: float,
        disc: float,
        routes: list[tuple[float, list[tuple[float, float]]]],
        drive: list[list[float]],
        points: Floats | None = None,
        tolerance: float = 2.5,
    ) -> None: ...
    vertices: Floats
    triangles: NDArray[np.int32]
    nodes: Floats
    bricks: NDArray[np.int64]
    fixed: NDArray[np.int64]
    core: int
    moduli: tuple[float, float]
    def newton_step(self, x: Floats) -> Floats: ...
    def sweep(
        self,
        axes: list[list[float]],
        gravity: tuple[float, float, float],
        load: tuple[float, float, float],
        progress: Callable[[float], None] | None = None,
    ) -> tuple[Floats, Floats]: ...
    def path(
        self,
        commands: Floats,
        gravity: Floats,
        load: tuple[float, float, float],
        progress: Callable[[float], None] | None = None,
    ) -> tuple[Floats, Floats]: ...
    def fields(
        self,
        commands: Floats,
        gravity: tuple[float, float, float],
        load: tuple[float, float, float],
        progress: Callable[[float], None] | None = None,
    ) -> dict[str, Floats]: ...
    def effort(self, command: list[float], gravity: tuple[float, float, float]) -> tuple[int, int]: ...
