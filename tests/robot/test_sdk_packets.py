"""Each instruction on the wire is the official SDK's, byte for byte, drawn ones too; each reads the
other's answers.

The SDK speaks to a double of its port, our bus to a pseudo-terminal. Packets that only the loop
sends (sync) go through the codec here; rust/servo/bus_tests.rs holds the bus to the same bytes. SDK
4.1.0 works out a packet's stuffing and then sends it without, and reads wrongly what follows the
first byte that it takes out: its `addStuffing` is the oracle there.
"""

import os
import random
import select
import threading
import tty
from dataclasses import dataclass
from typing import Any

import pytest
from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

from softmap_edge import _core
from softmap_edge.errors import ServoError

SDK = PacketHandler(2.0)
EVERYBODY, STATUS = 0xFE, 0x55
PATTERN = b"\xff\xff\xfd"
SYNC_READ = "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"
SYNC_WRITE = "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87"
FAST_SYNC_READ = "FF FF FD 00 FE 09 00 8A 84 00 04 00 01 02 4D 72"
FAST_ANSWER = "FF FF FD 00 FE 11 00 55 00 01 A6 00 00 00 74 3B 00 02 1F 08 00 00 1C 36"
PATIENCE = 10.0  # s until a question must have come
DONE = "FF FF FD 00 01 04 00 55 00 A1 0C"


class Port:
    """A double of the SDK's port: keeps what is sent and gives `answer`."""

    is_using = False

    def __init__(self, answer=b""):
        self.sent, self.answer = b"", bytearray(answer)

    def clearPort(self):
        """Nothing waits."""

    def writePort(self, packet):
        self.sent += bytes(packet)
        return len(packet)

    def readPort(self, count):
        taken, self.answer = self.answer[:count], self.answer[count:]
        return list(taken)

    def setPacketTimeout(self, count):
        """The answer is there already."""

    def setPacketTimeoutMillis(self, milliseconds):
        """The answer is there already."""

    def isPacketTimeout(self):
        return not self.answer

    def getBaudRate(self):
        return 1_000_000


def on_our_wire(ask, answer):
    """Let our bus ask; the bytes that it sent and what it made of `answer` (a fault is its
    text).
    """
    master, slave = os.openpty()
    tty.setraw(slave)
    sent = bytearray()

    def servo():
        while len(sent) < 7 or len(sent) < 7 + int.from_bytes(sent[5:7], "little"):
            if not select.select([master], [], [], PATIENCE)[0]:
                return  # it was never asked
            sent.extend(os.read(master, 1024))
        os.write(master, answer)

    there = threading.Thread(target=servo)
    there.start()
    try:
        bus = _core.ServoBus(os.ttyname(slave), 1_000_000, slack=0.5)
        try:
            made = ask(bus)
        except ServoError as fault:
            made = str(fault)
        bus.close()
    finally:
        there.join()
        os.close(master)
        os.close(slave)
    return bytes(sent), made


@dataclass(frozen=True)
class Instruction:
    """How both ask for the same, the manual's packet and answer, and what each makes of the
    answer.
    """

    sdk: Any
    ours: Any
    packet: str
    answer: str
    found: tuple[Any, Any]


INSTRUCTIONS = {
    "ping": Instruction(
        lambda port: SDK.ping(port, 1),
        lambda bus: bus.ping(1),
        "FF FF FD 00 01 03 00 01 19 4E",
        "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D",
        ((1030, COMM_SUCCESS, 0), (1030, 38)),
    ),
    "ping of everybody": Instruction(
        SDK.broadcastPing,
        lambda bus: bus.scan(),
        "FF FF FD 00 FE 03 00 01 31 42",
        "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D",
        (({1: [1030, 38], 2: [1030, 38]}, COMM_SUCCESS), [(1, 1030, 38), (2, 1030, 38)]),
    ),
    "read": Instruction(
        lambda port: SDK.read4ByteTxRx(port, 1, 132),
        lambda bus: bus.read(1, 132, 4),
        "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15",
        "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0",
        ((166, COMM_SUCCESS, 0), b"\xa6\0\0\0"),
    ),
    "write": Instruction(
        lambda port: SDK.write4ByteTxRx(port, 1, 116, 512),
        lambda bus: bus.write(1, 116, b"\0\2\0\0"),
        "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
        DONE,
        ((COMM_SUCCESS, 0), None),
    ),
    "reboot": Instruction(
        lambda port: SDK.reboot(port, 1),
        lambda bus: bus.reboot(1),
        "FF FF FD 00 01 03 00 08 2F 4E",
        DONE,
        ((COMM_SUCCESS, 0), None),
    ),
    "clear multi-turn": Instruction(
        lambda port: SDK.clearMultiTurn(port, 1),
        lambda bus: bus.clear_turns(1),
        "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC",
        DONE,
        ((COMM_SUCCESS, 0), None),
    ),
}


