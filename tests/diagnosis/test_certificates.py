"""Certificates: valid where nothing is hidden, strong where something is, from frames that fit
nothing.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from arm import NAMES, arm, protocol, record_run

from softmap_edge.diagnosis.certificate import LEVEL, SIZES, certificates, certified, hypotheses
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.families import FeatureBody, families
from softmap_edge.diagnosis.findings import Certificate, power
from softmap_edge.diagnosis.fit import Problem
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.outcome import Outcome
from softmap_edge.diagnosis.prepare import problem_of
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.records import Records
from softmap_edge.diagnosis.representatives import State
from softmap_edge.diagnosis.text import diagnosis_text
from softmap_edge.noise.noise_model import command_kernel
from softmap_edge.run.folds import (
    FOLDS,
    GAP,
    LABELS_A_FOLD,
    LEAST_WITHHOLDING,
    Withheld,
    run_folds,
    withheld,
)

BEGIN = np.zeros(1, np.intp)
KEPT = Withheld(np.arange(80), np.arange(80, 100), 5)


def claimed(run, names=None):
    """Return the certificates of a claim about a run, and the ratio of likelihoods on all of its
    frames.

    Without `names` the claim is the effect that fits best.
    """
    record = Record(arm(), run)
    problem = problem_of(record, NAMES)
    body, fits = FeatureBody(problem, NAMES), Fits(problem, NAMES)
    singles = [fits.get((name,)) for name in NAMES] if names is None else [fits.get(names)]
    fit = min(singles, key=lambda one: one.cost)
    loss = fits.losses(fit)[0]
    outcome = Outcome(body, fits, fits, State(body, fit), loss, loss)
    found = certified(outcome, fit, withheld(record.t_seen, record.block, record.begins))
    return found, 0.5 * (fits.null.chi2 - fit.chi2) / np.log(10.0)


def null_values(names, count, **settings):
    """Return the e-values of claims where nothing is hidden, and the ratios of likelihoods on all
    frames.
    """
    t, u = protocol(minutes=1.7)
    logs, naive = [], []
    for seed in range(count):
        found, ratio = claimed(record_run({}, seed=seed, frames=120, t=t, u=u, **settings), names)
        assert all(one.frames == 24 and one.blocks == 4 for one in found.effects.values())
        logs += [one.log10_e for one in found.effects.values()]
        naive.append(ratio)
    return 10.0 ** np.array(logs), 10.0 ** np.array(naive)


def test_e_values_are_valid_where_nothing_is_hidden():
    """The ratio on the frames that were fitted is no e-value; that on the withheld frames is: its
    mean is at most 1.

    The claim is the best of seven on all frames, for which the rule counts hypotheses; here even so
    much is not needed.
    """
    e, naive = null_values(None, 40)
    assert naive.mean() > 2.0 and naive.max() > 20.0  # choice makes evidence of nothing
    assert e.mean() + 3.0 * e.std() / np.sqrt(len(e)) < 1.0 and not np.any(e >= 20.0)


def test_each_claim_of_an_overfitted_set_is_valid():
    e, _ = null_values(("latency", "backlash", "mount"), 20)
    assert (
        len(e) == 60 and e.mean() + 3.0 * e.std() / np.sqrt(len(e)) < 1.0 and not np.any(e >= 20.0)
    )


def test_an_error_of_the_model_that_repeats_itself_is_no_evidence():
    """A static error of the stated size is the same in all blocks; laws that fit it must not be
    confirmed.
    """
    e, naive = null_values(("offset", "gain", "payload", "mount"), 30, warp=0.15, noise=0.03)
    assert np.mean(naive >= 20.0) > 0.3  # on the frames that were fitted they all seem to be there
    assert e.mean() + 3.0 * e.std() / np.sqrt(len(e)) < 1.0 and not np.any(e >= 20.0)


@pytest.mark.parametrize(
    "hidden",
    [
        {"latency.delay": 0.2},
        {"backlash.gap": 1.2},
        {"offset.shift[0]": 0.9, "offset.shift[1]": -0.9},
    ],
)
def test_hidden_effect_is_certified(hidden):
    found = diagnose(arm(), record_run(hidden, seed=5), effects=NAMES)
    (one,) = found.effects
    certificate = one.certificate
    needed = np.log10(hypotheses(len(NAMES) + len(families()), 1) / LEVEL)
    assert certificate.certified and certificate.log10_needed == pytest.approx(needed)
    assert (
        certificate.log10_e > 2.0 * needed and certificate.frames == 70 and certificate.blocks == 5
    )
    assert found.verdict == "identified" and "confirmed on the withheld blocks" in diagnosis_text(
        found.to_dict()
    )


def test_family_without_a_law_has_a_certificate():
    run = record_run({"creep.strength": 0.45, "creep.tau": 40.0}, seed=4)
    found = diagnose(arm(), run, effects=["gain", "payload", "mount"])
    assert [(f.name, f.certificate.certified) for f in found.families] == [("creep", True)]


def test_claim_that_withheld_blocks_contradict_is_not_identified():
    """The play is there in the blocks that are fitted, and gone in those that are withheld."""
    hidden, clean = ({"backlash.gap": 1.2}, {})
    run, other = record_run(hidden, seed=5), record_run(clean, seed=5)
    rows = withheld(run.t_seen, None, BEGIN).rows
    markers = run.markers.copy()
    markers[rows] = other.markers[rows]
    run = replace(run, markers=markers)
    found = diagnose(arm(), run, effects=NAMES)
    (one,) = found.effects
    assert one.name == "backlash" and one.certificate.refuted and one.certificate.log10_e < 0.0
    assert found.verdict != "identified" and one.probability < 0.8
    assert (
        "backlash is not confirmed on the withheld blocks (e-value less than 10^-6; needed"
        in found.sentence
    )


def test_e_value_is_that_of_fits_in_full():
    """Numbers of the claim fitted to the other frames, all other numbers to the withheld ones:
    without linear steps.
    """
    run = record_run({"backlash.gap": 1.2, "latency.delay": 0.2}, seed=5)
    found, _ = claimed(run, ("latency", "backlash"))
    record = Record(arm(), run)
    problem, kept = problem_of(record, NAMES), withheld(run.t_seen, None, BEGIN)
    kernel = command_kernel(record.command[kept.rows], record.spread, record.leaning[kept.rows])

    def chi2(effects, values):
        labels = record.layout(effects).labels
        modes = problem.modes(
            record.predict(effects, np.array([[values[label] for label in labels]]))[0]
        )
        return float(np.sum(problem.whitener.shrink(modes[kept.rows], kernel) ** 2))

    kernel_of_few = command_kernel(
        record.command[kept.chosen], record.spread, record.leaning[kept.chosen]
    )
    few = Problem(
        record.some(kept.chosen), problem.noise, replace(problem.whitener, kernel=kernel_of_few)
    )
    fit = few.fit(("latency", "backlash"), [Fits(problem, NAMES).get(("latency", "backlash")).x])
    least = min(
        chi2(("latency",), {"latency.delay": delay}) for delay in np.linspace(0.0, 0.5, 251)
    )
    fall = (least - chi2(fit.effects, fit.params)) / max(1.0, fit.chi2 / few.numbers)
    expected = (0.25 * fall + 0.5 * np.log(0.5)) / np.log(10.0)
    assert found.effects["backlash"].log10_e == pytest.approx(expected, rel=0.03)
    assert expected > 100.0


def test_a_search_of_more_claims_needs_more():
    """Each set of r claims among N and each member of it counts, by the share of its size."""
    assert hypotheses(54, 1) == SIZES * 54 and hypotheses(54, 2) == SIZES * 2 * 54 * 53 // 2
    assert hypotheses(10, 5) == 5 * 5 * 252
    sets = [set_ for r in range(1, SIZES + 1) for set_ in combinations(range(6), r)]
    # the level is shared out
    assert sum(len(s) / hypotheses(6, len(s)) for s in sets) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("logs", "sure"),
    [
        ([], []),
        # 100 candidates at 0.05: 2000 for one claim, 1000 each for two, 667 for three
        ([2.4], [False]),
        ([3.31], [True]),
        ([3.2, 3.1], [True, True]),
        ([3.2, 2.9], [False, False]),
        ([2.9, 5.0, 2.85], [True, True, True]),
        ([5.0, 2.9], [True, False]),
        ([-np.inf, 9.0], [False, True]),
    ],
)
def test_rule_of_e_bh(logs, sure):
    """The k claims of largest e are certified, for the largest k whose claims all reach m / (0.05
    k).
    """
    found = certificates(logs, 100, KEPT)
    assert [one.certified for one in found] == sure
    assert all((one.log10_e >= one.log10_needed) == one.certified for one in found)
    assert all((one.frames, one.blocks) == (20, 5) for one in found)


def test_rule_controls_the_false_discovery_rate():
    """Null e-values of mean 1 with the heaviest tails, with true claims: at most 0.05 of all claims
    are false.
    """
    rng = np.random.default_rng(0)
    shares = []
    for _ in range(2000):
        null = np.where(rng.uniform(size=16) < 1e-2, 100.0, 1e-9)
        found = certificates(np.log10([*null, *(4 * [1e6])]), 20, KEPT)
        false = sum(one.certified for one in found[:16])
        shares.append(false / max(1, sum(one.certified for one in found)))
    assert np.mean(shares) <= LEVEL
    assert np.mean(shares) > 0.4 * LEVEL  # and not because nothing false is ever certified


def test_blocks_of_time_and_their_gaps():
    t = np.linspace(0.0, 240.0, 350)
    kept = withheld(t, None, BEGIN)
    assert 60 <= len(kept.rows) <= 75 and kept.blocks == 5 and kept.chosen[0] == 0
    assert np.abs(t[kept.rows][:, None] - t[kept.chosen][None]).min() > GAP
    assert len(kept.chosen) + len(kept.rows) > 0.94 * len(t)
    # no more blocks than the gaps leave room for
    short = withheld(np.linspace(0.0, 30.0, 300), None, BEGIN)
    assert short.blocks == 1 and 55 <= len(short.rows) <= 62
    few = withheld(np.linspace(0.0, 240.0, LEAST_WITHHOLDING - 1), None, BEGIN)
    assert (
        not len(few.rows) and len(few.chosen) == LEAST_WITHHOLDING - 1 and "too few" in few.reason
    )
    fast = withheld(np.linspace(0.0, 3.0, 300), None, BEGIN)
    assert not len(fast.rows) and "gaps" in fast.reason


def test_labels_are_withheld_completely_and_enough_stay():
    t = np.linspace(0.0, 600.0, 400)
    labels = np.repeat(np.arange(40), 10)
    kept = withheld(t, labels, BEGIN)
    assert kept.blocks == 8 and not set(labels[kept.rows]) & set(labels[kept.chosen])
    least = LABELS_A_FOLD * FOLDS
    for count in (least, least + 2):
        labels = np.repeat(np.arange(count), 10)
        kept = withheld(np.linspace(0.0, 600.0, 10 * count), labels, BEGIN)
        assert kept.blocks == count - least
        parts = run_folds(t[kept.chosen], labels[kept.chosen])
        assert all(len(np.unique(labels[kept.chosen][test])) >= LABELS_A_FOLD for _, test in parts)


def test_several_runs_keep_their_first_frames():
    runs = [
        record_run({"backlash.gap": 1.2}, seed=seed, frames=150, other=bool(seed))
        for seed in range(2)
    ]
    record = Records(arm(), runs)
    kept = withheld(record.t_seen, record.block, record.begins)
    assert set(record.begins) <= set(kept.chosen) and len(kept.rows) > 40
    found = diagnose(arm(), runs, effects=NAMES)
    assert [e.name for e in found.effects] == ["backlash"] and found.effects[
        0
    ].certificate.certified
    assert found.effects[0].certificate.frames == len(kept.rows)


def test_short_run_is_diagnosed_completely_and_says_so():
    run = record_run({"backlash.gap": 2.0}, seed=5, frames=LEAST_WITHHOLDING - 2)
    (one,) = diagnose(arm(), run, effects=NAMES).effects
    assert one.certificate.log10_e is None and not one.certificate.refuted
    assert str(one.certificate).startswith("not tested on withheld blocks: 58 frames are too few")


def test_document_keeps_certificates_and_does_without():
    found = diagnose(arm(), record_run({"backlash.gap": 1.2}, seed=5), effects=NAMES)
    document = found.to_dict()
    again = Diagnosis.from_dict(document)
    assert again.effects[0].certificate == found.effects[0].certificate
    del document["effects"][0]["certificate"], document["families"][0]["certificate"]
    old = Diagnosis.from_dict(document)
    assert old.effects[0].certificate is None and old.effects[0] == replace(
        again.effects[0], certificate=None
    )
    assert "withheld" not in diagnosis_text(old.to_dict())


def test_certificate_in_words():
    good = Certificate(12.34, 3.0, 70, 5, True)
    assert str(good) == "confirmed on the withheld blocks (e-value more than 10^6; needed 1000)"
    assert (
        str(Certificate(0.5, 3.0, 70, 5))
        == "not confirmed on the withheld blocks (e-value 3.16; needed 1000)"
    )
    assert [power(x) for x in (-5.0, 0.0, 2.0, 5.26)] == ["10^-5", "1", "100", "10^5.3"]
    assert [power(x) for x in (-41.0, 4321.2)] == ["less than 10^-6", "more than 10^6"]
