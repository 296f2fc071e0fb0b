"""The document of a diagnosis: a round trip loses nothing, the earlier schema is read, damaged
files are refused.
"""

import copy
import dataclasses
import json
import math

import pytest

from softmap_edge.diagnosis.document import BEFORE, SCHEMA, VERDICTS, Diagnosis
from softmap_edge.diagnosis.findings import (
    Alternative,
    Bin,
    Displacement,
    ErrorLadder,
    FamilyFinding,
    Finding,
    NextBlock,
    Number,
    Refitted,
    Rung,
    ServoEffect,
    ServoError,
    ServoFinding,
    Unexplained,
    Untestable,
    Where,
    plain,
    read,
)
from softmap_edge.errors import ReportError, SoftmapError
from softmap_edge.model.learned_in import Alternative as LearnedAlternative
from softmap_edge.model.learned_in import LearnedIn, LearnedNumber

GAP = Number(0.62, 0.013, "mm", True, None)
WHOLE = Diagnosis(
    verdict="partly_explained",
    sentence="The model lacks backlash; 0.21 mm RMS (fitted) remain unexplained.",
    effects=(
        Finding(
            "backlash",
            {"backlash.gap": GAP},
            "memory",
            "transmission",
            Displacement(1.8, 1.5),
            0.9,
            0.97,
            Refitted({"backlash.stiffness": Number(0.1, 0.02)}, (0.1, 0.2)),
        ),
    ),
    faults=(
        Finding(
            "servo_swap", {"servo_swap.case": Number(2.0, meaning="channel 1 runs the wrong way")}
        ),
    ),
    families=(
        FamilyFinding(
            "memory", "memory", "identified", ("backlash",), 0.9, 1.8, 0.98, ("u³",), ("delay",)
        ),
    ),
    alternatives=(Alternative(("friction",), "fits as well", "backlash", "memory"),),
    not_testable=(Untestable("thermal_softening", "no temperature", "a warm-up", 15.0),),
    where=Where(
        {"speed": (Bin("still", None, 1.0, 9, 1.0),)}, {"speed": (Bin("still", None, 1.0, 9, 0.2),)}
    ),
    error=ErrorLadder(
        2.4,
        1.9,
        (Rung("backlash", 0.9),),
        0.3,
        (0.2, 0.4),
        noise_floor=0.1,
        model_floor=0.2,
        floor=0.2,
    ),
    unexplained=Unexplained(0.21, 1.8, 0.22, "dwell", 0.24),
    next=(NextBlock("staircase", 2.5, ("creep",), 42.0),),
    made_from={"seed": 1, "run": "abc"},
    servo=(
        ServoFinding(
            1,
            "mm",
            (ServoEffect("latency", {"latency.delay": Number(0.18)}),),
            ServoError(0.4, 0.1),
        ),
    ),
    remarks=("frames 3 and 4 are left out",),
    learned_in=(
        LearnedIn(
            "friction",
            "memory",
            "open",
            3.1,
            0.4,
            (LearnedNumber("friction.width", 0.2, 0.1, "mm", True),),
            (LearnedAlternative("", "rate", 0.5),),
        ),
    ),
)
TEXT = json.dumps(WHOLE.to_dict(), allow_nan=False)


def fresh():
    return json.loads(TEXT)


def test_a_round_trip_loses_nothing():
    """Every field of every record is set to a value that is not its default, and is read back."""
    back = Diagnosis.from_dict(fresh())
    for field in dataclasses.fields(Diagnosis):
        if field.name != "model":
            assert getattr(back, field.name) == getattr(WHOLE, field.name) != field.default, (
                field.name
            )
    assert (
        json.dumps(back.to_dict()) == TEXT
        and list(fresh())[0] == "schema"
        and fresh()["schema"] == SCHEMA
    )
    assert str(back) == str(WHOLE)


