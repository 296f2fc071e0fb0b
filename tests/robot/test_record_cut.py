"""Files of `softmap record` that is ended by a signal, killed, or out of disk: a cut loses
its last second.
"""

import json
import os
import re
import resource
import shlex
import signal
import subprocess
import time

import numpy as np
import pytest
from command import SOFTMAP
from waiting import until

from softmap_edge import Run, builtin_model
from softmap_edge.cli import main
from softmap_edge.errors import RunError
from softmap_edge.experiment.blocks import chosen, plan
from softmap_edge.robot.drive import observations
from softmap_edge.robot.drive.command_file import write_commands
from softmap_edge.robot.drive.observations import POINTS, Keeper, Kept, read_kept
from softmap_edge.robot.link.frames import Frame, HostClock
from softmap_edge.run.protocol import Limits

MOST = 200_000  # bytes of a file


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Give a folder with a command file, where a recording is made."""
    monkeypatch.chdir(tmp_path)
    write_commands(
        tmp_path / "c.csv", plan(chosen(["circle"]), Limits.even(2, 4.0)), builtin_model().robot
    )
    return tmp_path


def record(folder, *more, before=None):
    """Begin a recording; gives its process."""
    argv = [SOFTMAP, "record", "c.csv", "--emulated", "--out", "run.npz", *more]
    return subprocess.Popen(
        argv,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=before,
    )


def frames(file):
    """Return how many frames a file holds that grows."""
    if not file.exists():
        return 0
    return sum(
        len(json.loads(line).get("taken", []))
        for line in file.read_text().splitlines(True)
        if line[-1] == "\n"
    )


def kept(tmp_path, shape=(5, 3)):
    """Return what was played, and what its file gives back."""
    rng, played = np.random.default_rng(0), Kept(camera=HostClock(0.01))
    with Keeper(tmp_path / "a.seen", 0.01, builtin_model()) as keeper:
        for k in range(8):
            frame = Frame(
                k / 30,
                5.0 + k / 30 + 0.01 * rng.random(),
                rng.normal(size=shape).astype(np.float32),
            )
            played.clock.append((5.0 + k / 30, k / 30))
            taken = [(k, frame)] if k % 2 else []
            played.taken += taken
            keeper.add(played.clock[-1:], taken, played.camera.add([frame]))
    assert keeper.fault is None
    return played, tmp_path / "a.seen"


def test_what_was_kept_is_read_back_and_to_its_last_complete_line(tmp_path):
    played, file = kept(tmp_path)
    again = read_kept(file)
    assert (again.robot, again.vertices) == (builtin_model().robot, len(builtin_model().rest))
    assert again.clock == played.clock and [look for look, _ in again.taken] == [1, 3, 5, 7]
    for (_, one), (_, other) in zip(played.taken, again.taken, strict=True):
        np.testing.assert_array_equal(one.points, other.points)
    stamps = [frame for _, frame in played.taken]
    np.testing.assert_array_equal(played.camera.times(stamps), again.camera.times(stamps))
    lines = file.read_bytes().splitlines(True)
    file.write_bytes(b"".join(lines[:-1]))
    assert len(read_kept(file).taken) == 4 and "no line that ends it" in read_kept(file).lacks
    file.write_bytes(b"".join(lines[:-1])[:-9])
    assert [look for look, _ in read_kept(file).taken] == [1, 3, 5], "the last line was cut"
    assert "its last line is torn" in read_kept(file).lacks
    for bad in (
        b"",
        b"{}\n",
        b"[1]\n",
        b'{"schema": "softmap.seen/1", "late": "x"}\n',
        b"\xff\n",
        b'{"schema": "softmap.seen/1", "late": 0, "robot": 7}\n',
    ):
        file.write_bytes(bad)
        with pytest.raises(RunError, match="a.seen: damaged, or no `.seen` file"):
            read_kept(file)
    with pytest.raises(RunError, match="none.seen: no such file"):
        read_kept(tmp_path / "none.seen")


ODD = np.array([[0.1 + 0.2, -0.0, 5e-324], [np.nan, np.inf, -1.7e308], [1 / 3, np.pi, 2.0**-1030]])


def test_numbers_are_read_back_to_the_last_bit(tmp_path):
    frames = [Frame(k / 3, k / 3 + 1e-9 / 7, ODD / (k + 1)) for k in range(5)]
    single = Frame(np.float32(2.1), np.float64(2.2), np.float32([[0.1, 2.5, -1e-40]]))
    with Keeper(tmp_path / "a.seen", 0.0, builtin_model()) as keeper:
        keeper.add([(np.float64(1 / 3), 2 / 3)], [(np.int64(9), single)], [single])
        keeper.add([], list(enumerate(frames)), frames)
    found = read_kept(tmp_path / "a.seen")
    assert keeper.fault is None and found.lacks is None and found.clock == [(1 / 3, 2 / 3)]
    for (_, one), other in zip(found.taken, [single, *frames], strict=True):
        assert (one.stamp, one.arrived) == (float(other.stamp), float(other.arrived))
        assert one.points.tobytes() == np.asarray(other.points, float).tobytes()


@pytest.mark.parametrize(
    ("stamp", "points", "said"),
    [
        (np.nan, ODD, "not a finite number"),
        (np.inf, ODD, "not a finite number"),
        (1.0, np.zeros((3, 2)), "shape \\(3, 2\\)"),
        (1.0, np.zeros(6), "shape \\(6,\\)"),
        (1.0, np.zeros((POINTS + 1, 3)), "points at once"),
        ("soon", ODD, "could not convert"),
    ],
)
def test_what_could_not_be_read_again_is_a_fault_and_no_end(tmp_path, stamp, points, said):
    good = Frame(0.5, 0.5, ODD)
    with Keeper(tmp_path / "a.seen", 0.0, builtin_model()) as keeper:
        keeper.add([], [(0, good)], [good])
        keeper.add([], [(1, Frame(stamp, 1.0, points))], [])
        keeper.add([], [(2, good)], [good])
    assert re.search(said, keeper.fault)
    found = read_kept(tmp_path / "a.seen")
    assert [look for look, _ in found.taken] == [0] and "no line that ends it" in found.lacks


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), RuntimeError("gone"), MemoryError()]
)
def test_a_write_that_fails_is_a_fault_whatever_it_is(tmp_path, monkeypatch, error):
    def fails(line):
        raise error

    with Keeper(tmp_path / "a.seen", 0.0, builtin_model()) as keeper:
        monkeypatch.setattr(observations, "with_crc", fails)
    assert keeper.fault


def test_files_without_an_end_line_are_read_as_before(tmp_path):
    _, file = kept(tmp_path)
    bare = [json.loads(line) for line in file.read_bytes().splitlines()[:-1]]
    bare[0]["schema"] = "softmap.seen/2"
    plain = [json.dumps({k: v for k, v in one.items() if k != "crc"}) for one in bare]
    file.write_text("".join(observations.with_crc(line) for line in plain))
    assert read_kept(file).lacks is None and len(read_kept(file).taken) == 4


def test_a_line_whose_checksum_fails_is_left_out_and_a_file_without_checksums_says_so(tmp_path):
    _, file = kept(tmp_path)
    first, *lines = file.read_bytes().splitlines(True)
    file.write_bytes(b"".join([first, *lines[:2], lines[2].replace(b"0", b"1", 1), *lines[3:]]))
    again = read_kept(file)
    assert (
        "1 of 10 lines fail their checksum, the first is line 4" in again.lacks
        and len(again.taken) >= 3
    )
    bare = [json.loads(line) for line in (first, *lines)]
    bare[0]["schema"] = "softmap.seen/1"
    file.write_text(
        "".join(json.dumps({k: v for k, v in one.items() if k != "crc"}) + "\n" for one in bare)
    )
    again = read_kept(file)
    assert len(again.taken) == 4 and "carries no checksum" in again.lacks


def test_no_flipped_bit_changes_what_was_kept_without_a_word(tmp_path):
    _, file = kept(tmp_path)
    whole, sound, rng = file.read_bytes(), read_kept(file), np.random.default_rng(4)
    noticed = 0
    for place in rng.integers(0, 8 * len(whole), 400):
        bad = bytearray(whole)
        bad[place // 8] ^= 1 << (place % 8)
        file.write_bytes(bad)
        try:
            again = read_kept(file)
        except RunError:
            noticed += 1
            continue
        noticed += again.lacks is not None
        if again.lacks is None:
            assert (again.clock, again.robot, again.vertices) == (
                sound.clock,
                sound.robot,
                sound.vertices,
            )
            for (_, one), (_, other) in zip(sound.taken, again.taken, strict=True):
                np.testing.assert_array_equal(one.points, other.points)
    assert noticed > 390


@pytest.mark.parametrize("ends", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_as_ctrl_c_does(folder, ends):
    process = record(folder)
    until(lambda: frames(folder / "run.seen") > 8 or process.poll() is not None, 60)
    process.send_signal(ends)
    said = process.communicate(timeout=60)
    assert process.returncode in (130, 2), said  # 2: a busy machine was quicker
    assert Run.load(folder / "run.npz").frames > 3
    assert sorted(os.listdir(folder)) == ["c.csv", "run.npz"], "what is in the run is kept once"


def test_who_is_killed_loses_the_last_second(folder, capsys):
    for _ in range(3):  # on a busy machine a recording may be complete before it is killed
        process = record(folder)
        until(
            lambda process=process: frames(folder / "run.seen") > 8 or process.poll() is not None,
            60,
        )
        process.kill()
        said = process.communicate()[1]
        if (folder / "run.seen").exists():
            break
        (folder / "run.npz").unlink()
    time.sleep(1.0)
    assert main(["record", "c.csv", "--emulated", "--out", "run.npz"]) == 2
    again = capsys.readouterr().err
    line = "softmap record c.csv --recover run.seen --out run.npz"
    assert line in again and line in said, "how, at the start and when it is found"
    seen = frames(folder / "run.seen")
    assert main([*shlex.split(line)[1:], "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    run = Run.load(folder / "run.npz")
    assert (
        reported["schema"] == "softmap.record/1"
        and not reported["whole"]
        and reported["frames"] == run.frames >= seen - 3 > 2
    )
    assert run.vertices.shape[1:] == builtin_model().rest.shape and set(run.block) <= {
        "circle",
        "home",
    }
    assert np.abs(np.diff(run.ticks, axis=0)).max() > 0


def little():
    """Give a process that begins no room for files beyond MOST."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST, MOST))


