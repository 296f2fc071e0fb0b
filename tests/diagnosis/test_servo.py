"""Where a run has encoders, what the servo does is distinguished from what the tendon does."""

import re
from dataclasses import replace

import numpy as np
from finger_runs import finger_run

from softmap_edge import builtin_model, diagnose
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.servo_lag import servos

STEP = 0.015  # mm: a tick of a spool of 10 mm


def encoders(run, delay, gain=1.0):
    """Encoder ticks of servos that follow late; written apart from the
    library.
    """
    late = [np.interp(run.t - d, run.t, c) for d, c in zip(delay, run.command.T)]
    return np.round(gain * np.stack(late, axis=1) / STEP) * STEP


def test_servo_delay_is_not_the_tendon_s():
    run = finger_run()
    present = encoders(run, [0.18, 0.18])
    seen = finger_run(["backlash"], {"backlash.gap": 1.0}, acting=lambda u: present)
    run = replace(seen, present=present)
    found = diagnose(
        builtin_model(), run, effects=["latency", "lag", "gain", "backlash", "hysteresis"]
    )
    assert [e.name for e in found.effects] == ["backlash"]
    assert [row.channel for row in found.servo] == [0, 1]
    for row in found.servo:
        assert [e.name for e in row.effects] == ["latency"] and row.unit == "mm"
        value = row.effects[0].params["latency.delay"]
        assert abs(value.value - 0.18) < 0.01
        assert row.error.value < 0.1 * row.error.model

    assert re.search(r"channel 1: latency.delay 0.1(8|79)", str(found))
    again = Diagnosis.from_dict(found.to_dict())
    assert again.servo == found.servo
    older = {k: v for k, v in found.to_dict().items() if k != "servo"}
    assert Diagnosis.from_dict(older).servo == ()


def test_each_servo_for_itself_and_silence():
    run = finger_run()
    mixed = np.stack(
        [encoders(run, [0.0, 0.0])[:, 0], encoders(run, [0.3, 0.3], 0.8)[:, 1]], axis=1
    )
    first, second = servos(replace(run, present=mixed), ["latency", "lag", "gain", "offset"])
    assert first.effects == () and first.error.model < STEP
    assert {e.name for e in second.effects} == {"latency", "gain"}
    still = np.full_like(mixed, 3.0)
    assert servos(replace(run, present=still), ["latency"]) == [] and servos(run, ["latency"]) == []


def test_encoders_of_any_of_several_runs_are_read():
    run = replace(finger_run(), command_unit="mm")
    reported = replace(run, present=encoders(run, [0.18, 0.18]))
    found = diagnose(builtin_model(), [run, reported], effects=["latency", "lag"])
    assert [row.effects[0].name for row in found.servo] == ["latency", "latency"]