def test_what_is_not_given_keeps_its_default():
    short = Diagnosis.from_dict({"schema": SCHEMA, "verdict": "nothing"})
    assert short.effects == () and short.error == ErrorLadder() and math.isnan(short.error.before)
    assert Diagnosis.from_dict(short.to_dict()).to_dict() == short.to_dict()
    assert "refitted" not in plain(Finding("gain", {})) and "meaning" not in plain(Number(1.0))


def test_unknown_keys_are_passed_over():
    document = fresh() | {"certificate": 3}
    document["effects"][0]["colour"] = "red"
    assert Diagnosis.from_dict(document).to_dict() == WHOLE.to_dict()


def test_the_schema_before_is_read():
    """A document of the earlier version: alternatives, no families, an experiment for each
    alternative.
    """
    old = fresh() | {"schema": BEFORE}
    old["rivals"] = [
        {"member": "backlash", "effects": ["friction"], "why": "near", "experiment": ["loops", 2.0]}
    ]
    for key in ("alternatives", "families"):
        del old[key]
    found = Diagnosis.from_dict(old)
    assert (
        found.alternatives == (Alternative(("friction",), "near", "backlash"),)
        and found.families == ()
    )
    assert found.effects == WHOLE.effects and found.to_dict()["schema"] == SCHEMA
    assert "friction" in str(found)


@pytest.mark.parametrize("schema", [SCHEMA, BEFORE])
@pytest.mark.parametrize("law", ["identified", "ambiguous", "open", "unknown", "resolved"])
def test_a_law_of_an_earlier_document_is_read_in_the_words_of_today(law, schema):
    document = fresh() | {"schema": schema}
    document["families"][0]["law"] = law
    (family,) = Diagnosis.from_dict(document).families
    assert family.law == ("identified" if law == "resolved" else law)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_is_read_and_printed(verdict):
    assert VERDICTS[verdict] in str(Diagnosis.from_dict(fresh() | {"verdict": verdict}))


@pytest.mark.parametrize(
    ("document", "match"),
    [
        ([], "not a diagnosis: schema is 'list'"),
        ("text", "not a diagnosis: schema is 'str'"),
        ({}, "not a diagnosis: schema is None"),
        ({"schema": "softmap.diagnosis/9"}, "'softmap.diagnosis/2' is read"),
        ({"schema": SCHEMA}, "diagnosis has no 'verdict'"),
        (
            {"schema": SCHEMA, "verdict": "maybe"},
            "unknown verdict 'maybe'; there are identified, ambiguous",
        ),
    ],
)
def test_what_is_no_diagnosis_is_refused(document, match):
    with pytest.raises(ReportError, match=match):
        Diagnosis.from_dict(document)


def spoil(document, where, value):
    *path, last = where
    for key in path:
        document = document[key]
    document[last] = value


