"""Fits of sets of effects: each made once, from starts that find the hidden effects, with the share
of each member.
"""

import numpy as np
import pytest
from arm import NAMES, arm, record_run

from softmap_edge import builtin_model
from softmap_edge.diagnosis import fits as fits_module
from softmap_edge.diagnosis.fits import INSTANTS, Fits, starts
from softmap_edge.diagnosis.prepare import problem_of
from softmap_edge.diagnosis.record import Record
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.run.run import Run

HIDDEN = {"backlash.gap": 2.0, "creep.strength": 0.12, "payload.mass": 40.0, "latency.delay": 0.25,
          "gain.factor[0]": 1.15, "offset.shift[0]": 0.8, "mount.shift_x": 2.0}  # fmt: skip


def arm_fits(hidden):
    return Fits(problem_of(Record(arm(), record_run(hidden, noise=0.05, warp=0.0)), NAMES), NAMES)


def finger_fits(acting, names, noise=0.2):
    """Fits on a run of the built-in finger with another effective command."""
    protocol, model = standard_protocol(), builtin_model()
    rest = np.broadcast_to(model.rest, (protocol.frames, *model.rest.shape))
    points = model.predict(
        Run(protocol.t, acting(protocol.command), protocol.t_seen, vertices=rest)
    )
    points = points + noise * np.random.default_rng(0).normal(size=points.shape)
    run = Run(protocol.t, protocol.command, protocol.t_seen, vertices=points)
    return Fits(problem_of(Record(model, run), names), names)


@pytest.mark.parametrize("label", HIDDEN)
def test_the_hidden_effect_fits_best_and_exactly(label):
    fits = arm_fits({label: HIDDEN[label]})
    costs = {name: fits.get([name]).cost for name in NAMES}
    name = label.split(".")[0]
    assert min(costs, key=costs.get) == name
    found = fits.get([name])
    sigma = dict(
        zip(found.space.free_labels, fits.problem.uncertainty(found, fits.dispersion(found)))
    )
    assert abs(found.params[label] - HIDDEN[label]) < 4 * sigma[label]


@pytest.mark.parametrize(
    ("first", "second"),
    [("backlash.gap", "creep.strength"), ("payload.mass", "latency.delay"), ("gain.factor[0]", "mount.shift_x"),
     ("creep.strength", "payload.mass")],
)  # fmt: skip
def test_behind_a_fit_the_other_hidden_effect_fits_best(first, second):
    fits = arm_fits({label: HIDDEN[label] for label in (first, second)})
    one, other = (label.split(".")[0] for label in (first, second))
    costs = {name: fits.get([one, name]).cost for name in NAMES if name != one}
    assert min(costs, key=costs.get) == other


def test_a_set_is_fitted_once_whatever_the_order_of_its_names(monkeypatch):
    fits, made = arm_fits({"backlash.gap": 2.0}), []
    fit = fits.problem.fit
    monkeypatch.setattr(
        fits.problem, "fit", lambda effects, *a, **k: made.append(effects) or fit(effects, *a, **k)
    )
    pair = fits.get(["gain", "backlash"])
    assert fits.get(("backlash", "gain")) is pair and fits.get(frozenset(pair.effects)) is pair
    assert len(made) == 2  # the pair, and one member that it was built from
    assert fits.get([]) is fits.null and fits.without(fits.get(["gain"]), "gain") is fits.null
    assert fits.losses(pair)[1] is fits.losses(pair)[1]


def test_what_a_member_does_and_its_share_of_what_is_explained():
    fits = arm_fits({"backlash.gap": 2.0, "payload.mass": 40.0})
    both = fits.get(["backlash", "payload"])
    done = fits.displacement(both, "payload")
    assert fits.problem.record.rms_mm(done) > 0.3
    params = fits.problem.record.layout(("payload",)).values(
        {"payload.mass": both.params["payload.mass"]}
    )
    alone = fits.problem.record.predict(("payload",), params[None])[0] - fits.null.predicted
    # the load has the same effect behind a play
    assert np.abs(done - alone).max() < 0.2 * np.abs(alone).max()
    shares = [fits.share(both, name) for name in both.effects]
    assert all(0.2 < share < 2.0 for share in shares)  # above 1 if the other does harm without it
    assert fits.share(fits.get(["backlash", "payload", "latency"]), "latency") < 0.02


