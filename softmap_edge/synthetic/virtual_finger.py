"""The virtual finger: a stand-in for hardware, for tests of the complete pipeline.

It is simulated, and reports never call it real.

    command ─whole ticks─> u ─friction, hidden effects─> tetrahedra, another material, turned
    tendons, a lean─> points
                                                                                      points ─two
                                                                                      noisy views─>
                                                                                      clouds

It is the model's solid with other elements (`fem/cut.py`; a mesh of tetrahedra is unchanged). The
modulus is drawn within ±20 %, and Poisson's ratio is 0.45. Tendons are turned about the axis by a
drawn 3 to 6 degrees. Friction has memory (`truth_laws.BoucWen`). The mounting leans by up to 20
degrees, which the run declares to within 2. Hidden effects are added as in `synthetic/finger.py`.
**Never calls the effect library**, nor a model's prior or fields. The run holds the data of
hardware: commanded and read ticks (`robot/emulated/published_map.py`, encoder noise of one tick),
clouds, the declared gravity and camera noise; no command in mm and no vertex. Those are stored
separately in the arrays of the truth. Every frame is solved. Randomness only from the seeds. Pinned
by tests/synthetic/test_virtual.py.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError
from softmap_edge.fem.bodies import Meshed
from softmap_edge.fem.cut import Cut
from softmap_edge.fem.finger import Finger, Tendon
from softmap_edge.fem.simulator import FingerTemplate, Simulator
from softmap_edge.files.atomic import Document
from softmap_edge.robot.emulated.laws import LAWS, BoucWen, Law, TrueWeight, rotation
from softmap_edge.robot.emulated.named_laws import NAMED, check_hidden
from softmap_edge.robot.emulated.published_map import PUBLISHED, ServoMap
from softmap_edge.run.protocol import Protocol
from softmap_edge.run.run import Run
from softmap_edge.synthetic.depth_camera import TWO, DepthCameras
from softmap_edge.synthetic.finger import HiddenEffect, Truth, Vector, different, hide, toured

Floats = NDArray[np.float64]
Arrays = dict[str, NDArray[np.generic]]

SCHEMA = "softmap.virtual/1"
MODULUS = (0.8, 1.2)  # of the model's
POISSON = 0.45
PHASE = (3.0, 6.0)  # rotation of the tendons about the axis, either way, degrees
LEAN, MEASURED = 20.0, 2.0  # largest lean of the mounting, and its uncertainty, degrees
MADE_BY = "virtual finger of softmap-edge: simulated, no hardware"
FRICTION = (
    # for the demo: a lubricated tendon, so a static baseline can correct the larger part
    0.4
)
ENCODER = 1.0  # ticks, standard deviation
CAMERAS = replace(TWO, points=5000, hole_mm=8.0)


@dataclass(frozen=True)
class VirtualFinger:
    """The stand-in for hardware: the model's `finger`, and its differences.

    modulus: a multiple of the finger's · phase_deg: of the tendons about z · lean_deg,
    declared_deg: (2,) lean of the mounting about x and y of the base, and its declaration in the
    run · friction in the tendons, None for none · hidden effects · cameras · servos.
    """

    seed: int
    finger: Finger
    modulus: float
    phase_deg: float
    lean_deg: tuple[float, float]
    declared_deg: tuple[float, float]
    friction: Law | None
    hidden: tuple[HiddenEffect, ...] = ()
    cameras: DepthCameras = CAMERAS
    servos: ServoMap = PUBLISHED

    @cached_property
    def template(self) -> FingerTemplate:
        """The material points that the truth reports: the vertices of the model's finger."""
        return Simulator(self.finger).template

    @cached_property
    def body(self) -> Simulator:
        """The simulator of this finger."""
        solid, finger = self.finger.solid, self.finger
        other = finger.replace(
            solid=solid if isinstance(solid, Meshed) else Cut(solid),
            young_mpa=self.modulus * finger.young_mpa,
            poisson=POISSON,
            regions=tuple(replace(r, young_mpa=self.modulus * r.young_mpa) for r in finger.regions),
            tendons=tuple(_turned(tendon, self.phase_deg) for tendon in finger.tendons),
            bounds=(),
        )
        return Simulator(other, self.template)

    @property
    def truth(self) -> Truth:
        """The laws on command, weight and image, in order."""
        lean = HiddenEffect(TrueWeight(0.0, self.lean_deg), 0.0)
        own = (lean,) if self.friction is None else (HiddenEffect(self.friction, 0.0), lean)
        order = [*NAMED, *LAWS]
        hidden = sorted((*self.hidden, *own), key=lambda effect: order.index(effect.name))
        return Truth(self.seed, tuple(hidden), finger=self.finger)

    def shapes(self, protocol: Protocol) -> Floats:
        """Return true template points (K, N, 3) mm at each frame, for commands in mm."""

        def solved(_: Finger, __: float, gravity: Vector, force: Vector, u: Floats) -> Floats:
            places, which = different(u)
            return toured(self.body, gravity, force, places)[which]

        return self.truth.shapes_by(solved, protocol)

    def measure(self, protocol: Protocol, noise_seed: int = 0) -> tuple[Run, Arrays]:
        """Play a protocol in mm; return the run of the hardware, and separately the true arrays.

        `noise_seed` draws the noise of cameras and encoders. The truth: `vertices` (K, N, 3) mm,
        `command` (K, C) mm of the servos, `acting` (K, C) mm effective commands, `gravity` (K, 3)
        g, `t_seen` (K,) s, the template's `rest` (N, 3) mm and `triangles`, and the drawn
        parameters, as JSON. Raises SoftmapError for commands outside the limits of servos or body.
        """
        rng = np.random.default_rng([self.seed, noise_seed, 91])
        ticks = self.servos.to_ticks(protocol.command)
        turned = replace(protocol, command=self.servos.to_mm(ticks))
        vertices = self.shapes(turned)
        clouds = [self.cameras.look(points, self.template.triangles, rng) for points in vertices]
        row = np.searchsorted(protocol.t, protocol.t_seen, side="right") - 1
        run = Run(
            t=protocol.t,
            ticks=ticks,
            present_ticks=ticks + np.rint(ENCODER * rng.normal(size=ticks.shape)).astype(np.int64),
            gravity=protocol.gravity @ rotation((*self.declared_deg, 0.0)).T,
            load=protocol.load,
            temperature=protocol.temperature,
            t_seen=protocol.t_seen,
            points=np.concatenate([np.zeros((0, 3)), *clouds]),
            start=np.concatenate([[0], np.cumsum([len(cloud) for cloud in clouds])]),
            sigma=np.array(self.cameras.sigma_mm),
            block=protocol.block,
            robot=self.finger.name,
            extra={"made_by": np.array(MADE_BY)},
        )
        gravity = protocol.gravity[row]
        for effect in self.truth.hidden:
            gravity = np.array([effect.law.gravity(g) for g in gravity]).reshape(-1, 3)
        truth: Arrays = {
            "schema": np.array(SCHEMA),
            "vertices": vertices,
            "command": replace(self.truth, hidden=()).to_body(turned),
            "acting": self.truth.to_body(turned),
            "gravity": gravity,
            "t_seen": protocol.t_seen,
            "rest": self.template.vertices,
            "triangles": self.template.triangles,
            "drawn": np.array(json.dumps(self.to_dict(), sort_keys=True)),
        }
        return run, truth

    def to_dict(self) -> Document:
        """Return the drawn parameters."""
        return {
            "seed": self.seed,
            "finger": self.finger.name,
            "modulus": self.modulus,
            "phase_deg": self.phase_deg,
            "lean_deg": list(self.lean_deg),
            "declared_deg": list(self.declared_deg),
            "friction": None if self.friction is None else self.friction.params(),
            "hidden": [effect.to_dict() for effect in self.hidden],
        }


