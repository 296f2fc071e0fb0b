"""The rules of decision: comparisons of held-out losses, and for each constant a case that fails if
it is changed much.

Losses are given as rows of folds, so that each rule is easy to read. The cases at the end run a
complete diagnosis of the built-in finger, once with the constant unchanged and once with it
changed.
"""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from finger_runs import finger_run
from two_levels import judged, law

from softmap_edge import builtin_model, diagnose
from softmap_edge.diagnosis import acceptance, conclusion, decision, search, wording
from softmap_edge.diagnosis.decision import (
    clears,
    difference,
    form_of,
    leaves_cause,
    near,
    reaches,
    seen_to_fall,
)
from softmap_edge.diagnosis.findings import Alternative, Number


def folds(*values):
    return np.array(values, float)


FLAT = np.full(8, 100.0)


# --- comparisons --------------------------------------------------------------------------------


def test_a_difference_is_paired_fold_by_fold():
    """A fold that is hard for both hypotheses adds nothing to the error."""
    before, after = folds(110, 1010, 60), folds(100, 1000, 50)
    found = difference(before, after)
    assert (found.fall, found.error, found.share) == (30.0, 0.0, 1.0)
    spread = difference(folds(10, 30), folds(0, 0))
    assert spread.fall == 40.0 and spread.error == pytest.approx(np.sqrt(200.0) * np.sqrt(2.0))
    assert difference(folds(5.0), folds(1.0)).error == np.inf  # one fold is no evidence
    same = difference(FLAT, FLAT)
    assert (same.fall, same.error, same.share) == (0.0, 0.0, 0.0)


def test_a_fold_that_does_not_show_an_effect_speaks_for_neither_side():
    """Four blocks of one channel alone, without coupling, do not outvote four blocks that need the
    coupling.
    """

    def seen(*after):
        return seen_to_fall(difference(FLAT, folds(*after)))

    assert seen(101, 59, 35, 100, 101, 48, 35, 100)
    assert difference(FLAT, folds(101, 59, 35, 100, 101, 48, 35, 100)).share == 1.0
    assert not seen(20, 130, 130, 130, 100, 100, 100, 100)  # one falls, three rise
    assert not seen(101, 101, 102, 101, 100, 103, 101, 100)  # it is worse everywhere
    assert seen(99, 99, 99, 99, 98, 99, 98, 99)
    assert not seen(*FLAT)


def test_a_rare_event_counts_by_the_folds_that_show_it():
    """A single event affects one fold or two: its fall is within one standard error, but no fold
    rises.
    """
    once = difference(FLAT, folds(10, 100, 100, 100, 100, 100, 100, 100))
    assert once.fall <= once.error and once.share == 1.0 and seen_to_fall(once)
    twice = difference(FLAT, folds(10, 190, 100, 100, 100, 100, 100, 100))
    assert not seen_to_fall(twice)


def test_near_is_within_the_form_or_within_the_scatter_that_folds_do_not_agree_on():
    null, best = FLAT, np.full(8, 50.0)
    assert near(best, best, null) and near(best + 1.0, best, null)  # 8 of 400 behind
    assert not near(best + 10.0, best, null)  # 80 behind, in every fold
    scattered = best + folds(-10, -10, -10, 50, 0, 0, 0, 20)
    assert near(scattered, best, null)  # 40 behind, less than its error, and ahead in three folds
    agreed = best + folds(5, 5, 5, 5, 5, 5, 50, -30)
    assert difference(agreed, best).error > 50.0 and not near(
        agreed, best, null
    )  # as near, but behind in seven of eight


def test_a_law_reaches_within_one_standard_error_or_its_form():
    best = np.full(8, 20.0)
    assert (
        reaches(best, best, 640.0)
        and reaches(best * 1.09, best, 640.0)
        and not reaches(best * 1.4, best, 640.0)
    )
    assert reaches(best * 1.4, best, 640.0, form=0.11)
    assert reaches(folds(10, 30, 10, 60, 20, 20, 20, 20), best, 640.0)
    assert reaches(best * 0.5, best, 640.0)  # a lower loss reaches