FULL = r"file too large: .*{}, recorded up to \d+\.\d s; the recording broke off, and what it has is kept"


def test_a_full_disk_is_reported_and_what_there_is_is_kept(folder):
    process = record(folder, before=little)
    out, said = process.communicate(timeout=200)
    assert process.returncode != 0 and not (folder / "run.npz.part").exists(), out
    left = set(os.listdir(folder))
    assert "run.npz" in left or {"run.loop.mcap", "run.seen"} <= left, said
    assert (
        "recording broke off" in said
        or "are no longer recorded" in said
        or "kept: run.loop.mcap and run.seen" in said
    )


def test_a_full_disk_under_a_drive_is_reported(folder):
    argv = [
        SOFTMAP,
        "track",
        "O",
        "--sim",
        "--amplitude",
        "2",
        "--duration",
        "6",
        "--record",
        "t.mcap",
        "--json",
    ]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=200, preexec_fn=little)
    assert done.returncode == 2 and re.search(FULL.format("t.mcap"), done.stderr), done.stderr
    assert (folder / "t.mcap").exists() and (folder / "t.mcap").stat().st_size <= MOST
    assert main(["servo", "replay", "t.mcap"]) == 1


def test_an_error_in_making_the_run_keeps_both_files(folder, monkeypatch, capsys):
    def fails(self, path):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("softmap_edge.run.run.Run.save", fails)
        assert main(["record", "c.csv", "--emulated", "--out", "run.npz"]) == 2
    said = capsys.readouterr().err
    assert "run.npz: the disk is full; free some space, or give another place" in said
    assert (
        "kept: run.loop.mcap and run.seen; they become the run by: softmap record c.csv --recover "
        "run.seen" in said
    )
    assert {"run.loop.mcap", "run.seen"} <= set(os.listdir(folder))
    assert main(["record", "c.csv", "--recover", "run.seen", "--out", "run.npz"]) == 0
    assert Run.load(folder / "run.npz").frames > 3
