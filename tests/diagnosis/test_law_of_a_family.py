"""Level 2: which law stands for a family, given the held-out loss of each law that was tried.

The laws are rows of losses, written here; the representative of the family has a loss of 100.
"""

import pytest
from two_levels import judged, law


def test_the_simplest_law_that_reaches_stands_for_the_family():
    found = judged(
        law("asymmetry", 101, 3), law("gain", 105, 1), law("offset", 400, 1), law("(u³)", 500, 1)
    )
    assert found.law.name == "gain" and found.identified and found.equals == ()
    assert [one.name for one in found.reaching] == ["gain", "asymmetry"] and len(found.tried) == 4
    assert found.loss.sum() == pytest.approx(105) and found.numbers == 1


def test_where_no_law_reaches_it_is_unknown():
    found = judged(law("gain", 700, 1), law("offset+gain", 550, 2))
    assert found.law is None and not found.open and not found.identified and found.reaching == ()
    # the representative stays
    assert found.loss.sum() == pytest.approx(100) and found.numbers == 9.0


def test_a_static_law_that_does_most_of_its_family_is_the_candidate_of_an_open_one():
    """Imperfections of the robot may hide its form. The law of a memory is unknown then, and its
    nearest is named.
    """
    laws = law("gain", 300, 1), law("offset", 310, 1), law("asymmetry", 290, 3), law("(u³)", 500, 1)
    found = judged(*laws)
    # near the best, with fewer numbers
    assert found.open and found.law.name == "gain" and found.equals == ()
    assert judged(*laws, kind="time").law.name == "gain"
    memory = judged(*laws, kind="memory")
    assert memory.law.name == "gain" and memory.rough and not memory.open and not memory.identified
    # the model error is part of its noise
    assert judged(*laws, kind="memory", noisy=True).law is None
    # it explains less than 0.6 of what the family does
    assert judged(law("gain", 500, 1), kind="memory").law is None
    pulley = law("eccentric_pulley", 110, 5, **{"eccentric_pulley.radius": 8.0})
    assert judged(pulley, *laws).law.name == "gain"  # less than a turn of a sine is any smooth map


def test_a_generic_law_that_is_as_simple_opens_it():
    found = judged(law("gain", 105, 2), law("(u|u|)", 104, 2))
    assert found.open and not found.identified and found.law.name == "gain"  # the best candidate
    # one with more numbers does not
    assert judged(law("gain", 105, 2), law("(u, u³)", 104, 4)).identified
    none = judged(law("gain", 700, 1), law("(u³)", 104, 1))
    assert none.open and none.law is None


def test_numbers_for_single_cables_are_no_simpler_than_a_generic_law():
    """They follow any smooth map, so a generic law that does as well opens them whatever numbers it
    has.
    """
    cables = {"gain.factor[0+]": 1.0, "gain.factor[0-]": 0.8}
    assert judged(law("gain", 105, 2), law("(u, u³)", 104, 4)).identified
    found = judged(law("gain", 105, 2, **cables), law("(u, u³)", 104, 4))
    assert found.open and found.law.name == "gain"
    assert judged(law("gain", 105, 2, **cables), law("(u, u³)", 400, 4)).identified


def test_a_law_that_is_better_than_the_representative_is_the_measure():
    """The representative is not the optimum: a spline has no kink."""
    found = judged(law("gain", 100, 1), law("asymmetry", 20, 2))
    assert found.law.name == "asymmetry" and found.equals == ()


def test_members_that_do_as_well_are_equals_and_the_first_to_act_comes_first():
    found = judged(law("offset", 102, 1), law("gain", 103, 1))
    assert (
        found.identified
        and found.law.name == "gain"
        and [one.name for one in found.equals] == ["offset"]
    )
    # by more than the least fall of a family
    better = judged(law("offset", 100, 1), law("gain", 104, 1))
    assert better.law.name == "offset" and [one.name for one in better.equals] == ["gain"]
    pair = judged(law("gain", 101, 2), law("gain+offset", 102, 2))
    # a larger set is no alternative to its part
    assert pair.law.name == "gain" and pair.equals == ()
