"""The summary of a run, its document and its text; the report of a refit likewise."""

import dataclasses
import json
from dataclasses import replace

import numpy as np
import pytest
from recorded_arms import recorded, segmented

from softmap_edge.checks.summary import RunSummary, summary
from softmap_edge.checks.summary_text import sentences
from softmap_edge.diagnosis.findings import Number
from softmap_edge.diagnosis.refit import RefitReport


def declared():
    run = recorded(seconds=10.0)
    return replace(
        run,
        temperature=np.linspace(20.0, 30.0, len(run.t)),
        load=np.zeros(len(run.t)),
        block=np.array(["a", "b"])[np.arange(len(run.t_seen)) % 2],
    )


RUNS = {
    "bare": lambda: recorded(seconds=10.0),
    "declared": declared,
    "six tendons": lambda: segmented(1, 2, 100),
}


@pytest.mark.parametrize("kind", RUNS)
def test_a_summary_writes_each_of_its_fields(kind):
    found = summary(RUNS[kind]())
    document = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert list(document) == [field.name for field in dataclasses.fields(RunSummary)]
    assert document["rows"] == found.rows and document["hash"] == found.hash
    assert [word["text"] for word in document["cannot_tell"]] == [w.text for w in found.cannot_tell]
    assert [one["text"] for one in document["collinear"]] == [str(one) for one in found.collinear]


@pytest.mark.parametrize("kind", RUNS)
def test_the_text_of_a_summary_names_its_channels_and_frames(kind):
    found = summary(RUNS[kind]())
    text = "\n".join(sentences(found))
    assert f"{found.channels} channels, {found.rows} rows" in text
    assert f"{found.frames} frames" in text
    assert ("load 0 g" in text) == (found.load_g is not None)


@pytest.mark.parametrize(("after", "doubtful"), [(0.5, True), (0.7, True), (0.71, False)])
def test_a_refit_that_lowers_the_error_far_makes_the_model_doubtful(after, doubtful):
    report = RefitReport({"latency.delay": Number(0.2, 0.01, "s")}, 1.0, after)
    assert report.doubts_model == doubtful
    document = json.loads(json.dumps(report.to_dict()))
    assert list(document) == ["params", "before_rms_mm", "after_held_out_rms_mm"]
    assert document["params"]["latency.delay"]["value"] == 0.2
    assert document["after_held_out_rms_mm"] == after
