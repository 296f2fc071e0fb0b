"""What a finished search is worth: which set stands, what may be left of it, how sure a name is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from softmap_edge import _core
from softmap_edge.bundle import builtin_model
from softmap_edge.diagnosis.conclusion import RIVAL, TEMPERATURE
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.diagnosis.evidence import (
    BEYOND,
    FORMS,
    LEFT,
    NOISE,
    _static,
    allowed,
    at_bound,
    equivalents,
    leftover,
)
from softmap_edge.diagnosis.prepare import problem_of
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.search import CV_FALL, CV_FOLDS, SIMPLER, Search
from softmap_edge.protocol import standard_protocol
from softmap_edge.run import Run

FEW = ["gain", "latency", "clock_shift", "backlash", "creep", "mount"]


def searched(acting, effects=FEW, noise=0.25):
    """A search, not yet run, on a run of the built-in finger on which another command acts."""
    shown, model = standard_protocol(2), builtin_model()
    rest = np.broadcast_to(model.rest, (shown.frames, *model.rest.shape))
    run = Run(shown.t, shown.command, shown.t_seen, vertices=rest, gravity=shown.gravity, robot=model.robot)
    points = model.predict(Run(shown.t, acting(shown.command), shown.t_seen, vertices=rest, gravity=shown.gravity))
    points = points + noise * np.random.default_rng(0).normal(size=points.shape)
    run = Run(shown.t, shown.command, shown.t_seen, vertices=points, gravity=shown.gravity, robot=model.robot)
    return Search(problem_of(Record(model, run), effects), effects), run


def test_what_is_left_is_measured_against_the_form_of_what_is_found():
    """The same leftover is a claim beside nothing, and none beside an effect that explains ten times as much."""
    search, _ = searched(lambda u: 1.12 * u + 0.2 * np.sin(1.7 * u))
    found = search.get(("gain",))
    record = search.problem.record
    own = np.hypot(record.form_mm, NOISE * search.problem.noise.rms_mm(record.positions))
    assert allowed(search, search.null) == pytest.approx(own)
    expected = np.hypot(own, FORMS["channel"] * record.rms_mm(search.displacement(found, "gain")))
    assert allowed(search, found) == pytest.approx(expected, rel=0.02)
    left = leftover(search, found)
    assert not left.claim and left.rms_mm > LEFT * own
    assert leftover(search, search.null).claim


def test_beyond_a_bound_nobody_is_missing():
    """A servo that is mounted 6.5 mm off: an offset at its bound of 4 mm leaves the rest itself."""
    search, _ = searched(lambda u: u + [6.5, 0.0], ["offset", "gain"])
    found = search.problem.fit(("offset",), [np.array([1.0, 0.0])])
    left = leftover(search, found)
    moved = search.problem.record.rms_mm(search.displacement(found, "offset"))
    assert found.params["offset.shift[0]"] == pytest.approx(4.0) and left.rms_mm > 3 * FORMS["channel"] * moved
    assert left.rms_mm > LEFT * allowed(search, found) and not left.claim  # 6.5 mm leave nothing
    search.problem.beyond = lambda fit, *_: fit
    assert leftover(search, found).claim


def test_a_sine_beyond_its_bound_is_no_pulley_any_more():
    """A gain of a half without its name: a pulley four times as eccentric as may be would do, and is not believed."""
    search, _ = searched(lambda u: 1.5 * u, ["eccentric_pulley"])
    found = search.problem.fit(("eccentric_pulley",), search.screening.starts("eccentric_pulley"))
    assert at_bound(found).any() and leftover(search, found).claim


def test_ends_by_nature_are_no_bounds():
    search, _ = searched(lambda u: u, ["anchor_slip"])
    space = search.problem.space(("anchor_slip",))
    taut = space.free_labels.index("anchor_slip.taut")
    fit = search.problem.fit(("anchor_slip",), [space.start])
    for end in (space.low, space.high):
        x = space.start.copy()
        x[taut] = end[taut]
        assert not at_bound(replace(fit, x=x)).any()
    x[0] = space.high[0]
    assert at_bound(replace(fit, x=x))[0]


def test_a_field_at_its_bound_may_leave_much_of_what_it_moves():
    search, _ = searched(lambda u: 2.5 * u, ["stiffness_gradient"])
    found = search.problem.fit(("stiffness_gradient",), [np.array([1.0])])
    moved = search.problem.record.rms_mm(search.displacement(found, "stiffness_gradient"))
    within = replace(found, x=0.5 * found.x)
    assert abs(found.x[0]) == 1.0 and allowed(search, found) > BEYOND * moved
    assert allowed(search, within) < BEYOND * moved


def test_what_nobody_explains_is_claimed():
    search, _ = searched(lambda u: u + 1.2 * np.sin(1.5 * u[:, ::-1]), ["gain", "backlash"])
    assert leftover(search, search.run()).claim


def test_fewer_effects_that_come_nearer_stand_for_more():
    """The objective may like two effects better that leave more mm than one alone; nobody else would."""

    def fit(*effects, left):
        return SimpleNamespace(effects=effects, predicted=np.full((4, 3), left))

    search = object.__new__(Search)
    record = SimpleNamespace(seen=np.zeros((4, 3)), rms_mm=lambda d: float(np.abs(d).mean()))
    search.problem = SimpleNamespace(record=record)
    search.held_out_mm = lambda f: float(np.abs(f.predicted).mean())
    search.valid = lambda f: f.effects != ("creep",)
    pair, one = fit("mount", "gravity", left=0.6), fit("offset", left=0.3)
    others = [fit(left=0.9), fit("creep", left=0.1), fit("gain", left=0.59), fit("mount", "offset", left=0.2)]
    search._fits = {frozenset(f.effects): f for f in [pair, one, *others]}
    assert search._undominated(pair) is one  # nothing invalid, nothing as large, and never nothing at all
    assert search._undominated(one) is one
    del search._fits[frozenset(("offset",))]
    assert SIMPLER * 0.6 < 0.59 and search._undominated(pair) is pair  # hardly nearer is no reason


def judged(other, share, moved=0.6):
    """Whether a second effect counts beside `other`, which moves the body by 1.5 mm."""
    search = object.__new__(Search)
    families = {"kink": "body stiffness", "friction": "play", "payload": "dead load"}
    search.faults, search.screening = set(), SimpleNamespace(families=families)
    search.get, search.dispersion, search.penalty = (
        (lambda _: SimpleNamespace(cost=100.0)),
        (lambda _: 1.0),
        (lambda _: 0.0),
    )
    search._cv_fall, search._least_mm, search.share = (lambda *_: (0.1, 1.0)), (lambda _: 0.12), (lambda *_: share)
    search.displacement = lambda _, effect: 1.5 if effect == other else moved
    search.problem = SimpleNamespace(record=SimpleNamespace(rms_mm=float))
    return search.accepts(SimpleNamespace(effects=(other, "gravity"), cost=50.0), "gravity")


def test_beside_a_linear_field_a_second_effect_carries_more():
    """Fields of stiffness are linear: where they are strong, a tenth of the misfit may be their own."""
    assert judged("friction", 0.06) and not judged("kink", 0.06) and judged("kink", 0.12)
    assert judged("friction", 0.12, 0.4) and judged("payload", 0.06, 0.4) and not judged("kink", 0.12, 0.4)


def test_a_block_that_does_not_show_an_effect_speaks_for_neither_side():
    """Four blocks of one channel alone, in which nothing is coupled, do not outvote four that need the coupling."""

    def accepted(*after):
        search = object.__new__(Search)
        losses = {"rest": np.full(8, 100.0), "fit": np.array(after)}
        search.cv = lambda fit: (losses[fit], losses[fit], None)
        fall, folds = search._cv_fall("rest", "fit")
        return fall >= CV_FALL and folds >= CV_FOLDS

    assert accepted(103.0, 59.0, 35.0, 102.0, 101.0, 48.0, 35.0, 100.0)
    assert not accepted(109.0, 59.0, 35.0, 108.0, 107.0, 48.0, 35.0, 106.0)  # it does harm there
    assert not accepted(103.0, 59.0, 100.0, 102.0, 101.0, 99.5, 100.0, 100.0)  # one block is no evidence
    assert not accepted(20.0, 59.0, 108.0, 107.0, 101.0, 99.5, 100.0, 100.0)  # two fall, two rise
    assert accepted(98.0, 98.0, 98.0, 98.0, 98.0, 100.0, 100.0, 100.0)


def test_effects_that_undo_each_other_explain_nothing():
    search = object.__new__(Search)
    search.null = SimpleNamespace(predicted=np.zeros(3))
    search.problem = SimpleNamespace(record=SimpleNamespace(rms_mm=lambda d: float(np.abs(d).max())))
    search._least_mm, search.accepts = (lambda _: 0.2), (lambda *_: True)
    assert search.valid(SimpleNamespace(effects=("offset", "gravity"), predicted=np.full(3, 0.3)))
    assert not search.valid(SimpleNamespace(effects=("offset", "gravity"), predicted=np.full(3, 0.1)))


def test_a_name_is_as_sure_as_what_could_stand_in_its_place():
    """A delay of the command and a late camera are one answer to one question, whichever fits better."""
    late = lambda u: np.concatenate([np.tile(u[:1], (8, 1)), u])[: len(u)]  # noqa: E731
    found = diagnose(builtin_model(), searched(late)[1], effects=FEW)
    assert [e.name for e in found.effects] == ["latency"] and list(found.alternatives[0].effects) == ["clock_shift"]
    assert found.effects[0].probability == pytest.approx(1 / (1 + RIVAL), abs=0.02)
    assert found.made_from["temperature"] == TEMPERATURE


def test_what_is_alike_by_form_is_no_rival_where_it_leaves_twice_as_much():
    """Coupled channels and turned tendons are declared alike; shear in one direction only is no turn."""
    sheared = lambda u: u + 0.2 * np.stack([u[:, 1], 0.0 * u[:, 0]], axis=1)  # noqa: E731
    found = diagnose(builtin_model(), searched(sheared)[1], effects=["coupling", "routing", "gain", "mount"])
    assert [e.name for e in found.effects] == ["coupling"] and found.verdict == "identified" and not found.alternatives


def test_an_orientation_that_no_frame_shows_is_none():
    hanging, leaning = np.tile([0.0, 0.0, 1.0], (9, 1)), np.tile([0.6, 0.0, 0.8], (9, 1))
    registry = {e["name"]: e for e in _core.effects()}
    alone = SimpleNamespace(
        state=SimpleNamespace(gravity=hanging), gravity=np.vstack([hanging, leaning]), load=None, roll_seen=True
    )
    assert "gravity" in equivalents(alone, "payload", registry)
    both = SimpleNamespace(state=SimpleNamespace(gravity=np.vstack([hanging, leaning])), load=None, roll_seen=True)
    assert "gravity" not in equivalents(both, "payload", registry)


def test_a_static_residual_is_trained_where_a_feature_is_seen():
    """A marker that is hidden in most frames errs by as much there as elsewhere, and not by nothing."""

    class Some(SimpleNamespace):
        __len__ = lambda self: len(self.command)  # noqa: E731

    rng = np.random.default_rng(0)
    u = rng.uniform(-8, 8, (300, 2))
    record = Some(command=u, spread=np.array([5.0, 5.0]))
    truth = np.stack([0.1 * u[:, 0] + 1.0, 0.02 * u[:, 0] * u[:, 1], np.full(300, 0.5)], axis=1)
    dark = truth.copy()
    dark[rng.permutation(300)[:220], 1] = dark[:, 2] = np.nan
    found = _static(record, record, dark, np.arange(300))
    assert np.abs(found - truth)[:, 0].max() < 0.1 and np.abs(found - truth)[:, 1].max() < 0.15
    assert np.all(found[:, 2] == 0.0)
