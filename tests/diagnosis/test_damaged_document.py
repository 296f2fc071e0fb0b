"""A diagnosis with missing fields or absurd numbers is refused before a bundle is written."""

import json

import pytest

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.findings import Finding, Number
from softmap_edge.errors import ReportError

FIELDS = [
    *("schema", "verdict", "sentence", "effects", "faults", "alternatives"),
    *("not_testable", "where", "error", "unexplained", "next", "made_from"),
]


def document():
    labels = _core.Chain(["backlash"], 2).group_labels
    params = {label: Number(1.5, 0.1, "mm") for label in labels}
    return Diagnosis("identified", effects=(Finding("backlash", params),)).to_dict()


def added(found, folder, capsys):
    """Return the exit code of `softmap add` and its message; no bundle is left on failure."""
    (folder / "d.json").write_text(json.dumps(found))
    code = main(["add", "--from", str(folder / "d.json"), "--out", str(folder / "out")])
    assert (folder / "out").exists() == (code == 0)
    return code, capsys.readouterr().err


def test_a_complete_document_is_added(tmp_path, capsys):
    assert added(document(), tmp_path, capsys) == (0, "")


@pytest.mark.parametrize("field", FIELDS)
def test_a_missing_field_is_refused(field, tmp_path, capsys):
    found = document()
    del found[field]
    code, error = added(found, tmp_path, capsys)
    assert code == 2 and error.count("\n") == 1 and ("diagnose" in error)


@pytest.mark.parametrize("value", [1e308, -1e308, float("inf"), float("nan"), 1e12, -3.0])
def test_an_absurd_parameter_is_refused(value, tmp_path, capsys):
    found = document()
    for number in found["effects"][0]["params"].values():
        number["value"] = value
    code, error = added(found, tmp_path, capsys)
    assert code == 2 and error.count("\n") == 1 and "backlash.gap" in error


@pytest.mark.parametrize(
    "change",
    [
        {"share": 1e308},
        {"displacement_mm": {"fitted": 1e308}},
        {"refitted": {"params": {}, "error_mm": [1e12] * 3}},
        {"refitted": {"params": {"backlash.gap": {"value": 1e12}}}},
        {"refitted": {"params": {"rod.young_mpa": {"value": 1e20}}}},
        {"certificate": {"log10_e": float("nan")}},
    ],
)
def test_absurd_numbers_around_an_effect_are_refused(change, tmp_path, capsys):
    found = document()
    found["effects"][0] |= change
    code, error = added(found, tmp_path, capsys)
    assert code == 2 and error.count("\n") == 1 and "diagnose again" in error


@pytest.mark.parametrize("value", [1e301, float("-inf"), -1e308])
def test_no_number_of_a_document_is_beyond_bounds(value):
    with pytest.raises(ReportError):
        Diagnosis.from_dict(document() | {"unexplained": {"chi2_per_n": value}})


@pytest.mark.parametrize("robot", ["arm", "moe-finger-2", ""])
def test_a_diagnosis_of_another_robot_is_refused(robot, tmp_path, capsys):
    found = document() | {"made_from": {"robot": robot}}
    code, error = added(found, tmp_path, capsys)
    assert code == 2 and f"the diagnosis is of '{robot}', the model of 'moe-finger'" in error
    assert main(["next", str(tmp_path / "d.json"), "--out", str(tmp_path / "next.csv")]) == 2
    assert f"give the bundle of '{robot}' with --bundle" in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"PK\x03\x04\x98", b"\xff\xfe", b"\x89HDF\r\n\x98"])
def test_a_file_of_another_kind_is_no_diagnosis(content, tmp_path, capsys):
    (tmp_path / "run.npz").write_bytes(content)
    assert main(["next", str(tmp_path / "run.npz")]) == 2
    error = capsys.readouterr().err
    assert "run.npz: not a text; give a diagnosis, which `softmap diagnose --out` writes" in error
    assert error.count("\n") == 1
