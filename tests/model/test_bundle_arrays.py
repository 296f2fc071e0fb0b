"""The arrays of a bundle as types: each kind is read back as it was written, and what is missing is
named.
"""

from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.files.npz import Stored
from softmap_edge.model.bundle import builtin_model
from softmap_edge.model.coverage import Coverage
from softmap_edge.model.elastic_rod import ElasticRodArrays, RodLayout
from softmap_edge.model.polynomial_rod import PolynomialRodArrays, read_rod
from softmap_edge.model.shapes import (
    BundleArrays,
    FieldArrays,
    Grid,
    ModeArrays,
    NetworkArrays,
    Nodes,
    NumbersBefore,
    PriorArrays,
    TrainedOver,
)
from softmap_edge.model.template import Template

RNG = np.random.default_rng(7)
AXES = (np.linspace(-5.0, 5.0, 4), np.linspace(-3.0, 3.0, 3))
U = RNG.uniform(-3.0, 3.0, (6, 2))


def in_modes(over, rows):
    return ModeArrays(
        over,
        RNG.normal(size=9).astype(np.float32),
        Stored.in_steps(RNG.normal(size=(2, 9)), np.zeros((2, 1)), np.int8),
        Stored(RNG.normal(size=(rows, 2)).astype(np.float32)),
    )


def elastic():
    layout = RodLayout(1, 2, (0, 0), (0, 1), (1.0, 1.0), (1.0,))
    numbers = np.array([0.0, 0.0, 1.5, 4.0, 4.0, 0.0, 0.0, 900.0, 60.0, 0, 0, 0, 0, 0, 0, 0])
    return ElasticRodArrays(layout, numbers, 0.2, tuple(range(-1, 15)))


def polynomial():
    angles, lengths = RNG.normal(scale=0.1, size=(6, 2)), RNG.uniform(9.0, 11.0, (6, 1))
    return PolynomialRodArrays(np.zeros(3), np.zeros(2), np.ones(2), 2, angles, lengths, 1e-6)


TABLE, SCATTERED = in_modes(Grid(AXES), 12), in_modes(Nodes(U, np.array([3.0, 3.0]), 3), 9)
MODEL = builtin_model()
BEFORE = TrainedOver(np.ones((3, 3)), 0.25)
PULL = Stored.in_steps(RNG.normal(size=(12, 2)), 1e-3, np.int16)
KINDS = {
    "table": (TABLE.to_npz(), lambda arrays: ModeArrays.from_npz(arrays)),
    "scattered": (SCATTERED.to_npz(), lambda arrays: ModeArrays.from_npz(arrays)),
    "elastic rod": (elastic().to_npz(), read_rod),
    "polynomial rod": (polynomial().to_npz(), read_rod),
    "coverage": (Coverage.of(U).to_npz(), lambda arrays: Coverage.from_npz(arrays, 2)),
    "fields": (MODEL.arrays.fields.to_npz(), lambda arrays: FieldArrays.from_npz(arrays)),
    "template": (Template.of(MODEL).to_npz(), lambda arrays: Template.from_npz("b", arrays)),
    "prior": (
        PriorArrays(TABLE, pull=PULL, before=BEFORE).to_npz(),
        lambda arrays: PriorArrays.from_npz(ModeArrays.from_npz(arrays), arrays),
    ),
    "network": (
        PriorArrays(NetworkArrays(b"", Grid(AXES)), pull=PULL, before=BEFORE).to_npz(),
        lambda arrays: PriorArrays.from_npz(NetworkArrays(b"", Grid.from_npz(arrays)), arrays),
    ),
    "built-in prior": (
        MODEL.arrays.prior.to_npz(),
        lambda arrays: PriorArrays.from_npz(ModeArrays.from_npz(arrays), arrays),
    ),
}


def same(one, other):
    assert sorted(one) == sorted(other)
    for name, array in one.items():
        assert (array.dtype, array.shape) == (other[name].dtype, other[name].shape), name
        np.testing.assert_array_equal(array, other[name])


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_written_is_read_back(kind):
    arrays, read = KINDS[kind]
    same(read(arrays).to_npz(), arrays)


# what earlier versions did not write, and what only some fingers have
OPTIONAL = {"free", "pulled", "intervals", "coverage_basis", "stiffness", "handles"}
OPTIONAL |= {"pull", "form_before", "error_before_mm"}


