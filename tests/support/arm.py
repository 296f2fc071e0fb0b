"""A small bending arm and seven effects in NumPy, with the face that a diagnosis expects of a model and of the core.

It lets the statistics be proved without the compiled simulator: the arm is an analytic curve, its effects are loops.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np

from softmap_edge import _core
from softmap_edge.geometry.sections import FeatureMap
from softmap_edge.run.run import Run

SECTIONS, LENGTH, RADIUS = 6, 100.0, 10.0


def parameter(name, unit, null, start, low, high, per_channel=False):
    log = low > 0
    return dict(
        name=name, unit=unit, null=null, start=start, low=low, high=high, per_channel=per_channel, doc="", log=log
    )


def entry(name, family, stage, role, kind, parameters):
    return dict(
        name=name, family=family, stage=stage, role=role, formula="", doc="", signature="", reference="the test's own",
        needs=[], kind=kind, parameters=parameters, own=False,
        experiment=REGISTRY[name]["experiment"], alike=REGISTRY[name]["alike"],
    )  # fmt: skip


REGISTRY = {e["name"]: e for e in _core.effects()}

EFFECTS = [
    entry("offset", "actuation map", "command", "channel", "effect", [parameter("shift", "mm", 0, 0.5, -3, 3, True)]),
    entry("gain", "actuation map", "command", "channel", "effect", [parameter("factor", "", 0, 0.05, -0.3, 0.3, True)]),
    entry("latency", "delay", "command", "channel", "effect", [parameter("delay", "s", 0, 0.1, 0, 0.6)]),
    entry(
        "backlash", "reversal hysteresis", "transmission", "channel", "effect",
        [parameter("gap", "mm", 0, 0.5, 0.04, 4)],
    ),  # fmt: skip
    entry(
        "creep", "slow drift", "material", "channel", "effect",
        [parameter("strength", "1", 0, 0.1, 0.01, 0.5), parameter("tau", "s", 10, 10, 1, 100)],
    ),
    entry("payload", "dead load", "shape", "shape", "effect", [parameter("mass", "g", 0, 10, 0, 150)]),
    entry(
        "mount", "sensor frame", "sensing", "sensing", "fault",
        [parameter(n, "mm", 0, 1, -6, 6) for n in ("x", "y", "z")] + [parameter("turn", "rad", 0, 0.02, -0.1, 0.1)],
    ),
]  # fmt: skip


class Chain:
    """Labels and bounds of a list of effects, in the order of the registry."""

    def __init__(self, names, channels):
        self.names = [e["name"] for e in EFFECTS if e["name"] in names]
        rows = []
        for e in EFFECTS:
            if e["name"] not in names:
                continue
            for p in e["parameters"]:
                for c in range(channels) if p["per_channel"] else [None]:
                    rows.append((f"{e['name']}.{p['name']}" + ("" if c is None else f"[{c}]"), p))
        self.labels = self.group_labels = [label for label, _ in rows]
        self.tie = np.arange(len(rows))  # nothing is shared
        self.units = [p["unit"] for _, p in rows]
        for key in ("null", "start", "low", "high"):
            setattr(self, key, np.array([float(p[key]) for _, p in rows]))
        self.half_ranges = self.lengths = np.zeros(len(rows))
        self.log = np.array([p["log"] for _, p in rows], bool)
        self.integer = self.instant = np.zeros(len(rows), bool)

    def rollout(self, params, u, t, gravity=None, load=None, temperature=None):
        """Effective commands (B, T, 2) at full rate of commands (T, 2)."""
        return acted(self.names, params, u, t)


def acted(names, params, u, t):
    """Effective commands (B, T, 2) of commands (T, 2) at full rate, for parameters (B, P)."""
    column = {label: params[:, i] for i, label in enumerate(Chain(names, 2).labels)}
    u = np.broadcast_to(u, (len(params), *u.shape)).copy()
    dt = t[1] - t[0]
    if "offset" in names:
        u = u + np.stack([column["offset.shift[0]"], column["offset.shift[1]"]], axis=1)[:, None]
    if "gain" in names:
        u = u * (1 + np.stack([column["gain.factor[0]"], column["gain.factor[1]"]], axis=1)[:, None])
    if "latency" in names:
        for b, delay in enumerate(column["latency.delay"]):
            for c in range(2):
                u[b, :, c] = np.interp(t - delay, t, u[b, :, c])
    if "backlash" in names:
        half, y = 0.5 * column["backlash.gap"][:, None], u[:, 0].copy()
        for k in range(u.shape[1]):
            y = np.clip(y, u[:, k] - half, u[:, k] + half)
            u[:, k] = y
    if "creep" in names:
        decay = np.exp(-dt / column["creep.tau"])[:, None]
        slow, before = u[:, 0].copy(), u[:, 0].copy()
        for k in range(u.shape[1]):
            slow = decay * slow + (1 - decay) * before
            before = u[:, k].copy()
            u[:, k] = before + column["creep.strength"][:, None] * slow
    return u


LIBRARY = SimpleNamespace(effects=lambda: EFFECTS, Chain=Chain)


def shape(u, load):
    """Features (..., V, 3) of the arm for commands (..., 2) mm; `load` (...,) g sags it along +x."""
    s = (np.arange(SECTIONS) + 0.5) / SECTIONS
    bend = u / (2 * RADIUS)
    angle = np.linalg.norm(bend, axis=-1)[..., None] * s + 1e-9
    unit = bend / (np.linalg.norm(bend, axis=-1)[..., None] + 1e-12)
    side = LENGTH * s * (1 - np.cos(angle)) / angle
    centre = np.stack([unit[..., :1] * side, unit[..., 1:] * side, LENGTH * s * np.sin(angle) / angle], axis=-1)
    sag = 0.05 * load[..., None] * s**2
    centre[..., 0] += sag * np.cos(0.7 * angle)
    centre[..., 2] -= 0.5 * sag * np.sin(0.7 * angle) * unit[..., :1]
    return centre


@dataclass(frozen=True)
class Arm:
    """A model of the arm; `warp` (V, 3) mm adds a smooth static error over commands, for truths only."""

    form: float = 0.15
    chain_names: tuple[str, ...] = ()
    chain_params: np.ndarray = field(default_factory=lambda: np.zeros(0))
    kind: str = "table"
    channels: int = 2
    robot: str = "arm"
    output: object = None

    def with_effects(self, names, params):
        labels = Chain(names, 2).labels
        return replace(self, chain_names=tuple(names), chain_params=np.array([params[label] for label in labels]))

    def missing_for(self, name):
        return []

    def commands(self, run):
        return run.command

    def seen_features(self, run):
        return run.features

    def run_feature_map(self, run):
        return FeatureMap(np.eye(SECTIONS), np.ones(SECTIONS, bool), np.arange(SECTIONS))

    def run_leaning(self, run):
        return np.ones((len(run.t_seen), 1))

    def run_form_error(self, run):
        return np.full((SECTIONS, 3), self.form)

    def predict_features(self, names, params, run):
        return self.seen_at(self.acting(names, params, run), names, params)

    def features_at(self, effective, run):
        """Features (K, V, 3) of the bare arm at effective commands (K, 2)."""
        return shape(effective, np.zeros(len(effective)))

    def slopes_at(self, effective, step, run):
        moved = [np.where(np.arange(2) == c, h, 0.0) for c, h in enumerate(step)]
        return np.stack(
            [(self.features_at(effective + m, run) - self.features_at(effective - m, run)) / (2 * h)
             for m, h in zip(moved, step)]
        )  # fmt: skip

    def acting(self, names, params, run):
        """Effective commands (B, K, 2) at the seen times, between samples on a straight line."""
        u = acted(names, params, run.command, run.t)
        rows = [[np.interp(run.t_seen, run.t, column) for column in one.T] for one in u]
        return np.moveaxis(np.array(rows), 1, 2)

    def seen_at(self, u, names, params):
        column = {label: params[:, i] for i, label in enumerate(Chain(names, 2).labels)}
        mass = column.get("payload.mass", np.zeros(len(params)))
        seen = shape(u, np.broadcast_to(mass[:, None], u.shape[:2]))
        if "mount" in names:
            move = np.stack([column[f"mount.{n}"] for n in "xyz"], axis=1)
            turned = seen.copy()
            turned[..., 0] += column["mount.turn"][:, None, None] * seen[..., 2]
            seen = turned + move[:, None, None]
        return seen


def protocol(rng=None, minutes=4.0):
    """Triangles of growing size, loops at offsets, fast moves and dwells with home revisits: t (T,), u (T, 2)."""
    dt, u = 0.1, []
    points = [(0, 0, 6), (8, 0, 4), (8, 0, 8), (-8, 0, 6), (0, 0, 3), (0, 0, 5), (0, 8, 3), (0, -8, 5), (0, 0, 3)]
    points += [(0, 0, 5), (4, 4, 2), (4, 4, 6), (-4, -4, 2), (6, -6, 2), (6, -6, 6), (3, -3, 1), (5, -5, 1)]
    points += [
        (0, 0, 3),
        (0, 0, 5),
        (10, 0, 1.2),
        (-10, 0, 1.2),
        (10, 0, 1.2),
        (0, 0, 1.2),
        (0, 10, 1.2),
        (0, -10, 1.2),
    ]
    points += [(0, 0, 1.2), (0, 0, 6), (5, 7, 2), (5, 7, 8), (-6, 3, 2), (-6, 3, 6), (0, 0, 2), (0, 0, 6)]
    if rng is not None:
        points = [(float(rng.uniform(-9, 9)), float(rng.uniform(-9, 9)), float(rng.uniform(1, 6))) for _ in range(30)]
    while len(u) * dt < 60 * minutes:
        for x, y, seconds in points:
            last = np.array(u[-1] if u else (0.0, 0.0))
            steps = int(seconds / dt)
            u += [last + (np.array((x, y)) - last) * (k + 1) / steps for k in range(steps)]
    u = np.array(u[: int(60 * minutes / dt)], float)
    t = np.arange(len(u)) * dt
    return t, u


class Recording(SimpleNamespace):
    """What a diagnosis uses of a run, with the features themselves in place of vertices."""

    hash = Run.hash
    output, timeless, frame_sigma, extra = None, False, None, {}

    @property
    def frames(self):
        return len(self.t_seen)

    def at(self, rows):
        """Return the run with some of its frames."""
        kept = {name: getattr(self, name) for name in ("t_seen", "block", "features")}
        return Recording(**vars(self) | {name: a if a is None else np.asarray(a)[rows] for name, a in kept.items()})

    def arrays(self):
        return {name: np.asarray(value) for name, value in vars(self).items() if value is not None}


def record_run(hidden=None, seed=0, noise=0.15, warp=0.1, t=None, u=None, frames=350, moving=True, other=False):
    """Return a run of the arm with hidden effects `{label: value}`, camera noise and a smooth static error."""
    rng = np.random.default_rng(seed)
    if t is None:
        t, u = protocol(np.random.default_rng(seed + 77) if other else None)
    t_seen = np.linspace(t[0] + 0.1, t[-1], frames) if moving is True else np.asarray(moving, float)
    nothing = dict.fromkeys(("gravity", "load", "temperature", "block", "features", "vertices"))
    run = Recording(t=t, command=u, t_seen=t_seen, **nothing)
    hidden = hidden or {}
    names = tuple({label.split(".")[0] for label in hidden})
    arm = Arm().with_effects(names, dict(zip(Chain(names, 2).labels, Chain(names, 2).null)) | hidden)
    clean = arm.predict_features(arm.chain_names, arm.chain_params[None], run)[0]
    index = np.searchsorted(t, t_seen, side="right") - 1
    phase = u[index] / 8.0
    body = (np.arange(SECTIONS) + 1) / SECTIONS
    draw = rng.normal(size=(3, 4))
    static = (
        draw[:, 0] * np.sin(phase[:, :1]) + draw[:, 1] * np.cos(phase[:, 1:]) + draw[:, 2] * phase[:, :1] * phase[:, 1:]
    )
    run.features = clean + warp * body[:, None] * static[:, None, :] + noise * rng.normal(size=clean.shape)
    return run
