"""Pictures of a camera, newest first, and of files at their own rate; what cannot be read says
why.
"""

import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from softmap_edge.errors import TeleopError
from softmap_edge.robot.teleop import devices, frames
from softmap_edge.robot.teleop.frames import CameraFrames, FileFrames, UdpAddress, source

RATE, COUNT = 30, 30


def grey(picture):
    return int(np.median(picture))


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """A second of pictures, each of a grey of its own."""
    path = tmp_path_factory.mktemp("video") / "grey.avi"
    out = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), RATE, (64, 48))
    for k in range(COUNT):
        out.write(np.full((48, 64, 3), 8 * k, np.uint8))
    out.release()
    return path


class Device:
    """A camera that takes its pictures from a list, one each `period` s; ends, freezes or fails
    after them.
    """

    def __init__(self, count, period=0.005, after="end"):
        self.count, self.period, self.after, self.taken, self.released = (
            count,
            period,
            after,
            0,
            threading.Event(),
        )
        self.frozen = threading.Event()

    def read(self):
        assert not self.released.is_set()
        if self.taken == self.count:
            if self.after == "freeze":
                self.frozen.wait(5)
            if self.after == "fail":
                raise RuntimeError("ioctl")
            return False, None
        time.sleep(self.period)
        self.taken += 1
        return True, np.full((4, 4, 3), self.taken, np.uint8)

    def release(self):
        self.released.set()


def test_what_a_camera_is():
    assert source("0") == 0 and source("12") == 12
    assert source("clip.mp4") == Path("clip.mp4") and source("/absent/video0") == Path(
        "/absent/video0"
    )
    assert source("udp://:5005") == UdpAddress("", 5005)
    assert source("udp://192.168.0.7:5005") == UdpAddress("192.168.0.7", 5005)
    assert source("udp://[::1]:5005/") == UdpAddress("::1", 5005)
    bad = [
        "",
        "udp://",
        "udp://host",
        "udp://host:0",
        "udp://host:70000",
        "udp://host:x",
        "udp://a:1/b",
        "udp://u@h:1",
    ]
    for text in [*bad, "rtsp://camera/1", "http://x/y.mp4", "a\0b", "udp://[::1:5"]:
        with pytest.raises(TeleopError, match="udp://HOST:PORT"):
            source(text)


def test_every_picture_of_a_file(video):
    with FileFrames(video, live=False) as opened:
        for _ in range(2):  # each loop begins with the first
            seen = list(opened)
            assert [frame.number for frame in seen] == list(range(COUNT))
            assert np.abs([grey(frame.picture) - 8 * frame.number for frame in seen]).max() <= 3
            assert np.allclose(np.diff([frame.t for frame in seen]), 1 / RATE)
        assert opened.rate == RATE


def test_a_file_runs_at_its_own_rate_and_leaves_out_what_is_late(video):
    with FileFrames(video) as opened:
        start = time.monotonic()
        seen = [(frame, time.monotonic()) for frame in opened]
        assert time.monotonic() - start > (COUNT - 2) / RATE
    assert all(now - frame.t > -1e-3 for frame, now in seen)  # never before it is due
    with FileFrames(video) as opened:
        numbers = []
        for frame in opened:
            numbers.append(frame.number)
            assert abs(grey(frame.picture) - 8 * frame.number) <= 3
            time.sleep(0.12)  # someone slow
    assert 4 <= len(numbers) <= 12 and numbers[0] == 0 and numbers == sorted(set(numbers))