def test_what_leaves_more_than_noise_is_no_equal_of_what_leaves_noise():
    noise = np.full(8, 10.0)
    assert leaves_cause(noise * 1.4, noise, 80.0) and leaves_cause(noise * 1.4, noise, 70.0)
    assert not leaves_cause(noise * 1.2, noise, 80.0)  # noise may be as large
    # the best leaves more than noise, too: both forms may be off
    assert not leaves_cause(noise * 1.4, noise, 50.0)
    assert leaves_cause(noise * 0.5, noise * 0.1, 80.0)  # the noise is smaller than stated


def test_a_law_that_leaves_noise_is_seen_to_leave_less_than_free_columns():
    noise, scatter = np.full(8, 10.0), np.array([1.0, 3.0, 1.0, 2.0, 1.0, 2.0, 3.0, 1.0])
    assert clears(noise, noise + scatter, 80.0) and clears(noise, noise + scatter, 70.0)
    assert not clears(noise, noise + scatter, 50.0)  # the law itself leaves more than noise
    assert not clears(noise, noise + scatter * [1, -1, 1, -1, 1, -1, 1, -1], 80.0)  # not seen


def test_a_static_law_need_not_explain_ordinary_imperfections():
    assert form_of(False, 1.0, 0.5) == decision.FORM
    assert form_of(True, 2.0, 0.0) == decision.FORM
    assert form_of(True, 2.0, 0.5) == pytest.approx(0.0625)  # their share of the mean square
    assert form_of(True, 0.5, 0.5) == decision.FORM_MOST  # and never more
    assert form_of(True, 0.0, 0.3) == decision.FORM_MOST


# --- constants of the comparisons, each changed in both directions --------------------------------


@pytest.mark.parametrize(
    ("name", "low", "high", "question", "expected"),
    [
        ("FORM", 0.001, 0.2, lambda: [near(np.full(8, b), np.full(8, 20.0), FLAT) for b in (21.0, 25.0)],
         [True, False]),
        ("FORM_MOST", 0.02, 0.9, lambda: [form_of(True, 1.0, r) >= 0.1 for r in (0.35, 0.8)]
         + [form_of(True, 1.0, 0.8) > 0.5], [True, True, False]),
        ("FOLDS", 0.3, 0.9, lambda: [seen_to_fall(difference(FLAT, folds(*row))) for row in (
            (10, 10, 10, 10, 10, 110, 110, 100), (10, 10, 10, 120, 120, 120, 120, 100))], [True, False]),
        ("FOLD_SHOWS", 0.0, 5.0, lambda: [difference(FLAT, folds(10, 101, 101, 101, 20, 101, 101, 30)).share == 1.0,
                                           difference(FLAT, folds(10, 150, 20, 30, 40, 50, 60, 70)).share < 1.0],
         [True, True]),
        ("AGREE", 0.5, 1.01, lambda: [near(50.0 + folds(*row), np.full(8, 50.0), FLAT) for row in (
            (5, 5, 5, 5, 5, 5, 50, -30), (-10, -10, -10, 1, 1, 1, 1, 50))], [False, True]),
    ],
)  # fmt: skip
def test_comparisons_turn_when_their_constant_is_moved(
    monkeypatch, name, low, high, question, expected
):
    assert question() == expected
    for moved in (low, high):
        monkeypatch.setattr(decision, name, moved)
        assert question() != expected, f"{name} = {moved} decides the same"


# --- acceptance of a family ---------------------------------------------------------------------


def accepted(
    fall=600.0, before=800.0, numbers=100.0, moved=1.0, kind="memory", later=False, **more
):
    """Whether a family is accepted whose loss falls by `fall` in eight even folds."""
    static = more.get("static_mm", 3.0)
    record = SimpleNamespace(
        positions=None, form_mm=more.get("form", 0.0), seen=np.zeros((1, 3)),
        rms_mm=lambda _: static, error_is_noise=more.get("noisy", False),
    )  # fmt: skip
    noise = SimpleNamespace(measured=True, rms_mm=lambda _: more.get("noise", 0.0))
    state = SimpleNamespace(
        body=SimpleNamespace(
            problem=SimpleNamespace(record=record, noise=noise, numbers=numbers),
            record=record,
            ordinary_mm=more.get("ordinary", 0.3),
            free_map=False,
        ),
        without_background=lambda: None if more.get("background") else state,
    )
    ranking = SimpleNamespace(before=np.full(8, before / 8), static=np.zeros((1, 3)))
    row = SimpleNamespace(
        loss=np.full(8, (before - fall) / 8), moved_mm=moved, family=SimpleNamespace(kind=kind)
    )
    return acceptance.accepted(row, ranking, state, later, more.get("visible", decision.VISIBLE_MM))


