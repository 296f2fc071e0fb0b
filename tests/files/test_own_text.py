"""Mappings, fingers, robots, rigs and JSON of ours: regular files, in UTF-8."""

import json
import os
from pathlib import Path

import pytest

from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.errors import SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.mesh_file import read_guides
from softmap_edge.files.atomic import own_text
from softmap_edge.logs.mapping import read_mapping
from softmap_edge.robot.drive.command_file import read_commands
from softmap_edge.robot.servo.rig import Rig, RigServo, read_rig
from softmap_edge.rod.robot import Robot

EXAMPLES = Path(__file__).parents[2] / "examples"
READERS = {
    "mapping": read_mapping,
    "finger": Finger.load,
    "robot": Robot.load,
    "rig": read_rig,
    "commands": read_commands,
    "guides": read_guides,
    "diagnosis": Diagnosis.load,
}


def not_regular(kind: str, folder: Path) -> Path:
    """Return a path of a device, a pipe, a folder or a link to a device."""
    path = folder / kind
    match kind:
        case "device":
            return Path("/dev/zero")
        case "pipe":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
        case "link":
            path.symlink_to("/dev/urandom")
    return path


@pytest.mark.parametrize("kind", ["device", "pipe", "folder", "link"])
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_regular_file_is_refused_at_once(reader, kind, tmp_path):
    path = not_regular(kind, tmp_path)
    with pytest.raises(SoftmapError) as fault:
        READERS[reader](path)
    assert str(path) in str(fault.value) and "\n" not in str(fault.value)


def test_a_file_that_grows_is_read_up_to_its_bound(tmp_path):
    """Files of /proc have the size 0: what is read counts."""
    path = tmp_path / "long.toml"
    path.write_bytes(b"x" * 101)
    with pytest.raises(OSError, match="more than 100 bytes"):
        own_text(path, 100)
    assert own_text(path, 101) == "x" * 101


@pytest.mark.parametrize("text", [b"a\nb\n", b"a\r\nb\r\n", b"a\rb\r"])
def test_line_ends_are_read_alike_or_kept(text, tmp_path):
    path = tmp_path / "lines.toml"
    path.write_bytes(text)
    assert own_text(path, 100) == "a\nb\n"
    assert own_text(path, 100, keep_line_ends=True).encode() == text


SAMPLES = {
    "mapping": EXAMPLES / "sample_map.toml",
    "finger": EXAMPLES / "three_tendons.toml",
    "robot": EXAMPLES / "tdcr_robot.toml",
}


@pytest.mark.parametrize("reader", SAMPLES)
def test_a_byte_order_mark_is_skipped(reader, tmp_path):
    plain, marked = tmp_path / "plain.toml", tmp_path / "marked.toml"
    plain.write_bytes(SAMPLES[reader].read_bytes())
    marked.write_bytes(b"\xef\xbb\xbf" + SAMPLES[reader].read_bytes())
    read = READERS[reader]
    assert repr(read(plain)).replace("plain", "marked") == repr(read(marked))


def test_a_byte_order_mark_of_a_rig_commands_guides_and_a_diagnosis_is_skipped(tmp_path):
    path = tmp_path / "marked"
    path.write_text(
        Rig("/dev/ttyUSB0", 57_600, (RigServo(1, "XL330-M288"),)).to_toml(), encoding="utf-8-sig"
    )
    assert read_rig(path).port == "/dev/ttyUSB0"
    read_rig(path).note(path)
    assert read_rig(path).port == "/dev/ttyUSB0"
    path.write_text("[[0, 0, 0], [0, 0, 9]]", encoding="utf-8-sig")
    assert read_guides(path)[1] == (0, 0, 9)
    found = json.dumps(Diagnosis("nothing").to_dict())
    path.write_text(found, encoding="utf-8-sig")
    assert Diagnosis.load(path).verdict == "nothing"
    path.write_text("# softmap commands 1; robot x; unit mm\nt,u1\n0,0\n", encoding="utf-8-sig")
    with pytest.raises(SoftmapError, match="columns t,u1"):  # its first line is understood
        read_commands(path)


@pytest.mark.parametrize("mark", [b"\xff\xfe", b"\xfe\xff", b"\xef\xbb"])
def test_other_marks_are_no_text(mark, tmp_path):
    path = tmp_path / "wide.toml"
    path.write_bytes(mark + b"robot = 1\n")
    with pytest.raises(SoftmapError, match="UTF-8"):
        read_mapping(path)
