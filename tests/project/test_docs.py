"""The scripts of docs/ and the files of examples/ work as they stand, and leave the repository as
it was.
"""

import hashlib
import importlib.util
from pathlib import Path

import pytest

from benches.data import find
from softmap_edge import read_mapping

ROOT = Path(__file__).parents[2]


def script(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# their scripts need real data, real time or no data at all
OWN = ("tdcr_", "beam_", "track_", "diagnosis")


@pytest.mark.long
def test_the_pictures_are_made_in_the_given_folder(tmp_path, capsys):
    """Seed 4 is the finger that the demo's tests measure too, so that its sweeps are done once."""
    docs = sorted(path for path in (ROOT / "docs").rglob("*") if path.is_file())
    before = {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in docs}
    assert (
        script(ROOT / "docs/figures.py").main(["--out", str(tmp_path / "pictures"), "--seed", "4"])
        == 0
    )
    made = {path.name: path.read_bytes() for path in (tmp_path / "pictures").iterdir()}
    pictures = sorted((ROOT / "docs/pictures").glob("*.*g"))
    drawn = {
        path.name for path in pictures if path.suffix != ".jpg" and not path.name.startswith(OWN)
    }
    absent = set() if find("moe_finger") else {"mesh.svg"}  # public data that is not shipped
    assert made.keys() == drawn - absent
    assert made["error_on_the_body.png"].startswith(b"\x89PNG")
    assert all(b"<svg" in content[:1000] for name, content in made.items() if name.endswith(".svg"))
    assert "backlash" in capsys.readouterr().out
    assert {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in docs} == before


def test_a_picture_that_needs_a_browser_is_left_as_it_is_without_one(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setattr("benches.data.find", lambda name: tmp_path)
    assert script(ROOT / "docs/figures_teleop.py").main(["--out", str(tmp_path / "pictures")]) == 0
    assert (
        "teleop.jpg is not drawn again: the command chromium is absent" in capsys.readouterr().out
    )
    assert not (tmp_path / "pictures").exists()


def test_pictures_that_take_the_time_of_a_robot_stay_small_and_are_shown():
    """test_track.py and test_teleop_page.py test the pictures."""
    assert callable(script(ROOT / "docs/figures_track.py").main)
    for name, page in (("track_s.svg", "track.md"), ("teleop.jpg", "teleop.md")):
        assert 10_000 < (ROOT / "docs/pictures" / name).stat().st_size < 150_000
        assert f"](../pictures/{name})" in (ROOT / "docs/do" / page).read_text(encoding="utf-8")


def test_every_example_is_used_by_a_test():
    """By name, or in a page whose commands a test runs."""
    here = Path(__file__)
    tests = [
        path.read_text(encoding="utf-8")
        for path in (ROOT / "tests").rglob("test_*.py")
        if path != here
    ]
    pages = {str(page.relative_to(ROOT)): page for page in (ROOT / "docs").rglob("*.md")}
    run = [page for name, page in pages.items() if any(name in text for text in tests)]
    texts = tests + [
        page.read_text(encoding="utf-8") for page in run if page.name != "architecture.md"
    ]
    for example in (ROOT / "examples").iterdir():
        if example.is_file():
            assert any(example.name in text for text in texts), example.name


def test_the_example_mapping_is_read():
    mapping = read_mapping(ROOT / "examples/trunk.toml")
    assert mapping.robot == "asl-trunk" and mapping.command_unit == "deg" and len(mapping.logs) == 2
    assert not mapping.declare_load and mapping.load_g  # the load is known and kept from the run
