"""Level 1 against plain NumPy: explicit columns, whitened by `Whitener.shrink`, normal equations
solved directly.
"""

import numpy as np
import pytest

from softmap_edge import _core
from softmap_edge.diagnosis.representatives import RIDGES, best_ridge
from softmap_edge.errors import CoreError
from softmap_edge.noise.noise_model import Kernel, Whitener, command_kernel
from softmap_edge.run.folds import run_folds

FORM = np.array([30.0, 4.0, 0.5, 0.0])  # model-error variance of four modes, one without any
JITTER = 1e-9  # share of the mean diagonal, as in rust/families/level.rs


class Plain:
    """Reference for `_core.Level`."""

    def __init__(self, whitener, folds, kernels):
        self.whitener, self.folds, self.kernels, self.columns = whitener, folds, kernels, {}

    def white(self, x, frames, kernel):
        return self.whitener.shrink(x[:, frames], kernel).reshape(len(x), -1)

    def joined(self, names):
        return (
            np.concatenate([self.columns[name] for name in names])
            if names
            else np.zeros((0, *self.y.shape))
        )

    def solve(self, a, y, names, ridges):
        ridge = np.concatenate([np.full(len(self.columns[n]), r) for n, r in zip(names, ridges)])
        gram = a @ a.T
        system = gram + np.diag(ridge + JITTER * np.trace(gram) / len(gram))
        return np.linalg.solve(system, a @ y[0]), np.linalg.solve(system, gram)

    def losses(self, names, ridges):
        x, y, found = self.joined(names), self.y[None], []
        for (train, test), (before, after) in zip(self.folds, self.kernels):
            left = self.white(y, test, after)[0]
            if names:
                theta, _ = self.solve(
                    self.white(x, train, before), self.white(y, train, before), names, ridges
                )
                left = left - theta @ self.white(x, test, after)
            found.append(left @ left)
        return np.array(found)

    def whole(self, names, ridges):
        every = slice(None)
        kernel = self.whitener.kernel
        a, y = (
            self.white(self.joined(names), every, kernel),
            self.white(self.y[None], every, kernel),
        )
        return self.solve(a, y, names, ridges)


def kernel_of(command, rank, strongest=50.0):
    """Return a kernel with no pair below the threshold of 1e-4 at which the core skips pairs."""
    found = command_kernel(command, np.ptp(command, axis=0))
    rank = min(rank, len(found.strength))
    return Kernel(found.basis[:, :rank], np.geomspace(strongest, 0.1, rank))


def both(frames=90, channels=2, modes=4, rank=9, seed=0, labels=None):
    """Return the core's level and the reference on the same random columns; two of three names
    share bases.
    """
    rng = np.random.default_rng(seed)
    t, command = np.sort(rng.uniform(0, 40, frames)), rng.normal(size=(frames, channels))
    folds = run_folds(t, labels)
    kernel, form = kernel_of(command, rank), FORM[:modes]
    kernels = [
        (kernel_of(command[train], rank), kernel_of(command[test], rank)) for train, test in folds
    ]
    plain = Plain(Whitener(np.eye(modes), form, kernel), folds, kernels)
    level = _core.Level(
        form,
        (kernel.basis, kernel.strength),
        [(*fold, a.basis, a.strength, b.basis, b.strength) for fold, (a, b) in zip(folds, kernels)],
    )
    slopes = rng.normal(size=(channels, frames, modes))
    for name, count in (("map", 5), ("memory", 7)):
        which = np.repeat(np.arange(channels), count)
        weight = rng.normal(size=(len(which), frames))
        level.add(name, slopes, which, weight)
        plain.columns[name] = slopes[which] * weight[:, :, None]
    field = rng.normal(size=(2, frames, modes))
    which = np.array([1, 0, 1])
    weight = rng.normal(size=(3, frames))
    level.add("body", field, which, weight)
    plain.columns["body"] = field[which] * weight[:, :, None]
    truth = rng.normal(size=len(plain.columns["memory"]))
    plain.y = np.einsum("n,nkm->km", truth, plain.columns["memory"]) + 0.3 * rng.normal(
        size=(frames, modes)
    )
    level.close(plain.y)
    return level, plain, truth


CASES = [
    dict(),
    dict(channels=1, seed=1),
    dict(channels=6, rank=20, seed=2),
    dict(modes=1, seed=3),
    dict(rank=0, seed=4),
]
CHOICES = [
    ([], []),
    (["memory"], [0.3]),
    (["body", "map"], [10.0, 1e3]),
    (["memory", "body", "map"], [0.0, 1.0, 3.0]),
]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("names", "ridges"), CHOICES)
def test_losses_weights_and_freedom_match_numpy(case, names, ridges):
    level, plain, _ = both(**case)
    wanted = plain.losses(names, ridges)
    # Round-off of sums of 360 products, in a system of condition up to 1e9.
    np.testing.assert_allclose(level.losses(names, ridges), wanted, rtol=1e-7)
    if not names:
        return
    theta, hat = plain.whole(names, ridges)
    found = level.theta(names, ridges)
    assert [len(part) for part in found] == [len(plain.columns[name]) for name in names]
    np.testing.assert_allclose(np.concatenate(found), theta, rtol=1e-6, atol=1e-9)
    first = 0
    for name, part in zip(names, found):
        df = np.trace(hat[first : first + len(part), first : first + len(part)])
        first += len(part)
        assert level.freedom(names, ridges, name) == pytest.approx(df, abs=1e-6)
        drawn = np.einsum("n,nkm->km", part, plain.columns[name])
        np.testing.assert_allclose(
            level.fitted(name, part), drawn, atol=1e-12 * np.abs(drawn).max()
        )


