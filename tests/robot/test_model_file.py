"""`fetch_model` builds the model of hands from a wheel or copies it, and takes nothing else."""

import hashlib
import os
import random
import zipfile

import pytest
from hand_model import hand_model

from softmap_edge.errors import TeleopError
from softmap_edge.robot.teleop import model_file
from softmap_edge.robot.teleop.model_file import (
    DETECTOR,
    IN_WHEEL,
    LANDMARKS,
    check_model,
    default_path,
    fetch_model,
)

NETWORKS = {DETECTOR: b"\x1c\0\0\0TFL3" + b"d" * 500, LANDMARKS: b"\x1c\0\0\0TFL3" + b"l" * 900}


def archive(path, members, packed=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", packed) as out:
        for name, content in members:
            out.writestr(name, content)
    return path


def wheel(path, **changed):
    networks = {**NETWORKS, **changed}
    members = [(IN_WHEEL[name], networks[name]) for name in IN_WHEEL]
    return archive(path, [("mediapipe/__init__.py", b""), *members], zipfile.ZIP_DEFLATED)


def test_the_real_wheel_gives_the_known_file(tmp_path_factory):
    made = check_model(hand_model(tmp_path_factory.mktemp("wheel")))
    assert made.known_as == "mediapipe 0.10.18" and made.sha256 in str(made)


def test_a_wheel_becomes_a_task_file_and_a_task_file_is_copied(tmp_path):
    task = fetch_model(wheel(tmp_path / "a.whl"), tmp_path / "deep/hand.task")
    with zipfile.ZipFile(task.path) as found:
        assert [m.compress_type for m in found.infolist()] == [zipfile.ZIP_STORED] * 2
        assert {name: found.read(name) for name in found.namelist()} == NETWORKS
    content = task.path.read_bytes()
    assert task.sha256 == hashlib.sha256(content).hexdigest() and task.known_as == ""
    assert (tmp_path / "deep/hand.task.sha256").read_text() == f"{task.sha256}  hand.task\n"
    copy = fetch_model(task.path, tmp_path / "copy.task")
    assert copy.path.read_bytes() == content and copy.sha256 == task.sha256
    # the same bytes
    assert fetch_model(wheel(tmp_path / "b.whl"), tmp_path / "again.task").sha256 == task.sha256
    assert {path.name for path in (tmp_path / "deep").iterdir()} == {
        "hand.task",
        "hand.task.sha256",
    }


def test_what_is_there_is_kept_unless_forced(tmp_path):
    task = fetch_model(wheel(tmp_path / "a.whl"), tmp_path / "hand.task")
    other = wheel(tmp_path / "b.whl", **{DETECTOR: b"\x1c\0\0\0TFL3other"})
    with pytest.raises(TeleopError, match="is there already; --force replaces it"):
        fetch_model(other, task.path)
    assert check_model(task.path) == task
    assert fetch_model(other, task.path, force=True).sha256 != task.sha256
    with pytest.raises(TeleopError):  # a refused source leaves what was there
        fetch_model(archive(tmp_path / "c.whl", [("x", b"")]), task.path, force=True)
    check_model(task.path)


def test_a_file_that_was_exchanged_is_reported(tmp_path):
    task = fetch_model(wheel(tmp_path / "a.whl"), tmp_path / "hand.task").path
    archive(task, [(DETECTOR, NETWORKS[DETECTOR]), (LANDMARKS, NETWORKS[LANDMARKS] + b"x")])
    with pytest.raises(TeleopError, match=r"but hand.task.sha256 states .*; fetch the model again"):
        check_model(task)
    task.with_name("hand.task.sha256").unlink()
    assert check_model(task).known_as == ""


def test_bombs_and_other_contents_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(model_file, "LARGEST_NETWORK", 1 << 20)
    bomb = b"\x1c\0\0\0TFL3" + bytes(50 << 20)
    good = list(NETWORKS.items())
    cases = {
        "more than 1 MB": wheel(tmp_path / "bomb.whl", **{LANDMARKS: bomb}),
        "are compressed": archive(tmp_path / "packed.task", good, zipfile.ZIP_DEFLATED),
        "holds no model of hands": archive(tmp_path / "other.zip", [*good, ("run.sh", b"")]),
        "not a network in TFLite": wheel(tmp_path / "text.whl", **{DETECTOR: b"hello"}),
        "of different names": archive(
            tmp_path / "many.zip", [(f"{k}", b"") for k in range(20_001)]
        ),
        "no such file": tmp_path / "absent.whl",
        "is not a zip archive": tmp_path / "text.task",
    }
    (tmp_path / "text.task").write_text("no archive")
    with pytest.warns(UserWarning, match="Duplicate name"):
        cases["2 entries"] = archive(tmp_path / "twice.task", [good[0], good[0]])
    for said, file in cases.items():
        with pytest.raises(TeleopError, match=said) as fault:
            fetch_model(file, tmp_path / "out.task")
        assert "\n" not in str(fault.value) and not (tmp_path / "out.task").exists()
    monkeypatch.setattr(model_file, "LARGEST_SOURCE", 1000)
    with pytest.raises(TeleopError, match="at most 0 MB are read"):
        fetch_model(
            wheel(tmp_path / "a.whl", **{DETECTOR: b"\x1c\0\0\0TFL3" + os.urandom(2000)}),
            tmp_path / "out.task",
        )
    assert not [path for path in tmp_path.iterdir() if "out.task" in path.name]


@pytest.mark.parametrize("seed", range(4))
def test_damaged_archives_are_one_line(tmp_path, seed):
    """Bytes changed, cut and added at random: a complete model, or one clear error."""
    rng = random.Random(seed)
    whole = [
        wheel(tmp_path / "a.whl").read_bytes(),
        archive(tmp_path / "a.task", NETWORKS.items()).read_bytes(),
    ]
    for _ in range(150):
        content = bytearray(rng.choice(whole))
        for _ in range(rng.randint(1, 6)):
            content[rng.randrange(len(content))] = rng.randrange(256)
        if rng.random() < 0.3:
            del content[rng.randrange(len(content)) :]
        file = tmp_path / "damaged"
        file.write_bytes(content)
        try:
            made = fetch_model(file, tmp_path / "out.task", force=True)
        except TeleopError as fault:
            assert "\n" not in str(fault)
        else:
            assert check_model(made.path) == made


def test_a_folder_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(TeleopError, match="a part of this path is a file, not a folder"):
        fetch_model(wheel(tmp_path / "a.whl"), tmp_path / "file/hand.task")


def test_the_default_place_is_in_the_users_data(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert default_path() == tmp_path / "softmap/hand_landmarker.task"
    assert fetch_model(wheel(tmp_path / "a.whl")).path == default_path()