@pytest.mark.parametrize("kind", ["table", "scattered", "elastic rod", "polynomial rod"])
def test_a_missing_array_is_named(kind):
    arrays, read = KINDS[kind]
    for name in set(arrays) - OPTIONAL:
        left = {key: array for key, array in arrays.items() if key != name}
        if name.endswith("_step") or name in ("axis0", "nodes", "numbers"):
            continue  # without steps they are plain numbers; these three say which kind it is
        if name.startswith("axis"):
            with pytest.raises(SoftmapError):
                read(left).compiled()
            continue
        with pytest.raises(SoftmapError, match=f"'{name}'") as fault:
            read(left)
        assert "\n" not in str(fault.value) and len(str(fault.value)) < 200


def test_arrays_of_another_shape_are_refused():
    wrong = {
        "mean": np.zeros(8),
        "modes": np.zeros((3, 9)),
        "coefficients": np.zeros((11, 2)),
        "axis0": np.linspace(0.0, 1.0, 5),
    }
    plain = {name: array for name, array in TABLE.to_npz().items() if name != "modes_step"}
    for name, array in wrong.items():
        with pytest.raises(SoftmapError):
            ModeArrays.from_npz(plain | {name: array}).compiled()
    with pytest.raises(SoftmapError, match=r"steps \(3, 1\) of 'modes' \(2, 9\)"):
        ModeArrays.from_npz(TABLE.to_npz() | {"modes_step": np.ones((3, 1), np.float32)})
    with pytest.raises(SoftmapError, match="'power' holds 2 numbers"):
        ModeArrays.from_npz(SCATTERED.to_npz() | {"power": np.array([1, 3])})


def test_steps_lose_half_a_step_at_most():
    values = RNG.normal(size=(5, 4))
    for step, kind in ((1e-3, np.int16), (np.full((1, 4), 0.1), np.int8), (0.0, np.int16)):
        stored = Stored.in_steps(values, step, kind)
        assert stored.array.dtype == kind
        assert (np.abs(stored.values - values) <= 0.5001 * np.asarray(stored.step, float)).all()


def test_shapes_and_tensions_are_those_of_the_core():
    table = _core.Table(
        list(AXES), TABLE.coefficients.values, np.asarray(TABLE.mean, float), TABLE.modes.values
    )
    np.testing.assert_array_equal(TABLE.compiled().evaluate(U), table.evaluate(U))
    prior = PriorArrays(TABLE, pull=PULL)
    nodes = np.array([[-5.0, -3.0], [5.0, 3.0]])
    np.testing.assert_allclose(prior.tensions().evaluate(nodes), PULL.values[[0, -1]], atol=1e-9)
    assert PriorArrays(SCATTERED).tensions() is None and PriorArrays(elastic()).tensions() is None


def test_what_a_rod_was_before_is_kept_with_it():
    prior = PriorArrays(elastic(), coverage=Coverage.of(U), before=NumbersBefore(U[0], U))
    arrays = prior.to_npz()
    again = PriorArrays(
        read_rod(arrays),
        coverage=Coverage.from_npz(arrays, 2),
        before=NumbersBefore.from_npz(arrays),
    )
    same(again.to_npz(), arrays)
    assert NumbersBefore.from_npz(elastic().to_npz()) is None
    assert BundleArrays(prior).contents()["fields"] == {}


def test_rods_of_earlier_versions_are_read():
    arrays = polynomial().to_npz()
    left = {name: array for name, array in arrays.items() if name not in ("pulled", "intervals")}
    assert (read_rod(left).pulled, read_rod(left).intervals) == (False, 0)
    left = {name: array for name, array in elastic().to_npz().items() if name != "free"}
    assert read_rod(left).free == ()


def test_cables_need_what_they_are_made_of():
    fields, pull = MODEL.arrays.fields, MODEL.arrays.prior.tensions()
    assert fields.cables(pull) is not None
    assert replace(fields, stiffness=None).cables(pull) is None
    for missing in (
        fields.cables,
        replace(fields, stretch=None).cables,
        replace(fields, coefficients={}).cables,
    ):
        with pytest.raises(SoftmapError):
            missing(None if missing == fields.cables else pull)