def test_a_family_is_accepted_by_its_fall_and_by_what_it_moves():
    assert accepted()
    assert (
        not accepted(fall=-1.0)
        and not accepted(moved=0.05)
        and not accepted(moved=0.2, visible=0.3)
    )
    # below noise, below the model's error
    assert not accepted(noise=4.0) and not accepted(kind="static", form=2.0)
    assert accepted(kind="memory", form=2.0)  # which has no memory
    assert accepted(kind="static", form=2.0, noisy=True)  # whose model error is in its noise
    small = dict(fall=200.0, numbers=100.0)
    assert accepted(**small, kind="static") and accepted(**small, noisy=True)
    assert not accepted(**small, kind="static", noisy=True)  # a rod may err as much on any run
    # nor may a memory, once imperfections are explained
    assert not accepted(**small, noisy=True, background=True)
    # a share of all loss, within noise
    assert not accepted(fall=100.0, numbers=801.0) and accepted(numbers=801.0)


@pytest.mark.parametrize(
    ("name", "moved", "case"),
    [
        ("FALL", 0.9, dict(fall=600.0)),
        ("FALL", 0.0, dict(fall=4.0, numbers=790.0)),
        ("FALL_FIRST", 0.95, dict(fall=600.0)),
        ("FALL_FIRST", 0.01, dict(fall=60.0)),
        ("FALL_NEXT", 0.95, dict(fall=600.0, later=True)),
        ("FALL_NEXT", 0.01, dict(fall=60.0, later=True)),
        ("ABOVE_NOISE", 0.0, dict(fall=130.0, numbers=300.0)),
        ("ABOVE_NOISE", 8.0, dict(fall=60.0)),
        ("DOMINATES", 11.0, dict(kind="static")),
        ("DOMINATES", 0.1, dict(kind="static", static_mm=0.4)),
    ],
)
def test_acceptance_turns_when_its_constant_is_moved(monkeypatch, name, moved, case):
    now = accepted(**case)
    monkeypatch.setattr(decision, name, moved)
    assert accepted(**case) != now


def exceeds(moved, static=2.0, folds=(1.0, 1.0, 1.0, 1.0, 1.0), kind="static", free=True):
    """Whether an effect exceeds the model error of 1 mm, where `static` mm remain without it."""
    model = SimpleNamespace(made_from={"per_fold_mm": folds})
    record = SimpleNamespace(model=model, form_mm=1.0, rms_mm=lambda _: static)
    state = SimpleNamespace(body=SimpleNamespace(record=record, free_map=free), residual=None)
    return acceptance.exceeds_model_error(SimpleNamespace(kind=kind), moved, state)


def test_a_new_static_effect_of_a_learned_map_exceeds_its_model_error_and_the_scatter_of_that(
    monkeypatch,
):
    assert exceeds(1.7) and exceeds(1.7, kind="time")
    assert not exceeds(1.7, static=1.2)  # hardly more than the model error remains
    scattered = (0.3, 0.6, 1.0, 1.3, 1.4)  # the same error on average, but not on every run
    assert not exceeds(1.7, static=1.5, folds=scattered) and exceeds(1.5, static=1.5)
    monkeypatch.setattr(decision, "SCATTER", 0.0)
    assert exceeds(1.4, static=1.5, folds=scattered)
    assert exceeds(1.7, static=1.2, kind="memory")  # a map has no memory
    # the rod of a robot.toml follows few static effects
    assert exceeds(1.7, static=1.2, free=False)


def test_a_later_family_has_to_explain_more():
    case = dict(fall=170.0, before=800.0, numbers=100.0)
    assert accepted(**case) and not accepted(**case, later=True)
    assert decision.FALL_NEXT > decision.FALL_FIRST


def test_what_is_visible_moves_the_body_by_more_than_a_camera_s_floor(monkeypatch):
    run = finger_run(["backlash"], {"backlash.gap": 0.08}, noise=0.02)
    assert diagnose(builtin_model(), run).effects == ()
    monkeypatch.setattr(decision, "VISIBLE_MM", 0.01)
    assert [e.name for e in diagnose(builtin_model(), run).effects] == ["backlash"]