@pytest.mark.parametrize(
    ("where", "value", "match"),
    [
        (("effects",), {"gap": 3}, r"diagnosis.effects is dict"),
        (("effects", 0), "backlash", r"diagnosis.effects\[0\] is str, expected an object"),
        (("effects", 0, "name"), 7, r"diagnosis.effects\[0\].name is int"),
        (("effects", 0, "params"), [0.62], r"diagnosis.effects\[0\].params is list"),
        (("effects", 0, "params", "backlash.gap", "value"), None, r"params.backlash.gap.value is NoneType"),
        (("effects", 0, "params", "backlash.gap", "value"), True, r"params.backlash.gap.value is bool"),
        (("effects", 0, "params", "backlash.gap", "at_bound"), 1, r"params.backlash.gap.at_bound is int"),
        (("families", 0, "law"), "sure", r"law is 'sure', expected one of identified, ambiguous"),
        (("families", 0, "law"), ["open"], r"law is \['open'\], expected one of identified"),
        (("families", 0, "share"), "most", r"diagnosis.families\[0\].share is str"),
        (("families", 0, "effects"), "backlash", r"diagnosis.families\[0\].effects is str"),
        (("error", "ladder", 0), 3.0, r"diagnosis.error.ladder\[0\] is float"),
        (("where", "before", "speed"), [{"label": "x"}], r"where.before.speed\[0\] has no 'low'"),
        (("next", 0, "settles"), [7], r"diagnosis.next\[0\].settles\[0\] is int"),
        (("servo", 0, "channel"), 1.5, r"diagnosis.servo\[0\].channel is float"),
        (("remarks",), "late", r"diagnosis.remarks is str"),
    ],
)  # fmt: skip
def test_a_damaged_document_gives_one_error_that_says_where(where, value, match):
    document = fresh()
    spoil(document, where, value)
    with pytest.raises(ReportError, match=match) as fault:
        Diagnosis.from_dict(document)
    assert str(fault.value).startswith("damaged diagnosis: ") and str(fault.value).endswith(
        "; diagnose again"
    )


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, 10**400], ids=["nan", "inf", "-inf", "googol"]
)
def test_numbers_that_are_not_finite_are_refused(value, tmp_path):
    """Python's JSON allows NaN and integers beyond any float; a fit has neither."""
    for where in (
        ("effects", 0, "params", "backlash.gap", "value"), ("effects", 0, "params", "backlash.gap", "sigma"),
        ("error", "model"), ("error", "per_fold", 0), ("families", 0, "moved_mm"), ("unexplained", "chi2_per_n"),
        ("next", 0, "minutes"), ("servo", 0, "error", "value"),
    ):  # fmt: skip
        document = fresh()
        spoil(document, where, value)
        path = tmp_path / "d.json"
        path.write_text(json.dumps(document))
        with pytest.raises(
            SoftmapError,
            match=rf"{where[-1] if isinstance(where[-1], str) else where[-2]}.* finite",
        ):
            Diagnosis.load(path)


def test_every_leaf_in_turn_becomes_junk():
    """The document is read, or refused with one error: no other exception, and missing entries are
    reported.
    """
    refused = 0
    for where in leaves(fresh()):
        for junk in ("x", None, [], {}, -1):
            document = copy.deepcopy(fresh())
            spoil(document, where, junk)
            try:
                str(Diagnosis.from_dict(document))
            except ReportError as fault:
                refused += 1
                assert "\n" not in str(fault)
    assert refused > 100


def leaves(value, path=()):
    if isinstance(value, dict):
        return [leaf for key, inner in value.items() for leaf in leaves(inner, (*path, key))]
    if isinstance(value, list):
        return [leaf for key, inner in enumerate(value) for leaf in leaves(inner, (*path, key))]
    return [path]


def test_names_that_stand_twice_are_refused():
    document = fresh()
    document["faults"] += document["effects"]
    with pytest.raises(ReportError, match="names 'backlash' twice"):
        Diagnosis.from_dict(document)


def test_records_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        WHOLE.effects[0].params = {}
    with pytest.raises(dataclasses.FrozenInstanceError):
        WHOLE.verdict = "nothing"


def test_parts_are_read_by_their_annotations():
    assert read(Number, {"value": 1}, "n") == Number(1.0) and isinstance(
        read(Number, {"value": 1}, "n").value, float
    )
    assert read(Bin, {"label": "x", "low": None, "high": 2, "n": 3, "rms_mm": 1}, "b") == Bin(
        "x", None, 2.0, 3, 1.0
    )
    with pytest.raises(ReportError, match="n is list, expected an object"):
        read(Number, [1.0], "n")


def test_what_a_diagnosis_does_not_name_is_refused():
    assert WHOLE.params_of("backlash") == {"backlash.gap": 0.62, "backlash.stiffness": 0.1}
    assert WHOLE.params_of("servo_swap") == {"servo_swap.case": 2.0}
    with pytest.raises(SoftmapError, match="does not name 'creep'; it names backlash, servo_swap"):
        WHOLE.params_of("creep")
