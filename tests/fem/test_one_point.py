"""A sweep or recording of one point, one row, no length or no number is built from or refused in
one line.
"""

import numpy as np
import pytest

from softmap_edge.cli import main
from softmap_edge.model.bundle import load_bundle
from softmap_edge.run.run import Run

U = np.linspace(-4.0, 4.0, 9)[:, None]
TIP = np.stack([3.0 * U[:, 0], 0.0 * U[:, 0], 50.0 - 0.1 * U[:, 0] ** 2], axis=1)  # (9, 3)


@pytest.mark.parametrize("channels", [1, 2])
def test_a_sweep_of_one_point_makes_a_model(channels, tmp_path):
    """One marker at the tip: of one channel as a grid, of two as scattered commands."""
    rng = np.random.default_rng(0)
    u = U if channels == 1 else rng.uniform(-4.0, 4.0, (30, 2))
    tip = np.stack([3.0 * u[:, 0], 2.0 * u[:, -1], 50.0 - 0.1 * (u**2).sum(axis=1)], axis=1)
    np.savez(tmp_path / "s.npz", command=u, vertices=tip[:, None])
    assert main(["build", str(tmp_path / "s.npz"), "--out", str(tmp_path / "b")]) == 0
    model = load_bundle(tmp_path / "b")
    run = Run(
        t=np.arange(float(len(u))),
        command=u,
        t_seen=np.arange(float(len(u))),
        gravity=[1.0, 0, 0],
        load=5.0,
    )
    assert np.isfinite(model.predict(run)).all()
    np.testing.assert_allclose(model.prior.evaluate(u), tip, atol=0.01)


def test_a_recording_of_one_marker_teaches_a_rod(tmp_path):
    t = np.arange(0.0, 60.0, 0.25)
    u = np.stack([4.0 * np.sin(0.7 * t), 3.0 * np.sin(0.31 * t)], axis=1)
    tip = np.stack([2.0 * u[:, 0], 2.0 * u[:, 1], 50.0 - 0.1 * (u**2).sum(axis=1)], axis=1)
    Run(t=t, command=u, t_seen=t, markers=tip[:, None]).save(tmp_path / "r.npz")
    assert main(["learn", str(tmp_path / "r.npz"), "--out", str(tmp_path / "b")]) == 0


SWEEPS = {
    "one row": ((U[:1], TIP[:1, None]), "1 command"),
    "one row of one number": ((U[0], TIP[:1, None]), "one channel is a column"),
    "no row": ((U[:0], TIP[:0, None]), "0 commands"),
    "two equal rows": ((U[[3, 3]], TIP[[3, 3], None]), "one command only"),
    "two rows": ((U[[0, 8]], TIP[[0, 8], None]), "takes 2 values"),
    "two points in one place": (
        (U, np.repeat(TIP[:, None], 2, axis=1)),
        "two of the points lie in one place",
    ),
    "no point": ((U, TIP[:, None][:, :0]), "0 points"),
    "no channel": ((U[:, :0], TIP[:, None]), "no columns"),
    "no movement": ((U, np.repeat(TIP[4:5, None], 9, axis=0)), "the same for every command"),
    "no length": (
        (U, np.outer(U[:, 0], [3.0, 0, 0])[:, None]),
        "all points of the body at rest lie in one place",
    ),
    "in metres": ((U, 1e-3 * TIP[:, None]), "looks like metres"),
    "no number in a command": ((np.where(U == 1.0, np.nan, U), TIP[:, None]), "not finite"),
    "no number in a shape": ((U, np.where(U == 1.0, np.nan, TIP)[:, None]), "not finite"),
}


@pytest.mark.parametrize("name", SWEEPS)
def test_a_sweep_of_too_little_is_refused_in_one_line(name, tmp_path, capsys):
    (command, vertices), says = SWEEPS[name]
    np.savez(tmp_path / "s.npz", command=command, vertices=vertices, command_unit="mm")
    assert main(["build", str(tmp_path / "s.npz"), "--out", str(tmp_path / "b")]) != 0
    err = capsys.readouterr().err.strip()
    assert says in err and "\n" not in err and "Traceback" not in err


@pytest.mark.parametrize("frames", [1, 9])
def test_a_run_given_to_build_is_named(frames, tmp_path, capsys):
    t = np.arange(float(frames))
    Run(t=t, command=U[:frames], t_seen=t, markers=TIP[:frames, None]).save(tmp_path / "r.npz")
    (tmp_path / "r.mcap").write_bytes(b"\x89MCAP0\r\n")
    for name, says in (("r.npz", "it is a run"), ("r.mcap", "a recording")):
        assert main(["build", str(tmp_path / name), "--out", str(tmp_path / "b")]) != 0
        err = capsys.readouterr().err.strip()
        assert says in err and "softmap learn" in err and "\n" not in err
