"""Outputs of any kind: a force–displacement log from the CSV to the report, in its own unit, with
its loop drawn.
"""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import SOFTMAP

from softmap_edge import Run, compare, diagnose, import_logs, learn_model, load_bundle, read_mapping
from softmap_edge.comparison.comparison import MemorylessFloor
from softmap_edge.comparison.in_unit import comparison_in_unit
from softmap_edge.comparison.series import Loop, series
from softmap_edge.comparison.text import comparison_text
from softmap_edge.errors import RunError
from softmap_edge.model.bundle import save_bundle
from softmap_edge.report.html import write_html
from softmap_edge.run.in_unit import in_unit, words_in_unit
from softmap_edge.run.output import FARTHEST, RANGE_MM, Output, output_of

# N/mm of the spring and of the stop, and mm at which the stop slips
STIFF, STOP, SLIP = 2.0, 6.0, 3.0
MAPPING = """schema = "softmap.mapping/1"
robot = "damper"
[[log]]
time = "none"
command = { columns = ["displacement"], unit = "mm" }
output = { columns = ["force"], unit = "N" }
"""


def softmap(*argv: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([SOFTMAP, *map(str, argv)], capture_output=True, text=True)


def stop(x: np.ndarray) -> np.ndarray:
    """Return the force (N) of a spring in parallel with a dry-friction element that slips, from the
    law itself.
    """
    force, held = np.empty_like(x), 0.0
    for k, step in enumerate(np.diff(x, prepend=x[0])):
        held = np.clip(held + step, -SLIP, SLIP)
        force[k] = STIFF * x[k] + STOP * held
    return force


def moves(seed: int, rows: int = 1200) -> np.ndarray:
    """Return a displacement (mm) whose amplitude varies, so that no single loop is drawn."""
    s, rng = np.arange(rows) / rows, np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, 2)
    return (
        20.0
        * np.sin(2 * np.pi * 6 * s + phase[0])
        * (0.6 + 0.4 * np.sin(2 * np.pi * 0.8 * s + phase[1]))
    )


def write(path: Path, x: np.ndarray, force: np.ndarray) -> Path:
    rows = (f"{a:.6f},{b:.6f}" for a, b in zip(x, force))
    path.write_text("\n".join(["displacement,force", *rows]) + "\n")
    return path


