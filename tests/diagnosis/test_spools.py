"""The radius of the spools is known from a calibration or a mapping; then an eccentric pulley has
no free period.
"""

from dataclasses import replace

import numpy as np
import pytest
from finger_runs import finger_run

from softmap_edge import Run, diagnose
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.spools import spool_of
from softmap_edge.model.bundle import builtin_model
from softmap_edge.model.servo_calibration import TURN, Calibration

RADIUS = 4.6  # mm: a turn is 29 mm, the run sees 24 mm of it
CANDIDATES = [
    "gain",
    "offset",
    "asymmetry",
    "dead_zone",
    "saturation",
    "eccentric_pulley",
    "backlash",
]


def calibration(radii, crossed=0.0, unit="mm", signs=(1.0, -1.0)):
    """A calibration whose servos wind on spools of these radii, with a share of the other servo's
    slope.
    """
    own = np.diag(2.0 * np.pi * np.array(radii) * signs / TURN)
    return Calibration.stated(
        own + crossed * own[::-1], [0.0, 0.0], [2048.0, 2048.0], "told", unit=unit
    )


def pulley(u, sine=(0.7, 0.5), cosine=(0.5, -0.6)):
    angle = u / RADIUS
    return u + np.array(sine) * np.sin(angle) + np.array(cosine) * (np.cos(angle) - 1.0)


def test_a_calibration_gives_the_radius_of_spools_that_wind_one_channel_each():
    model = builtin_model()
    known = spool_of(replace(model, calibration=calibration([5.0, 5.0])), [])
    assert (
        known.radius == pytest.approx(5.0) and known.sigma == 0.0 and "calibration" in known.source
    )
    crossed, turned = calibration([5.0, 5.0], crossed=0.2), calibration([5.0, 5.0], unit="deg")
    for doubtful in (calibration([5.0, 6.0]), crossed, turned):
        assert spool_of(replace(model, calibration=doubtful), []) is None
    measured = replace(calibration([5.0, 5.0]), sigma_A=np.full((2, 2), 1e-5))
    assert spool_of(replace(model, calibration=measured), []).sigma == pytest.approx(
        1e-5 * TURN / (2.0 * np.pi)
    )


@pytest.mark.parametrize("wrong", ["5", np.nan, -3.0, 0.0, [5.0, 5.0], 1e9])
def test_a_run_that_declares_no_radius_of_a_spool_is_taken_to_declare_none(wrong):
    model, t = builtin_model(), np.arange(3.0)
    good, bad = (
        Run(t, np.zeros((3, 2)), extra={"spool_radius_mm": np.array(v)}) for v in (5.0, wrong)
    )
    assert spool_of(model, [good]).radius == 5.0 and spool_of(model, [good]).sigma is None
    assert spool_of(model, [bad]) is None and spool_of(model, [good, bad]) is None


def test_the_known_radius_is_no_parameter_of_the_fit():
    record = Record(
        replace(builtin_model(), calibration=calibration([RADIUS, RADIUS])), finger_run()
    )
    layout = record.layout(("eccentric_pulley",))
    i = layout.labels.index("eccentric_pulley.radius")
    assert (
        layout.null[i]
        == layout.start[i]
        == layout.low[i]
        == layout.high[i]
        == pytest.approx(RADIUS)
    )
    assert "eccentric_pulley.radius" in record.untold


@pytest.fixture(scope="module")
def run():
    return finger_run(acting=pulley)


@pytest.mark.long
def test_a_pulley_of_known_radius_is_named_before_a_full_turn_is_seen(run):
    """Without the radius, a part of a sine is any smooth map of the commands."""
    model = builtin_model()
    free = diagnose(model, run, effects=CANDIDATES)
    assert free.verdict != "identified" and free.families[0].law == "open"
    known = replace(model, calibration=calibration([RADIUS, RADIUS]))
    for found in (diagnose(known, run, effects=CANDIDATES), declared(model, run)):
        assert found.verdict == "identified" and [one.name for one in found.effects] == [
            "eccentric_pulley"
        ]
        params = {label.split(".")[1]: p.value for label, p in found.effects[0].params.items()}
        assert params.pop("radius") == pytest.approx(RADIUS)
        true = {"sine[0]": 0.7, "sine[1]": 0.5, "cosine[0]": 0.5, "cosine[1]": -0.6}
        assert params == pytest.approx(true, abs=0.05)


def declared(model, run):
    return diagnose(
        model, replace(run, extra={"spool_radius_mm": np.array(RADIUS)}), effects=CANDIDATES
    )


def test_a_wrong_radius_is_not_believed(run):
    """With spools declared as 12 mm, the law does not reach what the family explains."""
    wrong = replace(builtin_model(), calibration=calibration([12.0, 12.0]))
    found = diagnose(wrong, run, effects=CANDIDATES)
    assert not (
        found.verdict == "identified"
        and [one.name for one in found.effects] == ["eccentric_pulley"]
    )


def test_an_effect_of_a_known_radius_is_added_to_the_model(run):
    model = builtin_model()
    found = Diagnosis.from_dict(declared(model, run).to_dict())
    better = found.added(model, ["eccentric_pulley"])
    assert better.params["eccentric_pulley.radius"] == pytest.approx(RADIUS)
