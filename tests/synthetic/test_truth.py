"""Hidden truths: laws against closed forms, protocols, the camera, and truths solved by the finite
elements.
"""

import ast
from pathlib import Path

import numpy as np
import pytest

from softmap_edge.errors import SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.robot.emulated import laws as truth_laws
from softmap_edge.robot.emulated.laws import LAWS, rotation
from softmap_edge.run.protocol import FAST, REACH, other_protocol, standard_protocol

T = np.arange(0, 2000) / 50.0  # s
RAMP = np.stack([3.0 * T, -2.0 * T], axis=1)  # mm
WAVE = np.stack([8.0 * np.sin(0.7 * T), 5.0 * np.cos(0.4 * T) - 5.0], axis=1)  # mm, starts at home
STEP = np.where(T[:, None] < 1.0, 0.0, [[6.0, -3.0]])


def drawn(name, seed=3):
    return LAWS[name].draw(np.random.default_rng(seed), 2)


@pytest.mark.parametrize("name", LAWS)
def test_no_strength_is_no_effect_and_strength_grows(name):
    law = drawn(name)
    g = np.array([0.5, 0.1, 0.8])
    points = np.random.default_rng(0).normal(size=(4, 5, 3)) * 30

    def size(s):
        there = law.scaled(s)
        return (
            np.abs(there.command(T, WAVE) - WAVE).max()
            + np.abs(there.gravity(g) - g).max()
            + np.abs(there.force(g)).max()
            + np.abs(there.seen(points) - points).max()
        )

    # one packet late at 5.6 mm/s; encoder steps of 1/280 mm
    rest = 0.25 if name == "latency" else 0.01
    assert size(1e-9) < rest < size(0.5) < size(1.0)


@pytest.mark.parametrize("name", LAWS)
def test_memory_starts_in_equilibrium(name):
    still = np.tile([4.0, -2.0], (T.size, 1))
    out = drawn(name).command(T, still)
    assert np.ptp(out, axis=0).max() < 1e-12


@pytest.mark.parametrize("name", LAWS)
def test_same_seed_same_law(name):
    assert drawn(name, 5) == drawn(name, 5)
    assert drawn(name, 5) != drawn(name, 6)
    assert set(drawn(name).params())


def test_two_poles_follow_a_ramp_late_by_the_sum_of_their_times():
    law = truth_laws.TwoPoles(0.3, 0.1)
    late = law.command(T, RAMP)[-1]
    assert late == pytest.approx(RAMP[-1] - np.array([3.0, -2.0]) * 0.4, abs=1e-9)
    # the step response of two poles in series, exact between samples once the step is over
    out = law.command(T, STEP)[:, 0]
    since = T - 0.99  # the record rises linearly from 0.98 s to 1.00 s
    exact = 6.0 * (1 - (0.3 * np.exp(-since / 0.3) - 0.1 * np.exp(-since / 0.1)) / 0.2)
    assert np.abs(out - exact)[T > 1.05].max() < 0.02  # (0.02 s)²/(24 · 0.3 · 0.1) of 6 mm


def test_packets_are_late_by_delay_and_half_a_period():
    law = truth_laws.LatePackets(0.2, 0.02, 0.006, 1)
    slope = 3.0
    late = (RAMP[:, 0] - law.command(T, RAMP)[:, 0])[100:] / slope
    assert late.min() > 0.19
    assert late.mean() == pytest.approx(0.21, abs=0.011)
    assert law.command(T, RAMP)[0] == pytest.approx(RAMP[0])


def test_plays_are_off_by_their_mean_width_on_a_long_stroke():
    law = truth_laws.ManyPlays((0.8, 0.5), 0.2)
    out = law.command(T, RAMP)
    assert RAMP[-1] - out[-1] == pytest.approx([0.8, -0.5], abs=1e-12)
    # after a reversal nothing moves for the narrowest width, all of it after the widest
    back = np.concatenate([RAMP, RAMP[-1] - np.linspace(0, 3, 600)[:, None] * [1.0, -1.0]])
    moved = law.command(np.arange(len(back)) / 50.0, back)[len(RAMP) :, 0]
    travelled = np.linspace(0, 3, 600)
    assert np.ptp(moved[travelled < 2 * 0.8 * 0.8]) < 1e-12
    assert np.diff(moved[travelled > 2 * 0.8 * 1.2 + 0.01]) == pytest.approx(-3 / 599, abs=1e-9)


def test_bouc_wen_saturates_and_dissipates():
    law = truth_laws.BoucWen((0.3, 0.3), 4.0, 1.0)
    held = RAMP - law.command(T, RAMP)
    assert held[-1] == pytest.approx([1.2, -1.2], abs=1e-6)  # H = share · d0 once saturated
    exact = 1.2 * (1 - np.exp(-RAMP[:, 0] / 4.0))  # n = 1, loading
    assert np.abs(held[:, 0] - exact).max() < 1.2 / 20  # forward Euler in steps of d0/20 at most
    out = law.command(T, WAVE)
    work = np.sum((WAVE[1:] + WAVE[:-1]) / 2 * np.diff(out, axis=0), axis=0)[0]
    assert abs(work) > 1.0  # the loop has an area; mm²