@pytest.fixture(scope="module")
def damper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two logs of a damper, their mapping, runs and a model of the first."""
    folder = tmp_path_factory.mktemp("damper")
    (folder / "map.toml").write_text(MAPPING)
    for name, seed in (("fit", 1), ("held", 2)):
        x = moves(seed)
        noise = np.random.default_rng(seed + 10).normal(0.0, 0.2, len(x))
        log = write(folder / f"{name}.csv", x, stop(x) + noise)
        done = softmap("import", log, "--map", folder / "map.toml", "--out", folder / f"{name}.npz")
        assert done.returncode == 0, done.stderr
    assert softmap("learn", folder / "fit.npz", "--out", folder / "model").returncode == 0
    return folder


def test_a_csv_without_time_becomes_a_run_of_outputs(damper: Path) -> None:
    run = Run.load(damper / "fit.npz")
    x = moves(1)
    noise = np.random.default_rng(11).normal(0.0, 0.2, len(x))
    assert run.timeless and run.output is not None
    assert (run.output.names, run.output.unit) == (("force",), "N")
    np.testing.assert_allclose(run.outputs[:, 0], stop(x) + noise, atol=1e-6)
    np.testing.assert_allclose(run.commands()[:, 0], x, atol=1e-6)
    again = Run.load(damper / "fit.npz")
    assert again.hash() == run.hash() and run.frames == len(x)


def test_check_and_show_say_what_was_measured_in_its_unit(damper: Path) -> None:
    said = softmap("check", damper / "fit.npz").stdout
    assert "force:" in said and " N\n" in said and "no time recorded" in said
    for absent in ("base frame", "marker", "along the body", "orientation", "delay and lag"):
        assert absent not in said
    shown = softmap("show", damper / "fit.npz").stdout
    assert re.search(r"^  output +\[1200, 1\]", shown, re.M) and "last marker" not in shown


def test_learn_states_its_error_in_newtons(damper: Path) -> None:
    done = softmap("learn", damper / "fit.npz", "--out", damper / "again", "--force")
    stated = float(re.search(r"error ([\d.]+) N RMS", done.stdout).group(1))
    model, run = load_bundle(damper / "again"), Run.load(damper / "fit.npz")
    assert (
        model.output == run.output
        and "latency" not in model.chain_names
        and "lag" not in model.chain_names
    )
    assert stated == pytest.approx(model.output.value(model.vertex_error_mm), rel=0.01)


def test_compare_reports_newtons_that_are_those_of_the_log(damper: Path) -> None:
    model, run = load_bundle(damper / "model"), Run.load(damper / "held.npz")
    predicted = model.output.values(model.predict(run))[:, 0]
    truth = float(np.sqrt(np.mean((predicted - run.outputs[:, 0]) ** 2)))
    found = compare(model, run)
    assert comparison_in_unit(found).error["rms_mm"] == pytest.approx(truth, rel=2e-3)
    lowest = replace(found, memoryless=MemorylessFloor(3.0, 20, 50, 90, 4.0))
    shown = comparison_in_unit(lowest).memoryless
    assert (shown.mm, shown.error_mm) == (model.output.value(3.0), model.output.value(4.0))
    text = comparison_text(found)
    assert (
        "outputs, N" in text
        and "tip" not in text
        and "RMS mm" not in text
        and "time since" not in text
    )
    stated = float(re.search(r"^  rms +([\d.]+)", text, re.M).group(1))
    assert stated == pytest.approx(truth, rel=0.01)
    assert json.loads(
        softmap("compare", damper / "held.npz", "--bundle", damper / "model", "--json").stdout
    )["made_from"]["output"] == {
        "names": ["force"],
        "unit": "N",
        "mm_per_unit": model.output.mm_per_unit,
    }


def test_diagnose_runs_and_speaks_of_the_output(damper: Path) -> None:
    done = softmap(
        "diagnose",
        damper / "fit.npz",
        "--held-out",
        damper / "held.npz",
        "--bundle",
        damper / "model",
        "--out",
        damper / "found.json",
        "--html",
        damper / "found.html",
    )
    assert done.returncode == 0, done.stderr
    text = done.stdout
    assert (
        re.search(r"Error ladder \(.*, N\)", text)
        and "mm RMS" not in text
        and "the body" not in text
    )
    for geometry in ("payload", "gravity", "mount", "twist", "lens", "camera_drift"):
        assert geometry not in text
    page = (damper / "found.html").read_text()
    assert (
        "Output against command" in page
        and "Path of the tip" not in page
        and "Error over time" not in page
    )
    assert not re.search(r"\d mm RMS|mm rms", page)


def test_without_time_no_delay_or_rate_is_looked_for(damper: Path) -> None:
    model, run = load_bundle(damper / "model"), Run.load(damper / "fit.npz")
    found = diagnose(model, run)
    timed = {"latency", "lag", "rate_limit", "creep", "tendon_creep", "zero_drift", "clock_shift"}
    why = {row.name: row.why for row in found.not_testable}
    assert {name for name in timed if "no time" in why.get(name, "")} == timed
    assert not timed & {row.name for row in found.effects}


def test_an_affine_output_is_learned_exactly_and_kept_by_a_bundle(tmp_path: Path) -> None:
    """The chord of a marker is an angle: its polynomial fits an affine output within 2e-4 of the
    range.
    """
    x = moves(3)
    run = Run.of_outputs(
        7.5 * x[:, None] - 4.0,
        "N",
        ["force"],
        t=np.arange(1200) / 20,
        t_seen=np.arange(1200) / 20,
        command=x[:, None],
    )
    model = learn_model(run)
    assert model.output.value(model.vertex_error_mm) < 2e-4 * np.ptp(run.outputs)
    save_bundle(model, tmp_path / "b")
    back = load_bundle(tmp_path / "b")
    assert back.output == model.output
    np.testing.assert_array_equal(back.predict(run), model.predict(run))


def test_runs_of_other_scales_are_compared_in_the_models_own(damper: Path) -> None:
    model, run = load_bundle(damper / "model"), Run.load(damper / "held.npz")
    other = Output(run.output.names, "N", 3.0 * run.output.mm_per_unit)
    scaled = dataclasses.replace(run, output=other, markers=other.markers(run.outputs))
    one, two = compare(model, run), compare(model, scaled)
    assert two.error["rms_mm"] == pytest.approx(one.error["rms_mm"], rel=1e-9)


def test_a_run_of_another_output_is_refused(damper: Path) -> None:
    model, run = load_bundle(damper / "model"), Run.load(damper / "held.npz")
    volts = dataclasses.replace(run, output=dataclasses.replace(run.output, unit="V"))
    with pytest.raises(RunError, match="force in V, this model of 'damper' of force in N"):
        compare(model, volts)
    with pytest.raises(RunError, match="of places, this model"):
        compare(model, dataclasses.replace(run, output=None))


@pytest.mark.parametrize("amplitude", [1e-6, 1.0, 3e5])
def test_outputs_of_any_size_move_the_markers_as_far(amplitude: float) -> None:
    """Newtons, kilonewtons or micronewtons: the same markers up to two digits of scale, the same
    figures.
    """
    x = moves(1)
    values = amplitude * stop(x)[:, None]
    run = Run.of_outputs(
        values, "N", t=np.arange(1200) / 20, t_seen=np.arange(1200) / 20, command=x[:, None]
    )
    assert np.ptp(run.markers[..., 0]) == pytest.approx(RANGE_MM, rel=0.05)
    np.testing.assert_allclose(run.outputs, values, rtol=1e-12)


def test_a_file_may_hold_the_outputs_as_they_are(tmp_path: Path) -> None:
    t, values = np.arange(30) / 10, np.sin(np.arange(30))[:, None] * [1.0, 2.0]
    values[4, 1] = np.nan
    np.savez(
        tmp_path / "r.npz",
        t=t,
        command=t[:, None],
        t_seen=t,
        output=values,
        output_unit="deg",
        output_names=np.array(["a", "b"]),
    )
    run = Run.load(tmp_path / "r.npz")
    np.testing.assert_allclose(run.outputs, values, rtol=1e-12)
    assert run.output.names == ("a", "b") and run.marker_names == ["a", "b"] and not run.timeless
    run.save(tmp_path / "s.npz")
    assert Run.load(tmp_path / "s.npz").hash() == run.hash()
    assert run.at(run.t_seen < 1.0).outputs.shape == (10, 2)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('time = "none"', 'time = "nothing"'), "time"),
        ((', unit = "N"', ""), "unit is missing"),
        (('["force"]', '["thrust"]'), "no column thrust"),
        (('"N" }', '"N", names = ["a", "b"] }'), "expected 1 texts"),
        (("[[log]]", "[seen]\nrate_hz = 5.0\n[[log]]"), "rate_hz in a mapping with time"),
    ],
)
def test_a_mapping_that_cannot_be_right_says_why(
    damper: Path, tmp_path: Path, change: tuple[str, str], said: str
) -> None:
    file = tmp_path / "map.toml"
    file.write_text(MAPPING.replace(*change))
    with pytest.raises(RunError, match=said):
        import_logs([damper / "fit.csv"], read_mapping(file))


def test_an_output_that_hardly_moves_for_its_size_asks_for_an_offset() -> None:
    values = 1000.0 + np.sin(np.arange(50.0))[:, None]
    with pytest.raises(RunError, match="subtract its mean"):
        output_of(values, "N")
    output_of(values - 1000.0 + 2.0 * (FARTHEST - 0.6), "N")
    with pytest.raises(RunError, match="no column moves"):
        output_of(np.ones((5, 1)), "N")


def test_sentences_turn_the_outputs_and_leave_the_commands() -> None:
    half = Output(("force",), "N", 2.0)
    text = "gap 1.39 mm; the held-out error falls from 3.00 to 1.50 mm RMS, 0.40 mm RMS are left"
    assert (
        words_in_unit(text, half)
        == "gap 1.39 mm; the held-out error falls from 1.50 to 0.750 N RMS, 0.200 N RMS are left"
    )
    document = {
        "made_from": {"output": half.to_dict()},
        "effects": [
            {
                "params": {"backlash.gap": {"value": 4.0, "unit": "mm"}},
                "displacement_mm": {"fitted": 3.0},
            }
        ],
        "error": {
            "unit": "mm",
            "model": 3.0,
            "ladder": [{"added": "backlash", "value": 1.0}],
            "floor": None,
        },
        "where": {"before": {"command": [{"label": "home", "n": 4, "rms_mm": 2.0}]}},
    }
    found = in_unit(document)
    assert found["effects"][0] == {
        "params": {"backlash.gap": {"value": 4.0, "unit": "mm"}}, "displacement_mm": {"fitted": 1.5}
    }  # fmt: skip
    assert found["error"] == {
        "unit": "N",
        "model": 1.5,
        "ladder": [{"added": "backlash", "value": 0.5}],
        "floor": None,
    }
    assert found["where"]["before"]["command"][0]["rms_mm"] == 1.0


def test_the_loop_is_one_cycle_and_the_worst(damper: Path) -> None:
    from softmap_edge.report.loop_figure import worst_cycle

    x = np.concatenate(
        [np.linspace(0, 1, 11), np.linspace(1, -1, 21)[1:], np.linspace(-1, 1, 21)[1:]]
    )
    # turns at 10, 30, 50, 70
    x = np.concatenate([x, np.linspace(1, -1, 21)[1:], np.linspace(-1, 1, 21)[1:]])
    wrong = np.zeros(len(x))
    wrong[55] = 5.0
    cycle = worst_cycle(Loop("force", x, wrong, np.zeros(len(x)), None))
    assert (cycle.start, cycle.stop) == (30, 71)
    model, run = load_bundle(damper / "model"), Run.load(damper / "held.npz")
    drawn = series(run, model).loops
    assert len(drawn) == 1 and drawn[0].name == "force"
    np.testing.assert_allclose(drawn[0].seen, run.outputs[:, 0])


def test_the_page_of_two_models_draws_the_loop_before_and_after(
    damper: Path, tmp_path: Path
) -> None:
    model, run = load_bundle(damper / "model"), Run.load(damper / "held.npz")
    other = model.with_effects(["backlash"], {"backlash.gap": 4.0})
    page = write_html(
        tmp_path / "p.html",
        [compare(model, run), compare(other, run)],
        None,
        series(run, model, other),
    )
    text = page.read_text()
    assert "Output against command" in text and " N RMS" in text and "mm RMS" not in text
