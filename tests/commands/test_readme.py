"""README and the first pages of docs/learn as a newcomer follows them: the demo, then the lines on
what it leaves.

Every line that docs/learn/demo.md and docs/learn/own_csv.md quote is printed, and the demo prints
no other.
"""

import contextlib
import importlib.util
import io
import os
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from finger_runs import finger_run
from page import ROOT, blocks, lines, misquoted

from softmap_edge import Run, load_bundle, read_mapping
from softmap_edge.cli import main

README = (ROOT / "README.md").read_text(encoding="utf-8")
DEMO = (ROOT / "docs/learn/demo.md").read_text(encoding="utf-8")
CSV = (ROOT / "docs/learn/own_csv.md").read_text(encoding="utf-8")
HIDDEN = {"hysteresis.strength": 0.4, "hysteresis.reach": 6.0}


def commands(page):
    """Return the command lines of a page, a line of the shell (`a && b`) as several."""
    split = [
        re.split(r" && ", line)
        for language, text in blocks(page)
        if language == ""
        for line in text.splitlines()
    ]
    return [words for parts in split for part in parts for words in lines(part)]


def quoted(page):
    """Return the lines that a page quotes from the output."""
    return [
        line.rstrip()
        for language, text in blocks(page)
        if language == "text"
        for line in text.splitlines()
    ]


def run(words):
    """Run one line of a newcomer: make or change a folder, or call softmap; everything else is for
    the shell.
    """
    if words[:2] == ["mkdir", "-p"]:
        Path(words[2]).mkdir(parents=True)
    elif words[0] == "cd":
        os.chdir(words[1])
    elif words[0] == "softmap":
        assert main(words[1:]) == 0, words
    else:
        assert words[0] in ("make", "source"), words


def test_links_and_pictures_of_the_readme_are_there():
    targets = [target for _, target in re.findall(r"\[([^\]]*)\]\(([^)#]+)\)", README)]
    assert len(targets) >= 7
    for target in targets:
        assert target.startswith("https://") or (ROOT / target).is_file(), target


