"""Words for the guard's actions, causes and denials: one set of them, for every state and
cause.
"""

import re
from pathlib import Path

import pytest
from loops import STATES

from softmap_edge.robot.commissioning.jog import Jog
from softmap_edge.robot.control.controller import REQUESTS
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.rig import Rig, RigServo


def test_every_state_and_cause_of_the_guard_has_its_words():
    said = {words.sentence({"state": state, "cause": "late", "servo": 1}) for state in words.STATES}
    assert len(said) == len(words.STATES)
    assert "Holding where it is; it releases tension soon: servo 2 did not answer in time" in said
    assert words.sentence({"state": "engaged", "cause": "deadman"}) == "Driving"
    unsure = "torque off was sent; not every servo confirmed it"
    assert unsure in words.sentence({"state": "fault", "cause": "silent"})
    assert unsure in words.sentence(
        {"state": "fault", "cause": "loop", "torque": True, "rescued": "but servo 1 did not"}
    )
    assert "torque is off" in words.sentence({"state": "fault", "cause": "hot", "torque": False})
    assert "was released" in words.sentence(
        {"state": "fault", "cause": "loop", "rescued": "it was released"}
    )
    assert words.level({"state": "fault"}) == "fault" and words.level({}) == "off"
    assert words.limits({"slowed": True, "outside": False}) == ["as fast as allowed"]
    assert set(words.NAMES) == set(words.STATES) == set(STATES), "every state that the loop tells"
    guard = (Path(__file__).parents[2] / "rust/servo/guard/mod.rs").read_text()
    causes = guard.split("pub enum Cause {")[1].split("}")[0]
    named = [
        line.strip(" ,").lower()
        for line in causes.splitlines()
        if line.strip() and "///" not in line
    ]
    assert set(named) <= set(words.CAUSES), "a cause of the guard without words"


@pytest.mark.parametrize(
    "said, line",
    [
        ("from(safe_stop)", "not allowed in state slackening"),
        ("trouble(late)", "something is wrong: a servo did not answer in time"),
        ("torque", "a servo has torque; `softmap servo off` releases it"),
        ("undriven", "no fresh target, or the enable key is not pressed"),
        ("something new(2)", "something new(2)"),
    ],
)
def test_what_is_denied_is_reported_in_words(said, line):
    assert words.denied(said) == line


def test_what_leads_on_fits_the_state_and_home_is_lost_where_the_guard_loses_it():
    for cause in words.LOSES_HOME:
        assert "softmap servo home" in words.onward({"state": "fault", "cause": cause})
        assert "softmap servo home" in words.lost({"state": "fault", "cause": cause}, "")
    for cause, line in {
        "hot": "let it cool",
        "emergency": "release the emergency",
        "loop": "start another",
    }.items():
        assert words.onward({"state": "fault", "cause": cause}).startswith(line)
        assert "softmap servo home" not in words.lost({"state": "fault", "cause": cause}, "")
    for state in ("connected", "off"):
        assert "softmap servo home" in words.onward({"state": state, "cause": "silent"})
    assert "torque goes off; let it cool" in words.onward({"state": "safe_stop", "cause": "hot"})
    assert words.onward({"state": "safe_stop", "cause": "stale"}).startswith(
        "wait until it is ready"
    )
    assert words.onward({"state": "homed"}) == 'call request("arm") and engage() first'
    assert words.onward({"state": "ready"}) == "call engage() first"
    page = (Path(__file__).parents[2] / "docs/reference/safety.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in page.splitlines()
        if line.startswith("| ")
    ]
    lost = {row[0] for row in rows if len(row) == 4 and "home the robot again" in row[3]}
    assert lost == set(words.LOSES_HOME)


def test_no_word_of_the_guards_own_is_shown():
    report = {"state": "safe_stop", "cause": "stale"}
    assert words.where(report) == "in state slackening (no target came in time)"
    assert (
        words.where({"state": "fault", "cause": "hot", "servo": 1})
        == "in state fault (servo 2 is too hot)"
    )
    assert words.where({"state": "ready", "cause": "none"}) == "in state ready"

    class Ended:
        state, report, limits = "safe_stop", {"state": "safe_stop", "cause": "stale"}, None

    jog = object.__new__(Jog)
    jog.robot, jog.rig = Ended(), Rig("PORT", 57_600, (RigServo(1, "XL330-M288"),))
    with pytest.raises(
        Exception,
        match=r"ended the jog: the robot is in state slackening \(no target came in time\)",
    ):
        jog.press(0, 1.0)


def test_why_driving_ended_is_reported_once_and_with_a_remedy():
    tripped = {"state": "fault", "cause": "tripped", "servo": 0}
    assert (
        words.lost(tripped, words.sentence(tripped))
        == "end this, and home the robot again (softmap servo home)"
    )
    hot = {"state": "fault", "cause": "hot", "servo": 0}
    assert words.lost(hot, words.sentence(hot)) == "let go of the key, then reset the fault"
    held = {"state": "hold", "cause": "deadman"}
    assert (
        words.lost(held, "no hand") == "driving ended: no hand; release the key and press it again"
    )
    unproved = {"state": "connected", "cause": "tripped"}
    assert "home the robot again" in words.lost(unproved, words.sentence(tripped))


@pytest.mark.parametrize("cause", words.CAUSES)
@pytest.mark.parametrize("state", words.STATES)
def test_each_reader_is_named_what_they_have(state, cause):
    """A user of the command line has no methods; a program calls only what there is."""
    report = {"state": state, "cause": cause, "servo": 0, "ids": [7]}
    typed = words.onward(report, terminal=True)
    assert typed.endswith("run the same command again")
    assert not re.search(r"acknowledge|engage|Controller|\(\)", typed), typed
    assert ("servo home" in typed) == ("servo home" in words.onward(report))
    assert "softmap servo home" not in words.onward(report, terminal=True, has_rig=False)
    for name in re.findall(r'request\("(\w+)"\)', words.onward(report)):
        assert name in REQUESTS


def test_a_cause_that_is_sensed_is_named_with_value_and_limit():
    limits = {"servos": [{"hot": 65.0, "voltage": (3.5, 7.0), "low": 0, "high": 900}] * 2}
    report = {
        "state": "fault",
        "cause": "hot",
        "ids": [4, 9],
        "temperature_C": [66.0, 40.0],
        "voltage_V": [5.0, 2.9],
    }
    assert (
        words.where(report, limits)
        == "in state fault (servo 4 is too hot: 66 °C, allowed is below 65 °C)"
    )
    assert words.denied("trouble(hot)", report, limits).startswith(
        "servo 4 is too hot: 66 °C, allowed is below 65 °C; "
    )
    said = words.denied("trouble(voltage)", report, limits)
    assert said.startswith(
        "servo 9 has a supply voltage of 2.9 V, allowed are 3.5 to 7 V; check the power supply"
    )
    said = words.denied("outside", report | {"position": [950, 10]}, limits)
    assert said.startswith(
        "servo 4 stands at 950 ticks, outside its window of 0 to 900; turn it back by `softmap "
        "servo move"
    )
    assert "check the cables" in words.denied("trouble(late)", report, limits)
    assert "too hot" in words.denied("trouble(hot)", {"temperature_C": [None]}, limits), (
        "a report without values"
    )
