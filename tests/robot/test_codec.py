"""The official SDK drives the emulated servos through its own port, as our bus does; packets:
test_sdk_packets.py.
"""

import random

import pytest
from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

from softmap_edge import _core
from softmap_edge.errors import ServoError

PROTOCOL = PacketHandler(2.0)
XL330, XM430 = 1200, 1030
POSITION, GOAL, TORQUE, MODE, LED, CURRENT = 132, 116, 64, 11, 65, 102


def nasty(rng, count):
    """Return bytes that are mostly those of headers."""
    return bytes(rng.choice((0xFF, 0xFF, 0xFD, 0x00, rng.randrange(256))) for _ in range(count))


def test_packets_are_found_in_any_stream():
    rng = random.Random(3)
    asked = [nasty(rng, rng.randrange(0, 40)) for _ in range(200)]
    stream = b"".join(
        nasty(rng, rng.randrange(12)) + _core.servo_packet(7, 3, one) for one in asked
    )
    found = [parameters for id, _, parameters in _core.servo_packets(stream) if id == 7]
    assert found == asked


def test_a_packet_too_long_is_refused():
    with pytest.raises(ServoError, match="does not fit into 1024 bytes"):
        _core.servo_packet(1, 3, bytes(2000))


@pytest.fixture
def bus():
    """Two XL330 at 1 Mbaud, their horns at 2000 ticks, a tendon that asks for 0.4 mA a tick from
    there.
    """
    load = [(1000.0, -400.0), (2000.0, 0.0), (3000.0, 400.0)]
    emulated = _core.EmulatedBus(
        [(1, XL330, 1_000_000, 2000.0), (2, XL330, 1_000_000, 2000.0)],
        [load, load],
        delay=0.01,
        lag=0.03,
        seed=1,
    )
    yield emulated
    emulated.unplug()


@pytest.fixture
def sdk(bus):
    port = PortHandler(bus.path)
    assert port.openPort() and port.setBaudRate(1_000_000)
    yield port
    port.closePort()


def test_the_sdk_finds_reads_and_moves_the_servos(bus, sdk):
    found, result = PROTOCOL.broadcastPing(sdk)
    assert result == COMM_SUCCESS and found == {1: [XL330, 46], 2: [XL330, 46]}
    assert PROTOCOL.write1ByteTxRx(sdk, 1, MODE, 5) == (COMM_SUCCESS, 0)
    assert PROTOCOL.write1ByteTxRx(sdk, 1, TORQUE, 1) == (COMM_SUCCESS, 0)
    assert PROTOCOL.write1ByteTxRx(sdk, 1, MODE, 4) == (COMM_SUCCESS, 7), (
        "EEPROM is locked under torque"
    )
    assert PROTOCOL.write4ByteTxRx(sdk, 1, GOAL, 2300) == (COMM_SUCCESS, 0)
    at = 0
    for _ in range(300):
        at, result, error = PROTOCOL.read4ByteTxRx(sdk, 1, POSITION)
        assert (result, error) == (COMM_SUCCESS, 0)
        if at == 2300:
            break
    assert at == 2300
    assert PROTOCOL.reboot(sdk, 1) == (COMM_SUCCESS, 0)
    assert PROTOCOL.ping(sdk, 1)[1] != COMM_SUCCESS, "it is not back yet"


def test_the_sdk_s_groups_work_with_both_servos(bus, sdk):
    write = GroupSyncWrite(sdk, PROTOCOL, LED, 1)
    read = GroupSyncRead(sdk, PROTOCOL, LED, 1)
    for id in (1, 2):
        assert write.addParam(id, [id - 1]) and read.addParam(id)
    assert write.txPacket() == COMM_SUCCESS
    assert read.txRxPacket() == COMM_SUCCESS
    assert [read.getData(id, LED, 1) for id in (1, 2)] == [0, 1]
    assert read.fastSyncRead() == COMM_SUCCESS
    assert [read.getData(id, LED, 1) for id in (1, 2)] == [0, 1]


def test_our_bus_and_the_sdk_see_the_same_servo(bus, sdk):
    with pytest.raises(ServoError, match="in use by another program"):
        # The SDK does not lock its port; ours refuses to share one that somebody locked.
        first = _core.ServoBus(bus.path, 1_000_000)
        try:
            _core.ServoBus(bus.path, 1_000_000)
        finally:
            first.close()
    ours = _core.ServoBus(bus.path, 1_000_000)
    assert ours.ping(1) == (XL330, 46) and ours.ping(3) is None
    assert ours.scan() == [(1, XL330, 46), (2, XL330, 46)]
    ours.write(2, CURRENT, (300).to_bytes(2, "little", signed=True))
    assert ours.read(2, CURRENT, 2) == b"\x2c\x01"
    with pytest.raises(ServoError, match="beyond a limit"):
        ours.write(2, CURRENT, (3000).to_bytes(2, "little", signed=True))
    ours.close()
    with pytest.raises(ServoError, match="the port is closed"):
        ours.ping(1)
    assert PROTOCOL.read2ByteTxRx(sdk, 2, CURRENT)[0] == 300


def test_bad_ports_and_numbers_have_a_line_each(bus, tmp_path):
    file = tmp_path / "plain"
    file.write_text("")
    for port, said in ((str(tmp_path / "none"), "no such port"), (str(file), "is no serial port")):
        with pytest.raises(ServoError, match=said):
            _core.ServoBus(port, 1_000_000)
    assert _core.ServoBus(bus.path, 57_600).ping(1) is None, "another rate is not understood"
    with pytest.raises(ServoError, match="slack is 5"):
        _core.ServoBus(bus.path, 57_600, slack=5)
    for servos, said in (
        ([(1, 9999, 57_600, 0.0)], "no servo of model number 9999"),
        ([(1, XL330, 4_500_000, 0.0)], "XL330-M288 has no rate of 4500000 baud"),
        ([(253, XL330, 57_600, 0.0)], "ids go to 252"),
        ([(1, XL330, 57_600, float("nan"))], "numbers are finite"),
        ([], "0 servos with 1 loads"),
    ):
        with pytest.raises(ServoError, match=said):
            _core.EmulatedBus(servos, [[]])
    with pytest.raises(ServoError, match="no servo 5; there are 0 to 1"):
        bus.heat(5, 20.0)
    with pytest.raises(ServoError, match="chances from 0 to 1"):
        bus.faults(drop=2.0)


def test_servos_are_described_in_units():
    models = {model["name"]: model for model in _core.servo_models()}
    assert len(models) == 11
    assert models["XM430-W210"]["current_limit_mA"] == pytest.approx(2.69 * 1193)
    assert (
        models["XL430-W250"]["current_unit_mA"] is None
        and models["XL430-W250"]["operating_mode"] == 4
    )
    assert models["XL330-M288"]["baud_rates"][-1] == 4_000_000
    stalls = {
        name: (model["stall_torque_Nm"], model["stall_current_mA"])
        for name, model in models.items()
    }
    assert stalls["XL330-M288"] == (0.52, 1470.0) and stalls["XC330-T288"] == (0.92, 800.0), (
        "at 5.0 and 11.1 V"
    )
    assert stalls["XM430-W350"] == (4.1, 2300.0) and stalls["XM540-W270"] == (10.6, 4400.0), (
        "at 12.0 V"
    )
    registers = _core.servo_registers()
    assert registers["goal_position"] == (116, 4, False) and registers["homing_offset"] == (
        20,
        4,
        True,
    )
