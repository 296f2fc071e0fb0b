"""Evidence of a finished search: bounds, equivalent effects, unexplained error, probabilities, the
static baseline.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from softmap_edge.diagnosis.decision import ODDS_BASE, ODDS_DOUBT
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.diagnosis.evidence import (
    _static,
    at_bound,
    equivalents,
    not_testable,
    typical_difference,
    unexplained_structure,
)
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.prepare import problem_of
from softmap_edge.diagnosis.record import Record
from softmap_edge.model.bundle import builtin_model
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.run.run import Run

FEW = ["gain", "latency", "clock_shift", "backlash", "creep", "mount"]


def run_of(acting, noise=0.25):
    """A run of the built-in finger with another effective command."""
    shown, model = standard_protocol(2), builtin_model()
    rest = np.broadcast_to(model.rest, (shown.frames, *model.rest.shape))
    run = Run(
        shown.t,
        shown.command,
        shown.t_seen,
        vertices=rest,
        gravity=shown.gravity,
        robot=model.robot,
    )
    points = model.predict(replace(run, command=acting(shown.command)))
    return replace(
        run, vertices=points + noise * np.random.default_rng(0).normal(size=points.shape)
    )


def fits_of(acting, effects=FEW, noise=0.25):
    return Fits(problem_of(Record(builtin_model(), run_of(acting, noise)), effects), effects)


def test_what_is_left_is_what_is_beyond_the_noise_and_what_predicts_it():
    fits = fits_of(lambda u: 1.12 * u, ["gain"])
    problem, record = fits.problem, fits.problem.record
    none = unexplained_structure(problem, record.seen - fits.get(["gain"]).predicted, 2)
    whole = unexplained_structure(problem, record.seen - fits.null.predicted, 0)
    assert (
        none.rms_mm < 0.1
        and none.chi2_per_n == pytest.approx(1.0, abs=0.15)
        and none.predicted_by is None
    )
    noise = problem.noise.rms_mm(record.positions)
    assert whole.rms_mm == pytest.approx(
        np.sqrt(record.rms_mm(record.seen - fits.null.predicted) ** 2 - noise**2)
    )
    assert whole.rms_mm > 1.0 and whole.predicted_by == "command" and whole.blocked_r2 > 0.2


def test_ends_by_nature_are_no_bounds():
    problem = fits_of(lambda u: u, ["anchor_slip"]).problem
    space = problem.space(("anchor_slip",))
    taut = space.free_labels.index("anchor_slip.taut")
    fit = problem.fit(("anchor_slip",), [space.start])
    for end in (space.low, space.high):
        x = space.start.copy()
        x[taut] = end[taut]
        assert not at_bound(replace(fit, x=x)).any()
    x[0] = space.high[0]
    assert at_bound(replace(fit, x=x))[0]


def test_an_effect_that_does_nothing_here_cannot_be_tested():
    """Delays show while the robot moves; a run of long dwells hides them, and fitted effects are
    not tested again.
    """
    fits = fits_of(lambda u: 1.12 * u, ["gain", "latency"])
    assert not_testable(fits, fits.null) == []
    still = run_of(lambda u: u)
    still = replace(still, command=np.tile([3.0, 2.0], (len(still.t), 1)))
    frozen = Fits(
        problem_of(Record(builtin_model(), still), ["gain", "latency"]), ["gain", "latency"]
    )
    hidden = {row.name: row for row in not_testable(frozen, frozen.null)}
    assert "too weak to detect" in hidden["latency"].why and hidden["latency"].minutes > 0.0
    record = fits.problem.record
    assert all(
        record.rms_mm(typical_difference(fits.problem, name)) > 1.0 for name in ("gain", "latency")
    )


def test_what_no_other_effect_explains_is_claimed():
    found = diagnose(
        builtin_model(),
        run_of(lambda u: u + 1.2 * np.sin(1.5 * u[:, ::-1])),
        effects=["gain", "backlash"],
    )
    assert found.verdict == "partly_explained" and found.effects == ()
    silent = diagnose(builtin_model(), run_of(lambda u: u), effects=["gain", "backlash"])
    assert silent.verdict in ("nothing", "cannot_tell")


def test_a_name_is_as_sure_as_what_could_stand_in_its_place():
    """A delay of the command and a late camera are one answer to one question, whichever fits
    better.
    """
    late = lambda u: np.concatenate([np.tile(u[:1], (8, 1)), u])[: len(u)]  # noqa: E731
    found = diagnose(builtin_model(), run_of(late), effects=FEW)
    assert [e.name for e in found.effects] == ["latency"] and ("clock_shift",) in [
        a.effects for a in found.alternatives
    ]
    others = len(found.alternatives)
    assert found.effects[0].probability == pytest.approx(1 / (1 + ODDS_BASE + ODDS_DOUBT * others))


def test_what_is_alike_by_form_is_no_alternative_where_it_leaves_twice_as_much():
    """Coupled channels and turned tendons are declared alike; shear in one direction only is no
    turn.
    """
    sheared = lambda u: u + 0.2 * np.stack([u[:, 1], 0.0 * u[:, 0]], axis=1)  # noqa: E731
    found = diagnose(
        builtin_model(), run_of(sheared), effects=["coupling", "routing", "gain", "mount"]
    )
    assert (
        [e.name for e in found.effects] == ["coupling"]
        and found.verdict == "identified"
        and not found.alternatives
    )


def test_an_orientation_that_no_frame_shows_is_none():
    hanging, leaning = np.tile([0.0, 0.0, 1.0], (9, 1)), np.tile([0.6, 0.0, 0.8], (9, 1))
    alone = SimpleNamespace(
        state=SimpleNamespace(gravity=hanging),
        gravity=np.vstack([hanging, leaning]),
        load=None,
        roll_seen=True,
    )
    assert "gravity" in equivalents(alone, "payload")
    both = SimpleNamespace(
        state=SimpleNamespace(gravity=np.vstack([hanging, leaning])), load=None, roll_seen=True
    )
    assert "gravity" not in equivalents(both, "payload")


def test_a_static_residual_is_trained_where_a_feature_is_seen():
    """A marker that is hidden in most frames errs by as much there as in others, and not by
    nothing.
    """

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
