"""The network pass against onnxruntime on every network that training can make; graphs that only
onnxruntime reads.
"""

import json
import re
import subprocess
import sys
from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from softmap_training import choices, networks  # noqa: E402
from softmap_training.baselines import reduced  # noqa: E402
from softmap_training.deepsoro import Folding, to_graph  # noqa: E402
from softmap_training.export import Graph, to_onnx  # noqa: E402
from torch import nn  # noqa: E402

from softmap_edge import _core, builtin_model, load_bundle, save_bundle  # noqa: E402
from softmap_edge.cli import main  # noqa: E402
from softmap_edge.errors import BundleError  # noqa: E402
from softmap_edge.model import onnx as onnx_of_model  # noqa: E402
from softmap_edge.model.onnx import run_onnxruntime  # noqa: E402
from softmap_edge.model.shapes import BundleArrays, NetworkArrays, PriorArrays  # noqa: E402
from softmap_edge.robot.motion.kinematics import Kinematics  # noqa: E402

torch.set_num_threads(1)
AGREE_MM = 1e-4
BASE = builtin_model()
RNG = np.random.default_rng(5)


def shapes(channels):
    """Return commands (200, C) mm and points (200, 3N) mm of about 100 mm that depend on them
    smoothly.
    """
    u = RNG.uniform(-16, 16, (200, channels))
    if channels == 2:
        return u, np.asarray(BASE.prior.evaluate(u))
    bent = np.tanh(u @ RNG.normal(size=(channels, 30)) / 20)
    return u, 40 * bent + np.linspace(0, 100, 30)


def _laid_out(points):
    """Return mean and modes of what an encoding makes."""
    mean, modes, weights = reduced(points)
    return weights, mean, modes


def _encoded(u, points):
    """Return a published prior to the numbers of an encoding, and the layer that undoes it."""
    weights, mean, modes = _laid_out(points)
    network = networks.published_prior(u, weights)
    network.append(networks.Modes(mean, modes))
    return network


MADE = {
    "published": lambda u, x: networks.published_prior(u, x),
    "published, no dropout": lambda u, x: networks.published_prior(u, x, 0.0),
    "encoded": _encoded,
    "ours": lambda u, x: networks.mode_prior(u, x, choices.PRIOR_WIDTHS, choices.PRIOR_MODES),
    "ours, odd sizes": lambda u, x: networks.mode_prior(u, x, (33, 1, 95, 31), 7),
    "published residual": lambda u, x: networks.published_residual(
        u, x.shape[1], choices.RESIDUAL_WIDTHS, 0.1
    ),
    "our residual": lambda u, x: networks.to_modes(
        u, 0 * x[0], reduced(x)[1][:6], choices.OUR_RESIDUAL_WIDTHS
    ),
    "linear": lambda u, x: nn.Sequential(
        networks.Modes(x.mean(axis=0), RNG.normal(size=(u.shape[1], x.shape[1])))
    ),
    "one wide layer": lambda u, x: nn.Sequential(
        nn.Linear(u.shape[1], 1111), nn.LayerNorm(1111), nn.GELU(), nn.Linear(1111, x.shape[1])
    ),
}


def drawn(network, u, x):
    """Give a network other weights and running means than it began with, and outputs of the size of
    a body.
    """
    torch.manual_seed(7)
    with torch.no_grad():
        for part in network.modules():
            if isinstance(part, nn.Linear):
                part.weight.normal_(0.0, 1.0 / np.sqrt(part.in_features))
                part.bias.normal_(0.0, 0.1)
            if isinstance(part, nn.BatchNorm1d):
                part.running_mean.normal_(0.0, 0.3)
                part.running_var.uniform_(0.5, 2.0)
                part.weight.uniform_(0.5, 1.5)
                part.bias.normal_(0.0, 0.2)
            if isinstance(part, nn.LayerNorm):
                part.weight.uniform_(0.5, 1.5)
                part.bias.normal_(0.0, 0.2)
    return network.eval()


def parity(content, u):
    """Return the largest difference in mm between the core and onnxruntime, one at a time and
    together.
    """
    core, wanted = _core.Network(content), run_onnxruntime(content, u)
    together = np.asarray(core.evaluate(u))
    alone = np.concatenate([np.asarray(core.evaluate(row[None])) for row in u])
    np.testing.assert_array_equal(together, alone)
    both = [np.asarray(core.with_slopes(row.tolist())[0]) for row in u[:5]]
    np.testing.assert_array_equal(alone[:5], both)
    return float(np.abs(together - wanted).max()), float(np.abs(wanted).max())


