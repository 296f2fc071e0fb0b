"""Markers on a base and a body, as a camera films them."""

import numpy as np

from softmap_edge import Run, builtin_model
from softmap_edge.geometry.rigid import RigidPose, rotation
from softmap_edge.run.protocol import standard_protocol

DEGREES = np.r_[np.full(3, np.degrees(1.0)), np.ones(3)]


# camera → base
CAMERA = RigidPose(rotation(np.array([0.4, -2.0, 1.1])), np.array([300.0, -120.0, 900.0]))


SIDES = np.array(
    [
        [r * np.cos(a), r * np.sin(a), z]
        for r, z in ((15, 8), (13, 45), (11, 80), (9, 110))
        for a in (0, 2, 4)
    ]
)


BASE = np.array([[40.0, 0, 0], [-40, 10, 0], [0, 40, 5], [5, -35, -3]])


def visits_of_home(count=6, play=0.0, rng=None):
    """Commands that go home `count` times: t (T,), u (T, 2); `play` mm misses home at each visit,
    in what moves.
    """
    t, corners, real = [0.0], [np.zeros(2)], [np.zeros(2)]
    for k in range(count):
        off = np.zeros(2) if rng is None else play * rng.normal(size=2)
        real[-1] = off if k == 0 else real[-1]
        for target, miss, seconds in (
            (np.zeros(2), off, 1.0),
            (np.zeros(2), off, 4.0),
            (np.array([6.0, -4.0]), 0.0, 1.0),
        ):
            t.append(t[-1] + seconds)
            corners.append(target)
            real.append(target + miss)
    grid = np.arange(0, t[-1] - 1.0, 0.05)
    return grid, *(
        np.stack([np.interp(grid, t, np.array(c)[:, i]) for i in range(2)], axis=1)
        for c in (corners, real)
    )


def marked(
    seed=0, noise=0.2, play=0.15, hidden=0.0, wrong=0.0, visits=6, turns=None, rest=SIDES, base=()
):
    """A run of the built-in finger with markers, in the camera's frame: six visits of home that
    never are quite one.

    `hidden`, `wrong`: shares of markers that are unseen, or up to 60 mm off. `turns` (K,) → pose of
    the base (small). `base`: places of markers on the base, which stand first in the run.
    """
    rng = np.random.default_rng(seed)
    t, u, real = visits_of_home(visits, play, rng)
    record = {"t": t, "t_seen": t[::4], "robot": builtin_model().robot, "marker_rest": rest}
    blank = np.repeat(rest[None], len(t[::4]), axis=0)
    truth = builtin_model().predict(Run(command=real, markers=blank, **record))
    base = np.reshape(base, (-1, 3))
    truth = np.concatenate([np.broadcast_to(base, (len(truth), len(base), 3)), truth], axis=1)
    record["marker_rest"] = np.concatenate([base, rest])
    if turns is not None:
        small = turns(t[::4])
        truth = RigidPose(rotation(small[:, :3]), small[:, 3:])(truth)
    seen = CAMERA.inverse()(truth) + noise * rng.normal(size=truth.shape)
    bad = rng.random(seen.shape[:2]) < wrong
    seen[bad] += rng.uniform(-60, 60, size=(int(bad.sum()), 3))
    visible = rng.random(seen.shape[:2]) >= hidden
    seen[~visible] = np.nan
    return Run(command=u, markers=seen, visible=visible, **record)


def off(found):
    """How far a transform is from the true one: (6,) deg and mm."""
    return found.pose.after(CAMERA.inverse()).vector() * DEGREES


def film():
    """A vertex run of the standard protocol with camera jitter, in the base frame and in the
    camera's.
    """
    from softmap_edge.synthetic.finger import Camera

    model, p = builtin_model(), standard_protocol()
    record = {
        "t": p.t,
        "command": p.command,
        "gravity": p.gravity,
        "t_seen": p.t_seen,
        "robot": builtin_model().robot,
    }
    blank = np.repeat(model.rest[None], p.frames, axis=0)
    played = model.with_effects(("backlash",), {"backlash.gap": 2.0})
    seen = Camera().look(
        played.predict(Run(**record, vertices=blank)), p.t_seen, np.random.default_rng(4)
    )
    return Run(**record, vertices=seen), Run(**record, vertices=CAMERA.inverse()(seen))


def changed(run, **fields):
    known = {k: v for k, v in run.arrays().items() if k not in run.extra}
    return Run(
        **{
            **known,
            "robot": builtin_model().robot,
            "command_unit": "mm",
            "extra": run.extra,
            **fields,
        }
    )
