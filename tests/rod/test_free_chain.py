"""The free numbers of a chain: their ranges come from the registry and scale with the drive."""

import numpy as np
import pytest

from softmap_edge.model.effect_info import registry
from softmap_edge.rod.memory.free_chain import FreeChain
from softmap_edge.rod.regression import Drive, Record


def driven(*halves):
    """A drive whose channels go from −half to half."""
    t = np.arange(50.0)
    u = np.outer(np.sin(t), halves) / np.abs(np.sin(t)).max()
    u[0], u[1] = -np.array(halves), halves
    return Drive(Record(u, t, t))


@pytest.mark.parametrize("halves", [(16.0,), (8.0, 8.0), (2.0, 300.0, 5.0)])
def test_ranges_in_mm_scale_with_the_drive(halves):
    chain = FreeChain.of_effects(["friction"], driven(*halves))
    factor = np.median(halves) / 16.0
    declared = {f"friction.{one.name}": one for one in registry()["friction"].parameters}
    for label, low, high in zip(chain.labels, chain.low, chain.high):
        scale = factor if declared[label].unit.startswith("mm") else 1.0
        assert low == pytest.approx(scale * declared[label].low)
        assert high == pytest.approx(scale * declared[label].high)


@pytest.mark.parametrize("halves", [(16.0,), (8.0, 4.0), (2.0, 300.0, 5.0)])
def test_a_gap_may_take_up_almost_all_motion_of_its_channel(halves):
    drive = driven(*halves)
    shared = FreeChain.of_effects(["backlash"], drive)
    assert shared.labels == ("backlash.gap",)
    assert shared.high == pytest.approx(1.95 * np.median(halves))
    split = FreeChain.of_effects(["backlash"], drive, ["backlash"])
    assert split.high == pytest.approx(1.95 * np.array(halves))
    assert split.split == ["backlash"] and shared.split == []


def test_a_declared_upper_end_in_the_unit_of_the_parameter_does_not_scale():
    for half in (1.0, 16.0, 500.0):
        chain = FreeChain.of_effects(["hysteresis"], driven(half))
        assert dict(zip(chain.labels, chain.high))["hysteresis.strength"] == 30.0


@pytest.mark.parametrize("name", ["backlash", "friction", "lag", "hysteresis"])
def test_values_and_their_places_in_the_range_are_inverse(name):
    chain = FreeChain.of_effects([name], driven(4.0, 9.0), [name])
    x = np.linspace(0.1, 0.9, len(chain.labels))
    assert chain.at(dict(zip(chain.labels, chain.values(x)))) == pytest.approx(x)
    assert chain.at({}) == pytest.approx(0.5)
