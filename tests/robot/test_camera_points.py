"""Points of a camera over UDP: what counts, what is dropped and counted, one clock through
restarts.
"""

import argparse
import importlib
import math
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from page import blocks, lines
from waiting import until

from softmap_edge.commands import COMMANDS
from softmap_edge.errors import LinkError
from softmap_edge.robot.link import points as points_udp
from softmap_edge.robot.link.frames import Frame, on_host
from softmap_edge.robot.link.points import (
    MOST_POINTS,
    Message,
    PointReceiver,
    PointSender,
    packed,
    unpacked,
)
from softmap_edge.robot.link.session import SILENCE, read_key, udp_address

KEY = bytes(range(32))
POINTS = np.arange(12.0).reshape(4, 3)


@pytest.fixture
def receiver():
    with PointReceiver("127.0.0.1", 0, KEY, count=4) as opened:
        yield opened


def met(receiver, sender):
    """Let a sender ask for the receiver's session; nothing of that counts as a frame, or as
    refused.
    """
    before = receiver.taken, sum(receiver.refused.values())
    sender.send(POINTS, 0.0)
    until(lambda: sender._next() and sender.heard)
    sender._sequence = 0
    assert (receiver.taken, sum(receiver.refused.values())) == before
    return sender


def test_a_frame_arrives_as_it_was_sent(receiver):
    with PointSender("127.0.0.1", receiver.port, KEY) as sender:
        assert receiver.seen() == [] and not sender.heard
        met(receiver, sender)
        assert sender.send(POINTS, 7.0)
        assert sender.send(POINTS + 1, 7.1, visible=[True, False, True, True])
        until(lambda: receiver.taken == 2)
    first, second = receiver.seen()
    np.testing.assert_array_equal(first.points, POINTS)
    assert np.isnan(second.points[1]).all() and np.isfinite(second.points[[0, 2, 3]]).all()
    assert second.stamp - first.stamp == pytest.approx(0.1)
    assert 0 <= time.monotonic() - second.arrived < 10


def test_points_are_brought_to_the_base():
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    with PointReceiver("127.0.0.1", 0, frame=np.column_stack([turn, [1.0, 2, 3]])) as receiver:
        with PointSender("127.0.0.1", receiver.port) as sender:
            met(receiver, sender).send(np.where(np.arange(4)[:, None] == 2, np.nan, POINTS), 0.0)
        until(lambda: receiver.taken == 1)
        (frame,) = receiver.seen()
    np.testing.assert_allclose(
        frame.points[[0, 1, 3]], POINTS[[0, 1, 3]] @ turn.T + [1, 2, 3], rtol=1e-6
    )
    assert np.isnan(frame.points[2]).all()


def one(points=POINTS, stamp=1.0, session=bytes(range(16)), sequence=1):
    return Message(np.asarray(points, np.float32), stamp, session, sequence)


@pytest.mark.parametrize(
    "why, datagram",
    [
        ("length", b"x"),
        ("length", packed(one(), KEY)[:-1]),
        ("length", packed(one())),
        ("signature", packed(one(), bytes(32))),
        ("signature", packed(one(), KEY)[:40] + b"\x01" + packed(one(), KEY)[41:]),
        ("content", packed(one(stamp=math.nan), KEY)),
        ("content", packed(one(stamp=1e300), KEY)),
        ("content", packed(one(stamp=-1.1e10), KEY)),
        ("content", packed(one(POINTS * 1e9), KEY)),
        ("content", packed(one(np.full((4, 3), np.inf)), KEY)),
        ("content", packed(one(np.zeros((0, 3))), KEY)),
        ("points", packed(one(np.zeros((5, 3))), KEY)),
    ],
)
def test_what_does_not_count_is_dropped_and_counted(receiver, why, datagram):
    with PointSender("127.0.0.1", receiver.port, KEY) as sender:
        met(receiver, sender)._socket.send(datagram)
        sender.send(POINTS)
        until(lambda: receiver.taken == 1)
    assert dict(receiver.refused) == {why: 1} and f"1 for {why}" in receiver.summary()


