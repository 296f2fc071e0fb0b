"""No name of a file, a column, a topic or a key reaches a terminal, a page or an error as it is."""

import json
import shutil
import warnings
from dataclasses import replace

import numpy as np
import pytest
from containers import messages, write_dataset, write_db3, write_folder, write_mat73
from recordings import (
    JOINT_STATE,
    places,
    robot_messages,
    write_c3d,
    write_mcap,
    write_motive,
    write_trc,
)
from report_documents import DIAGNOSIS, compared
from sound_run import sound

from softmap_edge import Diagnosis, builtin_model, compare, save_bundle, series, write_html
from softmap_edge.cli import _printing_warnings, main
from softmap_edge.errors import LONGEST_LINE, RecordingWarning, SessionWarning, SoftmapError
from softmap_edge.files.toml import quoted
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs, read_mapping

NAMES = {
    "line end": "a\nFORGED all is well",
    "return": "a\rFORGED all is well",
    "separators": "a\u2028FORGED\x85FORGED\tFORGED",
    "escapes": "a\x1b[31mred\x1b[2J\x1b]0;title\x07\x9b31mb\x7f",
    "bidi": "a\u202egnp.exe\u2066b",
    "zero width": "a\u200bb\u200dc\ufeff",
    "long": "a" + "L" * 5000 + " and long" * 500,
    "quotes": "a\"b'c\\d<b onload=x>&",
}
NAMES["all at once"] = "".join(NAMES[kind] for kind in NAMES if kind != "long")
FAST = ("all at once", "long")
EVERY = [name if name in FAST else pytest.param(name, marks=pytest.mark.long) for name in NAMES]
FEW = 40


def table(name):
    """Names and numbers of a log: time, commands, a marker, and a column of another kind."""
    t, points = places(FEW)
    u = np.column_stack([5 * np.sin(t * 9), 4 * np.cos(t * 9)])
    names = ["time", f"command {name} 1", f"command {name} 2"]
    names += [f"{name}_{axis}" for axis in "xyz"] + [f"other {name}"]
    other = np.random.default_rng(1).normal(size=FEW)
    return names, np.column_stack([t, u, points[:, 2], other])


