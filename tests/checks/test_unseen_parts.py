"""`check` calls no run sound of which a part was not seen."""

import json
from dataclasses import replace

import numpy as np
import pytest
from lost_markers import BUT_ALSO, GOOD, SINES, K, T, body

from softmap_edge.checks.unseen_markers import unseen_parts
from softmap_edge.cli import main
from softmap_edge.run.run import Run

NAMES = np.array(["base", "mid", "tip\x1b[31m", "end"])


def run(points, u=SINES, **more):
    extra = {"marker_labels": NAMES, "not_seen": np.array("checked")}
    more = {"extra": extra if points.shape[1] == 4 else {}} | more
    return Run(t=T, t_seen=T, command=u, markers=points, **more)


def hidden(*where, noise=0.05):
    points = body(SINES, noise=noise)
    for frames, markers in where:
        points[frames, markers] = np.nan
    return run(points, visible=np.isfinite(points).all(axis=2))


def stuck(m, place, noise=0.05, digits=3):
    points = body(SINES, noise=noise, digits=digits)
    points[:, m] = place
    return run(points)


def few(count):
    shown = np.zeros(K, bool)
    shown[np.linspace(0, K - 1, count).astype(int)] = True
    return hidden((~shown, 2))


HALF = slice(K // 2, K)
CLOUDS = np.r_[0, np.cumsum(np.where(np.arange(K) < K // 2, 3, 0))]
UNSEEN = {
    "never": (hidden((slice(None), 1)), "mid: seen in none of 400 frames"),
    "two never": (hidden((slice(None), [1, 3])), "mid, end: seen in none of 400 frames"),
    "no marker ever": (hidden((slice(None), slice(None))), "no point is seen in any of 400"),
    "once": (few(1), "tip[31m: seen in 1 of 400 frames only"),
    "four times": (few(4), "seen in 4 of 400 frames only"),
    "one frame in 25": (few(16), "seen in 16 of 400 frames only"),
    "frozen": (stuck(2, (1.25, 3.5, 75.0)), "the same to the last digit in all 400 frames"),
    "frozen base": (stuck(0, (0.0, 0.0, 20.0)), "base: the same to the last digit"),
    "frozen tip without noise": (stuck(3, (1.0, 2.0, 99.0), noise=0), "end: the same to the"),
    "frozen in coarse digits": (stuck(2, (1.0, 2.0, 75.0), 0, 0), "the same to the last digit"),
    "zeros": (stuck(1, 0.0), "mid at exactly 0, 0, 0 in all 400 frames"),
    "one camera of two stops": (hidden((HALF, [2, 3])), "not seen in frames 200 to 399"),
    "one camera starts late": (hidden((slice(0, 190), [0, 1])), "base, mid: not seen in frames 0"),
    "a hole in the middle": (hidden((slice(100, 300), 3)), "end: not seen in frames 100 to 299"),
    "the only camera stops": (hidden((HALF, slice(None))), "200 frames show no point from 9.95 to"),
    "no more frames": (
        Run(t=T, t_seen=T[: K // 2], command=SINES, markers=body(SINES)[: K // 2]),
        "there is no frame from 9.95 to 19.95 s, 50 % of the recording",
    ),
    "no first frames": (
        Run(t=T, t_seen=T[HALF], command=SINES, markers=body(SINES)[HALF]),
        "there is no frame from 0 to 10 s, 50 % of the recording",
    ),
    "empty clouds": (
        Run(
            t=T,
            t_seen=T,
            command=SINES,
            points=np.random.default_rng(1).normal(size=(CLOUDS[-1], 3)) * 30,
            start=CLOUDS,
        ),
        "200 frames show no point",
    ),
    "no vertex": (
        Run(
            t=T,
            t_seen=T,
            command=SINES,
            vertices=body(SINES, 70),
            visible=np.repeat(np.arange(K)[:, None] < 150, 70, axis=1),
        ),
        "250 frames show no point",
    ),
    "an output without a value": (
        Run.of_outputs(
            np.c_[SINES[:, 0], np.full(K, np.nan)], "N", ["fx", "fy"], t_seen=T, t=T, command=SINES
        ),
        "fy: seen in none of 400 frames",
    ),
    "an output that is frozen": (
        Run.of_outputs(
            np.c_[SINES[:, 0], np.full(K, 1.25)], "N", ["fx", "fy"], t_seen=T, t=T, command=SINES
        ),
        "fy: the same to the last digit",
    ),
}


@pytest.mark.parametrize("name", UNSEEN)
def test_check_says_what_was_not_seen_and_never_that_it_is_sound(name, tmp_path, capsys):
    one, text = UNSEEN[name]
    assert any(text in line for line in unseen_parts(one)), unseen_parts(one)
    one.save(tmp_path / "run.npz")
    assert main(["check", str(tmp_path / "run.npz")]) == 1
    out, err = capsys.readouterr()
    assert out.startswith("not sound") and err.startswith("not sound: ") and text in err
    assert "\nnext: " not in out and "look at" in out
    assert main(["check", str(tmp_path / "run.npz"), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert not document["sound"] and set(document["unseen_parts"]) <= set(document["warnings"])


CLAMP = np.concatenate([np.tile([0.0, 0.0, 2.0], (K, 1, 1)), body(SINES, 3, noise=0)], axis=1)
WAITS = np.where(np.arange(K)[:, None] < K // 2, SINES, SINES[K // 2])
SEEN = {
    "a part": hidden((slice(100, 180), 2)),
    "every second frame": hidden((slice(None, None, 2), 2)),
    "by turns": hidden((slice(0, None, 2), [0, 1]), (slice(1, None, 2), [2, 3])),
    "a marker of the clamp without noise": run(CLAMP),
    "kept as asked": replace(stuck(2, (1.25, 3.5, 75.0)), extra={"not_seen": np.array("keep")}),
    "no frames while it waits": Run(
        t=T, t_seen=T[: K // 2], command=WAITS, markers=body(WAITS)[: K // 2]
    ),
    "ten frames": Run(
        t=T[:10],
        t_seen=T[:10],
        command=SINES[:10],
        markers=body(SINES)[:10],
        visible=np.arange(40).reshape(10, 4) % 4 < 3 + (np.arange(10)[:, None] > 6),
    ),
}
SEEN |= {
    name: run(points, u) for name, (points, u) in (GOOD | BUT_ALSO).items()
    if u is not None and name not in ("it never moves", "a clamp marker at the origin")
}  # fmt: skip


@pytest.mark.parametrize("name", SEEN)
def test_what_was_seen_is_sound(name, tmp_path, capsys):
    assert unseen_parts(SEEN[name]) == []
    SEEN[name].save(tmp_path / "run.npz")
    assert main(["check", str(tmp_path / "run.npz")]) == 0
    assert capsys.readouterr().out.startswith("sound ")