@pytest.mark.parametrize("name", INSTRUCTIONS)
def test_an_instruction_is_the_sdk_s_and_the_manual_s_and_its_answer_is_read_alike(name):
    one = INSTRUCTIONS[name]
    port = Port(bytes.fromhex(one.answer))
    read_by_sdk = one.sdk(port)
    sent, read_by_us = on_our_wire(one.ours, bytes.fromhex(one.answer))
    assert sent == port.sent == bytes.fromhex(one.packet)
    assert (read_by_sdk, read_by_us) == one.found


def sync_read(port, ids=(1, 2), address=132, size=4, fast=False):
    """Let the SDK ask for a sync read, return its group."""
    group = GroupSyncRead(port, SDK, address, size)
    assert all(group.addParam(id) for id in ids)
    (group.fastSyncRead if fast else group.txRxPacket)()
    return group


def test_sync_read_is_the_sdk_s_and_the_manual_s_and_its_answers_are_read_alike():
    answers = [(1, b"\xa6\0\0\0"), (2, b"\x1f\x08\0\0")]
    stream = b"".join(_core.servo_packet(id, STATUS, b"\0" + data) for id, data in answers)
    assert stream.hex(" ").upper() == (
        "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0 FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"
    )
    port = Port(stream)
    group = sync_read(port)
    assert (
        port.sent
        == _core.servo_packet(EVERYBODY, 0x82, bytes([132, 0, 4, 0, 1, 2]))
        == bytes.fromhex(SYNC_READ)
    )
    assert [group.getData(id, 132, 4) for id in (1, 2)] == [166, 2079]
    assert _core.servo_packets(stream) == [(id, STATUS, b"\0" + data) for id, data in answers]


def test_sync_write_is_the_sdk_s_and_the_manual_s():
    port = Port()
    group = GroupSyncWrite(port, SDK, 116, 4)
    assert group.addParam(1, [0x96, 0, 0, 0]) and group.addParam(2, [0xAA, 0, 0, 0])
    assert group.txPacket() == COMM_SUCCESS
    parameters = bytes([116, 0, 4, 0, 1, 0x96, 0, 0, 0, 2, 0xAA, 0, 0, 0])
    assert port.sent == _core.servo_packet(EVERYBODY, 0x83, parameters) == bytes.fromhex(SYNC_WRITE)


def test_fast_sync_read_is_the_sdk_s_and_its_answer_is_read_by_it():
    port = Port(bytes.fromhex(FAST_ANSWER))
    group = sync_read(port, fast=True)
    ours = _core.servo_packet(EVERYBODY, 0x8A, bytes([132, 0, 4, 0, 1, 2]))
    assert port.sent == ours == bytes.fromhex(FAST_SYNC_READ)
    assert [group.getData(id, 132, 4) for id in (1, 2)] == [166, 2079]


def of_sdk(id, instruction, parameters):
    """Return the packet of the SDK's own stuffing and checksum."""
    length = len(parameters) + 3
    sdk = Protocol2PacketHandler()
    packet = sdk.addStuffing(
        [0xFF, 0xFF, 0xFD, 0, id, length & 0xFF, length >> 8, instruction, *parameters, 0, 0]
    )
    crc = sdk.updateCRC(0, packet, len(packet) - 2)
    return bytes([*packet[:-2], crc & 0xFF, crc >> 8])


def nasty(rng, count):
    """Return bytes that are mostly those of headers."""
    return bytes(rng.choice((0xFF, 0xFF, 0xFD, 0x00, rng.randrange(256))) for _ in range(count))


def word(number):
    return number.to_bytes(2, "little")


def drawn_read(rng, port, id):
    address, size = rng.randrange(600), rng.randrange(1, 200)
    SDK.readTx(port, id, address, size)
    return id, 0x02, word(address) + word(size)


def drawn_write(rng, port, id):
    address, data = rng.randrange(600), nasty(rng, rng.randrange(1, 60))
    SDK.writeTxOnly(port, id, address, len(data), list(data))
    return id, 0x03, word(address) + data


