"""Commands whose range lies far from 0: home is not known, and no advice stands on 0 being home."""

import numpy as np
import pytest

from softmap_edge import Run
from softmap_edge.checks.summary import summary
from softmap_edge.checks.summary_text import sentences
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.run.rest_command import rest_command
from softmap_edge.run.run import HOME_TICKS

T = np.arange(1500) / 25
REST = (T < 4) | (T > 56)
MOVE = np.where(REST[:, None], 0.0, np.stack([np.sin(T - 4), np.sin(1.7 * (T - 4))], axis=1))


def run_of(u, unit="mm", **fields):
    drive = {"ticks": np.rint(u)} if unit == "raw" else {"command": u, "command_unit": unit}
    tip = np.stack([MOVE[:, :1], MOVE[:, 1:], 90 - MOVE[:, :1] ** 2], axis=2)
    near = tip * 0.4 + [1.0, 0, 0]
    return Run(t=T, t_seen=T, markers=np.concatenate([near, tip], axis=1), **drive, **fields)


AWAY = {
    "ticks around 2048": (np.array([2048, 2048]) + np.rint(600 * MOVE), "ticks", "-2048, -2048"),
    "ticks without a command": (np.array([1500, 2500]) + 700 * MOVE, "raw", "-1500, -2500"),
    "a servo around 180 degrees": (np.array([180.0, 175.0]) + 30 * MOVE, "deg", "-180, -175"),
    "one channel of two": (np.array([0.0, 512.0]) + np.rint(100 * MOVE), "ticks", "0, -512"),
    "a pretension": (np.array([20.0, 20.0]) + 5 * MOVE, "mm", "-20, -20"),
}


@pytest.mark.parametrize("kind", AWAY)
def test_home_is_reported_once_as_not_known(kind):
    u, unit, offset = AWAY[kind]
    document = summary(run_of(u, unit))
    poor = [
        word
        for word in document.cannot_tell
        if word.about in ("home", "sides", "together", "dwell")
    ]
    assert [word.about for word in poor] == ["home"] and not document.home_known
    assert "home is not known" in poor[0].text and f"offset = [{offset}]" in poor[0].remedy
    text = "\n".join(sentences(document))
    assert (
        "visits of home: not known" in text
        and "never visited" not in text
        and "one side only" not in text
    )


@pytest.mark.parametrize("kind", AWAY)
def test_without_the_rest_command_home_is_known(kind):
    u, unit, _ = AWAY[kind]
    document = summary(run_of(u - u[0], unit))
    assert document.home_known and "not known" not in "\n".join(sentences(document))


KNOWN = {
    "one-sided tendons": (5 * np.abs(MOVE), "mm"),
    "both sides": (5 * MOVE, "mm"),
    "tendons that never slacken": (1.0 + 5 * np.abs(MOVE), "mm"),
    "a channel that stays": (MOVE * [5.0, 0.0] + [0.0, 7.0], "mm"),
}


@pytest.mark.parametrize("kind", KNOWN)
def test_commands_that_count_from_home_keep_their_advice(kind):
    document = summary(run_of(*KNOWN[kind]))
    assert document.home_known
    home = [word for word in document.can_tell + document.cannot_tell if word.about == "home"]
    assert len(home) == 1 and "home is" in home[0].text and "not known" not in home[0].text
    sides = any(word.about == "sides" for word in document.cannot_tell)
    assert sides == (kind in ("one-sided tendons", "tendons that never slacken"))


def test_ticks_that_count_from_home_are_known():
    run = run_of(
        np.array([700.0, 700.0]) + 100 * MOVE, "ticks", extra={HOME_TICKS: np.array([10, 10])}
    )
    assert summary(run).home_known


@pytest.mark.parametrize("rest", [(2048, 2048), (500, 3000), (3000, 1000)])
@pytest.mark.parametrize("size", [300, 900])
def test_the_proposed_clamp_is_that_of_the_markers_at_rest(tmp_path, rest, size):
    ticks = np.rint(np.array(rest) + size * (0.4 * MOVE + 0.6 * np.abs(MOVE)))
    bend = MOVE[:, 0] + MOVE[:, 1]
    places = np.stack(
        [np.stack([3 * k * bend, 0 * bend, 20.0 * k - k * bend**2], axis=1) for k in (1, 2, 3)],
        axis=1,
    )
    lines = [
        "t,goal_position_1,goal_position_2,"
        + ",".join(f"m{k}_{a}" for k in (1, 2, 3) for a in "xyz")
    ]
    for t, u, row in zip(T, ticks, places.reshape(len(T), -1)):
        lines.append(",".join([f"{t:.2f}", *(f"{x:.0f}" for x in u), *(f"{x:.3f}" for x in row)]))
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    assert "origin_mm = [0.0, 0.0, 0.0]" in guess_mapping([tmp_path / "log.csv"]).text


def test_the_rest_command_is_where_the_run_begins_if_it_stays_or_ends_there():
    ramp = np.linspace(1000, 2000, 50)[:, None]
    assert rest_command(np.concatenate([np.full((20, 1), 1200.0), ramp])) == pytest.approx(1200)
    assert rest_command(np.concatenate([ramp, ramp[::-1]])) == pytest.approx(1000)
    assert rest_command(ramp) == pytest.approx(1500)
    assert rest_command(ramp - 1400) == pytest.approx(0)
