"""The command: what it refuses, model and key, landmarks between two programs; the commands of
docs/do/teleop.md.
"""

import argparse
import json
import re
import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from driving import Camera, Finder, Fingers, hand
from hand_model import hand_model
from waiting import until

from benches.data import find
from softmap_edge.cli import main
from softmap_edge.commands.teleop import teleop_arguments
from softmap_edge.robot.link.session import read_key
from softmap_edge.robot.teleop.hand import View
from softmap_edge.robot.teleop.hand_source import CameraHandSource, RemoteHandSource
from softmap_edge.robot.teleop.landmarks import Receiver, Sender
from softmap_edge.robot.teleop.model_file import WHEEL
from softmap_edge.robot.teleop.remote_sender import send
from softmap_edge.robot.teleop.requirements import INSTALL

PAGE = (Path(__file__).parents[2] / "docs/do/teleop.md").read_text(encoding="utf-8")
PATIENT = 20.0


@pytest.mark.parametrize(
    "options, said",
    [
        ([], "one of the arguments --sim --rig --send"),
        (["--sim", "--page", "x"], "--page 'x': give a port"),
        (["--sim", "--page", "70000"], "port 70000"),
        (["--sim", "--page", "none"], "nothing can drive"),
        (["--sim", "--camera", "udp://:9000"], "needs --key FILE"),
        (["--sim", "--camera", "http://x"], "give the number or path of a camera"),
        (
            ["--sim", "--camera", "none.mp4", "--model", "none.task"],
            "no model of hands; get the wheel",
        ),
        (["--sim", "--flip", "z"], "there are x and y"),
        (["--sim", "--seconds", "0"], "--seconds 0"),
        (["--sim", "--reach", "1"], "give two numbers, SIDE,FORWARD"),
        (["--sim", "--reach", "0,1"], "two numbers above 0"),
        (["--rig", "none.toml"], "no calibration"),
        (["--rig", "r.toml", "--hidden", "creep"], "give --sim with it"),
        (["--send", "nowhere"], "give udp://HOST:PORT"),
        (["--send", "udp://127.0.0.1:9000"], "gives no pictures"),
        (["--send", "udp://127.0.0.1:9000", "--camera", "0"], "needs --key FILE"),
        (["--fetch-model", "none.whl"], "no such file"),
    ],
)
def test_what_cannot_be_driven_is_refused_in_one_line(options, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["teleop", *options]) == 2
    assert said in capsys.readouterr().err


def test_a_camera_that_is_not_there_is_reported_before_anything_moves(capsys, tmp_path):
    model = str(hand_model(tmp_path))
    assert main(["teleop", "--sim", "--page", "none", "--camera", "9999", "--model", model]) == 2
    assert "camera 9999: there is no /dev/video9999" in capsys.readouterr().err


