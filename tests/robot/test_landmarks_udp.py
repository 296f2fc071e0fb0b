"""Landmarks over UDP: what was sent arrives, and whatever else arrives counts nothing."""

import math
import os
import random
import socket
import stat
import struct
import time

import numpy as np
import pytest
from hands import hand

from softmap_edge.errors import LinkError
from softmap_edge.robot.link import session as signed_udp
from softmap_edge.robot.link.session import NO_SESSION, SILENCE, new_key, read_key, tag
from softmap_edge.robot.teleop import landmarks as landmarks_udp
from softmap_edge.robot.teleop.landmarks import (
    DATAGRAM,
    OFFER,
    Message,
    Receiver,
    Sender,
    packed,
    unpacked,
)

KEY = bytes(range(32))
PALM = Message(hand(), held=True)


@pytest.fixture
def receiver():
    with Receiver("127.0.0.1", 0, KEY) as opened:
        yield opened


def arrived(receiver, sender, message=PALM):
    sender.send(message)
    return receiver.newest()


def met(receiver, sender):
    """The first datagram asks for the session, the second is signed under it."""
    arrived(receiver, sender)
    assert arrived(receiver, sender) is not None
    return receiver.newest()


def test_a_hand_arrives_as_it_was_sent(receiver):
    with Sender("127.0.0.1", receiver.port, KEY) as sender:
        assert receiver.newest() is None and not sender.heard
        assert arrived(receiver, sender) is None  # no sender is trusted before it answered
        got = arrived(receiver, sender)
        assert sender.heard and got.sequence == 2 and got.message.held and 0 <= got.age < 0.5
        np.testing.assert_allclose(got.message.hand.points, PALM.hand.points, rtol=1e-7)
        assert got.message.hand.side == "right"
        left = Message(hand(curl=0.4, side="left"))
        got = arrived(receiver, sender, left)
        assert got.message.hand.side == "left" and not got.message.held
        got = arrived(receiver, sender, Message(held=True))  # a heartbeat without a hand
        assert got.message.hand is None and got.message.held
        assert receiver.lost == 0 and not receiver.refused


def test_silence_ages(receiver):
    with Sender("127.0.0.1", receiver.port, KEY) as sender:
        met(receiver, sender)
        time.sleep(0.1)
        assert 0.1 <= receiver.newest().age < 0.6


def test_what_stood_in_a_queue_is_old(receiver):
    with Sender("127.0.0.1", receiver.port, KEY) as sender:
        met(receiver, sender)
        sender.send(PALM)
        time.sleep(0.2)  # as if it had been on its way for so long
        assert 0.2 <= receiver.newest().age < 0.7


def test_the_newest_wins_and_gaps_are_counted(receiver):
    with Sender("127.0.0.1", receiver.port, KEY) as sender:
        met(receiver, sender)
        for k in range(20):
            sender.send(Message(hand(curl=k / 100)))
        got = receiver.newest()
        assert got.sequence == 22
        np.testing.assert_allclose(got.message.hand.points, hand(curl=0.19).points, rtol=1e-6)
        sender._sequence += 5
        assert arrived(receiver, sender).sequence == 28 and receiver.lost == 5


def recorded(receiver, sender, count=3):
    """Datagrams of a live session as somebody on the way records them."""
    met(receiver, sender)
    datagrams = []
    for _ in range(count):
        sender.send(PALM)
        datagrams.append(packed(PALM, sender._session, sender._sequence, time.monotonic(), KEY))
    receiver.newest()
    return datagrams


def test_replayed_and_reordered_datagrams_count_nothing(receiver):
    with Sender("127.0.0.1", receiver.port, KEY) as sender:
        again = recorded(receiver, sender)
        before = receiver.newest().sequence
        for datagram in [*again, again[0]]:
            sender._socket.send(datagram)
        assert receiver.newest().sequence == before and receiver.refused["replay"] == 4