def test_any_bytes_are_refused_or_a_message():
    rng = np.random.default_rng(0)
    good = packed(one())
    for _ in range(3000):
        datagram = bytearray(good[: rng.integers(0, len(good) + 1)])
        for _ in range(rng.integers(0, 4)):
            if datagram:
                datagram[rng.integers(len(datagram))] = rng.integers(256)
        got = unpacked(bytes(datagram))
        assert got in ("length", "content") if isinstance(got, str) else got.points.shape == (4, 3)
    assert unpacked(struct.pack("<4sHH16sQd", b"SMP1", 65535, 0, b"", 0, 0.0)) == "length"


def test_old_frames_and_other_senders_do_not_count(receiver):
    with (
        PointSender("127.0.0.1", receiver.port, KEY) as sender,
        PointSender("127.0.0.1", receiver.port, KEY) as other,
    ):
        met(receiver, sender).send(POINTS, 1.0)
        until(lambda: receiver.taken == 1)
        early = packed(Message(POINTS.astype(np.float32), 1.0, sender._session, 1), KEY)
        sender._socket.send(early)
        until(lambda: receiver.refused["replay"] == 1)
        sender.send(POINTS, 0.9)
        until(lambda: receiver.refused["replay"] == 2)
        sender._sequence += 3
        sender.send(POINTS, 1.1)
        until(lambda: receiver.taken == 2)
        assert receiver.lost == 3
        # The other is a sender of its own: it counts once ours is silent, then ours has to ask
        # again.
        end = time.monotonic() + 30.0
        while receiver.taken == 2:
            assert time.monotonic() < end
            other.send(POINTS + 1, 500.0)
            time.sleep(SILENCE / 5)
        assert receiver.refused["sender"] >= 1
        time.sleep(2 * SILENCE)
        sender._socket.send(
            packed(Message(POINTS.astype(np.float32), 9.0, sender._session, 99), KEY)
        )
        until(lambda: receiver.refused["session"] == 1)
    stamps = [frame.stamp for frame in receiver.seen()]
    assert receiver.taken == 3 and np.all(np.diff(stamps) > 0)


@pytest.mark.parametrize("key", [None, KEY])
def test_a_recording_counts_nothing_after_a_restart_of_the_receiver(key):
    with (
        PointReceiver("127.0.0.1", 0, key) as first,
        PointSender("127.0.0.1", first.port, key) as sender,
    ):
        met(first, sender)
        recorded = [
            packed(Message(POINTS.astype(np.float32), k, sender._session, k), key)
            for k in range(1, 20)
        ]
        for datagram in recorded:
            sender._socket.send(datagram)
        until(lambda: first.taken == len(recorded))
    with (
        PointReceiver("127.0.0.1", 0, key) as second,
        PointSender("127.0.0.1", second.port, key) as thief,
    ):
        for datagram in recorded:
            thief._socket.send(datagram)
        until(lambda: second.refused["session"] == len(recorded))
        # no amplification
        assert second.taken == 0 and len(thief._socket.recv(4096)) < len(recorded[0])


def test_one_clock_through_a_camera_that_was_started_again(receiver):
    now = [100.0]
    first, second = bytes(range(16)), bytes(range(1, 17))
    receiver._session = first  # as if it had been offered and taken up
    for k in range(60):
        came = packed(one(stamp=5.0 + k / 30, session=first, sequence=k + 1), KEY)
        receiver._take(came, "a", now[0] + 0.02 * (k % 3))
        now[0] += 1 / 30
    now[0] += 5.0
    receiver._session, receiver._sequence = second, 0
    for k in range(60):
        receiver._take(
            packed(one(stamp=900.0 + k / 30, session=second, sequence=k + 1), KEY), "a", now[0]
        )
        now[0] += 1 / 30
    frames = receiver.seen()
    assert len(frames) == 120
    host = on_host(frames)
    np.testing.assert_allclose(host[:60], 100.0 + np.arange(60) / 30, atol=1e-6)
    np.testing.assert_allclose(host[60:], 107.0 + np.arange(60) / 30, atol=1e-6)


@pytest.mark.parametrize("drift", [0.0, 80e-6, -300e-6])
def test_a_clock_that_drifts_is_followed(drift):
    rng = np.random.default_rng(1)
    taken = 1000.0 + np.arange(0, 300.0, 1 / 30)
    stamps = (taken - 600.0) * (1 + drift)
    arrived = taken + 0.02 + rng.exponential(0.01, taken.size)
    off = on_host([Frame(s, a, POINTS) for s, a in zip(stamps, arrived)], late=0.02) - taken
    assert np.abs(off).max() < 1e-3
    if drift:  # the quickest frame alone does not do it
        plain = stamps + np.min(arrived - stamps) - 0.02 - taken
        assert np.abs(plain).max() > 10e-3


