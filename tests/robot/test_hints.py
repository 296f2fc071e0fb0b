"""Finding and remedy of a message come apart outside brackets, and its commands name the user's own
files.
"""

import re
from pathlib import Path

import pytest

from softmap_edge.robot import doctor
from softmap_edge.robot.finding import faulty
from softmap_edge.robot.remedies import filled, parted


@pytest.mark.parametrize(
    "said, finding, remedy",
    [
        (
            "home is lost (turns; a fault too); home it",
            "home is lost (turns; a fault too)",
            "home it",
        ),
        ("a [b; c] {d; (e; f)} g; do it; and that", "a [b; c] {d; (e; f)} g", "do it; and that"),
        ("run `x; y` is wrong; z", "run `x; y` is wrong", "z"),
        ("nothing to do (a; b)", "nothing to do (a; b)", ""),
        ("/a(b/rig.toml: no TOML; correct it", "/a(b/rig.toml: no TOML", "correct it"),
        ("odd) bracket; do it", "odd) bracket", "do it"),
        ("", "", ""),
    ],
)
def test_a_message_is_parted_outside_brackets(said, finding, remedy):
    assert parted(said) == (finding, remedy)
    line = faulty("x", said, "otherwise")
    assert line.do == (remedy or "otherwise") and line.found == (finding or "no reason is given")


@pytest.mark.parametrize(
    "said, full",
    [
        ("`softmap servo home --rig FILE`", "`softmap servo home --rig 'my rig.toml'`"),
        (
            "`softmap servo setup --port P --id 1`",
            "`softmap servo setup --port P --id 1 --rig 'my rig.toml'`",
        ),
        (
            "`softmap servo limits` and more",
            "`softmap servo limits --rig 'my rig.toml' --bundle B` and more",
        ),
        ("`softmap servo pull --bundle x`", "`softmap servo pull --bundle x --rig 'my rig.toml'`"),
        ("`softmap servo pull --rig other`", "`softmap servo pull --rig other --bundle B`"),
        ("`softmap servo heartbeat --new-key FILE`", "`softmap servo heartbeat --new-key FILE`"),
        ("`softmap servo scan --port P`", "`softmap servo scan --port P`"),
        ("no command: --rig FILE", "no command: --rig FILE"),
    ],
)
def test_commands_name_the_files_that_were_given(said, full):
    assert filled(said, "my rig.toml", "B") == full
    assert filled(said, None) == said


def test_a_bundle_that_was_not_given_is_left_to_the_user():
    """Without one, limits and pull fail: the built-in finger holds no calibration."""
    assert (
        filled("`softmap servo limits`", "r.toml")
        == "`softmap servo limits --rig r.toml --bundle DIR`"
    )
    assert filled("`softmap servo off`", "r.toml") == "`softmap servo off --rig r.toml`"


def test_no_other_place_splits_a_message():
    """A plain split at "; " cuts in brackets too; messages are parted by `hints.parted` alone."""
    for file in Path(doctor.__file__).parents[2].rglob("*.py"):
        if file.name != "remedies.py":
            found = re.findall(
                r'(?:split|partition|index|find)\(";? ?;? "\)', file.read_text(encoding="utf-8")
            )
            assert not [one for one in found if ";" in one], file