def test_injected_weights_are_recovered_and_another_family_does_not_explain_them():
    level, plain, truth = both()
    (theta,) = level.theta(["memory"], [1e-6])
    # Noise of 0.3 on 360 numbers, 14 weights of size 1.
    assert np.abs(theta - truth).max() < 0.2 and np.abs(truth).max() > 1
    alone, memory, other = (
        level.losses(names, [0.3] * len(names)).sum() for names in ([], ["memory"], ["map"])
    )
    assert memory < 0.1 * alone and other > 0.5 * alone


def test_frames_in_the_gap_neither_train_nor_test():
    labels = np.repeat(np.arange(18), 5)
    level, plain, _ = both(labels=labels)
    assert any(len(train) + len(test) < 90 for train, test in plain.folds)
    np.testing.assert_allclose(
        level.losses(["map"], [1.0]), plain.losses(["map"], [1.0]), rtol=1e-7
    )


def test_skipped_pairs_change_a_loss_by_at_most_1e_4():
    frames, form = 60, np.array([2.0, 1e-3])
    rng = np.random.default_rng(5)
    command = rng.normal(size=(frames, 2))
    kernel = command_kernel(command, np.ptp(command, axis=0))
    train, test = np.arange(30), np.arange(30, 60)
    half = command_kernel(command[train], np.ptp(command, axis=0))
    shares = kernel.strength[:, None] * form / (1 + kernel.strength[:, None] * form)
    assert np.any((shares > 0) & (shares < 1e-4)) and np.any(shares > 0.5)
    level = _core.Level(
        form,
        (kernel.basis, kernel.strength),
        [(train, test, half.basis, half.strength, half.basis, half.strength)],
    )
    modes = rng.normal(size=(frames, 2))
    wanted = float(np.sum(Whitener(np.eye(2), form, half).shrink(modes[test], half) ** 2))
    assert level.losses_of(modes)[0] == pytest.approx(
        wanted, abs=1e-4 * float(np.sum(modes[test] ** 2))
    )
    assert not np.isclose(wanted, np.sum(modes[test] ** 2), rtol=0.05)  # the kernel has an effect


def test_results_are_reproducible_and_do_not_depend_on_the_order_of_columns():
    level, plain, _ = both()
    again, _, _ = both()
    assert np.array_equal(
        level.losses(["map", "body"], [1.0, 2.0]), again.losses(["map", "body"], [1.0, 2.0])
    )
    level = level.fresh()
    assert level.names == []
    for name in ("body", "memory", "map"):
        x = plain.columns[name]
        level.add(name, x, np.arange(len(x)), np.ones(x.shape[:2]))
    level.close(plain.y)
    assert level.names == ["body", "memory", "map"]
    np.testing.assert_allclose(
        level.losses(["map"], [1.0]), plain.losses(["map"], [1.0]), rtol=1e-7
    )


def test_columns_and_residuals_that_come_later_give_what_fresh_ones_give():
    level, plain, _ = both()
    level.losses(["map", "body"], [1.0, 2.0])
    twice = np.repeat(plain.columns["map"][:1], 2, axis=0) * [[[1.0]], [[0.5]]]
    plain.columns["late"] = twice + plain.columns["memory"][1:3]
    level.add("late", plain.columns["late"], np.arange(2), np.ones((2, 90)))
    np.testing.assert_allclose(
        level.losses(["map", "late"], [1.0, 2.0]),
        plain.losses(["map", "late"], [1.0, 2.0]),
        rtol=1e-7,
    )
    plain.y = np.random.default_rng(9).normal(size=plain.y.shape)
    level.close(plain.y)
    np.testing.assert_allclose(
        level.losses(["late", "map"], [1.0, 2.0]),
        plain.losses(["late", "map"], [1.0, 2.0]),
        rtol=1e-7,
    )


@pytest.mark.parametrize(("names", "ridges"), CHOICES)
def test_the_least_loss_is_that_of_the_frames_that_are_fitted(names, ridges):
    level, plain, _ = both()
    every, kernel = slice(None), plain.whitener.kernel
    left = plain.white(plain.y[None], every, kernel)[0]
    if names:
        left = left - plain.whole(names, ridges)[0] @ plain.white(
            plain.joined(names), every, kernel
        )
    assert level.training_loss(names, ridges) == pytest.approx(left @ left, rel=1e-7)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", ["memory", "map", "body"])