def test_without_a_key_only_this_computer_sends():
    with pytest.raises(LinkError, match="need a shared key"):
        PointReceiver("0.0.0.0", 0)
    with PointReceiver("", 0) as receiver:
        assert receiver._socket.getsockname()[0] == "127.0.0.1"
    with pytest.raises(LinkError, match="at least 16"):
        PointReceiver("127.0.0.1", 0, b"short")


def test_a_port_that_is_taken_has_its_line(receiver):
    with pytest.raises(LinkError, match="cannot be listened at"):
        PointReceiver("127.0.0.1", receiver.port)


@pytest.mark.parametrize(
    "points, visible, line",
    [
        (np.zeros((3, 2)), None, r"points of shape \(3, 2\)"),
        (np.zeros((MOST_POINTS + 1, 3)), None, "1 to 5000 points"),
        (POINTS, [True], r"expected \(4,\)"),
    ],
)
def test_what_cannot_be_sent_is_reported(points, visible, line):
    with PointSender("127.0.0.1", 9, KEY) as sender, pytest.raises(LinkError, match=line):
        sender.send(points, 0.0, visible)


@pytest.mark.parametrize(
    ("points", "stamp", "line"),
    [
        (POINTS / 1000, 0.0, "within 0.011 mm of the origin, which looks like metres"),
        (
            [[0.0, 0.0, 0.04], [np.nan] * 3, [0.01, 0.0, 0.12]],
            0.0,
            "all 2 points .* looks like metres",
        ),
        (POINTS * 1000, 0.0, "at most 10000 mm; convert them to mm"),
        ([[0.0, 0.0, np.inf]], 0.0, "at most 10000 mm; convert them to mm"),
        (POINTS, float("nan"), "a stamp of nan s"),
        (POINTS, 1e12, "a stamp of 1000000000000"),
    ],
)
def test_points_that_are_not_in_mm_are_refused_by_their_sender(points, stamp, line):
    with PointSender("127.0.0.1", 9, KEY) as sender, pytest.raises(LinkError, match=line):
        sender.send(points, stamp)


def test_the_largest_frame_passes():
    with (
        PointReceiver("127.0.0.1", 0) as receiver,
        PointSender("127.0.0.1", receiver.port) as sender,
    ):
        assert met(receiver, sender).send(np.zeros((MOST_POINTS, 3)), 0.0)
        until(lambda: receiver.taken == 1)


def test_addresses():
    assert udp_address("udp://:9870") == ("", 9870)
    assert udp_address("udp://robot.local:1") == ("robot.local", 1)
    assert udp_address("udp://[::1]:65535") == ("::1", 65535)
    for text in ("udp://:0", "udp://a", "tcp://a:1", "udp://a:99999", "udp://u@a:1", "9870", ""):
        with pytest.raises(LinkError, match="is not an address"):
            udp_address(text)


def test_a_frame_holds_what_was_not_seen_as_nan():
    assert np.isnan(unpacked(packed(one([[1.0, np.nan, 2.0]] * 4))).points).all()
    assert isinstance(Frame(0.0, 0.0, POINTS), Frame) and points_udp.MARK == b"SMP1"


PAGE = (Path(__file__).parents[2] / "docs/do/camera.md").read_text(encoding="utf-8")


def test_what_the_page_says_can_be_typed(tmp_path, monkeypatch):
    """Its Python runs; its commands are understood (what they do is shown by the tests of each
    command).
    """
    monkeypatch.chdir(tmp_path)
    names = {command.name: command for command in COMMANDS}
    for language, text in blocks(PAGE):
        if language == "python":
            exec(compile(text, "docs/do/camera.md", "exec"), {})
        for words in lines(text) if language == "" else ():
            parser = argparse.ArgumentParser(exit_on_error=False)
            two = " ".join(words[1:3])
            command = names.get(two) or names[words[1]]
            getattr(importlib.import_module(command.module), f"{command.function}_arguments")(
                parser
            )
            parser.parse_args(words[1 + len(command.name.split()) :])
    assert len(read_key(tmp_path / "camera.key")) == 32
    assert f"at most {MOST_POINTS} points" in PAGE