def test_files_that_are_no_videos(video, tmp_path):
    with pytest.raises(TeleopError, match="no such video file"):
        FileFrames(tmp_path / "absent.mp4")
    with pytest.raises(TeleopError, match="no such video file"):
        FileFrames(tmp_path)
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "empty.mp4").write_bytes(b"")
    for name in ("text.mp4", "empty.mp4"):
        with pytest.raises(TeleopError, match="is not a video that can be read"):
            FileFrames(tmp_path / name)
    content = video.read_bytes()
    cut = tmp_path / "cut.avi"
    cut.write_bytes(content[: len(content) * 2 // 3])
    with (
        pytest.raises(TeleopError, match="ends after 1. of 30 pictures: it is damaged"),
        FileFrames(cut) as opened,
    ):
        list(opened)


def test_the_newest_picture_of_a_camera_wins():
    device = Device(40)
    with CameraFrames(0, device=device) as camera:
        first = camera.newest()
        time.sleep(0.1)
        second = camera.newest()
        third = camera.newest()  # waits for one that is newer
        assert second.number >= first.number + 5 and third.number > second.number
        assert grey(second.picture) == second.number + 1
        assert first.t < second.t < third.t <= time.monotonic()
        assert camera.dropped >= second.number - first.number - 2
    assert device.released.is_set()


@pytest.mark.parametrize("after", ["end", "fail"])
def test_a_camera_that_is_unplugged(after):
    device = Device(5, after=after)
    with (
        CameraFrames(3, device=device) as camera,
        pytest.raises(TeleopError, match="camera 3: is gone"),
    ):
        list(camera)
    assert device.released.wait(1)
    with pytest.raises(TeleopError, match="is closed"):
        camera.newest()


def test_a_camera_that_freezes_is_reported_in_time():
    device = Device(2, after="freeze")
    with CameraFrames(0, device=device, silence=0.2) as camera:
        start = time.monotonic()
        with pytest.raises(TeleopError, match=r"no picture for 0.2 s"):
            while True:
                camera.newest()
        assert time.monotonic() - start < 1.0
        device.frozen.set()
    assert device.released.wait(1)


def test_cameras_that_cannot_be_opened(monkeypatch, tmp_path):
    monkeypatch.setattr(devices, "DEVICES", tmp_path)
    with pytest.raises(
        TeleopError, match=r"there is no .*video7; no camera is connected; give another camera"
    ):
        CameraFrames(7)
    (tmp_path / "video2").write_text("")
    with pytest.raises(TeleopError, match=r"the cameras here are 2 \(.*video2\)"):
        CameraFrames(7)
    (tmp_path / "video97").write_text("")
    with pytest.raises(
        TeleopError, match="camera 97: .* cannot be opened; close the program that uses it"
    ):
        CameraFrames(97)
    monkeypatch.setattr(frames.os, "access", lambda *_: False)
    with pytest.raises(TeleopError, match="sudo usermod -aG video"):
        CameraFrames(97)


def test_without_opencv_the_install_line_is_reported(monkeypatch):
    monkeypatch.setitem(frames.importlib.sys.modules, "cv2", None)
    with pytest.raises(
        TeleopError, match="OpenCV cannot be loaded .*; run uv pip install --override"
    ):
        FileFrames("clip.mp4")


USB = "usb-Logitech_BRIO_1F2A-video-index0"


@pytest.fixture
def dev(monkeypatch, tmp_path):
    """Give a folder of devices with three cameras: one with lasting names, one with a name by its
    plug, one bare.
    """
    folder = tmp_path / "dev"
    for name in ("video0", "video3", "video12", "ttyUSB0", "video-notes.txt"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    for link, to in ((f"by-id/{USB}", 3), ("by-path/pci-0000:00:14.0-usb-0:2:1.0-video-index0", 3),
                     ("by-path/pci-0000:00:14.0-usb-0:5:1.0-video-index0", 12),
                     ("by-id/usb-Gone_Cam-video-index0", 9)):  # fmt: skip
        place = folder / "v4l" / link
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(f"../../video{to}")
    monkeypatch.setattr(devices, "DEVICES", folder)
    return folder


def test_a_path_of_a_device_is_the_camera_that_it_links_to(dev, tmp_path, monkeypatch):
    assert source(str(dev / "video0")) == 0 and source(str(dev / "video12")) == 12
    assert source(str(dev / "v4l/by-id" / USB)) == 3
    assert source(str(dev / "v4l/by-path/pci-0000:00:14.0-usb-0:5:1.0-video-index0")) == 12
    (dev / "left_camera").symlink_to("video3")  # as a rule of udev makes it
    (tmp_path / "cam").symlink_to(dev / "left_camera")  # and a user's own, in another folder
    assert source(str(dev / "left_camera")) == 3 and source(str(tmp_path / "cam")) == 3
    monkeypatch.chdir(dev)
    assert (
        source("video12") == 12
        and source("../dev/v4l/../video0") == 0
        and source("v4l/by-id/" + USB) == 3
    )


def test_a_regular_file_is_a_video_wherever_it_lies(dev, tmp_path):
    (dev / "shm").mkdir()
    for clip in (dev / "shm/clip.mp4", tmp_path / "video0", tmp_path / "video7.mp4"):
        clip.write_bytes(b"")
        assert source(str(clip)) == clip
    (tmp_path / "link.mp4").symlink_to(tmp_path / "video0")
    assert source(str(tmp_path / "link.mp4")) == tmp_path / "link.mp4"
    assert source(str(tmp_path / "absent.mp4")) == tmp_path / "absent.mp4"


def test_a_device_that_is_no_camera_or_gone_lists_those_there(dev, tmp_path):
    there = (
        f"the cameras here are 0 ({dev}/video0), 3 ({dev}/v4l/by-id/{USB}), 12 ({dev}/v4l/by-path/"
    )
    for path, what in (
        (dev / "video5", "is not there"),
        (dev / "v4l/by-id/usb-Other-video-index0", "is not there"),
        (dev / "v4l/by-id/usb-Gone_Cam-video-index0", "links to camera 9, now gone"),
        (dev / "v4l", "is not a camera"),
        (dev / "video123456", "is not there"),
        ("/dev/null", "is not a camera"),
    ):
        with pytest.raises(TeleopError) as fault:
            source(str(path))
        assert what in str(fault.value) and there in str(fault.value), path
    (dev / "round").symlink_to("round")
    for path in (dev / "round", dev / ("x" * 300)):
        with pytest.raises(TeleopError, match="the cameras here are"):
            source(str(path))
    with pytest.raises(
        TeleopError, match="no such video file; give one, or a camera; the cameras here are 0"
    ):
        FileFrames(tmp_path / "absent.mp4")


def test_cameras_are_listed_once_each_in_order(dev):
    found = devices.cameras(dev)
    assert [camera.number for camera in found] == [0, 3, 12]
    assert [len(camera.names) for camera in found] == [0, 2, 1]
    assert devices.there(dev / "none") == "no camera is connected"
    for k in range(20, 40):
        (dev / f"video{k}").touch()
    assert devices.there(dev).endswith("and 15 more")
