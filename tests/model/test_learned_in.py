"""The effects that a model was learned with are typed records, saved with the bundle and read as an
untrusted file.
"""

import json

import pytest
from recorded_arms import recorded

from softmap_edge import learn_model, load_bundle, save_bundle
from softmap_edge.errors import BundleError, SoftmapError
from softmap_edge.model.learned_in import Alternative, LearnedIn, LearnedNumber, read_learned_in

RECORD = LearnedIn(
    name="backlash",
    family="memory",
    law="ambiguous",
    before_mm=3.2,
    after_mm=0.4,
    params=(LearnedNumber("backlash.gap[1]", 1.4, 0.02, "mm", False),),
    alternatives=(Alternative("friction", "memory", 0.41), Alternative("", "rate", 0.42)),
)


def test_a_record_says_it_all_in_words_and_comes_back_from_its_document():
    said = str(RECORD)
    for part in (
        "backlash: memory, law ambiguous",
        "3.20 to 0.40 mm RMS",
        "backlash.gap[1] = 1.4 ± 0.02 mm",
        "friction",
    ):
        assert part in said
    assert "an unknown law (rate" in said
    assert read_learned_in(json.loads(json.dumps([RECORD.to_dict()]))) == (RECORD,)
    assert read_learned_in(None) == ()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"law": "certain"}, "law"),
        ({"name": 3}, "name"),
        ({"name": "a\nb"}, "name"),
        ({"before_mm": float("nan")}, "before_mm"),
        ({"after_mm": True}, "after_mm"),
        ({"after_mm": 1e300}, "after_mm"),
        ({"after_mm": 10**400}, "after_mm"),
        ({"params": [{"label": "gap"}]}, "label"),
        ({"alternatives": "friction"}, "alternatives"),
        ({"alternatives": [None] * 40}, "alternatives"),
        ({"further": 1}, "name"),
    ],
)
def test_a_record_that_was_tampered_with_is_refused_with_what_is_wrong(change, word):
    document = RECORD.to_dict() | change
    with pytest.raises(SoftmapError, match=word):
        read_learned_in([document])
    for no_list in ("backlash", document):
        with pytest.raises(SoftmapError, match="expected a list"):
            read_learned_in(no_list)


def test_a_bundle_whose_record_was_tampered_with_is_refused(tmp_path):
    model = learn_model(recorded((1.4, 1.4), seconds=60.0))
    folder = save_bundle(model, tmp_path / "finger")
    assert load_bundle(folder).learned_in == model.learned_in != ()
    file = folder / "manifest.json"
    manifest = json.loads(file.read_text())
    for wrong in ([{"name": "backlash"}], {"a": 1}, [7]):
        manifest["made_from"]["learned_in"] = wrong
        file.write_text(json.dumps(manifest))
        with pytest.raises(BundleError, match="learned_in"):
            load_bundle(folder)
    manifest["made_from"] |= {"learned_in": [], "runs": ["abc"]}
    file.write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match="runs"):
        load_bundle(folder)


def test_a_model_of_a_simulator_was_learned_with_nothing():
    from softmap_edge.model.bundle import builtin_model

    assert builtin_model().learned_in == () and builtin_model().coverage is None
