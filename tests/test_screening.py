"""Screening: what one step promises is what a fit keeps, and whole numbers are all looked at."""

import numpy as np
import pytest
from arm import LIBRARY, Arm, record_run

from softmap_edge import _core, builtin_model
from softmap_edge.diagnosis.prepare import problem_of
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.screening import Screening
from softmap_edge.protocol import standard_protocol
from softmap_edge.run import Run

NAMES = [e["name"] for e in LIBRARY.effects()]


def screening_of(problem, library):
    return Screening(problem, library.effects())


@pytest.mark.parametrize(
    "hidden",
    [{"offset.shift[0]": 0.8}, {"gain.factor[0]": 0.1}, {"latency.delay": 0.2}, {"backlash.gap": 1.0},
     {"creep.strength": 0.12}, {"payload.mass": 40.0}, {"mount.x": 2.0}],
    ids=lambda hidden: next(iter(hidden)).split(".")[0],
)  # fmt: skip
def test_the_hidden_effect_promises_most(hidden):
    problem = problem_of(Record(Arm(), record_run(hidden, noise=0.05, warp=0.0), LIBRARY), NAMES)
    null = problem.null()
    (promised, name, points), *_ = screening_of(problem, LIBRARY).best(null, NAMES, 3)
    assert name == next(iter(hidden)).split(".")[0]
    kept = problem.fit((name,), points[:1]).cost
    assert null.cost - promised > 0.8 * (null.cost - kept)
    modes = problem.at(problem.space((name,)), points[0][None])
    assert promised == pytest.approx(float(problem.costs(modes, points[0][None])[0][0]))


@pytest.mark.parametrize(
    ("first", "second"),
    [("backlash.gap", "creep.strength"), ("payload.mass", "latency.delay"), ("gain.factor[0]", "mount.x"),
     ("creep.strength", "payload.mass")],
)  # fmt: skip
def test_behind_a_fit_the_other_hidden_effect_promises_most(first, second):
    """What was seen of it on the model alone ranks it high enough to be looked at again."""
    hidden = {"backlash.gap": 2.0, "creep.strength": 0.12, "payload.mass": 40.0, "latency.delay": 0.25,
              "gain.factor[0]": 0.15, "mount.x": 2.0}  # fmt: skip
    run = record_run({label: hidden[label] for label in (first, second)}, noise=0.05, warp=0.0)
    problem = problem_of(Record(Arm(), run, LIBRARY), NAMES)
    screening, null = screening_of(problem, LIBRARY), problem.null()
    one, other = (label.split(".")[0] for label in (first, second))
    points = next(points for _, name, points in screening.best(null, NAMES, len(NAMES)) if name == one)
    parent = problem.fit((one,), points[:1])
    others = [name for name in NAMES if name != one]
    assert other in screening._promising(parent, others, 3, 0.0)[:3]
    assert screening.best(parent, others, 1)[0][1] == other
    assert not set(screening._promising(parent, others, 3, 1.1 * parent.cost)) & {other}  # more than there is to win


def test_every_wiring_is_looked_at():
    protocol, model = standard_protocol(), builtin_model()
    blank = np.repeat(model.rest[None], protocol.frames, axis=0)
    run = Run(protocol.t, protocol.command, protocol.t_seen, vertices=blank, gravity=protocol.gravity)
    problem = problem_of(Record(model, run), ["servo_swap"])
    screening = screening_of(problem, _core)
    space = problem.space(("servo_swap",))
    ways = {int(space.values(start)[0]) for start in screening.starts("servo_swap")}
    assert ways == {1, 2, 3}  # a sign of either channel, and the two exchanged


def test_a_limit_that_is_hardly_reached_is_found():
    """From the declared start of 8 mm every step is worse than nothing; nearer to no limit at all one is not."""
    protocol, model = standard_protocol(), builtin_model()
    rest = np.broadcast_to(model.rest, (protocol.frames, *model.rest.shape))
    most = 0.93 * np.abs(protocol.command).max()
    acting = Run(protocol.t, np.clip(protocol.command, -most, most), protocol.t_seen, vertices=rest)
    points = model.predict(acting) + 0.2 * np.random.default_rng(0).normal(size=rest.shape)
    run = Run(protocol.t, protocol.command, protocol.t_seen, vertices=points)
    names = ["saturation", "gain", "mullins", "friction"]
    problem = problem_of(Record(model, run), names)
    promised, name, starts = screening_of(problem, _core).best(problem.null(), names, 4)[0]
    assert name == "saturation" and promised < 0.5 * problem.null().cost
    assert problem.space((name,)).values(starts[0]) == pytest.approx(most, rel=0.1)
