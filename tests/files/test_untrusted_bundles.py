"""Untrusted bundles: no graph runs unasked, none reaches beyond its file, and time and memory are
bounded.

`tests/data/untrusted` holds graphs whose Loop does not end, whose weights are in another file, and
that take 3.6 GB.
"""

import json
import os
import re
import shutil
import struct
import subprocess
import sys
import time
import zipfile
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402

import softmap_edge.model.onnx as network  # noqa: E402
from softmap_edge import _core, builtin_model, load_bundle, save_bundle  # noqa: E402
from softmap_edge.alignment.clouds import read_clouds  # noqa: E402
from softmap_edge.cli import main  # noqa: E402
from softmap_edge.errors import BundleError, SoftmapError  # noqa: E402
from softmap_edge.files.npz import MOST_ARRAYS, read_npz, write_npz  # noqa: E402

GIVEN = Path(__file__).parents[1] / "data" / "untrusted"
BASE = builtin_model()
SIZE = BASE.rest.size


def info(name, *shape):
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)


def constant(name, array):
    return numpy_helper.from_array(np.asarray(array, np.float32), name)


def graph_file(nodes, constants=(), functions=(), domains=(), output="out"):
    """Return an ONNX file: commands (n, 2) to points (n, 3N)."""
    graph = helper.make_graph(
        nodes, "g", [info("command", "n", 2)], [info(output, "n", SIZE)], constants
    )
    opsets = [helper.make_opsetid(domain, 17 if domain == "" else 1) for domain in ("", *domains)]
    model = helper.make_model(graph, opset_imports=opsets, functions=list(functions))
    model.ir_version = 8
    return model.SerializeToString()


def weights(seed=0):
    rng = np.random.default_rng(seed)
    return constant("W", rng.normal(size=(SIZE, 2)) / 10), constant("b", BASE.rest.ravel())


def gemm(**attributes):
    return helper.make_node("Gemm", ["command", "W", "b"], ["out"], transB=1, **attributes)


def elsewhere(tensor, file):
    """Move the numbers of a tensor to another file."""
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=file)
    return tensor


def plain():
    return graph_file([gemm()], weights())


def foreign():
    """A sound graph that the core does not read."""
    nodes = [
        helper.make_node("Tanh", ["command"], ["t"]),
        helper.make_node("Gemm", ["t", "W", "b"], ["out"], transB=1),
    ]
    return graph_file(nodes, weights())


def external(inside):
    W, b = weights()
    if inside == "initializer":
        return graph_file([gemm()], [elsewhere(W, "ext.bin"), b])
    value = helper.make_node("Constant", [], ["W"], value=elsewhere(W, "../ext.bin"))
    return graph_file([value, gemm()], [b])


def with_body(kind):
    """A node that runs a graph within."""
    W, b = weights()
    if kind == "If":
        yes = helper.make_graph(
            [helper.make_node("Identity", ["first"], ["y"])], "y", [], [info("y", "n", SIZE)]
        )
        no = helper.make_graph(
            [helper.make_node("Neg", ["first"], ["z"])], "z", [], [info("z", "n", SIZE)]
        )
        first = helper.make_node("Gemm", ["command", "W", "b"], ["first"], transB=1)
        true = numpy_helper.from_array(np.array(True), "true")
        return graph_file(
            [first, helper.make_node("If", ["true"], ["out"], then_branch=yes, else_branch=no)],
            [W, b, true],
        )
    turn = helper.make_tensor_value_info("i", TensorProto.INT64, [])
    on, still_on = (
        helper.make_tensor_value_info(name, TensorProto.BOOL, []) for name in ("c", "c2")
    )
    steps = [
        helper.make_node("Identity", ["s"], ["s2"]),
        helper.make_node("Identity", ["c"], ["c2"]),
    ]
    body = helper.make_graph(
        steps, "body", [turn, on, info("s", "n", SIZE)], [still_on, info("s2", "n", SIZE)]
    )
    first = helper.make_node("Gemm", ["command", "W", "b"], ["first"], transB=1)
    forever = numpy_helper.from_array(np.array(2**62), "forever")
    loop = helper.make_node("Loop", ["forever", "", "first"], ["out"], body=body)
    return graph_file([first, loop], [W, b, forever])