def drawn_sync_read(rng, port, id, fast=False):
    ids, address, size = (
        rng.sample(range(253), rng.randrange(1, 9)),
        rng.randrange(600),
        rng.randrange(1, 60),
    )
    sync_read(port, ids, address, size, fast)
    return EVERYBODY, 0x8A if fast else 0x82, word(address) + word(size) + bytes(ids)


def drawn_fast_sync_read(rng, port, id):
    return drawn_sync_read(rng, port, id, fast=True)


def drawn_sync_write(rng, port, id):
    ids, address, size = (
        rng.sample(range(253), rng.randrange(1, 9)),
        rng.randrange(600),
        rng.randrange(1, 20),
    )
    data = {id: nasty(rng, size) for id in ids}
    group = GroupSyncWrite(port, SDK, address, size)
    assert all(group.addParam(id, list(one)) for id, one in data.items())
    group.txPacket()
    return (
        EVERYBODY,
        0x83,
        word(address) + word(size) + b"".join(bytes([id]) + one for id, one in data.items()),
    )


def drawn_ping(rng, port, id):
    SDK.ping(port, id)
    return id, 0x01, b""


def drawn_reboot(rng, port, id):
    SDK.reboot(port, id)
    return id, 0x08, b""


def drawn_clear(rng, port, id):
    SDK.clearMultiTurn(port, id)
    return id, 0x10, b"\x01DXL\x22"


ONE_SERVO = [drawn_ping, drawn_read, drawn_write, drawn_reboot, drawn_clear]
DRAWN = [*ONE_SERVO, drawn_sync_read, drawn_sync_write, drawn_fast_sync_read]


@pytest.mark.parametrize("draw", DRAWN)
def test_drawn_instructions_are_the_sdk_s(draw):
    rng, plain, stuffed = random.Random(5), 0, 0
    for _ in range(400):
        port = Port()
        id, instruction, parameters = draw(rng, port, rng.randrange(253))
        ours = _core.servo_packet(id, instruction, parameters)
        if PATTERN in parameters:
            stuffed += 1
            assert ours == of_sdk(id, instruction, parameters)
        else:
            plain += 1
            assert ours == port.sent
    assert plain > 50 and (stuffed > 50) == (draw in (drawn_write, drawn_sync_write))


def test_stuffing_and_checksum_are_the_sdk_s_whatever_the_instruction():
    rng, stuffed = random.Random(7), 0
    for _ in range(3000):
        parameters = nasty(rng, rng.randrange(0, 120))
        id = rng.choice((rng.randrange(253), 254))
        instruction = rng.choice((1, 2, 3, 4, 5, 6, 8, 16, STATUS, 0x82, 0x83, 0x8A, 0x92, 0x93))
        ours = _core.servo_packet(id, instruction, parameters)
        assert ours == of_sdk(id, instruction, parameters)
        assert _core.servo_packets(ours) == [(id, instruction, parameters)]
        stuffed += len(ours) > len(parameters) + 10
    assert stuffed > 1000


def test_drawn_answers_are_read_alike_and_written_alike():
    rng, plain, stuffed = random.Random(9), 0, 0
    for _ in range(1500):
        id, error = rng.randrange(253), rng.choice((0, 0x80, rng.randrange(1, 8), 0x87))
        data = nasty(rng, rng.randrange(1, 60))
        ours = _core.servo_packet(id, STATUS, bytes([error]) + data)
        assert ours == of_sdk(id, STATUS, bytes([error]) + data)
        assert _core.servo_packets(ours) == [(id, STATUS, bytes([error]) + data)]
        if PATTERN in bytes([error]) + data:
            stuffed += 1
        else:
            plain += 1
            read, result, said = SDK.readTxRx(Port(ours), id, 132, len(data))
            assert (bytes(read), result, said) == (data, COMM_SUCCESS, error)
    assert min(stuffed, plain) > 300


@pytest.mark.parametrize("error", [0x00, 0x80, 1, 2, 3, 4, 5, 6, 7, 0x87])
def test_what_an_answer_says_of_an_instruction_is_read_alike(error):
    answer = of_sdk(1, STATUS, bytes([error, 0xFF, 0xFF, 0xFD, 0x01]))
    data, result, said = SDK.readTxRx(Port(answer), 1, 132, 4)
    assert (bytes(data), result, said) == (PATTERN + b"\x01", COMM_SUCCESS, error)
    _, read = on_our_wire(lambda bus: bus.read(1, 132, 4), answer)
    if error & 0x7F:
        assert isinstance(read, str) and read.startswith("the servo "), read
    else:
        assert read == PATTERN + b"\x01", "an alert is no refusal"
