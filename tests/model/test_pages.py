"""The pages of `softmap compare --html` and `softmap diagnose --html` are complete, load nothing,
and say enough.
"""

import base64
import json
import re
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser

import numpy as np
import pytest

from softmap_edge import Run, builtin_model, save_bundle
from softmap_edge.cli import main
from softmap_edge.diagnosis.text import parameter
from softmap_edge.run.protocol import standard_protocol

LOADING = {
    "src",
    "href",
    "srcset",
    "data",
    "action",
    "poster",
    "background",
    "formaction",
    "xlink:href",
}


class Page(HTMLParser):
    """What a page would load, its pictures, and its text without style."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.loads, self.pictures, self.words, self.open = [], [], [], [], []
        self.styles = re.findall(r"<style>(.*?)</style>", text, re.DOTALL) + re.findall(
            r'style="([^"]*)"', text
        )
        self.feed(text)
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.open.append(tag)
        for name, value in attributes:
            if tag == "img" and name == "src":
                self.pictures.append(value)
            elif name in LOADING or name.startswith("on"):
                self.loads.append((tag, name, value))

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.words.append(data)


@pytest.fixture(scope="module")
def story(tmp_path_factory):
    """A run of the built-in finger with play and noise, and a bundle that knows the play."""
    folder = tmp_path_factory.mktemp("pages")
    model, protocol = builtin_model(), standard_protocol()
    played = model.with_effects(("backlash",), {"backlash.gap": 2.0})
    record = {
        "t": protocol.t,
        "command": protocol.command,
        "gravity": protocol.gravity,
        "t_seen": protocol.t_seen,
    }
    blank = np.repeat(model.rest[None], protocol.frames, axis=0)
    points = played.predict(Run(**record, vertices=blank, robot=model.robot))
    points += 0.2 * np.random.default_rng(3).normal(size=points.shape)
    Run(**record, vertices=points, robot=model.robot).save(folder / "run.npz")
    save_bundle(played, folder / "played")
    save_bundle(model, folder / "plain")
    return folder


def written(folder, capsys, *argv):
    """Run a command with --html and --json; return the page and the document."""
    assert main([*map(str, argv), "--html", str(folder / "page.html"), "--json"]) == 0
    return Page((folder / "page.html").read_text(encoding="utf-8")), json.loads(
        capsys.readouterr().out
    )


def assert_whole(page, pictures):
    assert page.loads == []
    assert not {"script", "link", "iframe", "object", "embed", "base", "form"} & set(page.tags)
    assert page.styles and not any(
        re.search(r"url\(|@import|expression", style) for style in page.styles
    )
    assert len(page.pictures) == pictures
    for picture in page.pictures:
        kind, data = re.fullmatch(
            r"data:image/(png|svg\+xml);base64,([A-Za-z0-9+/=]+)", picture
        ).groups()
        content = base64.b64decode(data, validate=True)
        if kind == "png":
            assert content.startswith(b"\x89PNG") and len(content) > 10_000
            continue
        drawn = ElementTree.fromstring(content)
        assert drawn.tag.endswith("svg")
        links = [
            value
            for e in drawn.iter()
            for key, value in e.attrib.items()
            if key.split("}")[-1] in LOADING
        ]
        assert all(value.startswith("#") for value in links)


def test_a_comparison_has_its_page(story, capsys):
    page, document = written(story, capsys, "compare", story / "run.npz")
    assert_whole(page, pictures=5)  # over time, on the body, where, tip
    assert f"{document['error']['rms_mm']:.2f} mm" in page.text
    assert f"{document['noise_floor_mm']:.3f} mm" in page.text and "floor" in page.text
    assert "effects in the model: none" in page.text


def test_two_bundles_have_one_page_that_shows_the_fall(story, capsys):
    bundles = ("--bundle", story / "plain", "--bundle", story / "played")
    page, (before, after) = written(story, capsys, "compare", story / "run.npz", *bundles)
    assert_whole(page, pictures=5)
    old, new = before["error"]["rms_mm"], after["error"]["rms_mm"]
    assert new < 0.5 * old
    assert f"{old:.2f} mm" in page.text and f"{new:.3f} mm" in page.text
    floor = after["noise_floor_mm"]
    gone = (old - new) / (old - floor)
    if new > floor:
        assert f"{100 * gone:.0f} % of the removable error gone" in page.text
    else:  # the noise floor is an estimate: nothing is counted above it
        assert f"{100 * (old - new) / old:.0f} % of the error gone" in page.text
    assert "effects in the model: backlash" in page.text


def test_a_diagnosis_has_its_page(story, capsys):
    page, document = written(
        story, capsys, "diagnose", story / "run.npz", "--effects", "backlash,lag,gain"
    )
    assert_whole(page, pictures=7)  # and the ladder, and the loop over the command
    assert [e["name"] for e in document["effects"]] == ["backlash"]
    assert document["verdict"] in page.text and " ".join(document["sentence"].split()) in page.text
    gap = document["effects"][0]["params"]["backlash.gap"]
    assert (
        gap["value"] == pytest.approx(2.0, rel=0.05)
        and f"backlash.gap {parameter(gap)}" in page.text
    )
    error = document["error"]
    assert f"Floor: {error['floor_kind']}" in page.text
    assert error["floor"] == error["noise_floor"]
    assert f"{error['floor']:.3f} mm floor {error['floor_kind']}" in page.text
    assert "fitted: this run took part" in page.text
    assert document["made_from"]["run"] in page.text  # the origin stands at the end
