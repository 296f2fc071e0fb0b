"""The clock of the frames against that of the commands: found from the motion with its uncertainty,
and corrected.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import Run, _core
from softmap_edge.checks.frame_clock import frame_clock
from softmap_edge.cli import main
from softmap_edge.run.protocol import standard_protocol

SECONDS = 160.0


def moves(kind, seed, t, channels):
    rng = np.random.default_rng(seed)
    if kind == "sines":
        return sum(
            a * np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 6, channels))
            for a, f in ((4, 0.11), (3, 0.23), (2, 0.41))
        )
    if kind == "stairs":
        step = (t // 3).astype(int)
        level = rng.uniform(-7, 7, (step.max() + 2, channels))
        way = np.clip((t % 3) / 0.5, 0, 1)[:, None]
        return level[step] * (1 - way) + level[step + 1] * way
    # triangles, slow and then fast
    turns = np.cumsum(np.where(t < SECONDS / 2, 0.05, 0.4)) * (t[1] - t[0])
    return np.stack(
        [6 * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * turns + c)) for c in range(channels)], axis=1
    )


def run(seed=0, ppm=0.0, step=None, kind="sines", channels=2):
    """A finger with play, lag and a gain that falls by 3 %, seen by a camera with its own clock and
    jitter.
    """
    rng, t = np.random.default_rng(seed + 50), np.arange(0, SECONDS, 0.02)
    u = moves(kind, seed, t, channels)
    chain, size = _core.Chain(["backlash", "lag"], 1), np.array([[0.6, 0.08]])
    acted = [
        chain.rollout(size, np.ascontiguousarray(u[:, c : c + 1]), t)[0, :, 0]
        for c in range(channels)
    ]
    true = np.arange(0.5, SECONDS - 1, 0.05)
    true = true + rng.uniform(-0.003, 0.003, len(true))
    a = np.stack([np.interp(true - 0.05, t, one) for one in acted], axis=1)
    bend = a[:, :2] + (1.1 * a[:, 2:3] if channels > 2 else 0.0)
    places = []
    for z in (40.0, 80.0, 120.0):
        k = z / 120
        places.append(
            np.column_stack(
                [3 * k**2 * bend + 0.02 * k * bend * bend[:, :1], z - 0.05 * k * (a**2).sum(axis=1)]
            )
        )
    seen = np.stack(places, axis=1) * (1 - 0.03 * true / SECONDS)[:, None, None] + rng.normal(
        0, 0.1, (len(a), 3, 3)
    )
    stamps = true * (1 + 1e-6 * ppm) + (
        0.0 if step is None else np.where(true >= step[0], step[1], 0.0)
    )
    return Run(t=t, t_seen=stamps, command=u, markers=seen)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ppm", [0.0, 200.0, -500.0])
def test_a_rate_is_found_within_its_uncertainty(seed, ppm):
    found = frame_clock(run(seed, ppm))
    assert abs(found.fast_ppm - ppm) < 4 * found.sigma_ppm < 120
    assert found.runs_fast == (ppm != 0) and found.step_s is None


@pytest.mark.parametrize(("at", "by"), [(70.0, 0.04), (50.0, -0.03)])
def test_a_step_is_found_with_its_place(at, by):
    for seed in range(2):
        found = frame_clock(run(seed, step=(at, by)))
        assert (
            found.step_s == pytest.approx(by, abs=4 * found.step_sigma_s)
            and found.step_sigma_s < 0.004
        )
        assert found.at_s == pytest.approx(at, abs=0.2)


@pytest.mark.parametrize("kind", ["sines", "stairs", "slow and fast"])
def test_play_lag_and_a_gain_that_falls_are_no_clock(kind):
    for seed in range(3):
        assert not frame_clock(run(seed, kind=kind)).differs


def test_moves_that_do_not_separate_clock_and_memory_show_nothing():
    """Six channels of three common frequencies: the speed is a sum of the commands. The rate is not
    made up.
    """
    found = frame_clock(run(1, ppm=200.0, channels=6))
    assert (
        found.fast_ppm is None
        and not found.differs
        and json.loads(json.dumps(found.to_dict()))["text"] is None
    )
    assert not frame_clock(
        run(1, step=(80.0, 0.05), kind="slow and fast")
    ).differs  # the step is where the speed changes


def test_runs_that_say_nothing():
    full = run(0)
    still = Run(t=full.t, t_seen=full.t_seen, command=0 * full.command, markers=full.markers)
    noise = np.random.default_rng(0).normal(0, 5, full.markers.shape)
    other = Run(t=full.t, t_seen=full.t_seen, command=full.command, markers=noise)
    timeless = Run(
        t=full.t, t_seen=full.t_seen, command=full.command, markers=full.markers, timeless=True
    )
    for one in (still, other, timeless, full.at(full.t_seen < 15)):
        assert frame_clock(one) is None


# --- from the logs to the corrected run ----------------------------------------------------
MAP = """schema = "softmap.mapping/1"
%s
[[log]]
file = "commands.csv"
time = { column = "t" }
command = { columns = ["u0", "u1"] }
[[log]]
file = "frames.csv"
time = { column = "t" }
markers = { unit = "mm", columns = [[1, 2, 3], [4, 5, 6], [7, 8, 9]] }
%s
"""


@pytest.mark.parametrize("zero", ["", "zero_time = true"])
@pytest.mark.parametrize("fault", [{"ppm": 300.0}, {"step": (70.0, 0.04)}])
def test_the_key_that_check_prints_corrects_the_run(tmp_path, capsys, fault, zero):
    recorded = run(0, **fault)
    names = "t," + ",".join(f"m{k}{axis}" for k in range(3) for axis in "xyz")
    for name, head, table in (
        ("commands.csv", "t,u0,u1", np.column_stack([recorded.t, recorded.command])),
        (
            "frames.csv",
            names,
            np.column_stack([recorded.t_seen, recorded.markers.reshape(recorded.frames, -1)]),
        ),
    ):
        table[:, 0] += 1000.0
        np.savetxt(tmp_path / name, table, delimiter=",", header=head, comments="", fmt="%.6f")

    def checked(seen):
        (tmp_path / "map.toml").write_text(MAP % (zero, seen))
        logs = [str(tmp_path / name) for name in ("commands.csv", "frames.csv")]
        out = str(tmp_path / "run.npz")
        assert (
            main(["import", *logs, "--map", str(tmp_path / "map.toml"), "--out", out, "--force"])
            == 0
        )
        capsys.readouterr()
        assert main(["check", out]) == 0
        return " ".join(capsys.readouterr().out.split())

    printed = checked("")
    assert "look at the clock of the frames" in printed
    key = re.search(r"set seen\.(fast_ppm = -?\d+|clock_step = \[[^\]]*\])", printed)[1]
    assert "the clock of the frames" not in checked(f"[seen]\n{key}")


def test_a_step_at_the_wrong_time_is_refused(tmp_path):
    from softmap_edge.errors import RunError
    from softmap_edge.logs.clock import corrected

    t = np.arange(0.0, 10.0, 0.05)
    with pytest.raises(RunError, match="frames overlap after 4.95 s"):
        corrected(t, 0.0, 0.0, (5.0, 0.2))
    assert corrected(t, 0.0, 100.0, None)[-1] == pytest.approx(t[-1] / 1.0001)


def test_any_run_has_an_answer_or_none():
    """Many points, thinned commands, gross errors, and numbers without bound."""
    full = run(0, ppm=400.0)
    many = np.repeat(full.markers, 400, axis=1)
    assert frame_clock(
        Run(t=full.t, t_seen=full.t_seen, command=full.command, markers=many)
    ).runs_fast
    dense = np.linspace(0, full.t[-1], 400_000)
    u = np.stack([np.interp(dense, full.t, one) for one in full.command.T], axis=1)
    found = frame_clock(Run(t=dense, t_seen=full.t_seen, command=u, markers=full.markers))
    assert found.fast_ppm == pytest.approx(400, abs=5 * found.sigma_ppm)
    wild = full.markers.copy()
    wild[::40] += 500.0
    found = frame_clock(Run(t=full.t, t_seen=full.t_seen, command=full.command, markers=wild))
    assert found is None or found.fast_ppm == pytest.approx(400, abs=5 * found.sigma_ppm)
    for size in (20.0, 0.1):
        frame_clock(
            Run(t=full.t, t_seen=full.t_seen, command=full.command, markers=full.markers * size)
        )


@pytest.mark.parametrize("ppm", [0.0, 10.0, -10.0])
def test_a_drift_within_its_spread_is_neither_reported_nor_corrected(ppm):
    scores = []
    for seed in range(6):
        found = frame_clock(run(seed, ppm))
        scores.append((found.fast_ppm - ppm) / found.sigma_ppm)
        assert not found.differs and found.to_dict()["text"] is None
        assert "agree within" in str(found) and "±" in str(found) and "fast_ppm" not in str(found)
    assert 0.2 < np.sqrt(np.mean(np.square(scores))) < 2.5, "the spread is that of the estimates"


def test_rows_with_one_stamp_for_commands_and_frames_have_one_clock():
    """Frames that come 500 ppm late in such a log are the robot's own doing."""
    two = run(0, ppm=-500.0)
    assert frame_clock(two).runs_fast
    command = np.stack([np.interp(two.t_seen, two.t, u) for u in two.command.T], axis=1)
    assert frame_clock(replace(two, t=two.t_seen, command=command)) is None


