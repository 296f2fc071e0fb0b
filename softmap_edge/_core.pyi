"""Types of the compiled core; the bindings in rust/python/ implement them."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import disjoint_base

from softmap_edge.errors import CoreError as CoreError
from softmap_edge.robot.servo.loop_types import LoopLimits
from softmap_edge.robot.servo.models import ServoModel

_Floats = NDArray[np.float64]

__all__ = [
    "Bank",
    "Cables",
    "Chain",
    "CoreError",
    "ElasticField",
    "ElasticRod",
    "EmulatedBus",
    "FAST_FIRMWARE",
    "FIELDS",
    "HARDWARE_ERRORS",
    "Inputs",
    "Inverse",
    "LOADS",
    "Level",
    "MODULI",
    "Mesh",
    "Network",
    "Predictor",
    "Reach",
    "Reading",
    "Registration",
    "Rod",
    "RodField",
    "STANDARD_GRAVITY",
    "STATIONS",
    "Scattered",
    "Second",
    "Series",
    "ServoBus",
    "Shape",
    "Solid",
    "Sum",
    "Surface",
    "Table",
    "chamfer",
    "check_limits",
    "check_onnx",
    "control_loop",
    "effects",
    "families",
    "forget",
    "limit_ranges",
    "monomial_degrees",
    "monomials",
    "read_recording",
    "register",
    "replay",
    "servo_models",
    "servo_packet",
    "servo_packets",
    "servo_registers",
    "tensor_splines",
]

@disjoint_base
class Shape:
    channels: int
    size: int
    numbers: list[str]
    def evaluate(self, u: _Floats) -> _Floats: ...
    def with_slopes(self, u: Sequence[float]) -> tuple[_Floats, _Floats]: ...
    def jacobian(self, u: _Floats) -> _Floats: ...
    def project(self, weights: _Floats, offset: _Floats) -> Shape: ...

@final
class Rod(Shape):
    def __new__(
        cls,
        base: _Floats,
        centre: _Floats,
        scale: _Floats,
        degree: int,
        angles: _Floats,
        lengths: _Floats,
        pulled: bool = False,
        intervals: int = 0,
    ) -> Self: ...

@final
class RodField(Shape):
    def __new__(cls, rod: Rod, name: str, compliance: float, lock: float = 0.0) -> Self: ...

@final
class ElasticRod(Shape):
    def __new__(
        cls,
        segments: int,
        channels: int,
        ends: Sequence[int],
        channel: Sequence[int],
        pull: Sequence[float],
        at: Sequence[float],
        numbers: _Floats,
    ) -> Self: ...
    @property
    def labels(self) -> list[str]: ...
    def state(self, u: _Floats) -> tuple[_Floats, _Floats]: ...
    def number_slopes(self, u: _Floats) -> tuple[_Floats, _Floats]: ...

@final
class ElasticField(Shape):
    def __new__(cls, rod: ElasticRod, name: str, flexibility: float) -> Self: ...

def monomials(x: _Floats, degree: int) -> _Floats: ...
def monomial_degrees(variables: int, degree: int) -> list[int]: ...
def tensor_splines(x: _Floats, intervals: int) -> _Floats: ...

@final
class Table(Shape):
    def __new__(
        cls, axes: Sequence[_Floats], coefficients: _Floats, mean: _Floats, modes: _Floats
    ) -> Self: ...
    @property
    def axes(self) -> list[_Floats]: ...
    @property
    def coefficients(self) -> _Floats: ...
    @property
    def mean(self) -> _Floats: ...
    @property
    def modes(self) -> _Floats: ...
    def project(self, weights: _Floats, offset: _Floats) -> Table: ...

@final
class Scattered(Shape):
    def __new__(
        cls,
        nodes: _Floats,
        scale: _Floats,
        power: int,
        coefficients: _Floats,
        mean: _Floats,
        modes: _Floats,
    ) -> Self: ...
    def project(self, weights: _Floats, offset: _Floats) -> Scattered: ...

@final
class Network(Shape):
    def __new__(cls, file: bytes) -> Self: ...
    @property
    def parameters(self) -> int: ...
    def project(self, weights: _Floats, offset: _Floats) -> Network: ...

def check_onnx(file: bytes) -> None: ...

@final
class Sum(Shape):
    def __new__(cls, prior: Shape, residual: Shape) -> Self: ...

def servo_packet(id: int, instruction: int, parameters: bytes) -> bytes: ...
def servo_packets(stream: bytes) -> list[tuple[int, int, bytes]]: ...
def servo_models() -> list[ServoModel]: ...
def servo_registers() -> dict[str, tuple[int, int, bool]]: ...

@final
class ServoBus:
    def __new__(cls, port: str, baud: int, slack: float = 0.02) -> Self: ...
    @property
    def port(self) -> str: ...
    @property
    def baud(self) -> int: ...
    def close(self) -> None: ...
    def counts(self) -> dict[str, int]: ...
    def ping(self, id: int) -> tuple[int, int] | None: ...
    def scan(self) -> list[tuple[int, int, int]]: ...
    def read(self, id: int, address: int, size: int) -> bytes: ...
    def write(self, id: int, address: int, data: bytes) -> None: ...
    def reboot(self, id: int) -> None: ...
    def clear_turns(self, id: int) -> None: ...
    def release(self) -> None: ...

def check_limits(table: LoopLimits) -> None: ...
def limit_ranges() -> dict[str, tuple[float, float, str]]: ...
def control_loop(
    orders: int,
    reports: int,
    *,
    port: str,
    baud: int,
    servos: Sequence[Sequence[int]],
    limits: dict[str, Any],
    slope: Sequence[float],
    b: Sequence[float],
    home: Sequence[float],
    chain: Mapping[str, Any] | None = None,
    gpio: tuple[str, int, bool] | None = None,
    heartbeat: tuple[str, int, bytes, float] | None = None,
    record: str | None = None,
    setup: str = "",
) -> bool: ...
def read_recording(path: str) -> list[tuple[str, int, bytes]]: ...

@final
class Reading:
    def __new__(cls, path: str) -> Self: ...
    def more(self) -> tuple[list[tuple[str, int, bytes]], bool]: ...

def replay(
    table: LoopLimits, periods: Sequence[tuple[Any, ...]]
) -> list[tuple[str, str, bool, list[int]]]: ...

@final
class EmulatedBus:
    def __new__(
        cls,
        servos: Sequence[tuple[int, int, int, float]],
        load: Sequence[Sequence[tuple[float, float]]],
        *,
        delay: float = 0.02,
        lag: float = 0.04,
        seed: int = 0,
        simulated: bool = False,
    ) -> Self: ...
    @property
    def path(self) -> str: ...
    def now(self) -> int: ...
    def hold(self, at: int) -> None: ...
    def advance(self, until: int, most: float) -> bool: ...
    def free(self, free: bool) -> int: ...
    def there(self, window: float | None) -> float: ...
    def waiting(self) -> bool: ...
    def faults(
        self,
        *,
        drop: float = 0.0,
        damage: float = 0.0,
        junk: float = 0.0,
        slow: float = 0.0,
        unpowered: bool = False,
    ) -> None: ...
    def damage(
        self,
        servo: int,
        *,
        mute: bool | None = None,
        stuck: bool | None = None,
        torn: bool | None = None,
        reversed: bool | None = None,
        jammed: bool | None = None,
        uncapped: bool | None = None,
    ) -> None: ...
    def burden(self, servo: int, factor: float) -> None: ...
    def lose_turn(self, servo: int) -> None: ...
    def swap(self, one: int, other: int) -> None: ...
    def mend(self) -> None: ...
    def reset(self, servo: int) -> None: ...
    def fail(self, servo: int, bits: int) -> None: ...
    def heat(self, servo: int, temperature: float) -> None: ...
    def supply(self, servo: int, volts: float) -> None: ...
    def rename(self, servo: int, id: int) -> None: ...
    def flash(self, servo: int, firmware: int) -> None: ...
    def unplug(self) -> None: ...
    def state(self) -> tuple[float, list[tuple[float, bool, bool, float]]]: ...

FIELDS: list[str]
LOADS: list[str]
MODULI: list[str]
STATIONS: list[float]
STANDARD_GRAVITY: float  # m/s², N/kg
FAST_FIRMWARE: int
HARDWARE_ERRORS: list[tuple[int, str]]

def effects() -> list[dict[str, Any]]: ...
def families() -> list[dict[str, Any]]: ...

@final
class Series:
    def __new__(
        cls,
        v: _Floats,
        t: _Floats,
        middle: _Floats,
        half: _Floats,
        temperature: _Floats | None = None,
        orientation: NDArray[np.int64] | None = None,
        orientations: NDArray[np.int64] | None = None,
        free_map: bool = False,
    ) -> Self: ...
    @property
    def samples(self) -> int: ...
    @property
    def channels(self) -> int: ...

@final
class Bank:
    def __new__(cls, name: str, channels: int) -> Self: ...
    @property
    def name(self) -> str: ...
    @property
    def channels(self) -> int: ...
    def columns(self, series: Series, at: _Floats) -> tuple[NDArray[np.int64], _Floats]: ...
    def applied(self, series: Series, theta: _Floats) -> _Floats: ...
    def modulation(self, series: Series, at: _Floats) -> _Floats: ...
    def signals(
        self, series: Series, at: _Floats, wide: bool
    ) -> tuple[NDArray[np.int64], _Floats]: ...

@final
class Level:
    def __new__(
        cls,
        form: _Floats,
        kernel: tuple[_Floats, _Floats],
        folds: Sequence[
            tuple[NDArray[np.int64], NDArray[np.int64], _Floats, _Floats, _Floats, _Floats]
        ],
    ) -> Self: ...
    @property
    def names(self) -> list[str]: ...
    def add(self, name: str, base: _Floats, which: NDArray[np.int64], weight: _Floats) -> None: ...
    def fresh(self) -> Level: ...
    def close(self, residual: _Floats) -> None: ...
    def losses(self, names: Sequence[str], ridges: Sequence[float]) -> _Floats: ...
    def training_loss(self, names: Sequence[str], ridges: Sequence[float]) -> float: ...
    def theta(self, names: Sequence[str], ridges: Sequence[float]) -> list[_Floats]: ...
    def freedom(self, names: Sequence[str], ridges: Sequence[float], name: str) -> float: ...
    def fitted(self, name: str, theta: _Floats) -> _Floats: ...
    def losses_of(self, modes: _Floats) -> _Floats: ...

def register(declaration: Mapping[str, Any], rollout: Callable[..., _Floats]) -> None: ...
def forget(name: str) -> None: ...

@final
class Chain:
    def __new__(cls, names: Sequence[str], channels: int) -> Self: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def channels(self) -> int: ...
    @property
    def state_size(self) -> int: ...
    @property
    def fields(self) -> list[str]: ...
    @property
    def numbers(self) -> list[str]: ...
    @property
    def labels(self) -> list[str]: ...
    @property
    def units(self) -> list[str]: ...
    @property
    def null(self) -> _Floats: ...
    @property
    def start(self) -> _Floats: ...
    @property
    def low(self) -> _Floats: ...
    @property
    def high(self) -> _Floats: ...
    @property
    def integer(self) -> NDArray[np.bool_]: ...
    @property
    def half_ranges(self) -> _Floats: ...
    @property
    def lengths(self) -> _Floats: ...
    @property
    def map_half_ranges(self) -> _Floats: ...
    @property
    def map_high(self) -> _Floats: ...
    @property
    def tie(self) -> NDArray[np.int64]: ...
    @property
    def group_labels(self) -> list[str]: ...
    def meanings(self, params: _Floats | Sequence[float]) -> list[str | None]: ...
    @property
    def instant(self) -> NDArray[np.bool_]: ...
    @property
    def log(self) -> NDArray[np.bool_]: ...
    def rollout(
        self,
        params: _Floats,
        u: _Floats,
        t: _Floats,
        gravity: _Floats | None = None,
        load: _Floats | None = None,
        temperature: _Floats | None = None,
        state: _Floats | None = None,
    ) -> _Floats: ...
    def advance(
        self,
        params: _Floats,
        u: _Floats,
        t: _Floats,
        gravity: _Floats | None = None,
        load: _Floats | None = None,
        temperature: _Floats | None = None,
        state: _Floats | None = None,
    ) -> tuple[_Floats, _Floats]: ...
    def init(self, params: _Floats, u0: _Floats) -> _Floats: ...
    def step(
        self,
        params: _Floats,
        state: _Floats,
        u: _Floats,
        dt: float,
        t: float,
        gravity: _Floats | None = None,
        load: float | None = None,
        temperature: float | None = None,
    ) -> tuple[_Floats, _Floats]: ...
    def peek(
        self,
        params: _Floats,
        state: _Floats,
        u: _Floats,
        dt: float,
        t: float,
        gravity: _Floats | None = None,
        load: float | None = None,
        temperature: float | None = None,
    ) -> _Floats: ...
    def coefficients(
        self,
        params: _Floats,
        gravity: _Floats,
        load: _Floats | None = None,
        temperature: _Floats | None = None,
        u: _Floats | None = None,
    ) -> _Floats: ...

@final
class Cables:
    def __new__(
        cls, stiffness: _Floats, pull: Table, stretch: Table, fields: Sequence[Table]
    ) -> Self: ...
    def project(self, weights: _Floats, offset: _Floats) -> Cables: ...

@final
class Second:
    def __new__(
        cls,
        axes: Sequence[_Floats],
        numbers: _Floats,
        tendons: int,
        modes: _Floats,
        moduli: _Floats | None = None,
    ) -> Self: ...
    def project(self, weights: _Floats) -> Second: ...

@final
class Predictor:
    def __new__(
        cls,
        prior: Shape,
        fields: dict[str, Shape],
        positions: NDArray[np.bool_],
        gravity_reference: _Floats,
        cables: Cables | None = None,
        declared_loads: bool = True,
        contact: tuple[Shape, dict[str, Shape], Cables | None, Second | None, Sequence[float]]
        | None = None,
        second: Second | None = None,
    ) -> Self: ...
    def through(self, weights: _Floats) -> Predictor | None: ...
    def still(
        self,
        chain: Chain,
        params: _Floats,
        gravity: _Floats,
        load: float = 0.0,
        temperature: float = ...,
    ) -> Shape: ...
    def predict(self, chain: Chain, params: _Floats, inputs: Inputs) -> _Floats: ...
    def acting(self, chain: Chain, params: _Floats, inputs: Inputs) -> _Floats: ...
    def slopes(self, chain: Chain, params: _Floats, inputs: Inputs, step: _Floats) -> _Floats: ...

@final
class Inputs:
    def __new__(
        cls,
        u: _Floats,
        t: _Floats,
        t_seen: _Floats,
        gravity: _Floats | None = None,
        load: _Floats | None = None,
        temperature: _Floats | None = None,
        cameras: _Floats | None = None,
    ) -> Self: ...

@final
class Reach:
    def __new__(
        cls, shape: Shape, low: Sequence[float], high: Sequence[float], axes: Sequence[bool]
    ) -> Self: ...
    @property
    def samples(self) -> tuple[_Floats, _Floats]: ...
    def path(
        self, targets: _Floats, start: Sequence[float] | None = None, published: bool = False
    ) -> tuple[_Floats, _Floats, _Floats, NDArray[np.int64]]: ...

@final
class Inverse:
    def __new__(
        cls,
        chain: Chain,
        params: _Floats,
        low: Sequence[float],
        high: Sequence[float],
        gravity: _Floats,
        load: float = 0.0,
        temperature: float = ...,
    ) -> Self: ...
    def settle(self, u: _Floats) -> _Floats: ...
    def command(self, wanted: _Floats, dt: float) -> tuple[_Floats, float]: ...
    def passed(self, u: _Floats, dt: float) -> _Floats: ...
    def path(self, wanted: _Floats, t: _Floats) -> tuple[_Floats, _Floats]: ...

@final
class Mesh:
    @staticmethod
    def finger(
        profile: list[tuple[float, float]], breaks: list[float], core: int, rings: int, layers: int
    ) -> Mesh: ...
    @staticmethod
    def block(size: tuple[float, float, float], cells: tuple[int, int, int]) -> Mesh: ...
    @staticmethod
    def tetrahedra(nodes: _Floats, cells: NDArray[np.int64], refine: int) -> Mesh: ...
    nodes: _Floats
    cells: NDArray[np.int64]
    fixed: NDArray[np.int64]
    height: float

@final
class Solid:
    def __new__(
        cls,
        mesh: Mesh,
        young: float,
        poisson: float,
        density: float,
        regions: Sequence[
            tuple[
                tuple[float, float, float],
                tuple[float, float, float],
                float | None,
                float,
                list[bool] | None,
            ]
        ],
        cable_stiffness: float,
        ring: float,
        disc: float,
        routes: Sequence[
            tuple[float, float, list[tuple[float, float]]] | list[tuple[float, float, float]]
        ],
        drive: list[list[float]],
        by_tension: bool = False,
        pretension: float = 0.0,
        load_at: tuple[float, float, float] | None = None,
        points: _Floats | None = None,
        tolerance: float = 2.5,
        change: list[tuple[str, float]] = ...,
    ) -> Self: ...
    vertices: _Floats
    triangles: NDArray[np.int32]
    def newton_step(self, x: _Floats) -> _Floats: ...
    def sweep(
        self,
        axes: list[list[float]],
        gravity: tuple[float, float, float],
        load: tuple[float, float, float],
        progress: Callable[[float], None] | None = None,
    ) -> tuple[_Floats, _Floats]: ...
    def path(
        self,
        commands: _Floats,
        gravity: _Floats,
        load: tuple[float, float, float],
        progress: Callable[[float], None] | None = None,
    ) -> tuple[_Floats, _Floats]: ...
    def path_from(
        self,
        other: Solid,
        commands: _Floats,
        gravity: tuple[float, float, float],
        load: tuple[float, float, float],
        progress: Callable[[float], None] | None = None,
    ) -> _Floats: ...
    def bends(
        self,
        commands: _Floats,
        gravity: tuple[float, float, float],
        load: tuple[float, float, float],
        progress: Callable[[float], None] | None = None,
    ) -> tuple[_Floats, _Floats, _Floats]: ...
    def fields(
        self,
        commands: _Floats,
        gravity: tuple[float, float, float],
        load: tuple[float, float, float],
        design: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> dict[str, _Floats]: ...

def chamfer(
    template: _Floats, cloud: _Floats, seen: _Floats | None = None, trusted: _Floats | None = None
) -> dict[str, Any]: ...

@final
class Surface:
    def __new__(cls, vertices: _Floats, triangles: list[list[int]]) -> Surface: ...
    def nearest(self, of: _Floats) -> tuple[_Floats, _Floats]: ...
    def seen(self, eye: list[float], places: _Floats, normals: _Floats) -> NDArray[np.bool_]: ...

@final
class Registration:
    def __new__(
        cls, rest: _Floats, triangles: list[list[int]], base: list[int]
    ) -> Registration: ...
    def edges(self) -> tuple[NDArray[np.int64], NDArray[np.int64], _Floats]: ...
    def deformed(self, goals: _Floats, strength: _Floats, rounds: int) -> _Floats: ...
    def robust(
        self,
        shape: Shape,
        clouds: list[_Floats],
        candidates: list[list[float]],
        low: list[float],
        high: list[float],
        cloud: float = 3.0,
        points: int = 2000,
        rounds: int = 25,
        base: float = 100.0,
    ) -> list[dict[str, Any]]: ...
    def published(self, cloud: _Floats, strength: _Floats, rounds: int) -> tuple[_Floats, int]: ...
