"""A session: its gate, its steps on disk, undo and redo, a program that is killed, bad folders."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from lab_runs import HIDDEN, measured, session

from softmap_edge import Run, compare, load_bundle
from softmap_edge.errors import LabError
from softmap_edge.lab.journal import JOURNAL, MODEL, Journal, as_inputs, read_inputs
from softmap_edge.lab.views import rms_of

HASH = "0" * 64
INPUTS = as_inputs([("run.npz", HASH)], (None, HASH))


def test_steps_are_taken_back_redone_and_read_again(tmp_path):
    first = session(tmp_path / "lab")
    first.check()
    first.accept(["backlash"], HIDDEN)
    first.check()
    first.accept(
        ["backlash", "offset"],
        first.model.params | {"backlash.gap": 1.0, "offset.shift[0]": 0.0, "offset.shift[1]": 0.0},
    )
    first.undo()
    assert first.model.params["backlash.gap"] == HIDDEN["backlash.gap"]
    first.redo()
    first.undo()
    params, errors = first.model.params, first.journal.state.accepted[0].errors_mm
    assert errors[1] == pytest.approx(
        compare(first.model, first.runs[1].run).error["rms_mm"], rel=1e-5
    )
    assert errors[1] < 0.1 < first.document()["base_errors_mm"][1], "without the step it is large"
    first.close()
    again = session(tmp_path / "lab")
    assert again.model.params == params and len(again.journal.state.undone) == 1
    assert load_bundle(tmp_path / "lab" / MODEL).params == params
    again.redo()
    with pytest.raises(LabError, match="no step to redo"):
        again.redo()
    again.close()


def test_a_step_needs_a_check_of_exactly_these_inputs(tmp_path):
    lab = session(tmp_path / "lab")
    for what in (lambda: lab.accept(["backlash"], HIDDEN), lambda: lab.fit(["backlash"], HIDDEN),
                 lambda: lab.diagnose(print)):  # fmt: skip
        with pytest.raises(LabError, match="needs a check"):
            what()
    lab.check()
    assert lab.document()["check"]["state"] == "passed"
    lab.accept(["backlash"], HIDDEN)
    assert lab.document()["check"]["state"] == "not done", "the model is another one"
    with pytest.raises(LabError, match="needs a check"):
        lab.fit(["backlash"], HIDDEN)
    with pytest.raises(LabError, match="no effect 'nonsense'"):
        lab.with_effects(["nonsense"], {})
    lab.close()


def test_points_that_stand_for_not_seen_fail_the_check_and_are_hidden(tmp_path):
    run = measured()
    points = run.vertices.copy()
    points[40:60, 100] = 0.0
    lab = session(tmp_path / "lab", replace(run, vertices=points))
    wrong = rms_of(lab.view(0)[0].before, lab.view(0)[0])
    lab.check()
    document, view = lab.document(), lab.view(0)[0]
    assert document["check"]["state"] == "failed" and document["revision"] == 1
    assert not view.visible[50, 100] and rms_of(view.before, view) < wrong
    expected = compare(lab.model, lab.runs[0].run).error["rms_mm"]
    assert rms_of(view.before, view) == pytest.approx(expected, rel=1e-5)
    with pytest.raises(LabError, match="needs a check that passes"):
        lab.diagnose(print)
    lab.close()


def test_a_run_of_outputs_is_refused(tmp_path):
    t = np.arange(0.0, 5.0, 0.1)
    levels = Run.of_outputs(np.sin(t)[:, None], "V", t_seen=t, t=t, command=np.zeros((50, 2)))
    with pytest.raises(LabError, match="holds outputs; use `softmap compare`"):
        session(tmp_path / "lab", levels)
    assert not (tmp_path / "lab").exists()


def test_a_diagnosis_is_kept_and_its_effects_are_accepted(tmp_path):
    lab = session(tmp_path / "lab", measured())
    lab.check()
    with pytest.raises(LabError, match="no diagnosis"):
        lab.accept_diagnosis()
    lab.diagnose(lambda line: None)
    assert lab.document()["diagnosis_current"]
    assert [one["name"] for one in lab.diagnosis()["effects"]] == ["backlash"]
    shown, shares = lab.diagnosis(), list[float]()
    error = shown["error"]
    before, after = error["model"], error["ladder"][-1]["value"]
    assert shown["verdict_text"].startswith(shown["verdict"])
    assert shown["removed"] == min(1.0, (before - after) / (before - error["floor"])) > 0.8
    rows = lab.experiments(shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert rows and all({"block", "minutes", "settles", "separation"} <= set(row) for row in rows)
    lab.accept_diagnosis()
    with pytest.raises(LabError, match="experiments need a diagnosis"):
        lab.experiments(shares.append)
    assert not lab.document()["diagnosis_current"]
    params = lab.model.params
    lab.close()
    again = session(tmp_path / "lab", measured())
    assert again.model.params == params and again.diagnosis() is not None
    again.close()


def test_a_killed_program_loses_no_accepted_step(tmp_path):
    code = (
        "import os, signal, sys; from lab_runs import session, HIDDEN, measured\n"
        "lab = session(sys.argv[1], measured()); lab.check(); lab.accept(['backlash'], HIDDEN)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    environment = dict(os.environ) | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "lab")], env=environment)
    assert done.returncode == -signal.SIGKILL
    lab = session(tmp_path / "lab", measured())
    assert lab.model.chain_names == ("backlash",)
    lab.close()


def accepted(name="backlash"):
    return {
        "do": "accepted",
        "effects": [name],
        "params": HIDDEN,
        "diagnosis": None,
        "errors_mm": [],
    }


def test_a_line_that_was_cut_is_dropped_and_the_next_one_is_complete(tmp_path):
    journal = Journal(tmp_path / "lab", INPUTS)
    journal.append(accepted())
    journal.close()
    file = tmp_path / "lab" / JOURNAL
    with file.open("ab") as stream:
        stream.write(b'{"do": "accepted", "eff')
    journal = Journal(tmp_path / "lab")
    assert len(journal.state.accepted) == 1
    journal.append({"do": "undone"})
    journal.close()
    assert [json.loads(line)["do"] for line in file.read_text().splitlines()] == [
        "open",
        "accepted",
        "undone",
    ]
    assert read_inputs(tmp_path / "lab") == INPUTS and read_inputs(tmp_path / "none") is None


@pytest.mark.parametrize(
    "line",
    ["[]", "nonsense", "[" * 2000, "{}", '{"do": "redone"}', '{"do": "undone"}', "\x00",
     json.dumps({"do": "diagnosed", "file": "../../etc/passwd", "inputs": HASH}),
     json.dumps({"do": "diagnosed", "file": "diagnosis-1.json", "inputs": "x"}),
     json.dumps(accepted() | {"diagnosis": "/elsewhere/diagnosis-1.json"}),
     json.dumps(accepted() | {"effects": ["a", "a"]}), json.dumps(accepted() | {"effects": "abc"}),
     json.dumps(accepted() | {"params": {"a": True}}), json.dumps(accepted() | {"params": {"a": 1e300}}),
     '{"do": "accepted", "effects": ["a"], "params": {"a": NaN}}'],
)  # fmt: skip
def test_a_damaged_journal_is_one_clear_error(tmp_path, line):
    Journal(tmp_path / "lab", INPUTS).close()
    with (tmp_path / "lab" / JOURNAL).open("a") as stream:
        stream.write(line + "\n")
    with pytest.raises(LabError, match="damaged in line 2: .*; give another --folder"):
        Journal(tmp_path / "lab")


def test_folders_that_hold_no_such_session_are_refused(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis\x1b[31m.tex").write_text("")
    with pytest.raises(LabError, match="no folder for a session"):
        Journal(tmp_path / "file", INPUTS)
    with pytest.raises(LabError, match=r"holds thesis\\u001b\[31m.tex and no session"):
        Journal(tmp_path / "full", INPUTS)
    assert [entry.name for entry in (tmp_path / "full").iterdir()] == ["thesis\x1b[31m.tex"]
    journal = Journal(tmp_path / "lab", INPUTS)
    with pytest.raises(LabError, match="another lab has this session open"):
        Journal(tmp_path / "lab", INPUTS)
    journal.close()
    with pytest.raises(LabError, match="other runs or another bundle"):
        Journal(tmp_path / "lab", as_inputs([("run.npz", "1" * 64)], (None, HASH)))
    (tmp_path / "link").mkdir()
    (tmp_path / "link" / JOURNAL).symlink_to(tmp_path / "file")
    with pytest.raises((LabError, OSError)):
        Journal(tmp_path / "link", INPUTS)


def test_a_diagnosis_that_is_gone_is_reported(tmp_path):
    lab = session(tmp_path / "lab", measured())
    lab.journal.append(accepted() | {"diagnosis": "diagnosis-1.json", "params": {}})
    lab.close()
    with pytest.raises(LabError, match="step 1 cannot be read again"):
        session(tmp_path / "lab", measured())