def test_a_recording_counts_nothing_after_a_restart_of_the_receiver():
    with Receiver("127.0.0.1", 0, KEY) as first, Sender("127.0.0.1", first.port, KEY) as sender:
        again = recorded(first, sender, 10)
    with (
        Receiver("127.0.0.1", 0, KEY) as second,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief,
    ):
        for _ in range(5):
            for datagram in again:
                thief.sendto(datagram, ("127.0.0.1", second.port))
        assert second.newest() is None and second.refused["session"] == 50
        thief.setblocking(False)
        assert len(thief.recv(4096)) == OFFER < DATAGRAM  # no amplification


def test_a_session_that_was_offered_is_soon_over(receiver, monkeypatch):
    monkeypatch.setattr(signed_udp, "OFFER_LASTS", 0.05)
    with Sender("127.0.0.1", receiver.port, KEY) as sender:
        assert arrived(receiver, sender) is None
        time.sleep(0.1)
        assert arrived(receiver, sender) is None  # too late: another is offered
        assert arrived(receiver, sender) is not None


def test_either_side_may_be_started_again():
    with Receiver("127.0.0.1", 0, KEY) as receiver:
        port = receiver.port
        with Sender("127.0.0.1", port, KEY) as sender:
            met(receiver, sender)
        with Sender("127.0.0.1", port, KEY) as sender:
            time.sleep(SILENCE)
            assert met(receiver, sender).sequence == 2
            receiver.close()
            for _ in range(2):
                sender.send(PALM)  # no listener: it raises nothing and goes on counting
            with Receiver("127.0.0.1", port, KEY) as second:
                for _ in range(4):
                    got = arrived(second, sender)
                assert got.sequence == 8


def test_while_a_sender_is_alive_no_other_takes_its_place(receiver):
    with (
        Sender("127.0.0.1", receiver.port, KEY) as first,
        Sender("127.0.0.1", receiver.port, KEY) as second,
    ):
        met(receiver, first)
        for _ in range(5):
            arrived(receiver, second, Message())
            assert arrived(receiver, first).message.held
        assert not second.heard and receiver.refused["sender"] == 5
        second._session, second._sequence = first._session, 10**6  # even under our own session
        assert arrived(receiver, second, Message()).message.held
        second._session = NO_SESSION
        time.sleep(SILENCE)
        arrived(receiver, second, Message())
        assert not arrived(receiver, second, Message()).message.held


def test_another_key_and_changed_bytes_count_nothing(receiver):
    with (
        Sender("127.0.0.1", receiver.port, KEY) as sender,
        Sender("127.0.0.1", receiver.port, KEY[::-1]) as stranger,
    ):
        met(receiver, sender)
        before = receiver.newest().sequence
        assert arrived(receiver, stranger).sequence == before and not stranger.heard
        good = packed(PALM, sender._session, 10**9, time.monotonic(), KEY)
        for place in range(DATAGRAM):
            changed = bytearray(good)
            changed[place] ^= 1 << (place % 8)
            sender._socket.send(bytes(changed))
            receiver.newest()
        assert (
            receiver.newest().sequence == before and receiver.refused["signature"] == DATAGRAM + 1
        )
        sender._socket.send(good)
        assert receiver.newest().sequence == 10**9


def test_forged_offers_are_not_taken(receiver):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with Sender("127.0.0.1", other.getsockname()[1], KEY) as sender:
            sender.send(PALM)
            _, address = other.recvfrom(4096)
            for junk in (
                b"",
                b"SMO1",
                b"SMO1" + os.urandom(48),
                os.urandom(4096),
                packed(PALM, NO_SESSION, 1, 0.0, KEY),
            ):
                other.sendto(junk, address)
            sender.send(PALM)
            assert not sender.heard


