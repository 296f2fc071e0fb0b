"""docs/do/import_sweep.md as written: its Python block and its commands run in order, and what it
quotes is printed.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from page import blocks, lines
from robots import arc, measured, rings

from softmap_edge import load_bundle
from softmap_edge.cli import main
from softmap_edge.sweep.sweep_file import _NUMBERS, _TEXTS

PAGE = (Path(__file__).parents[2] / "docs/do/import_sweep.md").read_text(encoding="utf-8")
BLOCKS = blocks(PAGE)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The folder and what each command printed; the reader's run is an arc with the truth's own
    play in its tendons.
    """
    there, printed = tmp_path_factory.mktemp("page"), {}
    place, offset = rings(13, 12)
    measured(
        lambda u, gravity, grams: arc(u, place, offset), "backlash", orientations=1, scale=0.5
    ).save(there / "run.npz")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(there)
        patch.setattr(
            "builtins.print",
            lambda *a, **k: printed.setdefault(words, []).append(" ".join(map(str, a))),
        )
        for language, text in BLOCKS:
            if language == "python":
                exec(compile(text, "docs/do/import_sweep.md", "exec"), {})
            elif language == "":
                for argv in lines(text):
                    words = " ".join(argv[1:])
                    assert main(argv[1:]) == 0, words
    return there, {name: "\n".join(parts) for name, parts in printed.items()}


def test_the_page_makes_the_arc_that_the_tests_measure(page):
    with np.load(page[0] / "sweep.npz") as sweep:
        true = arc(sweep["command"], *rings(13, 12))
        np.testing.assert_allclose(sweep["vertices"], true, atol=1e-5)


def test_what_is_quoted_is_what_is_printed(page):
    quoted = next(text for language, text in BLOCKS if language == "text")
    assert printed_without_path(page[1]["check sweep.npz"]) == quoted.splitlines()


def printed_without_path(text):
    return [line for line in text.splitlines() if not line.startswith("sound")]


def test_backlash_is_identified_and_added(page):
    there, printed = page
    said = next(text for words, text in printed.items() if words.startswith("diagnose"))
    assert "Verdict: identified" in said and "The model lacks backlash;" in said
    assert load_bundle(there / "finger2").chain_names == ("backlash",)


def test_every_field_of_the_file_is_on_the_page():
    rows = [line for line in PAGE.splitlines() if line.startswith("| `")]
    on_page = {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    assert on_page == {*_NUMBERS, *_TEXTS, "triangles"} - {"schema"}
