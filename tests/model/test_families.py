"""Effect families: the registry, and every column bank against an independent NumPy version."""

from itertools import combinations_with_replacement

import numpy as np
import pytest

from softmap_edge import _core
from softmap_edge.errors import CoreError

REGISTRY = {family["name"]: family for family in _core.families()}
GROSS_FAULTS = {"servo_swap"}  # checked before level 1
WITH_COLUMNS = [name for name, family in REGISTRY.items() if family["columns"]]
WITH_SIGNALS = [name for name, family in REGISTRY.items() if family["signals"]]


class Plain:
    """A random record of C channels at irregular times, with a warm-up and three orientations."""

    def __init__(self, channels, samples=400, seed=0):
        rng = np.random.default_rng(seed)
        self.t = np.cumsum(rng.exponential(0.05, samples))
        self.t[50] = self.t[49]  # two samples at one time
        knots = rng.uniform(-6, 6, (12, channels))
        ends = np.linspace(self.t[0], self.t[-1], 12)
        self.v = 1.5 + np.stack([np.interp(self.t, ends, knot) for knot in knots.T], axis=1)
        self.middle, self.half = 0.5 * (self.v.max(0) + self.v.min(0)), 0.5 * np.ptp(self.v, axis=0)
        self.temperature = (
            22 + 9 * (1 - np.exp(-(self.t - self.t[0]) / 8)) + 0.1 * rng.normal(size=samples)
        )
        self.orientation = np.repeat([4, -1, 7], [150, 150, samples - 300])
        self.x = (self.v - self.middle) / self.half
        self.share = (self.t - self.t[0]) / (self.t[-1] - self.t[0] + 1e-9)
        # unsorted, and beyond both ends
        self.at = rng.uniform(self.t[0] - 0.5, self.t[-1] + 0.5, 77)
        self.series = _core.Series(
            self.v, self.t, self.middle, self.half, self.temperature, self.orientation
        )

    def seen(self, columns):
        """Interpolate columns (T, n) at the capture times: (n, K)."""
        return np.stack([np.interp(self.at, self.t, column) for column in columns.T])


def spline(x, low, high, intervals):
    """Cubic B-splines (T, intervals + 3) by Cox and de Boor."""
    width = (high - low) / intervals
    knots = low + width * np.arange(-3, intervals + 4)
    x = np.clip(x, low, high - 1e-9 * (high - low))
    b = ((x[:, None] >= knots[:-1]) & (x[:, None] < knots[1:])).astype(float)
    for d in range(1, 4):
        left = (x[:, None] - knots[: -d - 1]) / (d * width) * b[:, :-1]
        b = left + (knots[d + 1 :] - x[:, None]) / (d * width) * b[:, 1:]
    return b


def play(x, width):
    y, out = x[0], []
    for value in x:
        y = min(max(y, value - width), value + width)
        out.append(y)
    return np.array(out)


def dahl(x, reach):
    """dz = dx − |dx| z / reach in closed form over each straight piece: z → ± reach."""
    z, out = 0.0, [0.0]
    for move in np.diff(x):
        fades = np.exp(-abs(move) / reach)
        z = z * fades + np.sign(move) * reach * (1.0 - fades)
        out.append(z)
    return np.array(out)


def leaking(x, t, tau):
    y, out = x[0], []
    for value, dt in zip(x, np.diff(t, prepend=t[0])):
        y = max(value, y * np.exp(-dt / tau))
        out.append(y)
    return np.array(out)


def pole(x, t, tau):
    """τ y' = x − y in closed form over each straight piece: y = x − τ s + (y₀ − x₀ + τ s) e^(−t/τ),
    s its slope.
    """
    y, out = x[0], [x[0]]
    for before, now, dt in zip(x, x[1:], np.diff(t)):
        if dt > 0:
            slope = (now - before) / dt
            y = now - tau * slope + (y - before + tau * slope) * np.exp(-dt / tau)
        out.append(y)
    return np.array(out)