def test_the_best_ridge_is_found_downhill(case, name):
    level, _, _ = both(**case)
    known = [other for other in ("map", "body") if other != name][:1]
    tried = {ridge: level.losses([*known, name], [1.0, ridge]).sum() for ridge in RIDGES}
    loss, ridge = best_ridge(level, known, [1.0], name)
    assert ridge == min(tried, key=tried.get) and loss.sum() == pytest.approx(tried[ridge])


def test_collinear_and_zero_columns_are_solvable():
    level, plain, _ = both()
    same = plain.columns["memory"][:1]
    level.add("twice", np.concatenate([same, same]), np.array([0, 1]), np.ones((2, 90)))
    level.add("nothing", np.zeros((1, 90, 4)), np.array([0]), np.ones((1, 90)))
    level.close(plain.y)
    one, two = level.theta(["twice"], [0.0])[0]
    assert one == pytest.approx(two, rel=1e-3)  # round-off 1e-16 over jitter 1e-9, with a margin
    assert np.all(level.theta(["nothing"], [0.0])[0] == 0.0)
    np.testing.assert_array_equal(level.losses(["nothing"], [0.0]), level.losses([], []))


def test_a_fold_without_training_frames_keeps_the_loss_of_the_residual():
    y, nobody = np.random.default_rng(0).normal(size=(5, 2)), np.arange(0)
    none, each = np.zeros((5, 0)), np.zeros(0)
    level = _core.Level(
        np.ones(2), (none, each), [(nobody, np.arange(5), none[:0], each, none, each)]
    )
    level.add("one", np.ones((1, 5, 2)), np.array([0]), np.ones((1, 5)))
    level.close(y)
    assert level.losses(["one"], [0.0])[0] == pytest.approx(np.sum(y**2), rel=1e-15)
    assert level.theta(["one"], [0.0])[0][0] == pytest.approx(y.mean(), rel=1e-8)  # jitter 1e-9


def refused(match):
    return pytest.raises(CoreError, match=match)


def test_invalid_columns_and_names_are_rejected():
    level, _, _ = both()
    ones = np.ones((1, 90))
    with refused("already exist"):
        level.add("map", np.zeros((1, 90, 4)), np.array([0]), ones)
    with refused(r"base has shape \[1, 89, 4\]"):
        level.add("new", np.zeros((1, 89, 4)), np.array([0]), ones)
    with refused(r"weight has shape \[1, 89\], expected \(n = 1, K = 90\)"):
        level.add("new", np.zeros((1, 90, 4)), np.array([0]), np.ones((1, 89)))
    with refused("which contains 1, but there are only 1 bases"):
        level.add("new", np.zeros((1, 90, 4)), np.array([1]), ones)
    with refused("which contains a negative number"):
        level.add("new", np.zeros((1, 90, 4)), np.array([-1]), ones)
    with refused("which must be a one-dimensional array of integers"):
        level.add("new", np.zeros((1, 90, 4)), np.array([0.5]), ones)
    with refused('unknown columns "creep"; available: map, memory, body'):
        level.losses(["creep"], [1.0])
    with refused("a ridge must be finite and not negative"):
        level.losses(["map"], [-1.0])
    with refused("a name may appear only once"):
        level.losses(["map", "map"], [1.0, 1.0])
    with refused("1 names and 2 ridges"):
        level.theta(["map"], [1.0, 1.0])
    with refused("not one of the fitted names"):
        level.freedom(["map"], [1.0], "body")
    with refused("theta has 2 weights"):
        level.fitted("map", np.zeros(2))
    with refused(r"residual has shape \[90, 3\]"):
        level.close(np.zeros((90, 3)))
    level = level.fresh()
    level.add("new", np.zeros((1, 90, 4)), np.array([0]), ones)
    with refused(r"call close\(residual\) first"):
        level.losses(["new"], [1.0])


def test_invalid_kernels_and_folds_are_rejected():
    basis = np.linalg.qr(np.random.default_rng(0).normal(size=(20, 3)))[0]
    half = np.linalg.qr(np.random.default_rng(1).normal(size=(10, 3)))[0]
    train, test, strength = np.arange(10), np.arange(10, 20), np.ones(3)
    fold = (train, test, half, strength, half, strength)

    two = np.ones(2)

    def level(form=two, kernel=(basis, strength), folds=(fold,)):
        return _core.Level(form, kernel, list(folds))

    level()
    with refused("not orthonormal"):
        level(kernel=(2 * basis, strength))
    with refused("fold 0, test.*not orthonormal"):
        level(folds=[(train, test, half, strength, half + 1.0, strength)])
    with refused("strength -1; strengths must not be negative"):
        level(kernel=(basis, -strength))
    with refused(r"basis has shape \[10, 3\], expected \(frames = 9"):
        level(folds=[(train[:9], test, half, strength, half, strength)])
    with refused("fold 0, test contains frame 20, but there are only 20 frames"):
        level(folds=[(train, test + 1, half, strength, half, strength)])
    with refused("form is"):
        level(form=np.array([-1.0]))
    with refused("0 folds"):
        level(folds=[])