@pytest.mark.parametrize(("law", "size"), [("backlash", [1.2, 1.0]), ("lag", [0.3]), (None, [])])
@pytest.mark.parametrize("seed", range(2))
def test_memory_that_acts_otherwise_in_parts_of_a_protocol_is_no_clock(law, size, seed):
    """Slow, stepped and fast parts in a row: play and lag delay each of them otherwise."""
    protocol = standard_protocol(seed=seed)
    t, u = np.asarray(protocol.t), np.asarray(protocol.command)
    t, u = t[t < 119], u[t < 119]
    acted = u if law is None else _core.Chain([law], 2).rollout(np.array([size]), u.copy(), t)[0]
    rng = np.random.default_rng(seed)

    def seen_by(ppm):
        true = np.arange(0.5, t[-1] - 1, 0.2) + rng.uniform(-0.003, 0.003, 588)
        a = np.stack([np.interp(true, t, one) for one in acted.T], axis=1)
        bent = [
            np.column_stack(
                [
                    3 * k**2 * a + 0.02 * k * a * a[:, :1],
                    120 * k - 0.05 * k * (a**2).sum(axis=1),
                ]
            )
            for k in (1 / 3, 2 / 3, 1.0)
        ]
        places = np.stack(bent, axis=1) + rng.normal(0, 0.1, (len(true), 3, 3))
        return Run(t=t, t_seen=true * (1 + 1e-6 * ppm), command=u, markers=places)

    assert not frame_clock(seen_by(0.0)).differs
    assert frame_clock(seen_by(800.0)).runs_fast