@pytest.mark.parametrize("channels", [1, 2, 3])
@pytest.mark.parametrize("name", MADE)
def test_the_core_is_within_a_tenth_of_a_micrometre_of_onnxruntime(name, channels):
    u, x = shapes(channels)
    network = drawn(MADE[name](u, x), u, x)
    apart, size = parity(
        to_onnx(network, channels), np.concatenate([u[:60], np.zeros((1, channels))])
    )
    # Single precision knows points that are 100 mm away to 8e-6: those of random weights that lie
    # farther off to less.
    assert apart <= AGREE_MM * max(1.0, size / 130.0), (apart, size)


@pytest.mark.parametrize("what", ["tiny", "huge", "zero", "dead", "constant"])
def test_extreme_weights_agree_too(what):
    u, x = shapes(2)
    network = drawn(MADE["published residual"](u, x), u, x)
    with torch.no_grad():
        for layer in network:
            if isinstance(layer, nn.Linear):
                scale = {"tiny": 1e-18, "huge": 1e4, "zero": 0.0, "dead": 1.0, "constant": 0.0}[
                    what
                ]
                layer.weight.mul_(scale)
                if what == "constant":
                    layer.bias.fill_(0.37)
        if what == "huge":
            network[-1].weight.mul_(1e-6)
        if what == "dead":  # nothing passes Relu
            network = nn.Sequential(nn.Linear(2, 64), nn.ReLU(), nn.Linear(64, x.shape[1]))
            network[0].bias.fill_(-1e3)
    apart, size = parity(to_onnx(network.eval(), 2), u[:40])
    assert apart <= AGREE_MM * max(1.0, size / 130.0), (apart, size)


def test_slopes_are_those_of_torch_where_inputs_are_passed_over():
    """Behind Relu half of the inputs are zero, and are not read."""
    u, x = shapes(2)
    network = drawn(MADE["published"](u, x), u, x)
    core = _core.Network(to_onnx(network, 2))
    for row in u[:2]:
        wanted = torch.autograd.functional.jacobian(
            lambda v: network(v[None])[0], torch.as_tensor(row, dtype=torch.float32)
        ).numpy()
        found = np.asarray(core.jacobian(row[None]))[0]
        assert np.abs(found - wanted).max() < 1e-4 * np.abs(wanted).max()


def foreign(curve):
    """Return the file of a graph with a layer that the core does not read, to the built-in finger's
    points.
    """
    u, x = shapes(2)
    mean, modes, weights = reduced(x)
    rows = np.column_stack([u, u**2, np.ones(len(u))])
    fit = np.linalg.lstsq(rows[:, [0, 1, 4]], weights, rcond=None)[0]
    graph = Graph()
    graph.add("Div", np.full(2, 16.0))
    graph.add(curve)
    graph.linear((16.0 * fit[:2] @ modes).T, fit[2] @ modes + mean)
    return graph.file(2, {})


def bundle(tmp_path, content):
    """Write a bundle whose prior is that file, and return its folder."""
    arrays = BundleArrays(PriorArrays(NetworkArrays(content)))
    bare = BASE.with_structure(fields={}, cables=None, second=None)
    model = replace(bare, kind="network", arrays=arrays)
    return save_bundle(model, tmp_path / "foreign")


def test_a_graph_that_only_onnxruntime_reads_becomes_a_table_that_says_so(tmp_path):
    content = foreign("Tanh")
    with pytest.raises(Exception, match="Tanh"):
        _core.Network(content)
    model = load_bundle(bundle(tmp_path, content), trust_onnx=True)
    reported = model.made_from["through_onnxruntime"]["prior"]
    assert model.kind == "table" and "Tanh" in reported["why"] and reported["table_off_mm"] < 0.02
    assert reported["graph_sha256"] == sha256(content).hexdigest()
    u = RNG.uniform(-16, 16, (200, 2))
    off = np.linalg.norm(
        (model.prior.evaluate(u) - run_onnxruntime(content, u)).reshape(200, -1, 3), axis=2
    )
    assert off.max() < 10 * max(reported["table_off_mm"], 1e-3)
    # Users of a model see no difference: inverse kinematics, and written once more it is a table.
    there = model.tip(np.array([[2.0, -3.0]]))
    assert Kinematics(model).solve(there).distance[0] < 1e-4
    again = load_bundle(save_bundle(model, tmp_path / "again"))
    assert again.kind == "table" and again.made_from["through_onnxruntime"]["prior"] == reported
    np.testing.assert_allclose(again.prior.evaluate(u), model.prior.evaluate(u), atol=1e-3)