def late(x, t, by):
    return np.interp(t - by, t, x)


def stack(columns):
    return np.stack(list(columns), axis=1)


def velocity(x, t):
    """The mean over 0.1 s, over its largest."""
    v = (late(x, t, -0.05) - late(x, t, 0.05)) / 0.1
    return v / np.abs(v).max()


def softer(u, half):
    below = np.maximum.accumulate(np.abs(u)) - np.abs(u)
    return stack([u * (1 - np.exp(-below / (d * half))) for d in (0.15, 0.5)] + [u * below / half])


def columns(p, name, c):
    """Columns (T, n) mm on channel c."""
    x, v, h, t = p.x[:, c], p.v[:, c], p.half[c], p.t
    others = [p.x[:, k] for k in range(p.x.shape[1]) if k != c]
    by_x = lambda b: 0.3 * h * np.concatenate([b, b * x[:, None]], axis=1)  # noqa: E731
    if name == "static map":
        return h * spline(x, -1.02, 1.02, 9)
    if name == "coupling":
        if len(others) > 2:
            return h * stack(others)
        odd = [0.5 * (5 * y**3 - 3 * y) for y in others]
        terms = [
            f
            for y, third in zip(others, odd)
            for f in (y, y**2, third, x * y, x**2 * y, x * y**2, np.abs(y), x * np.abs(y))
        ]
        return h * stack(terms) if terms else np.zeros((len(t), 0))
    if name == "memory":
        held = stack(h * (play(x, w) - x) for w in np.geomspace(0.012, 0.9, 12))
        dragged = (
            [h * (play(y, w) - y) for y in others for w in (0.08, 0.2, 0.5)]
            if len(others) < 3
            else []
        )
        slipping = [h * dahl(x, reach) for reach in np.geomspace(0.06, 0.9, 3)]
        return np.column_stack([held, held[:, 2::3] * np.abs(x)[:, None], *slipping, *dragged])
    if name == "delay":
        shifts = (-0.2, -0.1, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6)
        return stack(
            [late(v, t, by) - v for by in shifts]
            + [pole(v, t, tau) - v for tau in (0.08, 0.2, 0.5, 1.0)]
        )
    if name == "rate":
        s = velocity(x, t)
        return 0.3 * h * stack([s, s * np.abs(s), s**3, s * np.abs(x)])
    if name == "creep":
        slow = [pole(v, t, tau) - v for tau in (2, 5, 12, 30, 80, 200)]
        pulls = [(side, np.maximum(side * v, 0.0)) for side in (1, -1)]
        cables = [
            side * (pole(p, t, tau) - p) * (p > 0) for side, p in pulls for tau in (10, 30, 90)
        ]
        stroke = np.abs(p.x).max(axis=1)
        strokes = [h * (leaking(stroke, t, tau) - stroke) for tau in (4, 12, 36)]
        return stack([*slow, *strokes, *cables])
    if name == "softening":
        return softer(v, h)
    if name == "time":
        return by_x(spline(p.share, 0, 1, 5))
    if name == "step":
        after = (p.share[:, None] > np.linspace(0.06, 0.94, 16)).astype(float)
        return np.column_stack([by_x(after), 0.3 * h * after * x[:, None] ** 2])
    if name == "temperature":
        z = (p.temperature - p.temperature.mean()) / np.ptp(p.temperature)
        behind = [f for tau in (30, 100) for f in (pole(z, t, tau), pole(z, t, tau) * x)]
        crept = [z * (pole(x, t, tau) - x) for tau in (5, 30)]
        one = np.ones_like(z)
        return h * stack(
            [
                z,
                z * x,
                z**2 * x,
                z * x * np.abs(x),
                z * x**2,
                z**2,
                0.3 * one,
                0.3 * x,
                *behind,
                *crept,
            ]
        )
    if name == "load":
        e = (p.orientation[:, None] == [4, 7]).astype(float)
        return 0.3 * h * np.concatenate([e, e * x[:, None], e * x[:, None] ** 2], axis=1)
    raise KeyError(name)