def test_the_two_commands_are_targets_of_the_makefile():
    targets = set(
        re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    )
    used = {words[1] for words in commands(README) if words[0] == "make"} | set(
        re.findall(r"`make ([\w-]+)`", README)
    )
    assert {"demo", "test"} <= used <= targets
    rule = re.search(
        r"^demo:.*\n\t(.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )[1]
    assert shlex.split(rule)[1:] == ["demo", "--out", "$(OUT)/demo"]


def test_the_readme_is_one_screen():
    assert len(README.splitlines()) <= 55


# --- the demo: one run of a minute for all of it ------------------------------------------------
@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Runs as the demo leaves them, of the model itself with an effect."""
    folder = tmp_path_factory.mktemp("made")
    for name, seed in (("run.npz", 0), ("other_run.npz", 1)):
        finger_run(["hysteresis"], HIDDEN, seed=seed).save(folder / name)
    return folder


@pytest.fixture(scope="module")
def demo_printed(tmp_path_factory):
    """Run the demo as its page does; give its folder and what it prints."""
    folder = tmp_path_factory.mktemp("demo")
    text = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(text):
        patch.chdir(folder)
        run(commands(DEMO)[0])
    return folder, text.getvalue()


@pytest.mark.long
def test_its_page_quotes_every_line(demo_printed):
    made = [
        line.rstrip()
        for line in demo_printed[1].splitlines()
        if not re.search(r"solving, \d+ ?%|^\(\d+ s\)", line)
    ]
    assert [line for line in made if line] == [line for line in quoted(DEMO) if line]


@pytest.mark.long
def test_the_lines_of_the_readme_work_on_what_it_leaves(demo_printed, monkeypatch, capsys):
    folder, _ = demo_printed
    monkeypatch.chdir(folder)
    there = [words for words in commands(README) if words[0] in ("cd", "softmap")]
    assert there[0] == ["cd", "out/demo"] and len(there) == 5
    for words in there:
        run(words)
    out = capsys.readouterr().out
    before, after = map(float, re.search(r"^  rms +([\d.]+) +([\d.]+)", out, re.MULTILINE).groups())
    assert "sound     run.npz" in out and "Verdict: identified" in out
    assert after < 0.6 < 2.0 < before  # side by side, as the comment in the README says
    assert load_bundle("better").chain_names == ("hysteresis",)
    assert Path("d.html").read_text(encoding="utf-8").startswith("<!doctype html")


def test_each_output_ends_with_the_next_command_and_it_works(made, monkeypatch, capsys):
    monkeypatch.chdir(made)
    done, line = [], "softmap check run.npz"
    while len(done) < 5:
        done.append(line.split()[1])
        run(shlex.split(line.replace("ANOTHER_RUN", "other_run.npz")))
        line = capsys.readouterr().out.splitlines()[-1].removeprefix("next: ")
    assert done == ["check", "compare", "diagnose", "add", "compare"]
    assert line.startswith("The error is within 1.5 times the noise floor: the model ")


@pytest.mark.long
def test_the_lines_of_its_page_work_on_what_it_leaves(demo_printed, monkeypatch, tmp_path):
    shutil.copytree(demo_printed[0] / "out", tmp_path / "out")
    monkeypatch.chdir(tmp_path)
    shutil.rmtree(tmp_path / "out/demo/better", ignore_errors=True)  # of the README's lines
    for words in commands(DEMO)[1:]:
        run(words)
    left = {row for row in re.findall(r"^\| `([\w./]+)` \|", DEMO, re.MULTILINE)}
    assert left == {"run.npz", "other_run.npz", "diagnosis.json", "report.html", "finger2/"}
    assert all(Path(name).exists() for name in left)


# --- the sample log from file to validated model ------------------------------------------------
@pytest.fixture(scope="module")
def csv_printed(tmp_path_factory):
    """Run every command of the page in its order; give the folder of its files and what they
    print.
    """
    folder, text = tmp_path_factory.mktemp("csv"), io.StringIO()
    shutil.copytree(ROOT / "examples", folder / "examples")
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(text):
        patch.chdir(folder)
        for words in commands(CSV):
            run(words)
        own = Path.cwd()
    assert own != folder and {path.name for path in folder.iterdir()} == {"examples", "out"}
    return own, text.getvalue()


def test_what_the_page_quotes_is_printed_or_in_the_log(csv_printed):
    log = (ROOT / "examples/sample_log.csv").read_text(encoding="utf-8").splitlines()
    for language, text in blocks(CSV):
        rows = text.splitlines()
        if language == "text" and not all(
            row.startswith(line) for row, line in zip(log, rows, strict=False)
        ):
            assert misquoted(text, csv_printed[1]) is None


def test_the_hidden_effect_is_found_and_the_error_falls(csv_printed):
    assert load_bundle(csv_printed[0] / "better").chain_names == ("backlash",)
    before, after = re.findall(r"^  rms +([\d.]+) +([\d.]+)", csv_printed[1], re.MULTILINE)[-1]
    assert float(after) < 0.25 * float(before)


def test_the_proposal_differs_from_the_mapping_as_the_page_says(csv_printed):
    proposed = read_mapping(csv_printed[0] / "proposed.toml")
    mapping = read_mapping(ROOT / "examples/sample_map.toml")
    assert proposed.command_unit == mapping.command_unit and len(proposed.logs) == len(mapping.logs)
    (block,) = [text for language, text in blocks(CSV) if language == "toml"]
    example = (ROOT / "examples/sample_map.toml").read_text(encoding="utf-8")
    assert all(line in example for line in block.splitlines())
    assert (
        mapping.robot == "moe-finger" and Run.load(csv_printed[0] / "run.npz").robot == "moe-finger"
    )


def test_a_line_left_out_of_a_quote_without_a_mark_is_found():
    printed = "one\ntwo\nthree\nfour"
    assert misquoted("two\nthree", printed) is None and misquoted("one\n…\nfour", printed) is None
    assert misquoted("one\nthree", printed) == "three" and misquoted("five", printed) == "five"
    assert misquoted("three\n…\none", printed) == "one"


@pytest.mark.prove
def test_the_sample_logs_are_those_of_the_script(tmp_path):
    """Two solutions of a hundred seconds each; the values agree to the last digit that is
    written.
    """
    spec = importlib.util.spec_from_file_location(
        "make_sample_log", ROOT / "examples/make_sample_log.py"
    )
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert script.main([str(tmp_path)]) == 0
    for name in ("sample_log.csv", "sample_other.csv"):
        made = np.loadtxt(tmp_path / name, delimiter=",", skiprows=1)
        kept = np.loadtxt(ROOT / "examples" / name, delimiter=",", skiprows=1)
        # one digit of the file: threads add in another order
        np.testing.assert_allclose(made, kept, atol=0.011)