def csv(folder, name):
    names, rows = table(name)
    cells = ['"' + one.replace('"', '""') + '"' for one in names]
    lines = [",".join(cells), *(",".join(f"{x:.5f}" for x in row) for row in rows)]
    (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [folder / "log.csv"]


def semicolons(folder, name):
    names, rows = table(name)
    lines = [
        ";".join(names),
        *(";".join(f"{x:.5f}".replace(".", ",") for x in row) for row in rows),
    ]
    (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-16")
    return [folder / "log.csv"]


def file_name(folder, name):
    source = csv(folder, "m")[0]
    target = source.with_name(name[:60].replace("/", "_") + ".csv")
    return [source.rename(target)]


def trc(folder, name):
    return [write_trc(folder / "log.trc", *places(FEW), labels=("base", name, "tip"))]


def motive(folder, name):
    return [write_motive(folder / "log.csv", *places(FEW), labels=("base", name, "tip"))]


def c3d(folder, name):
    label = name.encode("ascii", "replace").decode()[:30]
    return [write_c3d(folder / "log.c3d", *places(FEW), labels=("base", label, "tip"))]


def npz(folder, name):
    names, rows = table(name)
    np.savez(
        folder / "log.npz", **{one.replace("/", "_"): rows[:, k] for k, one in enumerate(names)}
    )
    return [folder / "log.npz"]


def mat(folder, name):
    import scipy.io

    names, rows = table(name)
    short = [one.encode("ascii", "replace").decode()[-31:] for one in names]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scipy.io.savemat(folder / "log.mat", {one: rows[:, k] for k, one in enumerate(short)})
    return [folder / "log.mat"]


def mat73(folder, name):
    names, rows = table(name)
    plain = [one.replace("/", "_").replace(".", "_") for one in names]
    return [write_mat73(folder / "log.mat", {one: rows[:, k] for k, one in enumerate(plain)})]


def parquet(folder, name):
    import pyarrow as pa
    import pyarrow.parquet as pq

    names, rows = table(name)
    pq.write_table(pa.table({one: rows[:, k] for k, one in enumerate(names)}), folder / "l.parquet")
    return [folder / "l.parquet"]


def topic(folder, name):
    recorded = [(one[0] + name, *one[1:]) for one in robot_messages(FEW)]
    return [write_mcap(folder / "log.mcap", recorded)]


def schema(folder, name):
    """A recording whose schema has this name; a writer of ROS messages would refuse it."""
    from mcap.writer import Writer
    from mcap_ros2._dynamic import serialize_dynamic

    with (folder / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {}
        for topic, (kind, text), message, seconds in messages(FEW):
            encode = serialize_dynamic(kind, text)[kind]
            if topic not in channels:
                made = writer.register_schema(f"{kind} {name}", "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", made)
            ns = int(round(seconds * 1e9))
            writer.add_message(channels[topic], ns, bytes(encode(message)), ns)
        writer.finish()
    return [folder / "log.mcap"]


def joint(folder, name):
    recorded = robot_messages(FEW)
    for one in recorded:
        if one[1] == JOINT_STATE:
            one[2]["name"] = [name, f"{name} 2"]
    return [write_mcap(folder / "log.mcap", recorded)]


def db3(folder, name):
    recorded = [(one[0] + name, *one[1:]) for one in messages(FEW)]
    return [write_db3(folder / "log.db3", recorded, definitions=True)]


def bag(folder, name):
    stem = name[:60].replace("/", "_")
    bag = write_folder(folder / f"bag {stem}", [json.dumps(f"{stem}_0.db3")])
    write_db3(bag / f"{stem}_0.db3", messages(FEW), definitions=True)
    return [bag]


def dataset(folder, name):
    return [write_dataset(folder / "set", names=[f"{name}.pos", "gripper.pos"])]


READERS = [csv, semicolons, file_name, trc, motive, c3d, npz, mat, mat73, parquet, topic, schema]
READERS += [joint, db3, bag, dataset]


def assert_plain(text, longest=LONGEST_LINE + 50):  # what a command prints in front of it
    for line in text.split("\n"):
        assert line.isprintable(), line
        assert not line.strip().startswith("FORGED"), line
        assert len(line) <= longest, line[:200]


def run_plain(capsys, *words, longest=LONGEST_LINE + 50):
    """Run a command; nothing that it prints is raw. Return its exit code."""
    code = main([str(word) for word in words])
    out, err = capsys.readouterr()
    assert_plain(out, longest)
    assert_plain(err)
    return code


def called(work):
    """What `work` returns; None if it raises an error of ours, which is plain."""
    try:
        return work()
    except SoftmapError as fault:
        assert_plain(str(fault))
        return None


WRONG = """schema = "softmap.mapping/1"
[[log]]
time = { column = "no such column" }
command = { columns = ["nor this one"] }
"""


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("reader", READERS)
def test_no_name_of_a_log_is_printed_as_it_is(reader, name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        paths = reader(tmp_path, NAMES[name])
    except (OSError, ValueError, UnicodeError) as fault:  # the format or the file system forbids it
        pytest.skip(f"cannot be written: {type(fault).__name__}")
    for path in paths:  # a command refuses a path with a line end: no part of this test
        if any(c in str(path) for c in "\n\r\t"):
            path.rename(tmp_path / "given" if path.is_dir() else tmp_path / "given.csv")
    paths = [
        path if path.exists() else tmp_path / ("given" if reader is bag else "given.csv")
        for path in paths
    ]
    run_plain(capsys, "import", *paths, "--guess", longest=40 * LONGEST_LINE)
    run_plain(capsys, "import", *paths, "--guess", "--json", longest=10**6)
    (tmp_path / "wrong.toml").write_text(WRONG)
    assert run_plain(capsys, "import", *paths, "--map", "wrong.toml", "--out", "x.npz") == 2
    guess = called(lambda: guess_mapping(paths))
    if guess is not None:
        for line in (*guess.assumed, *guess.unknown, *guess.said):
            assert_plain(line)
        assert run_plain(capsys, "import", *paths, "--guess", "--out", "m.toml") == 0
        mapping = called(lambda: read_mapping(tmp_path / "m.toml"))
        assert mapping is not None, "a proposal can be read"
        done = called(lambda: import_logs(paths, mapping))
        for line in () if done is None else (*done.notes, *done.doubts, *done.damage):
            assert_plain(line)
        code = run_plain(capsys, "import", *paths, "--map", "m.toml", "--out", "run.npz")
        if code == 0:
            for words in (["check"], ["show"], ["run", "show"]):
                run_plain(capsys, *words, "run.npz")
                run_plain(capsys, *words, "run.npz", "--json", longest=10**6)


def fields_of(name):
    labels = np.array([f"{name} {k % 2}" for k in range(12)])
    extra = {
        name.replace("/", "_"): np.arange(3),
        "made_from": np.array([name]),
        "damage": np.array(name),
    }
    extra["marker_labels"] = np.array([f"{name} {k}" for k in range(sound().markers.shape[1])])
    return replace(sound(), block=labels, extra=extra)


@pytest.mark.parametrize("name", EVERY)
def test_no_name_within_a_run_is_printed_as_it_is(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        fields_of(NAMES[name]).save("run.npz")
    except (OSError, ValueError):
        pytest.skip("cannot be written")
    for words in (["check"], ["show"], ["run", "show"]):
        run_plain(capsys, *words, "run.npz")
        run_plain(capsys, *words, "run.npz", "--json", longest=10**6)
    assert run_plain(capsys, "run", "cut", "run.npz", "--block", "nowhere", "--out", "x.npz") == 2
    assert run_plain(
        capsys, "run", "cut", "run.npz", "--block", NAMES[name] + " 1", "--out", "x.npz"
    ) in (0, 2)
    run_plain(capsys, "run", "join", "run.npz", "run.npz", "--out", "joined.npz")
    run_plain(capsys, "compare", "run.npz")


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("key", ["robot", "command_unit", "output_unit"])
def test_no_text_of_a_run_is_printed_as_it_is(name, key, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arrays = sound().arrays() | {key: np.array(NAMES[name])}
    np.savez("run.npz", **arrays)
    for words in (["check"], ["show"], ["run", "show"], ["compare"]):
        run_plain(capsys, *words, "run.npz")


TABLES = {
    "mapping": ("import", "log.csv", "--out", "x.npz", "--map"),
    "finger": ("build", "--out", "model", "--finger"),
    "robot": ("learn", "run.npz", "--out", "model", "--robot"),
    "rig": ("servo", "scan", "--rig"),
}


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("kind", TABLES)
def test_no_key_or_text_of_a_toml_file_is_printed_as_it_is(
    kind, name, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    csv(tmp_path, "m")
    sound().save("run.npz")
    key = quoted(NAMES[name])
    for text in (
        f"{key} = 1\n",
        f"schema = {key}\n",
        f'schema = "softmap.{kind}/1"\nname = {key}\n{key} = 2\n',
        f'schema = "softmap.mapping/1"\n[[log]]\n{key} = 1\n',
        f'schema = "softmap.mapping/1"\n[[log]]\ntime = {{ column = {key} }}\n'
        f"command = {{ columns = [{key}], unit = {key} }}\n",
        f"a = {NAMES[name]}\n",
    ):
        (tmp_path / "file.toml").write_text(text, encoding="utf-8")
        assert run_plain(capsys, *TABLES[kind], "file.toml") == 2


def filled(value, name):
    """A document with a name at the end of each text, but for its schema and its verdict."""
    if isinstance(value, dict):
        kept = ("schema", "verdict", "kind", "law", "family", "stage", "unit", "name", "floor_kind")
        return {key: one if key in kept else filled(one, name) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [filled(one, name) for one in value]
    return f"{value} {name}" if isinstance(value, str) else value


@pytest.mark.parametrize("name", EVERY)
def test_no_text_of_a_diagnosis_is_printed_or_shown_as_it_is(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    document = filled(DIAGNOSIS, NAMES[name])
    document["effects"][0]["params"] = {
        f"backlash.gap {NAMES[name]}": {"value": 1.0, "sigma": 0.1, "unit": "mm", "at_bound": False}
    }
    found = Diagnosis.from_dict(document)
    assert_plain(str(found), 10**6)
    assert_plain(write_html("page.html", diagnosis=found).read_text(encoding="utf-8"), 10**7)
    (tmp_path / "diagnosis.json").write_text(json.dumps(document))
    run_plain(capsys, "next", "diagnosis.json", longest=10**5)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bundle") / "finger"
    save_bundle(builtin_model(), folder)
    return folder


@pytest.mark.parametrize("name", EVERY)
def test_no_text_of_a_bundle_is_printed_as_it_is(name, bundle, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sound().save("run.npz")
    manifest = json.loads((bundle / "manifest.json").read_text())
    bad = NAMES[name]
    changes = [
        {bad: 1},
        {"note": bad},
        {"robot": bad},
        {"made_from": manifest["made_from"] | {bad: bad, "log": [bad]}},
        {"kind": bad},
        {"schema": bad},
        {"sha256": manifest["sha256"] | {bad: "0" * 64}},
        {"own_effects": {bad: "0" * 64}},
    ]
    for k, change in enumerate(changes):
        folder = tmp_path / f"bundle{k}"
        shutil.copytree(bundle, folder)
        (folder / "manifest.json").write_text(json.dumps(manifest | change))
        for words in (
            ["check", folder],
            ["show", folder],
            ["compare", "run.npz", "--bundle", folder],
        ):
            run_plain(capsys, *words)


@pytest.mark.parametrize("name", EVERY)
def test_no_name_reaches_a_page_as_it_is(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run, _, model, _, _ = compared()
    labels = np.array([f"{NAMES[name]} {k % 3}" for k in range(run.frames)])
    strange = replace(run, block=labels)
    found = compare(model, strange)
    assert_plain(str(found), 10**5)
    text = write_html("page.html", found, series=series(strange, model)).read_text(encoding="utf-8")
    assert_plain(text, 10**7)
    assert "<b onload" not in text


@pytest.mark.parametrize("name", EVERY)
def test_a_warning_is_one_plain_line(name, capsys):
    def command():
        warnings.warn(SessionWarning(NAMES[name]), stacklevel=1)
        warnings.warn(RecordingWarning(NAMES[name]), stacklevel=1)

    with _printing_warnings("check"):
        command()
    err = capsys.readouterr().err
    assert_plain(err)
    assert err.count("\n") == 2


def test_an_error_is_one_plain_line_of_limited_length():
    for text in NAMES.values():
        assert_plain(str(SoftmapError(f"before {text} after")))
    path = "/".join(["folder"] * 40)
    assert str(SoftmapError(f"{path}: no such file")) == f"{path}: no such file"
