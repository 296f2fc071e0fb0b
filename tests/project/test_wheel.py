"""The wheel that `make wheel` built: its name, weight, needs and content; and that it drives where
it is alone.

`make prove` builds it first; a figure on an emulated robot is what it has to do with its base
dependencies alone.
"""

import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from softmap_edge.lab.server import SERVED as LAB_SERVED
from softmap_edge.report.pages import TEMPLATES
from softmap_edge.robot.teleop.page import SERVED

DIST = Path(__file__).parents[2] / "dist"
MOST = 5_000_000  # bytes
BASE = {"jinja2", "numpy", "onnxruntime", "tomlkit", "websockets"}

pytestmark = pytest.mark.prove


@pytest.fixture(scope="module")
def wheel():
    wheels = sorted(DIST.glob("softmap_edge-*x86_64.whl"))
    if not wheels:
        pytest.skip("not run: dist/ holds no wheel; `make wheel` builds one")
    assert len(wheels) == 1, "more than one wheel lies there; `make wheel` leaves one"
    return wheels[0]


def test_one_wheel_for_every_python_and_linux_since_glibc_2_17(wheel):
    assert "-abi3-" in wheel.name and "manylinux_2_17_x86_64" in wheel.name
    assert wheel.stat().st_size <= MOST


def test_it_asks_for_its_base_alone_and_holds_what_runs(wheel):
    with zipfile.ZipFile(wheel) as file:
        names = file.namelist()
        (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        asked = re.findall(r"^Requires-Dist: (.*)$", file.read(metadata).decode(), re.MULTILINE)
    always = {re.match(r"[\w-]+", line)[0] for line in asked if "extra ==" not in line}
    assert always == BASE and not any("torch" in line for line in asked)
    folders = {name.split("/")[0] for name in names}
    assert {name for name in folders if ".dist-info" not in name} == {"softmap_edge"}
    pages = {f"softmap_edge/robot/teleop/{name}" for name in SERVED.values()}
    pages |= {f"softmap_edge/lab/page/{name}" for name in LAB_SERVED.values()}
    pages |= {f"softmap_edge/report/templates/{file.name}" for file in TEMPLATES.iterdir()}
    assert {"softmap_edge/data/finger/manifest.json", "softmap_edge/py.typed", *pages} <= set(names)


def test_installed_alone_it_drives_an_emulated_robot(wheel, tmp_path):
    """A fresh environment, no repository around it: what a user of a small computer has."""
    made = tmp_path / "env"
    subprocess.run([sys.executable, "-m", "venv", made], check=True)
    uv = Path(sys.executable).with_name("uv")
    subprocess.run(
        [uv, "pip", "install", "--quiet", "--python", made / "bin/python", wheel], check=True
    )

    def run(*words):
        done = subprocess.run(
            words, cwd=tmp_path, env={"PATH": str(made / "bin")}, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    listed = json.loads(run(uv, "pip", "list", "--python", made / "bin/python", "--format", "json"))
    there = {entry["name"] for entry in listed} - {"pip", "setuptools"}
    assert there >= {"softmap-edge", *BASE} and not there & {
        "torch",
        "scipy",
        "matplotlib",
        "opencv-python-headless",
    }
    loaded = run(made / "bin/python", "-c", "import softmap_edge, sys; print(*sys.modules)").split()
    assert not {"onnxruntime", "cv2", "mediapipe", "matplotlib"} & set(loaded)
    reported = json.loads(
        run(
            made / "bin/softmap",
            "track",
            "O",
            "--sim",
            "--duration",
            "6",
            "--amplitude",
            "5",
            "--json",
        )
    )
    assert reported["seen_mm"]["n"] > 100 and reported["seen_mm"]["mean"] < 1.0
