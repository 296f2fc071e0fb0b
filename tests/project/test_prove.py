"""`rust/servo/prove.py` on outcomes as cargo-mutants 27.1 writes them; the run itself
is `make prove`.
"""

import importlib.util
from collections import Counter
from pathlib import Path

import pytest

FILE = Path(__file__).parents[2] / "rust" / "servo" / "prove.py"


@pytest.fixture(scope="module")
def prove():
    spec = importlib.util.spec_from_file_location("prove", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def outcome(line, summary, what="replace > with >= in Guard::go_on"):
    """Return one outcome as cargo-mutants writes it, but for fields that are not read."""
    file = "rust/servo/guard/machine.rs"
    mutant = {
        "name": f"{file}:{line}:58: {what}",
        "file": file,
        "genre": "BinaryOperator",
        "replacement": ">=",
    }
    return {"scenario": {"Mutant": mutant}, "summary": summary, "phase_results": []}


BASELINE = {"scenario": "Baseline", "summary": "Success", "phase_results": []}
NAME = "machine.rs: replace > with >= in Guard::go_on"


def test_mutants_are_named_without_their_places(prove):
    found = prove.names(
        {"outcomes": [BASELINE, outcome(281, "CaughtMutant"), outcome(285, "MissedMutant")]}
    )
    assert found == [
        {"name": NAME, "summary": "CaughtMutant"},
        {"name": NAME, "summary": "MissedMutant"},
    ]


@pytest.mark.parametrize(
    "caught, late, missed, unviable, explained, fails",
    [
        pytest.param(100, 0, 0, 5, 0, False, id="all are caught"),
        pytest.param(95, 5, 0, 0, 0, False, id="one that never ends is caught"),
        pytest.param(
            94, 6, 0, 0, 0, True, id="too many ran out of time to be loops: the machine was slow"
        ),
        pytest.param(0, 100, 0, 0, 0, True, id="all ran out of time"),
        pytest.param(99, 0, 1, 0, 0, True, id="a survivor without a reason"),
        pytest.param(99, 0, 1, 0, 1, False, id="a survivor with one"),
        pytest.param(98, 0, 2, 0, 1, True, id="a reason counts once"),
        pytest.param(94, 0, 6, 50, 6, True, id="too many survive, unviable ones aside"),
        pytest.param(0, 0, 0, 3, 0, True, id="nothing was checked"),
    ],
)
def test_the_score_and_every_survivor_are_checked(
    prove, capsys, caught, late, missed, unviable, explained, fails
):
    counts = {"CaughtMutant": caught, "Timeout": late, "MissedMutant": missed, "Unviable": unviable}
    outcomes = [
        BASELINE,
        *(outcome(1, kind) for kind, count in counts.items() for _ in range(count)),
    ]
    assert prove.assess(prove.names({"outcomes": outcomes}), Counter({NAME: explained})) == fails
    said = capsys.readouterr().out
    assert f"{caught + late} of {caught + late + missed} mutants are caught" in said
    assert (
        f"({100 * (caught + late) / max(1, caught + late + missed):.1f} %), {caught} by a test "
        f"that fails and {late} by" in said
    )
    assert said.count(f"ran out of time: {NAME}") == late
    assert (f"no reason in survivors.toml: {NAME}" in said) == (missed > explained)


@pytest.mark.parametrize("code", [1, 4])
def test_a_run_without_results_is_a_failure(prove, monkeypatch, tmp_path, capsys, code):
    monkeypatch.setattr(prove, "ROOT", tmp_path)
    monkeypatch.setattr(prove, "cargo", lambda *words, **environment: code)
    old = tmp_path / "target" / "mutants" / "mutants.out" / "outcomes.json"
    old.parent.mkdir(parents=True)
    old.write_text("{}")
    assert prove.mutants(1, []) == 1
    assert f"ended with {code} and checked nothing" in capsys.readouterr().out and not old.exists()