def virtual_finger(
    seed: int,
    finger: Finger | None = None,
    hidden: Sequence[str] = (),
    cameras: DepthCameras = CAMERAS,
) -> VirtualFinger:
    """Draw the virtual finger of a seed.

    `finger` is that of the model, by default the built-in one; `hidden` are names of further
    effects (`truth.hide`, with its strengths, whose search takes minutes). Raises SoftmapError for
    an unknown name, a negative seed, or a finger without commands in mm of two servos.
    """
    check_hidden(hidden, seed)
    finger = finger or Finger.builtin()
    channels = len(finger.pairs)
    if channels != len(PUBLISHED.home) or finger.command_unit != "mm":
        raise SoftmapError(
            f"{finger.name}: {channels} commands in {finger.command_unit}; the virtual finger has "
            f"{len(PUBLISHED.home)} servos, each commanded in mm of tendon: give such a finger"
        )
    rng = np.random.default_rng([seed, 90])
    modulus, phase = rng.uniform(*MODULUS), rng.uniform(*PHASE) * rng.choice([-1.0, 1.0])
    lean = _direction(rng) * rng.uniform(0.0, LEAN)
    declared = lean + _direction(rng) * rng.uniform(0.0, MEASURED)
    return VirtualFinger(
        seed=seed,
        finger=finger,
        modulus=float(modulus),
        phase_deg=float(phase),
        lean_deg=(float(lean[0]), float(lean[1])),
        declared_deg=(float(declared[0]), float(declared[1])),
        friction=BoucWen.draw(rng, channels).scaled(FRICTION),
        hidden=hide(hidden, seed, finger=finger).hidden if hidden else (),
        cameras=cameras,
    )


def _direction(rng: np.random.Generator) -> Floats:
    angle = rng.uniform(0.0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def _turned(tendon: Tendon, degrees: float) -> Tendon:
    """Return a tendon turned about z."""
    if not tendon.points:
        return replace(tendon, angle_deg=(tendon.angle_deg + degrees + 180.0) % 360.0 - 180.0)
    x, y, z = (np.array(tendon.points) @ rotation((0.0, 0.0, degrees)).T).T.tolist()
    return replace(tendon, points=tuple(zip(x, y, z)))