# --- constants that decide between outcomes, each moved up and down ----------------------------


def remains(left=0.0, mm=0.0, standing=True):
    """Whether something unknown remains: a share `left` beyond a law, or `mm` against a model error
    of 1 mm.
    """
    record = SimpleNamespace(form_mm=1.0, positions=None, rms_mm=lambda _: mm)
    problem = SimpleNamespace(record=record, noise=SimpleNamespace(rms_mm=lambda _: 0.5))
    state = SimpleNamespace(residual=0.0, ordinary=0.0)
    outcome = SimpleNamespace(
        body=SimpleNamespace(problem=problem, record=record), left=left, state=state
    )
    steps = [SimpleNamespace(answer=SimpleNamespace(law="a law", rough=False))] if standing else []
    return conclusion._unknown(outcome, None, None, steps, False)


def is_exchanged(off, monkeypatch):
    """Whether servos are exchanged where the model is `off` mm on a motion of 10 mm."""
    monkeypatch.setattr(acceptance, "motion_mm", lambda _: 10.0)
    monkeypatch.setattr(search, "law_of", lambda *_: SimpleNamespace(left=1.0))
    monkeypatch.setattr(search, "_stand_in", lambda *_: None)
    record = SimpleNamespace(rms_mm=lambda _: off)
    state = SimpleNamespace(body=SimpleNamespace(record=record), residual=None)
    ranking = SimpleNamespace(rows=[SimpleNamespace(left=1.0)], found=FLAT)
    return search._miswired(ranking, state, SimpleNamespace(candidates=["servo_swap"])) is not None


def mimics(r2, monkeypatch):
    """Whether a family does what a static map can do, where the map explains `r2` of its effect."""
    static = SimpleNamespace(name="static map")
    column, other = 100.0 * np.eye(2)
    target = np.sqrt(r2) * column + np.sqrt(1.0 - r2) * other
    columns = SimpleNamespace(base=column.reshape(1, 2, 1), which=[0], weight=np.ones((1, 2)))
    body = SimpleNamespace(columns=lambda *_: columns, modes=lambda x: x)
    level = SimpleNamespace(theta=lambda *_: [None], fitted=lambda *_: target.reshape(2, 1))
    ranking = SimpleNamespace(level=level, names=[], ridges=[])
    monkeypatch.setattr(acceptance, "families", lambda: [static])
    other = SimpleNamespace(
        family=SimpleNamespace(name="creep"), representative=SimpleNamespace(ridge=1.0)
    )
    state = SimpleNamespace(body=body, commands=None, slopes=None)
    return acceptance.does_the_same(other, SimpleNamespace(family=static), ranking, state)


def is_discovery(static_mm):
    """Whether a static misfit on a motion of 10 mm is more than ordinary imperfections."""
    record = SimpleNamespace(
        seen=np.array([[10.0], [-10.0]]), frame_mm=0.0, rms_mm=lambda x: np.sqrt(np.mean(x**2))
    )
    level = SimpleNamespace(close=lambda _: None)
    body = SimpleNamespace(
        record=record, candidates=[], curves=lambda *_: {}, level=lambda: level, modes=lambda x: x
    )
    body.free_map = False
    state = SimpleNamespace(body=body, commands=None, slopes=None, residual=np.zeros((2, 1)))
    ranking = SimpleNamespace(static=np.full((2, 1), static_mm), rows=[])
    body.ordinary_mm = acceptance.ordinary(state, ranking, [])
    return acceptance.beyond_ordinary(ranking, state)


SCATTERED = (0.3, 0.6, 1.0, 1.3, 1.4)  # 1 mm, but not on every run