def test_a_key_is_made_once_and_readable_by_its_owner_alone(capsys, tmp_path):
    file = tmp_path / "teleop.key"
    assert main(["teleop", "--new-key", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["schema"] == "softmap.teleop/1"
    assert len(read_key(file)) == 32 and file.stat().st_mode & 0o777 == 0o600
    assert main(["teleop", "--new-key", str(file)]) == 2


def test_a_model_is_copied_with_its_checksum(capsys, tmp_path):
    model = hand_model(tmp_path)
    to = tmp_path / "copy.task"
    assert main(["teleop", "--fetch-model", str(model), "--model", str(to), "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert (
        reported["known_as"] == "mediapipe 0.10.18"
        and reported["sha256"] in to.with_name("copy.task.sha256").read_text()
    )
    assert main(["teleop", "--fetch-model", str(model), "--model", str(to)]) == 2
    assert main(["teleop", "--fetch-model", str(model), "--model", str(to), "--force"]) == 0


def test_a_video_is_played_through_the_full_chain(capsys, tmp_path):
    folder = find("hand")
    if folder is None:
        pytest.skip("not run: there is no hand.mp4")
    model = str(hand_model(tmp_path))
    words = [
        "teleop",
        "--sim",
        "--page",
        "none",
        "--camera",
        str(folder / "hand.mp4"),
        "--model",
        model,
    ]
    assert main([*words, "--seconds", "3", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert (
        reported["pictures"] > 5
        and reported["hands"] == reported["pictures"]
        and reported["presses"] == 0
    )
    assert set(reported["states_s"]) == {"ready"}, "a hand alone drives nothing"


def test_landmarks_and_key_reach_the_other_computer():
    """The robot's eyes see the messages of the sender's loop; the key lapses with the
    connection.
    """
    key = bytes(range(32))
    with Receiver("127.0.0.1", 0, key) as receiver:
        port = receiver.port
        far = RemoteHandSource(receiver, View())
        camera, finder, fingers, lines = Camera(), Finder(), Fingers("hand"), []
        with (
            far,
            CameraHandSource("camera 0", camera, finder, View()) as near,
            Sender("127.0.0.1", port, key) as sender,
        ):
            done = []
            thread = threading.Thread(
                target=lambda: done.append(send(near, sender, fingers, None, lines.append))
            )
            thread.start()
            until(lambda: far.hands > 3)
            np.testing.assert_allclose(far.newest().hand.points, hand().points, atol=0.01)
            held = lambda: far.controls(time.monotonic()).held  # noqa: E731
            assert not held()

            def pressed():
                """Press, again where a busy machine made the key lapse."""
                begin = time.monotonic()
                while not held():
                    assert time.monotonic() - begin < PATIENT
                    fingers.held = False
                    time.sleep(0.2)
                    fingers.held = True
                    time.sleep(0.2)

            pressed()
            fingers.held = False
            until(lambda: not held())
            finder.hands = []
            until(lambda: far.newest().hand is None)
            pressed()
            fingers.wish.ask("end")
            thread.join(PATIENT)
            until(lambda: not held())
    assert done[0].sent > 10 and done[0].ended == "ended at the terminal"
    assert any("sending" in line for line in lines) and any("no hand" in line for line in lines)


def test_who_has_another_key_is_reported_on_both_sides(tmp_path, capsys):
    for name in ("ours", "another"):
        main(["teleop", "--new-key", str(tmp_path / name)])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    lines, far = [], ("127.0.0.1", port, read_key(tmp_path / "another"))
    with CameraHandSource("camera 0", Camera(), Finder(), View()) as near, Sender(*far) as sender:
        thread = threading.Thread(target=send, args=(near, sender, None, 3.0, lines.append))
        thread.start()
        words = [
            "teleop",
            "--sim",
            "--camera",
            f"udp://127.0.0.1:{port}",
            "--key",
            str(tmp_path / "ours"),
            "--page",
        ]
        assert main([*words, "none", "--seconds", "3"]) == 0
        thread.join(PATIENT)
    assert re.search(r"datagrams dropped: \d+ for signature", capsys.readouterr().out)
    assert lines and all("with the same key" in line for line in lines)


def test_a_port_that_is_taken_is_reported(capsys, tmp_path):
    main(["teleop", "--new-key", str(tmp_path / "k")])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        there = f"udp://127.0.0.1:{taken.getsockname()[1]}"
        assert main(["teleop", "--sim", "--camera", there, "--key", str(tmp_path / "k")]) == 2
    assert "give a free port" in capsys.readouterr().err


def commands():
    """Return the commands of the page."""
    blocks = re.findall(r"```\n(.*?)```", PAGE, re.S)
    return [line for block in blocks for line in block.splitlines()]


def test_every_command_of_the_page_is_one():
    """Those that need neither a camera nor another computer run; of all the words are
    understood.
    """
    ours = [line.split() for line in commands() if line.startswith("softmap ")]
    assert len(ours) == 6
    for words in ours:
        parser = argparse.ArgumentParser(exit_on_error=False)
        teleop_arguments(parser)
        assert words[1] == "teleop" and parser.parse_args(words[2:])
    assert set(commands()) - {" ".join(words) for words in ours} == {WHEEL, INSTALL}


def test_the_commands_of_the_page_that_need_no_device_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    ours = [line.split()[1:] for line in commands() if line.startswith("softmap ")]
    plain = next(words for words in ours if words == ["teleop", "--sim"])
    assert main([*plain, "--page", "0", "--seconds", "0.5"]) == 0
    assert "open http://127.0.0.1:" in capsys.readouterr().err
    assert main(next(words for words in ours if "--new-key" in words)) == 0
    udp = next(words for words in ours if "udp://:9000" in words)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    udp = [word.replace("9000", str(port)) for word in udp]
    assert main([*udp, "--page", "0", "--seconds", "0.5", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (
        reported["camera"] == "the other computer" and reported["ended"] == "after 0.5 s, as asked"
    )
    fetch = next(words for words in ours if "--fetch-model" in words)
    (tmp_path / "wheels").mkdir()
    model = hand_model(tmp_path / "wheels")
    assert main([*fetch[:2], str(model), "--model", "hand_landmarker.task"]) == 0
