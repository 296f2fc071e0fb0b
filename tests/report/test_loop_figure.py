"""The loop of the tip against a command, and the family and law of a diagnosis in words, in text
and on the page.
"""

import numpy as np
import pytest
from leaning_triangle import lean, triangle

from softmap_edge.comparison.comparison import compare
from softmap_edge.comparison.series import Loop, series, tip_loops
from softmap_edge.diagnosis.family_text import family_facts, family_line
from softmap_edge.diagnosis.text import diagnosis_text
from softmap_edge.report.html import write_html
from softmap_edge.report.loop_figure import worst_cycle

GAP = 1.4  # mm
BACKLASH = {
    "name": "backlash",
    "family": "memory",
    "stage": "transmission",
    "probability": 0.97,
    "share": 1.0,
    "displacement_mm": {"fitted": 1.2, "held_out": None},
    "params": {
        "backlash.gap[0]": {"value": 1.385, "sigma": 0.01, "unit": "mm", "at_bound": False},
        "backlash.gap[1]": {"value": 0.77, "sigma": 0.01, "unit": "mm", "at_bound": False},
    },
}


def family(name="memory", kind="memory", law="identified", effects=("backlash",), **more):
    return {
        "name": name,
        "kind": kind,
        "law": law,
        "effects": list(effects),
        "share": 0.72,
        "moved_mm": 1.3,
        "law_share": 0.98,
        "generic": [],
        "alternatives": [],
    } | more


def diagnosis(*families, effects=(BACKLASH,)):
    return {
        "schema": "softmap.diagnosis/2",
        "verdict": "identified",
        "sentence": "The model lacks backlash.",
        "effects": list(effects),
        "families": list(families),
    }


def play(u, gap):
    """The output of a play of width `gap`, sample by sample, at rest in the middle of its gap at
    first.
    """
    out = [float(u[0])]
    for value in u[1:]:
        out.append(float(np.clip(out[-1], value - 0.5 * gap, value + 0.5 * gap)))
    return np.array(out)


def two_channels():
    """Two channels, one after the other: cycles of the first, then of both, which the loop of one
    must not show.
    """
    s = np.linspace(0.0, 1.0, 41)
    cycle = np.concatenate([np.interp(s, [0, 0.25, 0.75, 1], [0, 8, -8, 0])] * 2)
    still = np.zeros_like(cycle)
    return np.stack(
        [np.concatenate([cycle, cycle]), np.concatenate([still, np.roll(cycle, 10)])], axis=1
    )


# --- the loop -----------------------------------------------------------------------------------


def test_the_tip_moves_along_the_direction_of_its_command_and_a_play_is_as_wide_as_its_gap():
    u = two_channels()
    u[82:, 0] = 0.0  # the second half moves the second channel alone
    # mm per mm, sizes 5 and 2
    rest, way = np.array([3.0, -2.0, 90.0]), np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 2.0]])
    acting = np.stack([play(c, GAP) for c in u.T], axis=1)
    loops = tip_loops(u, rest + acting @ way, rest + u @ way, rest + acting @ way)
    assert [loop.name for loop in loops] == ["tip, channel 0", "tip, channel 1"]
    for loop, c, size in zip(loops, (0, 1), (5.0, 2.0)):
        np.testing.assert_array_equal(loop.command, u[:, c])
        np.testing.assert_array_equal(loop.seen, loop.after)
        rows = worst_cycle(loop)
        # the directions are exact: both tips move along them
        lost = (loop.before - loop.seen)[rows]
        assert np.ptp(lost) == pytest.approx(GAP * size, rel=1e-9)
    plain = tip_loops(u, rest + u @ way, rest + u @ way, None)
    np.testing.assert_allclose(plain[0].before[:82], 5.0 * u[:82, 0], atol=1e-9)
    assert plain[0].after is None


def test_a_cycle_in_which_the_other_commands_stand_still_is_shown_first():
    u = two_channels()
    wrong = np.where(np.arange(len(u)) >= 82, 5.0, 1.0)  # the model is worse where both move
    loop = Loop("tip, channel 0", u[:, 0], wrong, np.zeros(len(u)), None, u[:, 1:])
    alone, any_cycle = (
        worst_cycle(loop),
        worst_cycle(Loop("x", u[:, 0], wrong, np.zeros(len(u)), None)),
    )
    assert alone.stop <= 83 and np.ptp(u[alone, 1]) == 0.0
    assert any_cycle.stop > 83
    both = Loop("tip, channel 0", u[82:, 0], wrong[82:], np.zeros(82), None, u[82:, 1:])
    # no such cycle: any cycle is right
    assert worst_cycle(both).stop > worst_cycle(both).start + 10