def disguised():
    """An operator that is called Gemm, and is a function of the file."""
    function = helper.make_function(
        "hidden",
        "Gemm",
        ["x", "w", "v"],
        ["y"],
        [helper.make_node("Gemm", ["x", "w", "v"], ["y"], transB=1)],
        [helper.make_opsetid("", 17)],
        ["transB"],
    )
    return graph_file([gemm(domain="hidden")], weights(), [function], ["hidden"])


def overridden():
    """A function of the file in ONNX's own domain."""
    function = helper.make_function(
        "",
        "Relu",
        ["x"],
        ["y"],
        [helper.make_node("Neg", ["x"], ["y"])],
        [helper.make_opsetid("", 17)],
    )
    nodes = [
        helper.make_node("Gemm", ["command", "W", "b"], ["h"], transB=1),
        helper.make_node("Relu", ["h"], ["out"]),
    ]
    return graph_file(nodes, weights(), [function])


def sparse():
    W, b = weights()
    values = numpy_helper.from_array(np.ones(2, np.float32), "W")
    places = numpy_helper.from_array(np.array([0, 5], np.int64), "places")
    model = onnx.load_from_string(graph_file([gemm()], [b]))
    model.graph.sparse_initializer.append(helper.make_sparse_tensor(values, places, [SIZE, 2]))
    return model.SerializeToString()


REACHING = {
    "a loop (given)": lambda: (GIVEN / "loop.onnx").read_bytes(),
    "weights in another file (given)": lambda: (GIVEN / "external.onnx").read_bytes(),
    "a loop": lambda: with_body("Loop"),
    "a branch": lambda: with_body("If"),
    "weights in another file": lambda: external("initializer"),
    "a constant in another file": lambda: external("node"),
    "a function named Gemm": disguised,
    "a function in place of Relu": overridden,
    "an operator of another domain": lambda: graph_file(
        [gemm(domain="com.microsoft")], weights(), (), ["com.microsoft"]
    ),
    "sparse constants": sparse,
}


def bundle(tmp_path, content):
    """Write a bundle whose prior is that file, with right hashes; return its folder."""
    folder = tmp_path / "bundle"
    shutil.copytree(Path(network.__file__).parents[1] / "data" / "finger", folder)
    (folder / "prior.onnx").write_bytes(content)
    write_npz(folder / "prior.npz", {})
    write_npz(folder / "fields.npz", {})
    return signed(folder, kind="network", schema=8)


def signed(folder, **changes):
    """Write the manifest of a folder again with the hashes of its files."""
    manifest = json.loads((folder / "manifest.json").read_text())
    names = [file.name for file in folder.iterdir() if file.name != "manifest.json"]
    manifest["sha256"] = {name: sha256((folder / name).read_bytes()).hexdigest() for name in names}
    (folder / "manifest.json").write_text(json.dumps(manifest | changes))
    return folder


@pytest.fixture
def never_run(monkeypatch):
    """Fail where onnxruntime is given a graph."""

    def run(*_):
        raise AssertionError("onnxruntime was given the graph")

    monkeypatch.setattr(network, "run_onnxruntime", run)


@pytest.mark.parametrize("trusted", [False, True])
@pytest.mark.parametrize("name", REACHING)
def test_a_graph_that_reaches_beyond_itself_is_never_run(tmp_path, never_run, name, trusted):
    (tmp_path / "ext.bin").write_bytes(bytes(8 * SIZE))
    with pytest.raises(
        BundleError, match=r"^prior\.onnx: .*(another file|may never end|functions|domain|sparse)"
    ):
        load_bundle(bundle(tmp_path, REACHING[name]()), trust_onnx=trusted)


def test_a_sound_graph_that_the_core_does_not_read_is_run_only_if_asked(
    tmp_path, never_run, monkeypatch, capsys
):
    folder = bundle(tmp_path, foreign())
    with pytest.raises(BundleError, match=r"'Tanh'.*--trust-onnx.*trust_onnx=True"):
        load_bundle(folder)
    assert main(["show", str(folder)]) == 2
    assert "--trust-onnx" in capsys.readouterr().err
    asked = []
    with pytest.raises(BundleError, match="Tanh"):
        load_bundle(folder, trust_onnx=lambda *given: asked.append(given))
    assert asked == [(folder / "prior.onnx", sha256(foreign()).hexdigest())]
    monkeypatch.undo()
    assert load_bundle(folder, trust_onnx=True).kind == "table"
    assert main(["show", str(folder), "--trust-onnx"]) == 0