def signals(p, name, c, wide):
    """Signals (T, n) in half ranges of channel c."""
    x, t = p.x[:, c], p.t
    if name == "memory":
        widths = np.geomspace(0.03, 1.9, 12) if wide else np.geomspace(0.012, 0.9, 12)
        return stack(
            [play(x, w) for w in widths] + [dahl(x, reach) for reach in np.geomspace(0.03, 3.0, 6)]
        )
    if name == "delay":
        shifts, poles = (0.05, 0.1, 0.2, 0.35, 0.6), (0.08, 0.2, 0.5, 1.0, 2.0)
        return stack([late(x, t, by) for by in shifts] + [pole(x, t, tau) for tau in poles])
    if name == "creep":
        return stack(pole(x, t, tau) for tau in (2, 5, 12, 30, 80))
    if name == "rate":
        s = velocity(x, t)
        return stack([s, s * np.abs(s), s**3, s * x, s * x * x, s * s])
    if name == "softening":
        return softer(x, 1.0)
    if name == "time":
        b = spline(p.share, 0, 1, 4)
        return np.concatenate([b, b * x[:, None]], axis=1)
    if name == "static map":
        return spline(x, -1.05, 1.05, 9)
    raise KeyError(name)


def modulation(p, name):
    x = p.seen(p.x)
    one = np.ones(len(p.at))
    if name in ("load", "body"):
        return np.stack([one, *(row for xc in x for row in (xc, xc**2))])
    if name == "frame":
        return one[None]
    if name == "frame drift":
        share = np.interp(p.at, p.t, p.share)
        return np.vstack([spline(share, 0, 1, 3).T, [share > k / 9 for k in range(1, 9)]])
    assert name == "static shape"
    if len(x) > 3:
        return np.stack([one, *(xc**n for xc in x for n in (1, 2, 3))])
    terms = [k for degree in range(4) for k in combinations_with_replacement(range(len(x)), degree)]
    return np.stack([np.prod(x[list(k)], axis=0) for k in terms])


def test_every_effect_is_a_member_of_a_family_and_mimics_are_mutual():
    effects = {effect["name"] for effect in _core.effects()}
    assert {m for family in REGISTRY.values() for m in family["members"]} == effects - GROSS_FAULTS
    for name, family in REGISTRY.items():
        assert family["doc"].endswith(".") and family["kind"] in (
            "static",
            "memory",
            "condition",
            "time",
        )
        assert set(family["fields"]) <= effects
        assert family["columns"] or family["fields"] or family["modes"]
        for other in family["mimics"]:
            assert other != name and name in REGISTRY[other]["mimics"], (name, other)


@pytest.mark.parametrize("channels", [1, 2, 3, 6])
@pytest.mark.parametrize("name", WITH_COLUMNS)
def test_columns_match_numpy_at_capture_times_and_at_full_rate(name, channels):
    p, bank = Plain(channels), _core.Bank(name, channels)
    wanted = [columns(p, name, c) for c in range(channels)]
    which, found = bank.columns(p.series, p.at)
    assert which.tolist() == [c for c, part in enumerate(wanted) for _ in part.T]
    size = max(float(np.abs(p.v).max()), 1.0)
    for c, part in enumerate(wanted):
        if part.size:
            # Round-off of a few hundred steps of mm.
            np.testing.assert_allclose(found[which == c], p.seen(part), atol=1e-12 * size)
    theta = np.random.default_rng(1).normal(size=len(which))
    acting = p.v.copy()
    for c, part in enumerate(wanted):
        acting[:, c] += part @ theta[which == c]
    np.testing.assert_allclose(bank.applied(p.series, theta), acting, atol=1e-11 * size)


