"""`next` separates families first, then laws: the block that varies what only one of two families
depends on.
"""

import pytest
from played_blocks import LIMITS, MODEL, document, played

from softmap_edge import _core, next_experiment
from softmap_edge.diagnosis.findings import Alternative, FamilyFinding, Untestable
from softmap_edge.diagnosis.separate import families_of, next_blocks, separating
from softmap_edge.experiment.blocks import BLOCKS
from softmap_edge.experiment.choose import Experiment, program
from softmap_edge.experiment.simulate import OpenQuestion
from softmap_edge.model.effect_info import registry

REGISTRY = registry()


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        ("memory", "delay", "two speeds"),
        ("load", "body", "two orientations"),
        ("creep", "time", "twice, with a rest"),
        ("temperature", "time", "warms up and while it cools down"),
        ("static map", "coupling", "alone, then the channels together"),
        ("frame", "static shape", "points near the base"),
    ],
)
def test_two_families_are_separated_by_what_only_one_depends_on(one, other, words):
    block, minutes = separating(one, other)
    assert words in block and minutes > 0
    assert separating(other, one) == (block, minutes)


def test_every_family_is_separated_from_each_that_it_mimics():
    for family in _core.families():
        for other in family["mimics"]:
            assert separating(family["name"], other) is not None, (family["name"], other)
    assert separating("memory", "memory") is None and separating("nothing", "static shape") is None


def test_families_of_effects_are_those_that_have_them_as_members():
    assert (
        families_of(["latency", "lag", "backlash"]) == ("delay", "memory")
        and families_of(["servo_swap"]) == ()
    )


def family(name, effects, alternatives=()):
    return FamilyFinding(name, "memory", "identified", effects, 1.0, 1.0, alternatives=alternatives)


def test_the_diagnosis_asks_between_families_before_it_asks_between_laws():
    within = Alternative(("hysteresis",), "fits as well", "backlash", "memory")
    between = Alternative(("latency",), "fits as well", "backlash", "delay")
    hidden = Untestable("creep", "weak", "staircase", 2.0)
    found = [family("memory", ("backlash",), ("delay",))]
    blocks = next_blocks([within, between], [hidden], REGISTRY, ["backlash"], found)
    assert blocks[0].block == separating("memory", "delay")[0] and blocks[0].settles == (
        "memory",
        "delay",
    )
    assert any("hysteresis" in block.settles for block in blocks[1:]) and blocks[-1].settles == (
        "creep",
    )
    # An alternative alone, without the list of the family, asks the same; one of the same family
    # asks nothing first.
    assert (
        next_blocks([between], [], REGISTRY, ["backlash"], [family("memory", ("backlash",))])[0]
        == blocks[0]
    )
    alone = next_blocks([within], [], REGISTRY, ["backlash"], [family("memory", ("backlash",))])
    assert alone[0].block == REGISTRY["backlash"].experiment[0]


def experiment(name, questions, minutes=1.0):
    return Experiment(name, minutes, ["x"], 100.0, object(), tuple((q, s) for q, s in questions))


def test_a_block_that_separates_families_is_recorded_before_a_better_one_that_separates_laws():
    law = OpenQuestion(("backlash",), ("hysteresis",))
    apart = OpenQuestion(("backlash",), ("latency",), families=("memory", "delay"))
    quick, slow = (
        experiment("quick", [(law, 1e4)]),
        experiment("slow", [(apart, 30.0)], minutes=3.0),
    )
    assert [one.block for one in program([quick, slow])] == ["slow", "quick"]
    # without the families, the order in which they were given
    plain = OpenQuestion(("backlash",), ("latency",))
    assert [
        one.block for one in program([quick, experiment("slow", [(plain, 30.0)], minutes=3.0)])
    ][0] == "quick"


def proposed(named):
    """The blocks that are proposed for play on a circle, against hysteresis and a delay."""
    run = played(BLOCKS["circle"].plan(LIMITS), {"backlash.gap": 0.8})
    stated = {"backlash.gap": {"value": 0.8, "sigma": 0.1, "unit": "mm"}}
    rows = [
        {"effects": ["hysteresis"], "why": "", "member": "backlash", "family": "memory"},
        {"effects": ["latency"], "why": "", "member": "backlash", "family": "delay"},
    ]
    asked = document(
        effects=[{"name": "backlash", "params": stated}], families=named, alternatives=rows
    )
    return [one for one in next_experiment(MODEL, asked, [run]) if one.separation is not None]


def test_the_first_block_that_is_proposed_is_best_for_the_family():
    """Hysteresis is another law of the family, delay another family: two speeds come before
    amplitudes.
    """
    row = {
        "name": "memory",
        "kind": "memory",
        "law": "identified",
        "effects": ["backlash"],
        "share": 1,
        "moved_mm": 1,
    }
    ranked = proposed([row])
    (question,) = {q for q, _ in ranked[0].answers if q.families == ("memory", "delay")}
    rate = [
        dict(one.answers)[question] / one.minutes if question in one.settled() else 0.0
        for one in ranked
    ]
    assert rate == sorted(rate, reverse=True) and ranked[0].block == "fast and slow triangles"
    assert (
        program(ranked)[0] is ranked[0] and program(ranked)[1].block == "triangles of growing size"
    )
    # where no family is known, all questions count alike
    assert proposed([])[0].block == "triangles of growing size"
