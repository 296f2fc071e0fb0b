"""The published logs of the trunk robot become runs: frame, blocks, un-held encoders, a load that
stays hidden.
"""

import numpy as np
import pytest
from logs import ROOT, published

from softmap_edge.logs.importer import import_logs, read_mapping

TRUNK_MAP = ROOT / "examples" / "trunk.toml"


def trunk(name):
    folder = published("trunk")
    return import_logs(
        [folder / "control_inputs_controlled_1.csv", folder / name], read_mapping(TRUNK_MAP)
    )


def test_the_trunk_hangs_along_z_of_the_base_frame():
    run = trunk("observations_controlled_1.csv").run
    assert (run.channels, len(run.t), run.frames, run.command_unit) == (6, 15000, 3000, "deg")
    assert np.diff(run.t_seen) == pytest.approx(np.full(2999, 0.05))
    assert list(np.bincount(run.block)) == [600] * 5
    raw = np.loadtxt(
        published("trunk") / "observations_controlled_1.csv", delimiter=",", skiprows=1
    )
    x, y, z = raw[0, 7:10] * 1000
    assert run.markers[0, 2] == pytest.approx([x - 101.2, z - 104.6, -y])
    # from the base over the three bodies
    chord = np.diff(run.markers, axis=1, prepend=np.zeros((3000, 1, 3)))
    length = np.linalg.norm(chord, axis=2)
    # a chain: another origin or axis stretches it
    assert (length.std(axis=0) / length.mean(axis=0)).max() < 0.05
    assert np.median(chord[:, :, 2] / length, axis=0).min() > 0.8  # and it hangs along +z
    assert np.array_equal(run.gravity, [0, 0, 1])


def test_both_trunk_runs_play_the_same_commands_and_hide_the_load():
    free, loaded = (
        trunk("observations_controlled_1.csv"),
        trunk("observations_controlled_1_100g.csv"),
    )
    assert np.array_equal(free.run.command, loaded.run.command)
    assert free.run.load is None and loaded.run.load is None
    assert any("100 g" in note and "not declared" in note for note in loaded.notes)
    assert not np.array_equal(free.run.markers, loaded.run.markers)


def test_unheld_encoders_explain_the_trunk_better_than_held_ones(tmp_path):
    """Ridge on quadratic features of the encoders, five blocks held out: the lag of holding costs
    accuracy.
    """
    folder = published("trunk")
    (tmp_path / "held.toml").write_text(
        TRUNK_MAP.read_text().replace('held = "auto"', 'held = "keep"')
    )
    logs = [folder / "control_inputs_controlled_1.csv", folder / "observations_controlled_1.csv"]
    error = {}
    for name, path in (("unheld", TRUNK_MAP), ("held", tmp_path / "held.toml")):
        run = import_logs(logs, read_mapping(path)).run
        q = run.command_at(run.t_seen, "present") / 50
        pairs = [q[:, i] * q[:, j] for i in range(6) for j in range(i, 6)]
        features = np.column_stack([np.ones(len(q)), q, *pairs])
        target = run.markers.reshape(len(q), 9)
        miss = np.empty_like(target)
        for block in range(5):
            fit = run.block != block
            normal = features[fit].T @ features[fit] + 1e-2 * np.eye(features.shape[1])
            miss[~fit] = target[~fit] - features[~fit] @ np.linalg.solve(
                normal, features[fit].T @ target[fit]
            )
        error[name] = np.sqrt((miss**2).sum(axis=1).mean() / 3)
    assert error["unheld"] < 12.0  # mm; predicting the mean scores about 39
    assert error["unheld"] < error["held"] - 0.05
