"""Names that differ in numbers only are one family; unit quaternions are recognised by their length
alone.
"""

import numpy as np
import pytest

from softmap_edge.logs.drive_roles import is_unit_quaternion
from softmap_edge.logs.numbered import numbers_in, without_numbers


@pytest.mark.parametrize(
    ("name", "bare", "numbers"),
    [("m12_x3", "m#_x#", [12, 3]), ("tip", "tip", []), ("007", "#", [7])],
)
def test_numbers_of_a_name(name, bare, numbers):
    assert without_numbers(name) == bare and numbers_in(name) == numbers
    assert without_numbers(name, "*") == bare.replace("#", "*")


def test_a_unit_quaternion_has_four_columns_and_length_one():
    turn = np.linspace(0, 2, 50)
    rows = np.stack([np.cos(turn / 2), 0 * turn, np.sin(turn / 2), 0 * turn], axis=1)
    assert is_unit_quaternion(rows)
    # missing cells do not decide
    assert is_unit_quaternion(np.vstack([np.full((3, 4), np.nan), rows]))
    assert (
        not is_unit_quaternion(1.05 * rows)
        and not is_unit_quaternion(rows[:, :3])
        and not is_unit_quaternion(rows[:1])
    )
    rows[7] *= 1.05
    assert not is_unit_quaternion(rows)