def test_check_says_that_a_graph_is_run_as_a_table(tmp_path, capsys):
    folder = bundle(tmp_path, foreign("Tanh"))
    assert main(["check", str(folder), "--trust-onnx"]) == 0
    (said,) = [
        line for line in capsys.readouterr().out.splitlines() if line.startswith("onnxruntime")
    ]
    assert (
        "the prior is a table of what onnxruntime makes of its graph" in said and "'Tanh'" in said
    )
    assert main(["check", str(folder), "--trust-onnx", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)["through_onnxruntime"]["prior"]
    assert f"{reported['table_off_mm']:.2g} mm off" in said and reported["why"] in said


def test_check_compares_a_network_of_the_core_with_onnxruntime(tmp_path, capsys, monkeypatch):
    folder = bundle(tmp_path, foreign("Relu"))
    assert main(["check", str(folder)]) == 0
    assert re.search(
        r"onnxruntime +the prior network: differs by (0|\de-\d+) mm", capsys.readouterr().out
    )
    both = onnx_of_model.run_onnxruntime
    monkeypatch.setattr(
        onnx_of_model, "run_onnxruntime", lambda content, u: both(content, u) + 0.01
    )
    assert main(["check", str(folder)]) == 1
    assert (
        "prior.onnx: onnxruntime and the core differ by 0.01 mm, allowed is 0.001"
        in capsys.readouterr().err
    )
    load_bundle(folder)  # the core alone


def test_without_onnxruntime_all_works_but_graphs_that_the_core_does_not_read(tmp_path):
    """As on a computer that does not have it; nothing that the core runs asks for it."""
    own, other = (
        bundle(tmp_path / "own", foreign("Relu")),
        bundle(tmp_path / "other", foreign("Tanh")),
    )
    code = (
        "import sys; sys.modules['onnxruntime'] = None\n"
        "from softmap_edge import load_bundle, save_bundle\n"
        "from softmap_edge.cli import main\n"
        "from softmap_edge.errors import BundleError\n"
        f"model = load_bundle({str(own)!r}); assert model.kind == 'network'\n"
        f"save_bundle(model, {str(tmp_path / 'again')!r})\n"
        f"assert main(['predict', '3,-2', '--bundle', {str(own)!r}]) == 0\n"
        f"assert main(['check', {str(own)!r}]) == 0\n"
        f"assert main(['check', {str(other)!r}, '--trust-onnx']) == 1\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "the prior network: not compared, onnxruntime is not installed" in done.stdout
    assert re.search(
        r"prior\.onnx: .*'Tanh'.*onnxruntime is not installed; run pip install onnxruntime",
        done.stderr,
    )


def test_a_network_that_the_core_runs_loads_no_onnxruntime(tmp_path):
    folder = bundle(tmp_path, foreign("Relu"))
    code = (
        "import sys, numpy as np; from softmap_edge import load_bundle\n"
        f"load_bundle({str(folder)!r}).tip(np.zeros((1, 2))); print('onnxruntime' in sys.modules)"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
        == "False\n"
    )


def test_a_graph_that_jumps_is_no_table(tmp_path):
    with pytest.raises(
        BundleError, match=r"holds 'Sign'.* mm off, allowed is 0\.2; train a network"
    ):
        load_bundle(bundle(tmp_path, foreign("Sign")), trust_onnx=True)


def test_a_decoder_in_the_manner_of_deepsoro_goes_through_onnxruntime():
    u, x = shapes(2)
    network = Folding(u, list(x.reshape(len(x), -1, 3)), 100)
    content = to_graph(network)
    with torch.no_grad():
        wanted = network(torch.as_tensor(u, dtype=torch.float32)).numpy().reshape(len(u), -1)
    np.testing.assert_allclose(run_onnxruntime(content, u), wanted, atol=1e-4)
    with pytest.raises(
        Exception,
        match=r"'w\d+' holds int64 numbers; the core's network pass reads weights of 32-bit",
    ):
        _core.Network(content)


def test_what_neither_runs_is_reported(tmp_path):
    folder = bundle(tmp_path, foreign("Tanh"))
    for content in (b"no graph", foreign("Tanh")[:-40]):
        (folder / "prior.onnx").write_bytes(content)
        manifest = json.loads((folder / "manifest.json").read_text())
        manifest["sha256"]["prior.onnx"] = sha256(content).hexdigest()
        (folder / "manifest.json").write_text(json.dumps(manifest))
        with pytest.raises(
            BundleError, match=r"prior.onnx: .*(onnxruntime cannot run|no ONNX file)"
        ):
            load_bundle(folder, trust_onnx=True)