def test_three_terms_creep_to_their_sum():
    law = truth_laws.ThreeTerms((0.1, 0.2), 2.0, (0.2, 0.5, 0.3))
    t = np.arange(0, 6000) / 50.0
    step = np.where(t[:, None] < 1.0, 0.0, [[6.0, -3.0]])
    grown = law.command(t, step) - step
    since = t[:, None] - 0.99 - np.zeros(2)
    decay = sum(w * np.exp(-since / tau) for w, tau in zip((0.2, 0.5, 0.3), (0.4, 2.0, 10.0)))
    exact = np.array([0.6, -0.6]) * (1 - decay)
    assert np.abs(grown - exact)[t > 1.05].max() < 1e-3


def test_spool_and_horn():
    wound = truth_laws.OtherSpool((0.1, -0.05), 0.0).command(T, WAVE)
    assert wound == pytest.approx(WAVE * [1.1, 0.95])
    askew = truth_laws.AskewHorn((1.0, -0.5), 280.0).command(T, WAVE) - WAVE
    assert np.abs(askew - [1.0, -0.5]).max() <= 0.5 / 280 + 1e-12


def test_weights_and_mount():
    g = np.array([0.0, 0.6, 0.8])
    heavy = truth_laws.TrueWeight(0.2, (5.0, -3.0)).gravity(g)
    assert np.linalg.norm(heavy) == pytest.approx(1.2)
    assert truth_laws.TipWeight(20.0).force(g) == pytest.approx(0.1961330 * g)
    turn = rotation((10.0, -20.0, 30.0))
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(np.sqrt(1400))
    points = np.random.default_rng(0).normal(size=(3, 7, 3))
    seen = truth_laws.AskewBase((0.0, 0.0, 90.0), (1.0, 0.0, 0.0)).seen(points)
    assert seen == pytest.approx(
        np.stack([1 - points[..., 1], points[..., 0], points[..., 2]], axis=-1)
    )


def test_truths_never_touch_the_effect_library():
    """The compiled core may be used for interpolation and finite elements only."""
    package = Path(truth_laws.__file__).parents[2]
    for name in ("robot/emulated/laws.py", "run/protocol.py", "synthetic/finger.py"):
        tree = ast.parse((package / name).read_text())
        core = {
            n.attr
            for n in ast.walk(tree)
            if isinstance(n, ast.Attribute) and ast.unparse(n.value) == "_core"
        }
        imported = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        assert core <= {"Table"}
        assert not imported & {
            "softmap_edge.model.model",
            "softmap_edge.model.bundle",
            "softmap_edge.diagnosis.diagnose",
        }


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_protocol_holds_what_a_diagnosis_needs(channels):
    p = standard_protocol(channels)
    assert p.command.shape == (p.t.size, channels)
    assert np.all(np.diff(p.t_seen) > 0)
    assert p.t_seen[0] >= p.t[0]
    assert p.t_seen[-1] <= p.t[-1]
    assert np.abs(p.command).max() <= REACH + 1e-9
    speed = np.abs(np.diff(p.command, axis=0)).max() * 50
    assert speed == pytest.approx(FAST, rel=0.05)
    declared = p.gravity[np.searchsorted(p.t, p.t_seen, side="right") - 1]
    assert len(np.unique(declared, axis=0)) == 2
    assert np.linalg.norm(p.gravity, axis=1) == pytest.approx(np.ones(p.t.size))
    at_home = p.t_seen[p.block == "home"]
    assert at_home.size >= 30
    span = np.histogram(at_home, bins=3, range=(p.t[0], p.t[-1]))[0]
    assert np.all(span >= 5)
    u = np.stack([np.interp(at_home, p.t, p.command[:, c]) for c in range(channels)], axis=1)
    assert np.abs(u).max() < 1e-9
    still = np.diff(p.command, axis=0)[:, 0] == 0
    longest = max(len(s) for s in "".join("x" if k else " " for k in still).split()) / 50
    assert longest >= 6.0
    if channels == 2:
        assert 320 <= p.frames <= 400


def test_other_protocol_is_of_another_kind():
    p = other_protocol()
    assert 150 <= p.frames <= 300
    assert set(p.block) == {"home", "circle", "spiral", "random", "random fast"}
    assert np.abs(p.command).max() <= REACH
    assert np.all(np.diff(p.t_seen) > 0)
    assert np.abs(np.diff(p.command, axis=0)).max() * 50 < 2 * FAST
    moving = np.abs(p.command) > 0.5
    assert moving.all(axis=1).mean() > 0.5  # both channels at once, unlike the triangles


def test_protocols_repeat_themselves_and_refuse_nonsense():
    a, b, c = standard_protocol(2, 1), standard_protocol(2, 1), standard_protocol(2, 2)
    assert np.array_equal(a.t_seen, b.t_seen)
    assert not np.array_equal(a.t_seen, c.t_seen)
    for bad in ((0, 0, 12.0), (2, 0, -1.0)):
        with pytest.raises(SoftmapError, match="at least 1 channel"):
            standard_protocol(*bad)


