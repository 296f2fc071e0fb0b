"""The benchmark on outside data is correct: derivatives, laws, errors and peers against exact
answers.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benches.outside import bouc_wen, tanks
from benches.outside.case import Case, along_x, error, folder, places
from benches.outside.ours import Answer, answer, library_laws
from benches.outside.rate_free import cubic, fitted, play, stop
from benches.outside.table import PEERS, Row, document, lines, page
from softmap_edge import Run, learn_model

ROOT = Path(__file__).parents[2]


def lagged_run(seed: int, back: int, rows: int = 900) -> Run:
    """Return a run whose output is a quadratic static map of the command `back` rows earlier."""
    t = np.arange(rows) / 20.0
    rng = np.random.default_rng(seed)
    u = np.convolve(rng.normal(size=rows + 60), np.hanning(40) / 20.0, "valid")[:rows]
    late = np.interp(t - back / 20.0, t, u)
    return Run.of_outputs((3.0 * late)[:, None], "N", ["force"], t=t, t_seen=t, command=u[:, None])


def case_of(fit: Run, held: Run, **more: object) -> Case:
    given = dict(
        name="test",
        about="A test.",
        values=along_x,
        fit=fit,
        held={"held": held},
        model=lambda: learn_model(fit),
        law=None,
        law_name="none",
        unit="NRMSE",
        expected="delay",
        lags=(0, 1, 2, 3, 4, 5, 6),
    )
    return Case(**(given | more))


def test_the_derivative_of_a_period_is_exact():
    t = np.arange(bouc_wen.PERIOD) / bouc_wen.RATE_HZ
    w = 2 * np.pi * bouc_wen.RATE_HZ / bouc_wen.PERIOD * np.array([55, 1000])
    x = np.sin(w[0] * t) + 0.3 * np.cos(w[1] * t)
    truth = -(w[0] ** 2) * np.sin(w[0] * t) - 0.3 * w[1] ** 2 * np.cos(w[1] * t)
    np.testing.assert_allclose(
        bouc_wen._derivative(x, True), truth, atol=1e-6 * np.abs(truth).max()
    )
    fine = bouc_wen._finer(x, True)
    s = np.arange(len(fine)) / (bouc_wen.FINER * bouc_wen.RATE_HZ)
    np.testing.assert_allclose(fine, np.sin(w[0] * s) + 0.3 * np.cos(w[1] * s), atol=1e-9)


def test_a_sweep_is_derived_within_its_ends():
    t = np.arange(20_000) / bouc_wen.RATE_HZ
    w = 2 * np.pi * 31.7  # fits no whole number of periods
    edge = int(bouc_wen.EDGE_S * bouc_wen.RATE_HZ)
    off = bouc_wen._derivative(np.sin(w * t), False) + w**2 * np.sin(w * t)
    assert np.abs(off[edge:-edge]).max() < 2e-3 * w**2
    fine = bouc_wen._finer(np.sin(w * t), False)
    s = np.arange(len(fine)) / (bouc_wen.FINER * bouc_wen.RATE_HZ)
    assert np.abs(fine - np.sin(w * s))[bouc_wen.FINER * edge : -bouc_wen.FINER * edge].max() < 2e-3


def test_play_and_stop_add_up_to_what_goes_in():
    """A stop of slip g/2 is the input minus a play of gap g, from a common start: Brokate and
    Sprekels, 1996.
    """
    x = 5.0 * np.sin(np.linspace(0.0, 20.0, 3000)) * np.linspace(0.2, 1.0, 3000)
    np.testing.assert_allclose(play(x, 3.0) + stop(x, 1.5) + x[0] - play(x, 3.0)[0], x, atol=1e-12)


def test_the_bouc_wen_element_keeps_its_closed_forms():
    rise = np.linspace(0.0, 3.0, 40_000)
    np.testing.assert_allclose(bouc_wen.hysteresis(rise, 0.0, 0.0, 1.0), rise, atol=1e-9)
    # loading from rest with ν = 1: ζ = (1 − exp(−(γ + δ) y)) / (γ + δ)
    np.testing.assert_allclose(
        bouc_wen.hysteresis(rise, 0.8, 0.3, 1.0),
        (1 - np.exp(-1.1 * rise)) / 1.1,
        rtol=1e-6,
        atol=1e-9,
    )


def test_the_tanks_settle_where_the_flows_balance():
    k1, k2, k3, k4 = 0.05, 0.06, 0.055, 0.04
    level = tanks.levels(np.full(3000, 2.0), 1.0, k1, k2, k3, k4, 0.0, 1.0)
    high = (k4 * 2.0 / k1) ** 2
    assert level[-1] == pytest.approx((k2 * np.sqrt(high) / k3) ** 2, rel=1e-6)
    assert level.max() <= tanks.FULL


def test_a_law_by_hand_is_recovered():
    u = 30.0 * np.sin(np.arange(1200) / 60.0) * (0.5 + 0.5 * np.arange(1200) / 1200)
    t = np.arange(1200) / 20.0
    seen = cubic(play(u, 12.0) / 30.0) @ np.array([1.0, 20.0, -3.0, 5.0])
    run = Run.of_outputs(seen[:, None], "N", t=t, t_seen=t, command=u[:, None])
    found = fitted(
        lambda one, x: cubic(play(one.commands()[:, 0], x[0]) / 30.0), run, seen[:, None],
        {"held": run}, [[5.0]], [0.0], [50.0],
    )  # fmt: skip
    assert np.abs(found["held"][:, 0] - seen).max() < 1e-2 * np.ptp(seen)


def test_errors_are_what_they_say():
    run = lagged_run(1, 0)
    case = case_of(run, run)
    seen = run.outputs
    assert error(case, run, np.full_like(seen, seen.mean())) == pytest.approx(1.0)
    t = np.arange(20) / 10.0
    markers = np.zeros((20, 2, 3)) + [[0.0, 0.0, 50.0], [0.0, 0.0, 100.0]]
    body = Run(t=t, t_seen=t, command=t[:, None], markers=markers)
    moved = places(markers + [3.0, 0.0, 4.0])
    assert error(case_of(body, body, values=places, unit="mm"), body, moved) == pytest.approx(5.0)


@pytest.mark.long
def test_peers_with_lags_find_a_delay_and_a_static_network_cannot():
    pytest.importorskip("pysindy")
    from benches.outside.peers import peers

    fit, held = lagged_run(1, 5, 500), lagged_run(2, 5, 500)
    case = case_of(fit, held)
    model = learn_model(fit).bare()
    found = {name: figures["held"] for name, figures in peers(case, model).items()}
    assert set(found) == set(PEERS)
    assert found["process"] < 0.1 and found["trees"] < 0.35
    assert found["network"] > 2.0 * found["process"]


@pytest.mark.long
def test_the_network_is_drawn_with_a_fixed_seed(monkeypatch):
    pytest.importorskip("pysindy")
    from benches.outside import peers

    monkeypatch.setattr(peers, "STEPS", 10)
    case = case_of(lagged_run(1, 0, 300), lagged_run(2, 0, 300))
    one, two = (peers._static(case, case.fit.outputs)["held"] for _ in range(2))
    np.testing.assert_array_equal(one, two)


def test_sindy_finds_a_recurrence_that_is_in_its_library():
    pytest.importorskip("pysindy")
    from benches.outside.peers import _sindy

    def filtered(seed: int) -> Run:
        run = lagged_run(seed, 0)
        u, at = run.commands()[:, 0], np.zeros(run.frames)
        for k in range(1, run.frames):
            at[k] = 0.9 * at[k - 1] + 0.5 * u[k - 1]
        return Run.of_outputs(at[:, None], "N", t=run.t, t_seen=run.t_seen, command=run.command)

    fit, held = filtered(1), filtered(2)
    case = case_of(fit, held)
    assert error(case, held, _sindy(case, fit.outputs)["held"]) < 0.15


def test_a_law_of_the_library_is_distinguished_from_the_others():
    t = np.arange(900) / 20.0
    u = 8.0 * np.sin(t) * (0.5 + 0.5 * np.sin(0.21 * t))
    run = Run.of_outputs((2.0 * play(u, 4.0))[:, None], "N", t=t, t_seen=t, command=u[:, None])
    case = case_of(run, run)
    found = {
        name: figures["held"] for name, figures in library_laws(case, learn_model(run)).items()
    }
    assert min(found, key=lambda name: found[name]) == "backlash"
    assert found["backlash"] < 0.02 < 5 * found["backlash"] + 0.1 < found["no law"]


def test_our_answer_needs_no_diagnosis_where_there_is_none():
    run = lagged_run(1, 0)
    ours, model = answer(case_of(run, lagged_run(2, 0), diagnose=False))
    assert ours.verdict == "–" and ours.before == ours.after and model.output == run.output


def test_the_table_and_the_page_hold_every_figure():
    said = ("latency.delay 0.2", "ambiguous", "memory", "backlash 0.90 (gap 1.4 mm)")
    ours, others = (
        Answer(*said, {"held": 0.5}, {"held": 0.25}, 1.0),
        {name: {"held": 0.3} for name in PEERS},
    )
    row = Row(
        "test",
        "NRMSE",
        "play",
        "play by hand",
        ours,
        others,
        {"held": 0.1},
        {"no law": {"held": 0.4}},
    )
    (_, _, line) = lines([row])
    assert (
        line.count("0.300") == len(PEERS) and "0.500 | 0.250" in line and line.endswith("0.100 |")
    )
    assert (
        "**ambiguous**: families: memory; backlash 0.90 (gap 1.4 mm) (learned: latency.delay 0.2)"
        in line
    )
    text = page([row], {"test": case_of(lagged_run(1, 0), lagged_run(2, 0))}, {"Trunk": "absent"})
    assert (
        line in text
        and "A test." in text
        and "Skipped: Trunk (absent)" in text
        and "| no law | 0.400 |" in text
    )
    assert json.loads(document([row], {}))["rows"][0]["law"] == {"held": 0.1}


@pytest.mark.long
def test_absent_sets_are_skipped_with_their_reason(tmp_path):
    pytest.importorskip("pysindy")
    code = (
        "import sys; from benches.outside import __main__ as m; m.folder = lambda name: None; "
        f"sys.argv = ['x', '--out', {str(tmp_path)!r}]; sys.exit(m.main())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("skipped: ") == 7 and "no folder 'bouc_wen'" in done.stdout
    assert json.loads((tmp_path / "outside.json").read_text())["skipped"]["Trunk"]


@pytest.mark.skipif(folder("memory") is None, reason="the data set 'memory' is absent")
def test_the_right_law_is_the_limit_on_real_play():
    from benches.outside.memory import vio

    at = folder("memory")
    assert at is not None
    for name, degrees in (("vio000", 1.3), ("vio090", 1.2)):
        case = vio(at, name)
        spread = float(np.std(case.values(np.asarray(case.held["held"].markers))))
        assert error(case, case.held["held"], case.law()["held"]) * spread < degrees