def test_a_graph_of_the_layers_that_training_writes_needs_no_trust(tmp_path):
    assert load_bundle(bundle(tmp_path, plain())).kind == "network"


def expanded():
    """Points plus the mean of a matrix of 3.6 GB that no number of the file lets expect."""
    W, b = weights()
    shape = numpy_helper.from_array(np.array([30000, 30000], np.int64), "shape")
    nodes = [
        helper.make_node("Gemm", ["command", "W", "b"], ["h"], transB=1),
        helper.make_node("ReduceMean", ["command"], ["m"], keepdims=0),
        helper.make_node("Expand", ["m", "shape"], ["wide"]),
        helper.make_node("ReduceSum", ["wide"], ["s"], keepdims=0),
        helper.make_node("Add", ["h", "s"], ["out"]),
    ]
    return graph_file(nodes, [W, b, shape])


LOADED = """
import resource, sys
from softmap_edge import load_bundle
try:
    load_bundle(sys.argv[1], trust_onnx=True)
finally:
    print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


@pytest.mark.parametrize(
    "content", [(GIVEN / "memory.onnx").read_bytes(), expanded()], ids=["given", "expanded"]
)
def test_a_graph_that_takes_gigabytes_is_stopped(tmp_path, content):
    folder, begun = bundle(tmp_path, content), time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", LOADED, folder], capture_output=True, text=True, timeout=120
    )
    assert re.search(r"prior\.onnx: .* more than 1000 MB of memory", done.stderr), done.stderr
    assert time.monotonic() - begun < 60
    assert int(done.stdout) < 1_300_000  # kB, the program's own pages included


def test_axes_of_a_bundle_make_no_endless_table(tmp_path):
    folder = bundle(tmp_path, foreign())
    axes = {f"axis{c}": np.linspace(-20, 20, 3000) for c in range(2)}
    write_npz(folder / "prior.npz", axes)
    with pytest.raises(BundleError, match="table of 9000000 nodes, at most 4000"):
        load_bundle(signed(folder, kind="network", schema=8), trust_onnx=True)


def test_modes_are_those_of_either_gram_matrix():
    values = np.random.default_rng(3).normal(size=(20, 6)) @ np.random.default_rng(4).normal(
        size=(6, 50)
    )
    wide, tall = network._modes(values), network._modes(np.vstack([values, np.zeros((40, 50))]))
    np.testing.assert_allclose(wide[0][-6:], tall[0][-6:], rtol=1e-9)
    np.testing.assert_allclose(np.abs(np.sum(wide[1][-6:] * tall[1][-6:], axis=1)), 1.0, rtol=1e-9)


def test_a_graph_that_takes_too_long_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(network, "CHILD_S", 2.0)
    nodes = [helper.make_node("Gemm", ["command", "W", "b"], ["h"], transB=1)]
    big = constant("B", np.zeros((1500, 1500)))
    nodes += [helper.make_node("MatMul", ["B", "B"], ["p0"])]
    nodes += [helper.make_node("MatMul", [f"p{k}", "B"], [f"p{k + 1}"]) for k in range(400)]
    nodes += [
        helper.make_node("ReduceSum", ["p400"], ["s"], keepdims=0),
        helper.make_node("Add", ["h", "s"], ["out"]),
    ]
    folder, begun = bundle(tmp_path, graph_file(nodes, [*weights(), big])), time.monotonic()
    with pytest.raises(BundleError, match="takes longer than 2 s"):
        load_bundle(folder, trust_onnx=True)
    assert time.monotonic() - begun < 30


@pytest.mark.parametrize(
    "name", ["effects.json", "prior.npz", "template.npz", "fields.npz", "safety.toml"]
)
def test_a_sparse_file_is_refused_by_its_size_before_it_is_read(tmp_path, name):
    folder = tmp_path / "b"
    save_bundle(BASE, folder)
    (folder / name).touch()
    os.truncate(folder / name, 6 << 30)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["sha256"].setdefault(name, "0" * 64)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_CPU, (8, 8)); from softmap_edge.cli "
        "import main; "
    )
    code += f"main(['show', {str(folder)!r}])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert f"{name} has {6 << 30} bytes, at most" in done.stderr and done.returncode == 0


def many(path, count, comment=b""):
    """Write an archive of `count` empty entries of one name."""
    local = struct.pack("<4s5H3I2H", b"PK\3\4", 20, 0, 0, 0, 33, 0, 0, 0, 5, 0) + b"a.npy"
    entry = (
        struct.pack("<4s6H3I5H2I", b"PK\1\2", 20, 20, 0, 0, 0, 33, 0, 0, 0, 5, 0, 0, 0, 0, 0, 0)
        + b"a.npy"
    )
    end = struct.pack(
        "<4s4H2IH",
        b"PK\5\6",
        0,
        0,
        count % 65536,
        count % 65536,
        count * len(entry),
        len(local),
        len(comment),
    )
    path.write_bytes(local + count * entry + end + comment)


@pytest.mark.parametrize(
    "count, comment", [(2000, b""), (60_000, b""), (400_000, b""), (60_000, b"about it")]
)
def test_an_archive_of_very_many_entries_is_refused_at_once(tmp_path, count, comment):
    many(tmp_path / "prior.npz", count, comment)
    begun = time.process_time()
    with pytest.raises(
        SoftmapError, match=rf"at most {MOST_ARRAYS} are read|holds up to {MOST_ARRAYS} arrays"
    ):
        read_npz(tmp_path / "prior.npz")
    with pytest.raises(
        SoftmapError, match=rf"at most {MOST_ARRAYS} of|holds up to {MOST_ARRAYS} arrays"
    ):
        read_clouds([tmp_path / "prior.npz"])
    assert time.process_time() - begun < 1.0


def test_an_archive_in_the_form_for_larger_ones_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(zipfile, "ZIP_FILECOUNT_LIMIT", 1)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", b"1")
        archive.writestr("b.npy", b"1")
    with pytest.raises(SoftmapError, match="ZIP64"):
        read_npz(tmp_path / "a.npz")


WRONG = [
    ("length_unit", "m"),
    ("length_unit", 1),
    ("length_unit", None),
    ("written_by", 7),
    ("made_from", 5),
    ("made_from", ["a"]),
    ("schema", True),
    ("schema", 1.0),
    ("channels", True),
    ("channels", 2.0),
    ("sha256", {"prior.npz": 7}),
    ("command_unit", 3),
    ("robot", "a\x1b[31m"),
    ("held_out_error_mm", "1"),
    ("gravity_reference", [0, 0, True]),
]


@pytest.mark.parametrize("key, value", WRONG)
def test_each_field_of_the_manifest_has_its_type(tmp_path, key, value):
    folder = save_bundle(BASE, tmp_path / "b")
    manifest = json.loads((folder / "manifest.json").read_text()) | {key: value}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match=key):
        load_bundle(folder)


@pytest.mark.parametrize("key", ["length_unit", "command_unit"])
def test_a_unit_that_is_missing_is_not_assumed(tmp_path, key):
    folder = save_bundle(BASE, tmp_path / "b")
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest[key]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match=key):
        load_bundle(folder)


def test_what_reaches_beyond_is_named_by_the_core():
    with pytest.raises(_core.CoreError, match="'Loop'"):
        _core.check_onnx(with_body("Loop"))
    with pytest.raises(_core.CoreError, match="no ONNX file"):
        _core.check_onnx(b"\xff" * 40)
    assert _core.check_onnx(foreign()) is None


@pytest.mark.parametrize("name", ["manifest.json", "template.npz", "prior.npz"])
def test_a_file_of_a_bundle_is_no_link_to_a_file_outside(tmp_path, name):
    folder = tmp_path / "b"
    save_bundle(BASE, folder)
    shutil.move(folder / name, tmp_path / "elsewhere")
    (folder / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(BundleError, match=f"{name} is a link to a file outside the bundle"):
        load_bundle(folder)
    (folder / name).unlink()
    shutil.move(tmp_path / "elsewhere", folder / f"{name}.real")
    (folder / name).symlink_to(f"{name}.real")
    (tmp_path / "link").symlink_to(folder)
    assert load_bundle(tmp_path / "link").robot == BASE.robot


@pytest.mark.parametrize(
    "piece", ["x", ["a" * 64], ["a", 0.0, 1.0], ["a" * 64, "0", 1.0], ["a" * 64, 0.0, float("nan")]]
)
def test_pieces_that_are_none_are_refused(tmp_path, piece):
    folder = tmp_path / "b"
    save_bundle(BASE, folder)
    with pytest.raises(BundleError, match="pieces"):
        load_bundle(signed(folder, made_from={"pieces": [piece]}))