def test_held_out_error_falls_to_the_noise_with_the_true_set_alone():
    fits = arm_fits({"backlash.gap": 2.0})
    noise = fits.problem.noise.rms_mm(fits.problem.record.positions)
    assert fits.held_out_mm(fits.get(["backlash"])) < 1.3 * noise
    assert (
        fits.held_out_mm(fits.null) > 3.0 * noise
        and fits.held_out_mm(fits.get(["mount"])) > 3.0 * noise
    )


def test_numbers_for_each_channel_are_fitted_from_the_number_for_all():
    gaps = np.array([1.4, 0.6])

    def played(u):
        out, y = [], u[0].copy()
        for row in u:
            y = np.clip(y, row - gaps / 2, row + gaps / 2)
            out.append(y)
        return np.array(out)

    fits = finger_fits(played, ["backlash"])
    shared, split = fits.get(["backlash"]), fits.get(["backlash"], ["backlash"])
    assert len(split.x) == 2 * len(shared.x) and split.cost < shared.cost
    values = split.space.values(split.x)
    assert values == pytest.approx(gaps, rel=0.05)
    assert fits.get(["backlash"], ["backlash"]) is split and fits.get(["backlash"]) is shared


def test_every_wiring_is_a_start():
    fits = finger_fits(lambda u: u[:, ::-1], ["servo_swap"])
    space = fits.problem.space(("servo_swap",))
    ways = {int(space.values(start)[0]) for start in starts(fits.problem, "servo_swap")}
    assert ways == {1, 2, 3}  # the sign of either channel, and the two exchanged
    assert fits.get(["servo_swap"]).params["servo_swap.case"] == 3.0


def test_what_happens_once_is_looked_for_at_instants_all_over_the_run():
    fits = finger_fits(lambda u: u, ["anchor_slip"])
    space = fits.problem.space(("anchor_slip",))
    at = [space.values(start)[space.instant] for start in starts(fits.problem, "anchor_slip")]
    low, high = (space.values(end)[space.instant] for end in (space.low, space.high))
    spread = np.unique(np.round([float(v[0]) for v in at], 6))
    assert (
        len(spread) >= INSTANTS and np.diff(spread).max() < 1.5 * float(high[0] - low[0]) / INSTANTS
    )


def test_a_limit_that_is_hardly_reached_is_found():
    """From the declared start of 8 mm every step makes the fit worse; a start closer to no limit
    improves it.
    """
    most = 0.93 * np.abs(standard_protocol().command).max()
    fits = finger_fits(lambda u: np.clip(u, -most, most), ["saturation", "gain"])
    found = fits.get(["saturation"])
    assert found.cost < 0.5 * fits.null.cost and found.space.values(found.x) == pytest.approx(
        most, rel=0.02
    )
    assert fits.get(["gain"]).cost > 2.0 * found.cost


@pytest.mark.parametrize("signs", [(-1, -1, -1, 1), (1, -1, -1, -1), (-1, 1, 1, -1)])
def test_a_pulley_is_found_whatever_its_signs(signs):
    """A radius is compared at the signs that fit it: at other signs the right one would look
    worst.
    """
    sine, cosine = np.array([1.5, 1.2]) * signs[:2], np.array([0.8, 1.3]) * signs[2:]
    radius = 2.2
    fits = finger_fits(
        lambda u: u + sine * np.sin(u / radius) + cosine * (np.cos(u / radius) - 1.0),
        ["gain", "eccentric_pulley"],
    )
    found = fits.get(["eccentric_pulley"]).params
    assert found["eccentric_pulley.radius"] == pytest.approx(radius, rel=0.02)
    for channel in range(2):
        assert found[f"eccentric_pulley.sine[{channel}]"] == pytest.approx(sine[channel], abs=0.1)
        assert found[f"eccentric_pulley.cosine[{channel}]"] == pytest.approx(
            cosine[channel], abs=0.1
        )


def test_slopes_of_old_fits_are_dropped_and_found_again(monkeypatch):
    """A long log with hundreds of fits must not fill the memory."""
    fits = arm_fits({"backlash.gap": 2.0})
    known = {name: fits.get([name]).slopes.copy() for name in NAMES}
    most = 2 * max(slopes.nbytes for slopes in known.values())
    monkeypatch.setattr(fits_module, "SLOPES_BYTES", most)
    fits.get(NAMES[:2])
    held = [fit for fit in map(fits.get, ([name] for name in NAMES)) if "slopes" in fit.__dict__]
    assert len(held) < len(NAMES) and sum(fit.slopes.nbytes for fit in held) <= most
    for name, slopes in known.items():
        off = 0.05 * np.abs(slopes).max()  # secants carry slopes on
        np.testing.assert_allclose(fits.get([name]).slopes, slopes, atol=off)