@pytest.mark.parametrize("channels", [1, 2])
@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("name", WITH_SIGNALS)
def test_signals_match_numpy(name, wide, channels):
    p = Plain(channels, seed=2)
    which, found = _core.Bank(name, channels).signals(p.series, p.at, wide)
    wanted = [signals(p, name, c, wide) for c in range(channels)]
    assert which.tolist() == [c for c, part in enumerate(wanted) for _ in part.T]
    np.testing.assert_allclose(found, np.concatenate([p.seen(part) for part in wanted]), atol=1e-12)


@pytest.mark.parametrize("channels", [1, 2, 3, 6])
@pytest.mark.parametrize("name", REGISTRY)
def test_modulations_match_numpy(name, channels):
    p, family = Plain(channels, seed=3), REGISTRY[name]
    found = _core.Bank(name, channels).modulation(p.series, p.at)
    if not family["fields"] and not family["modes"]:
        assert found.shape == (0, len(p.at))
        return
    wanted = modulation(p, name)
    assert found.shape == wanted.shape
    # The order of the products does not matter, only that each occurs once.
    order = lambda rows: rows[np.lexsort(np.round(rows[:, :3], 9).T)]  # noqa: E731
    np.testing.assert_allclose(order(found), order(wanted), atol=1e-13)


def test_piecewise_linear_commands_give_the_same_columns_at_any_sampling():
    coarse = np.array([0.0, 0.7, 1.9, 2.0, 3.1])
    u = np.array([0.0, 3.0, -2.0, 1.0, 1.0])[:, None]
    fine = np.sort(np.concatenate([coarse, np.linspace(0, 3.1, 500)]))
    middle, half = np.zeros(1), np.ones(1)
    for name in ("delay", "creep", "memory", "softening"):
        found = []
        for t in (coarse, fine):
            series = _core.Series(np.interp(t, coarse, u[:, 0])[:, None], t, middle, half)
            # Compared at the knots only: between samples, columns are interpolated linearly.
            found.append(_core.Bank(name, 1).columns(series, coarse)[1])
        # Of creep without what single cables do: where a command crosses zero, a pull has a kink
        # between samples.
        rows = {"delay": slice(9, None), "creep": slice(None, 6)}.get(name, slice(None, 12))
        np.testing.assert_allclose(found[0][rows], found[1][rows], atol=1e-12)


def test_memory_families_vanish_at_rest():
    t = np.linspace(0, 5, 60)
    v = np.tile([2.0, -3.0], (60, 1))
    series = _core.Series(v, t, np.zeros(2), np.full(2, 4.0))
    for name in ("memory", "delay", "rate", "creep", "softening"):
        assert np.abs(_core.Bank(name, 2).columns(series, t)[1]).max() < 1e-14


@pytest.mark.parametrize(
    ("family", "left_out"), [("memory", 2 * 3), ("creep", 2 * 9), ("step", 2 * 16)]
)
def test_a_free_map_has_no_columns_that_imitate_its_error(family, left_out):
    """Single cables, other channels and even terms look like it, so only a map of few numbers shows
    them.
    """
    p, bank = Plain(2), _core.Bank(family, 2)
    free = _core.Series(p.v, p.t, p.middle, p.half, free_map=True)
    (every, full), (which, rows) = bank.columns(p.series, p.at), bank.columns(free, p.at)
    assert len(which) == len(every) - left_out
    for c in (0, 1):
        assert np.array_equal(rows[which == c], full[every == c][: np.sum(which == c)])


def test_softening_vanishes_on_first_loading():
    t = np.linspace(0, 5, 60)
    out = np.linspace(0, 8, 60)[:, None]
    series = _core.Series(out, t, np.full(1, 4.0), np.full(1, 4.0))
    assert np.abs(_core.Bank("softening", 1).columns(series, t)[1]).max() == 0.0
    back = _core.Series(out[::-1].copy(), t, np.full(1, 4.0), np.full(1, 4.0))
    assert np.abs(_core.Bank("softening", 1).columns(back, t)[1]).max() > 1.0


