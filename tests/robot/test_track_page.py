"""docs/do/track.md as its reader types it: its commands in order, and the lines that it quotes;
figures, options and the paper's columns are true.
"""

import argparse
import contextlib
import io
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from page import blocks, lines, misquoted

from softmap_edge import load_bundle
from softmap_edge.cli import main
from softmap_edge.commands.track import track_arguments
from softmap_edge.report.figures import AFTER, INK
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.motion.figures import FIGURES
from softmap_edge.robot.motion.kinematics import METHODS
from softmap_edge.synthetic.table_two import ALTERNATIVE, COMPENSATED, OURS, PUBLISHED_ERRORS

PAGE = (Path(__file__).parents[2] / "docs/do/track.md").read_text(encoding="utf-8")
PATH = "{http://www.w3.org/2000/svg}path"


long = pytest.mark.long  # the commands of the page take half a minute


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The folder in which the page's commands ran, and what each printed."""
    there, printed = tmp_path_factory.mktemp("page"), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(there)
        for language, text in blocks(PAGE):
            for words in lines(text) if language == "" else ():
                assert words[0] == "softmap"
                with contextlib.redirect_stdout(io.StringIO()) as out:
                    assert main(words[1:]) == 0, words
                printed[" ".join(words[1:])] = out.getvalue().rstrip()
    return there, printed


def curves(file):
    """Return colour and width of the long lines of a picture, in the order in which they are
    drawn.
    """
    lines = [
        path for path in ElementTree.parse(file).iter(PATH) if path.get("d", "").count("L") > 30
    ]
    reported = [dict(re.findall(r"([a-z-]+): ([^;]+)", path.get("style", ""))) for path in lines]
    return [
        (one.get("stroke"), one.get("stroke-width"))
        for one in reported
        if one.get("fill") == "none"
    ]


@long
def test_the_lines_after_each_block_are_those_that_its_commands_print(page):
    _, printed = page
    commanded, quotes = [], 0
    for language, text in blocks(PAGE.split("\n## 3.")[0]):
        if language == "":
            commanded = [" ".join(words[1:]) for words in lines(text)]
            continue
        assert language == "text"
        assert misquoted(text, "\n".join(printed[said] for said in commanded)) is None
        quotes += 1
    assert quotes == 5


@long
def test_each_command_says_and_writes_what_the_page_says(page):
    there, printed = page
    reach, point, plan, sim, off, alone, _, _, found, *_ = printed.values()
    assert list(printed)[1] == "track --workspace --reach 60 0 60"
    assert "the tip rests at" in reach and "60.00 mm, along xyz: out of reach by" not in reach
    assert "out of reach by" in point and "nearest is" in point
    assert "expected tip error 0.0" in plan and "measured" not in plan
    assert "s.mcap: written\ns.seen: written" in sim
    assert sim.endswith("next: softmap diagnose s.mcap")
    assert (
        "a run of 'moe-finger'" in off and 1.0 < float(re.search(r"  tip rms +(\S+)", off)[1]) < 4.0
    )
    assert "Missing effects" not in alone and "backlash.gap" in found
    assert "Alternatives" not in found  # as the page says
    assert (there / "warm.csv").exists() and load_bundle(there / "found").params
    assert curves(there / "reach.svg")
    # target, and expected over it
    assert curves(there / "s.svg")[:2] == [(INK, "2.4"), (AFTER, "1.2")]
    # target, and seen over it
    assert curves(there / "seen.svg")[:2] == [(INK, "2.4"), (AFTER, "1.2")]
    recording = read_recording(there / "s.mcap")
    assert recording.replay() == [] and np.ptp(recording.run().ticks, axis=0).min() > 300


def test_the_pages_figures_methods_and_options_are_those_of_the_command():
    names = re.search(r"Figures: `([^`]+)`", PAGE)
    assert names and names[1].split() == list(FIGURES)
    parser = argparse.ArgumentParser()
    track_arguments(parser)
    verb = {option for action in parser._actions for option in action.option_strings}
    assert set(re.findall(r"`(--[a-z-]+)", PAGE)) | set(re.findall(r" (--[a-z-]+)", "\n".join(
        line for line in PAGE.splitlines() if line.startswith("softmap track")
    ))) <= verb  # fmt: skip
    assert all(f"--method {name}" in PAGE or name == "exact" for name in METHODS)


def test_table_ii_is_complete_with_the_papers_own_figures_as_other_data():
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in PAGE.splitlines()
        if line.startswith("| ")
    ]
    head, *rows = rows
    assert head[2:] == ["simulator", "stand-in", "the paper: simulation", "the paper: hardware"]
    names = {"DeepSoRo-style": ALTERNATIVE}
    reported = {(letter, names.get(name, name)): cells for letter, name, *cells in rows}
    assert list(reported) == [
        (letter, name) for letter in "SHOE" for name in (OURS, COMPENSATED, ALTERNATIVE)
    ]
    for key, cells in reported.items():
        paper = [
            "{:.2f} ± {:.2f}, {:.2f}".format(*numbers) for numbers in PUBLISHED_ERRORS.get(key, ())
        ] or ["", ""]
        assert cells[2:] == paper, key
        for cell in cells[:2]:
            mean, _, most = map(
                float, re.fullmatch(r"(\d\.\d\d) ± (\d\.\d\d), (\d\.\d\d)", cell).groups()
            )
            assert 0 < mean < most
    assert "The paper's columns are of **other data**" in PAGE


def test_the_commands_of_table_ii_are_commands():
    """Training takes minutes: here the lines only fit together. The table runs in
    tests/synthetic/test_table_two.py.
    """
    (text,) = (text for _, text in blocks(PAGE.split("\n## 3.")[1]))
    words = list(lines(text))
    assert [line[1] for line in words] == ["train", "train", "model", "track"]
    parser = argparse.ArgumentParser()
    track_arguments(parser)
    args = parser.parse_args(words[-1][2:])
    assert args.table and args.bundle == words[2][-1] and args.alternative == words[1][-1]
