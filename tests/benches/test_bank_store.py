"""Cases are made once: kept as files, found again by the digest of their code, scored from these
files.
"""

import json

import numpy as np
import pytest

from benches.bank import store
from benches.bank.__main__ import main
from benches.bank.answers import LAW_OPEN, Answer
from benches.bank.case import case, protocol_of
from benches.bank.make import made, verdicts
from benches.bank.store import Kept, keep, made_by, name_of
from softmap_edge.run.run import Run

TASK = ("development", "A", "easy", "null", 0)


@pytest.fixture(scope="module")
def kept_case(tmp_path_factory):
    return made(TASK, tmp_path_factory.mktemp("cases"))


def test_a_case_that_is_kept_is_the_one_that_was_made(kept_case):
    mine = case(*TASK)
    assert kept_case.run().hash() == mine.run(protocol_of("null", (), 0)).hash()
    truth = kept_case.truth
    assert (
        truth["hidden"] == []
        and truth["verdicts"] == ["nothing", "cannot_tell"]
        and truth["runs"] == ["first"]
    )
    assert (
        truth["background_mm"] == pytest.approx(mine.background_mm(), abs=1e-4)
        and truth["made_by"] == made_by()
    )
    assert kept_case.is_current and kept_case.folder.name == name_of(TASK) == truth["case"]
    # no partial files
    assert [path.name for path in kept_case.folder.parent.iterdir()] == [name_of(TASK)]


def test_only_what_makes_a_case_makes_it_again(kept_case, monkeypatch, tmp_path):
    own = tmp_path / "bank"
    own.mkdir()
    for name in ("case.py", "judge.py"):
        (own / name).write_text("x = 1\n")
    monkeypatch.setattr(store, "__file__", str(own / "store.py"))
    made_by.cache_clear()
    first = made_by()
    (own / "judge.py").write_text("x = 2\n")
    made_by.cache_clear()
    assert made_by() == first
    (own / "case.py").write_text("x = 2\n")
    made_by.cache_clear()
    assert made_by() != first
    assert not Kept(kept_case.folder).is_current
    monkeypatch.undo()
    made_by.cache_clear()
    assert Kept(kept_case.folder).is_current


def test_making_and_scoring_are_two_steps_and_go_on_where_they_were_stopped(
    tmp_path, monkeypatch, capsys
):
    def one(task, root):
        run = Run(t=np.arange(3.0), command=np.zeros((3, 1)))
        return keep(task, root, {"hidden": [], "truth_seconds": 0.0}, {"first": run})

    def reported(case):
        return {
            "case": case.folder.name,
            "hidden": [],
            "named": [],
            "verdict": "nothing",
            "made_by": case.truth["made_by"],
        }

    class Alone:
        def __init__(self, *args, **kwargs):
            self.ran = []

        def __enter__(self):
            return self

        def __exit__(self, *args):
            return None

        def submit(self, what, job):
            from concurrent.futures import Future

            done = Future()
            done.set_result(what(job))
            return done

    monkeypatch.setattr("benches.bank.__main__.ProcessPoolExecutor", Alone)
    monkeypatch.setattr("benches.bank.make.made", one)
    monkeypatch.setattr("benches.bank.work.judge_case", reported)
    monkeypatch.setattr("benches.bank.judge.text", lambda rows: f"{len(rows)} rows")
    some = [
        "--parts",
        "shop/floor",
        "--kinds",
        "null",
        "--out",
        str(tmp_path),
        "--share",
        "0.03",
        "--jobs",
        "1",
    ]

    def said(*more):
        main([*some, *more])
        out = capsys.readouterr()
        return out.out, out.err

    assert "3 cases, 3 to make" in said("--make")[1] and "3 cases, 0 to make" in said("--make")[1]
    out, err = said("--judge")
    assert "3 to score" in err and "3 rows" in out and "0 to score" in said("--judge")[1]
    folder = tmp_path / "cases" / "development-shop-floor-null-0001"
    truth = json.loads((folder / "truth.json").read_text())
    (folder / "truth.json").write_text(json.dumps(truth | {"made_by": "an older bank"}))
    # from the files
    assert "1 to score" in said("--judge")[1] and "0 to score" in said("--judge")[1]
    assert "3 cases, 1 to make" in said("--make")[1] and "1 to score" in said()[1]


def test_what_is_right_for_a_run_follows_from_its_laws():
    known, unknown = Answer(("memory",), ("backlash",), (), ("identified",)), Answer(("time",))
    assert verdicts("null", ()) == ("nothing", "cannot_tell")
    assert (
        verdicts("single", (known,)) == ("identified",)
        and verdicts("unknown", (unknown,)) == LAW_OPEN
    )
    assert verdicts("pair", (known, known)) == ("identified", "ambiguous")
    assert verdicts("pair", (known, unknown)) == LAW_OPEN and "identified" not in verdicts(
        "removed", (known,)
    )