def test_conditions_that_do_not_vary_give_no_columns():
    p = Plain(2)
    bare = _core.Series(p.v, p.t, p.middle, p.half)
    still = _core.Series(
        p.v, p.t, p.middle, p.half, 22 + 0.001 * p.temperature, np.zeros(len(p.t), int)
    )
    always = _core.Series(p.v, p.t, p.middle, p.half, orientation=np.arange(len(p.t)) // 20)
    cases = [
        ("temperature", bare),
        ("load", bare),
        ("temperature", still),
        ("load", still),
        ("load", always),
    ]
    for name, series in cases:
        which, found = _core.Bank(name, 2).columns(series, p.at)
        assert which.shape == (0,) and found.shape == (0, len(p.at))
        assert np.array_equal(_core.Bank(name, 2).applied(series, np.zeros(0)), p.v)


def test_a_body_without_channels_has_fields_alone():
    """A beam under weight alone: nothing is commanded, and its shape is still compared."""
    t = np.linspace(0.0, 5.0, 20)
    series = _core.Series(np.zeros((20, 0)), t, np.zeros(0), np.zeros(0))
    for row in _core.families():
        bank = _core.Bank(row["name"], 0)
        which, found = bank.columns(series, t)
        assert which.shape == (0,) and found.shape == (0, 20)
        assert bank.applied(series, np.zeros(0)).shape == (20, 0)
    assert _core.Bank("load", 0).modulation(series, t).shape[0] >= 1


def test_invalid_input_is_rejected():
    p = Plain(2)
    refused = lambda match: pytest.raises(CoreError, match=match)  # noqa: E731
    with refused('unknown family "slope"; available: static map, coupling'):
        _core.Bank("slope", 2)
    with refused("the series has 2 channels, but the bank has 3"):
        _core.Bank("memory", 3).columns(p.series, p.at)
    with refused('theta has 3 weights, but family "memory" has 44 columns'):
        _core.Bank("memory", 2).applied(p.series, np.zeros(3))
    with refused('family "frame" has no signals; families with signals: static map'):
        _core.Bank("frame", 2).signals(p.series, p.at, True)
    with refused("at holds NaN at position 0"):
        _core.Bank("memory", 2).columns(p.series, np.array([np.nan]))
    with refused("half is 0 mm for channel 1"):
        _core.Series(p.v, p.t, p.middle, p.half * [1.0, 0.0])
    with refused("t falls"):
        _core.Series(p.v, p.t[::-1].copy(), p.middle, p.half)
    with refused(r"v has shape \[400, 2\], expected \(T = 399"):
        _core.Series(p.v, p.t[1:], p.middle, p.half)
    with refused("orientation has 3 numbers, expected 400"):
        _core.Series(p.v, p.t, p.middle, p.half, orientation=np.arange(3))
    with refused("T ≥ 2"):
        _core.Series(p.v[:1], p.t[:1], p.middle, p.half)


def test_orientations_of_other_runs_keep_their_columns():
    """Two runs are fitted together, each seen in one orientation: they have the same columns."""
    p, bank = Plain(2), _core.Bank("load", 2)
    codes, zeros = np.array([4, 7]), np.zeros(len(p.t), int)
    one, other = (
        _core.Series(p.v, p.t, p.middle, p.half, orientation=zeros + c, orientations=codes)
        for c in codes
    )
    (which, absent), (same, there) = bank.columns(one, p.t), bank.columns(other, p.t)
    assert (
        list(which) == list(same) == 3 * [0] + 3 * [1]
        and not absent.any()
        and there.any(axis=1).all()
    )
    assert (
        len(bank.columns(_core.Series(p.v, p.t, p.middle, p.half, orientation=zeros), p.t)[0]) == 0
    )
