"""Pages, messages, docstrings, comments and names are plain English; sentences are short."""

import pytest
from plain_words import ROOT, findings, sentences

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
CLEAN = ("pages", "pictures", "messages", "docstrings", "names", "comments")
LONGEST, MEAN = 40, 18.0  # words of a sentence


@pytest.mark.parametrize("scope", CLEAN)
def test_no_word_that_a_reader_of_the_field_does_not_expect(scope):
    found = [f"{one.file}:{one.line}: {one.word}" for one in findings() if one.scope == scope]
    assert not found, (
        "write another word: tests/support/plain_words.py has one for each\n" + "\n".join(found)
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_sentences_are_short(page):
    long = {
        sentence: words
        for sentence in sentences(page)
        if (words := len(sentence.split())) > LONGEST
    }
    assert not long
    lengths = [len(sentence.split()) for sentence in sentences(page)]
    assert sum(lengths) <= MEAN * max(1, len(lengths)), (
        f"{sum(lengths) / len(lengths):.1f} words on average"
    )


def test_the_script_finds_words_and_long_sentences(tmp_path):
    """Otherwise the tests above could not fail."""
    from plain_words import WORDS

    assert [
        found[0] for found in WORDS.finditer("nobody told the whole story; whole numbers are fine")
    ] == [
        "nobody",
        "told",
        "whole",
    ]
    page = tmp_path / "page.md"
    page.write_text(
        "# Head\n\nShort one. " + "word " * 45 + ".\n\n| a | table |\n\n```\ncode\n```\n",
        encoding="utf-8",
    )
    assert [len(sentence.split()) for sentence in sentences(page)] == [2, 46]