@pytest.mark.parametrize(
    ("name", "low", "high", "question"),
    [
        ("LEFT", 0.04, 0.25, lambda _: (remains(left=0.07), remains(left=0.2))),
        ("UNKNOWN_TIMES", 1.2, 5.0, lambda _: (remains(mm=2.0, standing=False), remains(mm=4.0, standing=False))),
        ("MISWIRED", 0.1, 0.4, lambda patch: (is_exchanged(1.5, patch), is_exchanged(3.0, patch))),
        ("MIMIC", 0.7, 0.97, lambda patch: (mimics(0.8, patch), mimics(0.94, patch))),
        ("STANDS_FOR", 0.4, 0.9, lambda _: tuple(
            judged(law("gain", left, 1), kind="memory").law is not None for left in (500, 300))),
        ("ORDINARY", 0.015, 0.08, lambda _: (is_discovery(0.6), is_discovery(1.2))),
        ("SCATTER", 5.0, 0.7, lambda _: (not exceeds(1.7, folds=SCATTERED),
                                         not exceeds(1.5, static=1.7, folds=SCATTERED))),
    ],
)  # fmt: skip
def test_a_decision_turns_when_its_constant_is_moved(monkeypatch, name, low, high, question):
    """One case lies below the constant and one above: the first turns if it is lowered, the second
    if it is raised.
    """
    assert tuple(map(bool, question(monkeypatch))) == (False, True)
    for value, expected in ((low, (True, True)), (high, (False, False))):
        assert 1 / 3.1 < value / getattr(decision, name) < 3.1
        with monkeypatch.context() as patch:
            patch.setattr(decision, name, value)
            assert tuple(map(bool, question(patch))) == expected, f"{name} = {value}"


# --- odds ---------------------------------------------------------------------------------------


def probability(alternatives=0, bound=False, unknown=False, reaching=None):
    others = [Alternative(("lag",), "", "gain")] * alternatives + [
        Alternative(("lag",), "", "creep")
    ]
    step = (
        None
        if reaching is None
        else SimpleNamespace(answer=SimpleNamespace(identified=False, reaching=[0] * reaching))
    )
    numbers = {"gain.factor": Number(0.1, at_bound=bound)}
    return conclusion._probability(step, "gain", numbers, others, unknown)


def test_a_name_is_as_likely_as_what_speaks_against_it_allows():
    assert probability() == pytest.approx(1 / 1.03)
    assert probability(1) == pytest.approx(1 / 1.53) and probability(2) == pytest.approx(1 / 2.03)
    assert probability(bound=True) == probability(unknown=True) == probability(1)
    assert probability(reaching=2) == pytest.approx(1 / 4.03)  # a candidate of an open law
    assert (
        probability(1)
        > 0.5
        > probability(2)
        > probability(2, bound=True)
        > probability(2, True, True)
    )


@pytest.mark.parametrize(
    ("name", "moved", "case"),
    [
        ("ODDS_BASE", 1.0, {}), ("ODDS_BASE", 0.0, {}),
        ("ODDS_DOUBT", 0.05, {"alternatives": 2}), ("ODDS_DOUBT", 2.0, {"alternatives": 1}),
        ("ODDS_DOUBT", 0.0, {"bound": True}), ("ODDS_DOUBT", 2.0, {"unknown": True}),
    ],
)  # fmt: skip
def test_probabilities_follow_the_odds(monkeypatch, name, moved, case):
    """By more than the 3 % of the calibration of probabilities."""
    before = probability(**case)
    monkeypatch.setattr(decision, name, moved)
    assert abs(probability(**case) - before) >= 0.028


# --- complete diagnoses -------------------------------------------------------------------------


def imperfect(u):
    """Many small errors at once: a scale, an offset, a wave, a cross term; 0.3 mm RMS together, and
    none dominates.
    """
    return 1.01 * u + [0.1, -0.1] + 0.12 * np.sin(0.9 * u) + 0.003 * u[:, ::-1] ** 2


@pytest.fixture
def moved(monkeypatch):
    """Diagnose with constants as they are, and with some of them changed."""

    def both(run, effects, **constants):
        model = builtin_model()
        now = diagnose(model, run, effects=effects)
        for name, value in constants.items():
            for module in (decision, acceptance):
                if hasattr(module, name):
                    monkeypatch.setattr(module, name, value)
        return now, diagnose(model, run, effects=effects)

    return both


def test_ordinary_imperfections_are_a_level_and_no_discovery(moved):
    """On a motion of 10 mm they are ignored; for a robot without imperfections they would be a
    discovery.
    """
    now, then = moved(finger_run(acting=imperfect), ["gain", "offset", "asymmetry"], ORDINARY=0.0)
    assert not now.families and now.verdict in ("nothing", "cannot_tell")
    assert then.families and then.families[0].kind == "static"
    assert (
        0.2 < now.unexplained.ordinary_mm < 0.4
        and "ordinary imperfections of this robot: 0." in str(now)
    )
    assert then.unexplained.ordinary_mm is None


