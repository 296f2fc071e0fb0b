"""Training on a small finger's shapes: layers, export, checkpoints, the loss, and bundles that hold
the result.
"""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from softmap_training import choices, fit  # noqa: E402
from softmap_training.chamfer import chamfer  # noqa: E402
from softmap_training.errors import TrainingError  # noqa: E402
from softmap_training.export import checked, to_onnx  # noqa: E402
from softmap_training.networks import (  # noqa: E402
    Modes,
    mode_prior,
    published_prior,
    published_residual,
)
from softmap_training.prior import train_prior, vertex_error, with_prior  # noqa: E402

from softmap_edge import _core, builtin_model, load_bundle, save_bundle  # noqa: E402

torch.set_num_threads(1)
RNG = np.random.default_rng(3)
BASE = builtin_model()
LOW, HIGH = BASE.command_range.T
GRID = np.stack(
    np.meshgrid(*(np.linspace(a, b, 21) for a, b in zip(LOW, HIGH)), indexing="ij"), axis=-1
).reshape(-1, 2)
# a table's own shapes: what a network of a bundle has to learn
POINTS = np.asarray(BASE.prior.evaluate(GRID))
ORDER = np.random.default_rng(0).permutation(len(GRID))
PARTS = tuple(np.sort(part) for part in np.split(ORDER, [350, 395]))
QUICK = choices.PRIOR.with_(epochs=150, batch=64)


@pytest.fixture(scope="module")
def quick():
    return train_prior(GRID, POINTS, PARTS, "modes", None, QUICK)


def stirred(network):
    """Give every number that training would move another value, running means of BatchNorm too."""
    with torch.no_grad():
        for number in [
            *network.parameters(),
            *(b for n, b in network.named_buffers() if "running" in n),
        ]:
            if number.dtype == torch.float32:
                number.add_((0.2 * number.abs() + 0.001) * torch.rand_like(number))
    return network.eval()


@pytest.mark.parametrize("name", ["published prior", "our prior", "published residual"])
def test_export_gives_what_torch_gives_in_onnxruntime_and_in_the_core(name):
    torch.manual_seed(0)
    made = {
        "published prior": lambda: published_prior(GRID, POINTS),
        "our prior": lambda: mode_prior(GRID, POINTS, (16, 16), 8),
        "published residual": lambda: published_residual(GRID, POINTS.shape[1], (16, 32), 0.1),
    }
    network = stirred(made[name]())
    content = to_onnx(network, 2)
    assert checked(network, content, GRID[::7]) < 1e-3
    list(network.parameters())[-1].data.add_(1.0)
    with pytest.raises(TrainingError, match="off the trained one"):
        checked(network, content, GRID[::7])


def test_a_layer_that_no_bundle_holds_is_refused():
    with pytest.raises(TrainingError, match="Tanh"):
        to_onnx(
            torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Tanh(), torch.nn.Linear(3, 6)), 2
        )


def test_our_prior_learns_and_a_mean_shape_does_not(quick):
    train, _, test = PARTS
    mean = vertex_error(
        np.broadcast_to(POINTS[train].mean(axis=0), POINTS[test].shape), POINTS[test]
    )
    assert quick.report["test_vertex_mm"] < 0.1 * mean
    assert isinstance(quick.network[-1], Modes)


def test_a_bundle_carries_the_network_and_answers_as_it_does(quick, tmp_path):
    model = with_prior(BASE, quick, GRID[PARTS[2]], POINTS[PARTS[2]])
    again = load_bundle(save_bundle(model, tmp_path / "network"))
    assert again.kind == "network" and isinstance(again.prior, _core.Network)
    np.testing.assert_array_equal(again.prior.evaluate(GRID), model.prior.evaluate(GRID))
    assert again.vertex_error_mm > BASE.vertex_error_mm
    assert set(again.fields) == set(BASE.fields) and again.structure.cables is not None
    assert again.made_from["prior"]["kind"] == "modes"
    # Fits see features through a table of the network: no farther from it than the network is from
    # its set.
    run = _run(RNG.uniform(0.8 * LOW, 0.8 * HIGH, (40, 2)))
    seen = again.structure.feature_map(np.asarray(again.predict(run)))
    assert np.abs(seen - again.features(run)).max() < 0.02


def test_a_residual_of_another_prior_goes(quick):
    from softmap_edge.adaptation.residual import learn_residual

    taught = learn_residual(
        BASE, replace(_run(GRID[::9]), vertices=POINTS[::9].reshape(-1, *BASE.rest.shape) + 0.5)
    )[0]
    assert taught.residual is not None
    assert with_prior(taught, quick, GRID[PARTS[2]], POINTS[PARTS[2]]).residual is None


def test_a_damaged_or_foreign_network_is_refused(quick, tmp_path):
    from softmap_edge.errors import BundleError

    folder = save_bundle(
        with_prior(BASE, quick, GRID[PARTS[2]], POINTS[PARTS[2]]), tmp_path / "network"
    )
    content = (folder / "prior.onnx").read_bytes()
    (folder / "prior.onnx").write_bytes(content[:-100] + bytes(100))
    with pytest.raises(BundleError, match="hash"):
        load_bundle(folder)
    other = to_onnx(torch.nn.Sequential(torch.nn.Linear(3, POINTS.shape[1])), 3)
    _replaced(folder, "prior.onnx", other)
    with pytest.raises(BundleError, match="3 commands"):
        load_bundle(folder)
    _replaced(folder, "prior.onnx", b"no graph")
    with pytest.raises(BundleError, match="ONNX"):
        load_bundle(folder)