def test_fuzzed_datagrams_never_crash_and_are_never_believed(receiver):
    """Random bytes, and rightly signed ones of any content: numbers that are none, flags that do
    not exist.
    """
    rng = random.Random(0)
    with Sender("127.0.0.1", receiver.port, KEY) as sender:
        met(receiver, sender)
        before = receiver.newest().sequence
        for _ in range(3000):
            size = rng.choice([0, 1, DATAGRAM - 1, DATAGRAM, DATAGRAM + 1, rng.randrange(3000)])
            assert isinstance(unpacked(rng.randbytes(size), KEY), str)
            receiver._take(rng.randbytes(size), ("127.0.0.1", 1), 0.0)
        taken = 0
        for _ in range(3000):
            body = bytearray(packed(PALM, sender._session, 0, 0.0, KEY)[:-32])
            for _ in range(rng.randint(1, 8)):
                body[rng.randrange(len(body))] = rng.choice(
                    [0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)]
                )
            found = unpacked(bytes(body) + tag(KEY, bytes(body)), KEY)
            if isinstance(found, str):
                assert found == "content"
                continue
            taken += 1
            message, _, _, clock = found
            assert math.isfinite(clock)
            assert message.hand is None or np.isfinite(message.hand.points).all()
        assert 0 < taken < 3000
        assert receiver.newest().sequence == before


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e9])
def test_signed_numbers_that_are_none_are_refused(bad):
    good = packed(PALM, NO_SESSION, 1, 0.0, KEY)[:-32]
    for offset, form in (
        (29, "<d"),
        (37, "<f"),
        (41, "<f"),
        (41 + 41 * 4, "<f"),
    ):  # clock, score, first and last number
        body = bytearray(good)
        struct.pack_into(form, body, offset, bad)
        found = unpacked(bytes(body) + tag(KEY, bytes(body)), KEY)
        assert found == "content" or (offset == 29 and math.isfinite(bad))


def test_a_flood_delays_no_receiver(receiver):
    with Sender("127.0.0.1", receiver.port, KEY) as sender:
        met(receiver, sender)
        for _ in range(2000):
            sender._socket.send(b"x" * 50)
        start = time.monotonic()
        receiver.newest()
        assert time.monotonic() - start < 0.1
        assert receiver.refused["length"] <= landmarks_udp.MOST_AT_ONCE


def test_clocks_that_part_slowly_make_nothing_old(receiver):
    """A sender's clock that loses 50 parts in a million for an hour: 0.18 s, of which nothing is
    lateness.
    """
    late = [receiver._lateness(now, now * (1 - 50e-6) + 1e6) for now in np.arange(0.0, 3600.0, 0.5)]
    assert max(late) < 1e-3
    assert receiver._lateness(3600.3, 3600.0 * (1 - 50e-6) + 1e6) > 0.25


def test_a_host_of_both_kinds_is_met_on_ipv4():
    with Receiver("", 0, KEY) as receiver, Sender("localhost", receiver.port, KEY) as sender:
        assert met(receiver, sender).message.held


def test_keys(tmp_path):
    file = tmp_path / "key"
    key = new_key(file)
    assert read_key(file) == key and len(key) == 32 and stat.S_IMODE(file.stat().st_mode) == 0o600
    assert new_key(tmp_path / "other") != key
    with pytest.raises(LinkError, match="give the name of a new file"):
        new_key(file)
    file.chmod(0o644)
    with pytest.raises(LinkError, match="others can read this key; run chmod 600"):
        read_key(file)
    with pytest.raises(LinkError, match="copy it from the other computer"):
        read_key(tmp_path / "absent")
    file.chmod(0o600)
    for text in (b"", b"no key\n", b"abcd\n", b"\xff" * 64, b"00" * 2000):
        file.write_bytes(text)
        with pytest.raises(LinkError, match="at least 16 are needed"):
            read_key(file)
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(LinkError, match="at least 16 are needed"):
        read_key(tmp_path / "pipe")  # does not wait for who writes it
    for make in (
        lambda: Sender("127.0.0.1", 9, b"short"),
        lambda: Receiver("127.0.0.1", 0, b"short"),
    ):
        with pytest.raises(LinkError, match="key: 5 bytes"):
            make()


def test_addresses_that_cannot_be_had(receiver):
    cases = [
        (lambda: Receiver("127.0.0.1", receiver.port, KEY), "cannot be listened at"),
        (lambda: Receiver("192.0.2.1", 0, KEY), "cannot be listened at"),
        (lambda: Sender("no.such.host.invalid", 5005, KEY), "cannot be reached"),
        (lambda: Sender("a" * 300, 5005, KEY), "cannot be reached"),
        (lambda: Sender("127.0.0.1", 10**6, KEY), "ports are 1 to 65535"),
        (lambda: Receiver("", -1, KEY), "ports are 1 to 65535"),
    ]
    for act, said in cases:
        with pytest.raises(LinkError, match=said):
            act()
