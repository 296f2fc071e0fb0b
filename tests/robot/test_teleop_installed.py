"""Requirements of teleoperation and their remedies: two OpenCVs in one folder, libraries,
processor, model.
"""

from importlib.metadata import distributions

import pytest

from softmap_edge.robot.teleop.requirements import (
    INSTALL,
    findings,
    hand_model,
    libraries,
    mediapipe,
    opencv,
    processor,
)


@pytest.fixture
def site(tmp_path):
    """A folder of installed distributions, written as pip writes them."""

    def install(name, version="1.0", files=()):
        info = tmp_path / f"{name.replace('-', '_')}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        (info / "RECORD").write_text("".join(f"{file},,\n" for file in files))
        for file in files:
            (tmp_path / file).parent.mkdir(exist_ok=True)
            (tmp_path / file).write_text("")
        return tmp_path

    install.found = lambda: list(distributions(path=[str(tmp_path)]))
    install.folder = tmp_path
    return install


CV2 = ("cv2/__init__.py", "cv2/cv2.abi3.so")


def test_one_opencv_is_fine(site):
    site("opencv-python-headless", "5.0", CV2)
    site("opencv-stubs", "1.0", ("stubs/cv2.pyi",))
    site("numpy")
    found = opencv(site.found())
    assert found.fine and found.found == "opencv-python-headless 5.0"


def test_two_opencvs_clash(site):
    site("opencv-python-headless", "5.0", CV2)
    site("opencv-contrib-python", "5.1", CV2)
    found = opencv(site.found())
    assert found.state == "fault"
    assert (
        "opencv-contrib-python 5.1 and opencv-python-headless 5.0 are installed into one folder "
        "cv2/" in found.found
    )
    assert (
        f"run uv pip uninstall opencv-contrib-python opencv-python-headless, then {INSTALL}"
        in found.do
    )


def test_what_another_opencv_took_away_is_reported(site):
    site("opencv-python-headless", "5.0", CV2)
    (site.folder / "cv2/__init__.py").unlink()
    found = opencv(site.found())
    assert not found.fine and "lost its folder cv2/" in found.found and INSTALL in found.do


def test_nothing_installed(site):
    assert not opencv(site.found()).fine and INSTALL in opencv(site.found()).do
    found = mediapipe(site.found())
    assert found.state == "warning" and "udp://" in found.do


@pytest.mark.parametrize(
    ("version", "tells"),
    [("0.10.18", False), ("0.10.21", False), ("0.10.35", True), ("1.2.3", True)],
)
def test_a_mediapipe_that_reports_its_use_says_so(site, version, tells):
    site("mediapipe", version)
    found = mediapipe(site.found())
    assert found.fine and version in found.found and ("reports its use" in found.found) == tells


def test_libraries_that_cannot_be_loaded():
    assert libraries(("libc.so.6",)).fine
    found = libraries(("libc.so.6", "libNoSuchEGL.so.1"))
    assert (
        not found.fine
        and found.found == "libNoSuchEGL.so.1 cannot be loaded"
        and "apt install libegl1" in found.do
    )


def test_a_processor_without_lse(tmp_path):
    cpu = tmp_path / "cpuinfo"
    cpu.write_text("processor\t: 0\nFeatures\t: fp asimd evtstrm crc32 cpuid\n")  # a Raspberry Pi 4
    found = processor("aarch64", cpu)
    assert (
        not found.fine and "without LSE atomics" in found.found and "mediapipe==0.10.18" in found.do
    )
    cpu.write_text("Features\t: fp asimd atomics crc32\n")
    assert processor("aarch64", cpu).fine
    cpu.write_text("Features\t: fp asimd atomics\nFeatures\t: fp asimd\n")  # of two kinds of cores
    assert not processor("arm64", cpu).fine
    cpu.write_text("Features\t: fp notatomics atomics2\n")
    assert not processor("aarch64", cpu).fine
    assert processor("aarch64", tmp_path / "absent").fine and processor("x86_64", cpu).fine


def test_an_absent_model_says_where_it_comes_from(tmp_path):
    found = hand_model(tmp_path / "absent.task")
    assert not found.fine and "no model of hands" in found.found
    assert "pip download mediapipe==0.10.18" in found.do and "--fetch-model" in found.do


def test_this_computer_is_in_order_but_for_the_model(tmp_path):
    """The tests' own environment is the clean set that the documentation describes."""
    found = {finding.name: finding for finding in findings(tmp_path / "absent.task")}
    assert list(found) == ["opencv", "mediapipe", "graphics libraries", "processor", "hand model"]
    assert found["opencv"].fine and found["opencv"].found.startswith("opencv-python-headless ")
    assert found["mediapipe"].fine and not found["hand model"].fine
    assert all(finding.do for finding in found.values() if not finding.fine)