def test_a_network_of_another_finger_is_refused(quick):
    with pytest.raises(TrainingError, match="sweep of the same finger"):
        with_prior(BASE.with_structure(rest=BASE.rest[:-1]), quick, GRID[:2], POINTS[:2])


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(quick):
    again = train_prior(GRID, POINTS, PARTS, "modes", None, QUICK.with_(epochs=3))
    assert (
        again.content
        == train_prior(GRID, POINTS, PARTS, "modes", None, QUICK.with_(epochs=3)).content
    )
    assert (
        again.content
        != train_prior(GRID, POINTS, PARTS, "modes", None, QUICK.with_(epochs=3, seed=1)).content
    )


KILLED = """
import os, signal, sys, torch
sys.path.insert(0, sys.argv[2]); import test_training as here
from softmap_training.prior import train_prior
from pathlib import Path
def die(share, line):
    if share > 0.5: os.kill(os.getpid(), signal.SIGKILL)
train_prior(here.GRID, here.POINTS, here.PARTS, "modes", None, here.QUICK.with_(epochs=10), Path(sys.argv[1]), die)
"""


@pytest.mark.long
def test_a_killed_training_goes_on_and_ends_as_if_it_had_not_been_killed(tmp_path):
    recipe = QUICK.with_(epochs=10)
    whole = train_prior(GRID, POINTS, PARTS, "modes", None, recipe, tmp_path / "whole")
    argv = [sys.executable, "-c", KILLED, str(tmp_path / "killed"), str(Path(__file__).parent)]
    done = subprocess.run(argv, capture_output=True)
    assert done.returncode == -9, done.stderr.decode()
    assert len((tmp_path / "killed/log.csv").read_text().splitlines()) == 1 + 6
    epochs = []
    resumed = train_prior(
        GRID,
        POINTS,
        PARTS,
        "modes",
        None,
        recipe,
        tmp_path / "killed",
        lambda share, line: epochs.append(line),
    )
    assert len(epochs) == 4 and resumed.content == whole.content
    lines = [
        [row.rsplit(",", 1)[0] for row in (tmp_path / f / "log.csv").read_text().splitlines()]
        for f in ("whole", "killed")
    ]
    assert lines[0] == lines[1]


def test_a_checkpoint_of_something_else_or_damaged_is_refused(tmp_path):
    recipe = QUICK.with_(epochs=2)
    train_prior(GRID, POINTS, PARTS, "modes", None, recipe, tmp_path / "one")
    with pytest.raises(TrainingError, match="other numbers"):
        train_prior(GRID, POINTS, PARTS, "modes", None, recipe.with_(rate=0.1), tmp_path / "one")
    shutil.copytree(tmp_path / "one", tmp_path / "two")
    (tmp_path / "two/checkpoint.pt").write_bytes(b"PK" + bytes(200))
    with pytest.raises(TrainingError, match="remove it"):
        train_prior(GRID, POINTS, PARTS, "modes", None, recipe, tmp_path / "two")


def test_early_stopping_keeps_the_best_epoch():
    values = iter([3.0, 1.0, 2.0, 2.0, 2.0, 2.0, 0.5])
    network = torch.nn.Sequential(torch.nn.Linear(1, 1))
    weights = []

    def validate(net):
        weights.append(net[0].weight.item())
        return next(values)

    task = fit.Task(
        network, 4, lambda net, some: net(torch.ones(len(some), 1)).square().mean(), validate
    )
    log = fit.fit(task, choices.Recipe(epochs=7, batch=2, rate=0.1, patience=3))
    assert len(log) == 5
    assert network[0].weight.item() == weights[1]


def test_a_rate_that_is_too_large_is_reported(quick):
    with pytest.raises(TrainingError, match="too large for these data"):
        train_prior(GRID, POINTS, PARTS, "modes", None, QUICK.with_(rate=1e30, epochs=3))


@pytest.mark.filterwarnings("ignore:Converting a tensor")  # torch's own, in gradcheck
def test_the_loss_is_the_chamfer_distance_and_its_slope_is_that_of_differences():
    points = torch.tensor(RNG.normal(size=(2, 12, 3)), requires_grad=True)
    clouds = [RNG.normal(size=(30, 3)), RNG.normal(size=(40, 3))]
    near = torch.cdist(points[0], torch.as_tensor(clouds[0]))
    wanted = near.min(dim=1).values.mean() + near.min(dim=0).values.mean()
    assert float(chamfer(points, clouds)[0]) == pytest.approx(float(wanted), rel=1e-6)
    assert torch.autograd.gradcheck(lambda p: chamfer(p, clouds), (points,), eps=1e-5, atol=1e-4)


def _run(commands):
    from softmap_edge import Run

    t = np.arange(float(len(commands)))
    return Run(t=t, command=commands, t_seen=t)


def _replaced(folder, name, content):
    import hashlib
    import json

    (folder / name).write_bytes(content)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["sha256"][name] = hashlib.sha256(content).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))