def test_camera_noise_has_the_declared_size_and_memory():
    from softmap_edge.synthetic.finger import Camera

    camera = Camera(vertex_mm=0.25, shift_mm=0.5, turn_deg=0.0, memory_s=1.0)
    t = np.arange(4000) * 0.5
    seen = camera.look(np.zeros((t.size, 40, 3)), t, np.random.default_rng(0))
    drift = seen.mean(axis=1)[:, 0]
    assert np.std(seen - seen.mean(axis=1, keepdims=True)) == pytest.approx(
        0.25 * np.sqrt(39 / 40), rel=0.01
    )
    assert np.std(drift) == pytest.approx(0.5, rel=0.1)
    assert np.corrcoef(drift[1:], drift[:-1])[0, 1] == pytest.approx(np.exp(-0.5), abs=0.05)


# `hide` itself refuses what moves less or more; every law runs in test_hidden_effects.py
long = pytest.mark.prove


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    ["mount", *(pytest.param(name, marks=long) for name in ("backlash", "latency", "payload"))],
)
def test_hidden_effect_moves_the_centroids_by_its_stated_size(name):
    from softmap_edge.synthetic.finger import centroids, hide

    p = standard_protocol()
    truth = hide([name], 4)
    moved = centroids(truth.shapes(p, 3)) - centroids(truth.twin().shapes(p, 3))
    rms = np.sqrt((moved**2).sum(axis=2).mean())
    assert 1.0 <= rms <= 4.0
    assert rms == pytest.approx(truth.hidden[0].displacement_mm)


@pytest.mark.long
def test_every_frame_is_the_equilibrium_found_on_its_own():
    from softmap_edge.synthetic import finger as truth
    from softmap_edge.synthetic.finger import hide

    finger, p = hide(["payload"], 4), standard_protocol()
    chosen = np.arange(0, p.frames, 80)
    (frames, gravity, force), *_ = [part for part in finger._weights(p)]
    chosen = np.intersect1d(chosen, frames)
    body = truth._simulator(finger.finger, finger.modulus)
    own = [body.path(u[None], gravity=gravity, load=force) for u in finger.to_body(p)[chosen]]
    # Both stop where the next Newton step moves no node by 2e-4 mm.
    assert np.abs(finger.shapes(p, 8)[chosen // 8] - np.concatenate(own)).max() < 2e-3
    # What a sweep of the same finger would make of it: why frames are solved.
    assert np.abs(finger.rough(p, 9)[chosen] - np.concatenate(own)).max() > 0.1


def test_a_tour_visits_every_place_once_and_makes_short_steps():
    from softmap_edge.synthetic.finger import tour

    places = np.random.default_rng(0).uniform(-10, 10, (200, 2))
    order = tour(places)
    assert sorted(order) == list(range(200))
    steps = np.linalg.norm(np.diff(places[order], axis=0), axis=1)
    assert np.median(steps) < 1.5  # 20 mm / sqrt(200) = 1.4 between neighbours of a grid


@pytest.mark.long
def test_a_measured_finger_is_a_run():
    from softmap_edge.synthetic.finger import hide, template

    p = other_protocol()
    run = hide(["mount"], 4).measure(p)
    again = hide(["mount"], 4).measure(p)
    assert run.vertices.shape == (p.frames, *template().shape)
    assert np.array_equal(run.vertices, again.vertices)
    assert not np.array_equal(run.vertices, hide(["mount"], 4).measure(p, seed=1).vertices)


def test_unknown_and_doubled_hidden_effects_are_refused():
    from softmap_edge.synthetic.finger import hide

    with pytest.raises(SoftmapError, match="offset, gain, backlash"):
        hide(["wobble"], 0)
    with pytest.raises(SoftmapError, match="once"):
        hide(["creep", "creep"], 0)
    with pytest.raises(SoftmapError, match="negative"):
        hide([], -1)


def test_laws_that_are_asked_for_by_name_move_every_channel():
    from softmap_edge.robot.emulated.named_laws import OffCentreSpool, SwappedServos
    from softmap_edge.synthetic.finger import hide

    t = np.arange(5.0)
    u = np.linspace(-9, 9, 5)[:, None] * [1.0, -0.5, 0.7, 0.2]
    wound = OffCentreSpool().command(t, u)
    assert wound.shape == u.shape and np.all(np.ptp(wound - u, axis=0) > 0.05)
    np.testing.assert_allclose(OffCentreSpool().scaled(0.0).command(t, u), u, atol=1e-12)
    assert np.array_equal(SwappedServos().command(t, u), u[:, [1, 0, 2, 3]])
    assert np.array_equal(SwappedServos().command(t, u[:, :1]), -u[:, :1])
    coarse = Finger.builtin().replace(core=1, layers=10)
    hidden = hide(["servo_swap", "mount", "off_centre_spool"], 4, finger=coarse)
    assert [effect.name for effect in hidden.hidden] == ["servo_swap", "off_centre_spool", "mount"]
