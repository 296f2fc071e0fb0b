"""Every command that a message names exists, and the advice leads out: provoked, followed, and it
works.
"""

import pytest
from remedies import ROOT, command_of, commands, fault, faults, named_in
from remedy_cases import CASES

from softmap_edge.cli import main
from softmap_edge.model.user_effect import forget_effect, loaded


@pytest.fixture(autouse=True)
def forgotten():
    """Forget the effects that a remedy loads: other tests go through all effects that there are."""
    yield
    for name in list(loaded()):
        forget_effect(name)


def test_every_command_that_a_text_names_is_taken_by_the_parser():
    assert faults() == []


def test_the_list_holds_the_commands_of_messages():
    found = commands()
    named = {command_of(one.words) for one in found}
    assert len(found) > 100
    assert {
        "learn",
        "model calibrate",
        "run align",
        "run register",
        "servo",
        "next",
        "add",
        "model refit",
    } <= named
    computed = [
        one
        for one in found
        if one.file.endswith("guess_points.py") and one.words[:3] == ("run", "align", "RUN")
    ]
    assert computed and "HOLE" in computed[0].words  # a part of it is computed


# Commands that messages name without mending anything by them, or that other tests execute, with
# the file.
LOOKS = {"check", "compare", "show", "model predict", "servo doctor", "demo", "run"}
ELSEWHERE = {
    "servo": "test_servo_remedies.py",
    "servo move": "test_servo_remedies.py",
    "record": "test_record_cut.py",
    "teleop": "test_teleop_installed.py",
    "train": "test_residual_network.py",
    "evaluate": "test_evaluate.py",
    "model adapt": "test_adaptation.py",
    "model sweep": "test_elsewhere.py",
    "build": "test_elsewhere.py",
    "lab": "test_lab_server.py",
}


def test_every_command_that_a_message_names_is_executed_by_a_test():
    """A new remedy needs a case (`remedy_cases.py`), or a test of its own that is listed here."""
    named = {command_of(one.words) for one in commands()}
    cases = {command_of(words) for case in CASES for words in (*case.remedy, case.works)}
    assert named - cases - LOOKS <= {*ELSEWHERE}
    for verb, file in ELSEWHERE.items():
        (path,) = (ROOT / "tests").rglob(file)
        assert all(word in path.read_text() for word in verb.split()), (verb, file)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("use `softmap wobble RUN`", "no command 'wobble'"),
        ("use `softmap diagnose RUN --seed 3`", "no option --seed"),
        ("use `softmap servo scna`", "no action 'scna'"),
        ("use `softmap servo scan --rigs FILE`", "no option --rigs"),
        ("use `softmap model calibrate RUN RUN2 --out DIR`", "unrecognized"),
        ("use `softmap learn RUN --input gaol`", "invalid choice"),
        ("use `softmap\n   learn RUN --hold_out 1:2`", "no option --hold_out"),
        ("then softmap learn RUN --outt DIR", "no option --outt"),
    ],
)
def test_a_command_that_does_not_exist_is_found(text, wrong):
    (words,) = named_in(text)
    assert wrong in fault(tuple(words))


@pytest.mark.parametrize(
    "text",
    [
        "`softmap run align`",
        "`softmap diagnose --out`",
        "`softmap model calibrate RUN --bundle DIR --out DIR2`",
        "`softmap run cut RUN --from 0 --to 9 --out PIECE.npz`",
        "`softmap servo home --rig FILE`",
        "`softmap model effects new NAME`",
        "softmap diagnose RUN --effects NAME.py",
    ],
)
def test_a_part_of_a_command_is_enough(text):
    (words,) = named_in(text)
    assert fault(tuple(words)) is None


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_remedy_of_a_message_leads_out(case, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    case.make()
    capsys.readouterr()
    assert main(list(case.fails)) == case.code
    out, err = capsys.readouterr()
    message = " ".join((err + out).split())
    assert f"`{case.names}" in message, message
    assert command_of(case.names.split()[1:]) in [command_of(words) for words in case.remedy], (
        "the remedy is not what the message names"
    )
    for words in case.remedy:
        assert main(list(words)) in (0, 1), capsys.readouterr().err
    capsys.readouterr()
    assert main(list(case.works)) == 0, capsys.readouterr().err
    out, err = capsys.readouterr()
    if command_of(case.works) == command_of(case.fails):
        assert f"`{case.names}" not in " ".join((err + out).split()), "the advice leads in a circle"
