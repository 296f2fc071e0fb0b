"""docs/do/registration.md as its reader runs it: its commands, its file formats, its figures and
what it prints.
"""

import io
import json
import re
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from page import blocks, lines, misquoted

pytest.importorskip("meshio")

from softmap_edge import Run, builtin_model, load_bundle
from softmap_edge.alignment.base_in_clouds import align_clouds
from softmap_edge.alignment.register import register
from softmap_edge.alignment.result import in_frame
from softmap_edge.calibration.calibration import _calibrated, calibrate
from softmap_edge.cli import main
from softmap_edge.errors import RegistrationError
from softmap_edge.fem import finger
from softmap_edge.geometry.rigid import RigidPose, rotation, rotation_vector
from softmap_edge.robot.emulated.published_map import PUBLISHED

pytestmark = pytest.mark.long

PAGE = (Path(__file__).parents[2] / "docs/do/registration.md").read_text(encoding="utf-8")


def worded(text):
    """Return a text without its numbers: times differ, and so do last digits on other machines."""
    return re.sub(r"-?\d+(\.\d+)?", "#", " ".join(text.split()))


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """The folder of a reader who did all that the page says, and what was printed there."""
    folder = tmp_path_factory.mktemp("reader")
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as said:
        patch.chdir(folder)
        for language, text in blocks(PAGE):
            if language == "python":
                exec(compile(text, "docs/do/registration.md", "exec"), {})
            for words in lines(text) if not language else ():
                assert words[0] == "softmap" and main(words[1:]) == 0, words
    return folder, said.getvalue()


def test_the_page_shows_what_is_reported(reader):
    folder, said = reader
    run = Run.load(folder / "grid.npz")
    cloud = run.points[: run.start[1]]
    box = np.random.default_rng(0).uniform(-40.0, 40.0, (4000, 3)) + [0.0, 0.0, 50.0]
    said += "\n" + str(register(builtin_model(), [1.05 * cloud]))
    for wrong in (1e-3 * cloud, box):
        with pytest.raises(RegistrationError) as refused:
            register(builtin_model(), [wrong])
        said += f"\n{refused.value}"
    quotes = [text for language, text in blocks(PAGE) if language == "text"]
    assert len(quotes) == 6
    for quote in quotes:
        assert misquoted(quote, said, worded) is None


def test_files_of_three_kinds_are_read_alike(reader):
    folder, _ = reader
    three, run = Run.load(folder / "three.npz"), Run.load(folder / "grid.npz")
    alone = register(
        builtin_model(), [run.points[a:b] for a, b in zip(run.start[:3], run.start[1:4])]
    )
    np.testing.assert_allclose(three.vertices, alone.vertices, atol=1e-3)


def test_the_vertices_are_as_near_as_the_page_says(reader):
    folder, _ = reader
    truth = np.load(folder / "grid_truth.npz")["vertices"]
    shapes, paper = (Run.load(folder / f"{name}.npz") for name in ("shapes", "paper"))
    robust, published = (
        np.median(np.linalg.norm(run.vertices - truth, axis=2).mean(axis=1))
        for run in (shapes, paper)
    )
    assert robust == pytest.approx(0.16, abs=0.03) and published == pytest.approx(12.0, abs=1.0)
    assert not shapes.extra["roll_seen"] and shapes.visible.mean() == pytest.approx(0.72, abs=0.02)


def test_the_calibration_is_as_near_as_the_page_says(reader):
    folder, _ = reader
    found = load_bundle(folder / "calibrated").calibration
    off = np.abs(found.A - PUBLISHED.slope)
    assert np.max(off / np.abs(PUBLISHED.slope)) < 0.008 and np.all(off < 3.0 * found.sigma_A)
    bent = calibrate(builtin_model(), Run.load(folder / "shapes.npz"), refine=False).calibration
    assert np.max(np.abs(bent.A - PUBLISHED.slope) / np.abs(PUBLISHED.slope)) == pytest.approx(
        0.07, abs=0.01
    )
    assert json.loads(str(np.load(folder / "grid_truth.npz")["drawn"]))[
        "phase_deg"
    ] == pytest.approx(-3.4, abs=0.05)
    drawn = (folder / "calibration.svg").read_text(encoding="utf-8")
    assert "<svg" in drawn and len(drawn) > 20_000
    document = json.loads((folder / "d.json").read_text(encoding="utf-8"))
    assert "twist" in [one["name"] for one in document["not_testable"]]


def test_a_base_that_is_away_does_not_bend_the_map(reader):
    folder, _ = reader
    run, model = Run.load(folder / "grid.npz"), builtin_model()
    pose = RigidPose(rotation(np.radians([1.0, -0.6, 0.0])), np.array([1.0, -0.7, 0.0]))
    off = in_frame(run, pose, np.zeros(6))
    found, alone = calibrate(model, off), _calibrated(model, off, None, None, True)
    reported, bent = (
        np.abs(one.calibration.A - PUBLISHED.slope) / np.abs(PUBLISHED.slope)
        for one in (found, alone)
    )
    assert reported.max() < 0.008 < 0.03 < bent.max(), (reported, bent)
    assert (
        "the base is not at the origin" in found.warnings[0] and found.calibration.run == off.hash()
    )
    assert not any(
        "the base is not at the origin" in text for text in calibrate(model, run).warnings
    )
    back = align_clouds(off, found.model)
    turn, shift = np.degrees(rotation_vector(back.pose.rotation)), back.pose.shift
    away = np.abs(np.r_[turn - [-1.0, 0.6, 0.0], shift - [-1.0, 0.7, 0.0]])[[0, 1, 3, 4]]
    assert np.all(away < 3.0 * back.sigma[[0, 1, 3, 4]]), (away, back.sigma)


def test_the_finger_of_the_page_has_its_handles():
    (wanted,) = (text for language, text in blocks(PAGE) if language == "toml")
    assert finger.Finger.from_toml(finger._template() + wanted).handles == 137