def test_commands_that_stand_still_and_tips_that_are_not_seen_have_no_loop():
    u = two_channels()
    u[:, 1] = 0.0
    tip = np.column_stack([u[:, 0], u[:, 0], 90.0 + 0.0 * u[:, 0]])
    assert [loop.name for loop in tip_loops(u, tip, tip, None)] == ["tip, channel 0"]
    assert tip_loops(u, np.full_like(tip, np.nan), tip, None) == ()
    assert tip_loops(u[:, :0], tip, tip, None) == ()
    gaps = tip.copy()
    gaps[::3] = np.nan
    (loop,) = tip_loops(u, gaps, tip, None)
    np.testing.assert_array_equal(np.isnan(loop.seen), np.isnan(gaps[:, 0]))
    np.testing.assert_allclose(loop.before, np.sqrt(2.0) * u[:, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("found", "drawn"),
    [
        (diagnosis(family()), True),
        (diagnosis(family("delay", effects=("latency",))), True),
        (diagnosis(family("static map", "static", effects=("gain",))), False),
        (None, False),
    ],
)
def test_the_page_draws_the_loop_where_a_family_with_memory_was_detected(found, drawn, tmp_path):
    run, worse, better = triangle(noise=0.05), lean(lambda run, p: 2.0), lean(lambda run, p: 0.2)
    pair = [compare(worse, run), compare(better, run)]
    text = write_html(tmp_path / "p.html", pair, found, series(run, worse, better)).read_text()
    assert ("Tip against command: the loop" in text) is drawn


# --- families and laws in words -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("row", "line"),
    [
        (family(), "Memory: backlash, gap 1.39 mm on channel 0 and 0.770 mm on channel 1"),
        (
            family(
                "static map",
                "static",
                "open",
                ("eccentric_pulley",),
                generic=["u|u| on each channel"],
            ),
            "Static, non-linear map of the commands; law open: eccentric_pulley, u|u| on each "
            "channel",
        ),
        (family("delay", "memory", "open", ("latency", "lag")), "Delay; law open: latency, lag"),
        (family("rate", "memory", "unknown", ()), "Unknown law of the family rate"),
        (
            family(effects=("backlash", "friction")),
            "Memory: backlash, gap 1.39 mm on channel 0 and 0.770 mm on channel 1, or friction",
        ),
        (family("load", "static", "identified", ("payload",)), "Load: payload"),
    ],
)
def test_a_family_and_its_law_make_one_line(row, line):
    assert family_line(row, [BACKLASH]) == line


def test_numbers_of_cables_are_named_by_channel_and_side():
    numbers = {
        f"dead_zone.slack[{cable}]": {"value": v, "unit": "mm"}
        for cable, v in (("0+", 0.6), ("10-", 1.4))
    }
    line = family_line(
        family("slack", "static", effects=("dead_zone",)),
        [{"name": "dead_zone", "params": numbers}],
    )
    assert (
        line
        == "Slack: dead_zone, slack 0.600 mm on the + cable of channel 0 and 1.40 mm on the - cable of channel 10"
    )


def test_the_facts_name_both_shares_and_what_cannot_be_distinguished():
    facts = family_facts(family(alternatives=["delay", "rate"]), "mm")
    assert facts == [
        "72 % of the explained error",
        "1.30 mm RMS (fitted)",
        "its law explains 98 % of what the family can do",
        "cannot be distinguished here from: delay, rate",
    ]
    unknown = family_facts(family(law="unknown", effects=(), law_share=0.41), "N")
    assert unknown[1:] == [
        "1.30 N RMS (fitted)",
        "the best known law explains 41 % of what the family can do",
    ]
    assert family_facts(family(law_share=None), "mm") == facts[:2]


def test_text_and_page_name_family_and_law(tmp_path):
    found = diagnosis(family(alternatives=["delay"]), family("rate", law="unknown", effects=()))
    text = diagnosis_text(found)
    together = " ".join(text.split())
    assert "Memory: backlash, gap 1.39 mm on channel 0 and 0.770 mm on channel 1" in together
    assert (
        "72 % of the explained error · 1.30 mm RMS (fitted)" in together
        and "Unknown law of the family rate" in together
    )
    assert max(map(len, text.splitlines())) <= 100
    page = write_html(tmp_path / "p.html", diagnosis=found).read_text()
    assert (
        "Memory: backlash, gap 1.39 mm on channel 0" in page
        and "<td>72 %</td><td>98 %</td>" in page
    )


def test_a_document_without_families_has_no_such_part(tmp_path):
    """Schema 1 has none, and none are invented."""
    old = diagnosis() | {"schema": "softmap.diagnosis/1", "families": []}
    assert "family of effects" not in diagnosis_text(old)
    assert "family of effects" not in write_html(tmp_path / "p.html", diagnosis=old).read_text()


def test_names_of_a_family_stay_text(tmp_path):
    hostile = family("<script>x</script>", law="unknown", effects=(), alternatives=["<b>y</b>"])
    page = write_html(tmp_path / "p.html", diagnosis=diagnosis(hostile)).read_text()
    assert "<script>" not in page and "<b>y</b>" not in page and "&lt;script&gt;" in page