def test_what_is_left_of_the_error_beyond_a_tenth_is_unknown(moved):
    """Half of a play, and a delay that is not a candidate."""
    late = lambda u: np.concatenate([np.tile(u[:1], (6, 1)), u])[: len(u)]  # noqa: E731
    run = finger_run(["backlash"], {"backlash.gap": 1.5}, acting=late)
    now, then = moved(run, ["backlash"], LEFT=10.0, MOST=1)
    assert now.verdict == "partly_explained"
    assert then.verdict != "partly_explained" or then.families[0].law == "unknown"


def test_at_most_four_families_are_taken(moved):
    hidden = {"backlash.gap": 1.5, "creep.strength": 0.2, "creep.tau": 15.0}
    run = finger_run(["backlash", "creep"], hidden)
    now, then = moved(run, ["backlash", "creep"], MOST=1)
    assert len(now.families) == 2 and len(then.families) == 1 and then.verdict == "partly_explained"


def test_two_laws_of_two_families_are_found_together(monkeypatch):
    """One after the other, a free static shape absorbs the share of both, and other laws are
    named.
    """
    run = finger_run(
        ["gain", "mount"], {"gain.factor[0]": 0.8, "gain.factor[1]": 0.8, "mount.shift_x": 2.0}
    )
    some = ["offset", "gain", "tendon_stretch", "routing", "pre_curve", "mount"]
    now = diagnose(builtin_model(), run, effects=some)
    assert {e.name for e in (*now.faults, *now.effects)} == {"gain", "mount"}
    assert now.error.after < 0.3 * now.error.before

    def one_by_one(outcome, more, visible):
        more(outcome, acceptance.MOST)
        return outcome

    monkeypatch.setattr(search, "completed", one_by_one)
    then = diagnose(builtin_model(), run, effects=some)
    assert {e.name for e in (*then.faults, *then.effects)} != {"gain", "mount"}


def test_something_far_beyond_the_model_s_error_is_unknown_though_no_family_falls(moved):
    # no column has so many waves
    run = finger_run(acting=lambda u: u + 2.0 * np.sin(3.0 * u[:, ::-1]))
    now, then = moved(run, ["gain", "backlash"], UNKNOWN_TIMES=1e3)
    assert (
        now.verdict == "partly_explained"
        and not now.effects
        and "remain unexplained" in now.sentence
    )
    assert then.verdict in ("nothing", "cannot_tell")


def test_servos_are_exchanged_only_where_the_model_is_far_off(moved):
    run = finger_run(acting=lambda u: u[:, ::-1])
    now, then = moved(run, ["servo_swap", "gain"], MISWIRED=1e3)
    assert [f.name for f in now.faults] == ["servo_swap"] and not then.faults


def test_an_effect_of_the_same_form_is_an_alternative_where_it_explains_enough(moved):
    run = finger_run(acting=lambda u: u * [0.85, 0.85])
    now, then = moved(run, ["gain", "tendon_stretch"], STANDS_FOR=2.0)
    assert [a.effects for a in now.alternatives] == [
        ("tendon_stretch",)
    ] and then.alternatives == ()


@pytest.mark.long
def test_a_family_that_does_what_a_static_map_does_is_no_alternative_to_it(moved):
    """A slow change can look like a gain where large commands are held long, and the gain leaves
    more than noise.
    """
    run = finger_run(acting=lambda u: u * [0.85, 0.85] + 0.05 * np.sin(u[:, ::-1]))
    now, then = moved(run, None, MIMIC=2.0)
    assert [f.name for f in now.families] == ["static map"]
    assert now.families[0].alternatives == () and "creep" in then.families[0].alternatives


def test_gross_faults_are_the_verdict_and_small_ones_are_listed():
    """Wording has one factor of its own: a fault leads if it moves the body more than twice as far
    as any physics.
    """
    assert wording.GROSS == 2.0 and 0.1 < wording.UNTESTABLE_SHARE < 0.9


def test_each_constant_of_the_decision_has_its_reason_next_to_it():
    lines = Path(decision.__file__).read_text(encoding="utf-8").splitlines()
    constants = [
        (above, line)
        for above, line in zip(lines, lines[1:])
        if re.match(r"[A-Z][A-Z_, ]+ = ", line)
    ]
    assert 10 < len(constants) <= 20
    for above, line in constants:
        assert "#" in line or above.startswith("#"), line
