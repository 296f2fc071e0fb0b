"""Values of JSON and TOML documents that are a finite number, or not."""

from __future__ import annotations

import json
import math
import tomllib

import numpy as np
import pytest

from softmap_edge.files.atomic import finite
from softmap_edge.files.numbers import fall, mm, number, percent


@pytest.mark.parametrize("value", [0, -3, 2.5, 1e308, 10**300, np.float64(4.0)])
def test_a_finite_number_is_accepted(value):
    assert finite(value)
    assert number(value) == float(value)


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, 10**400, True, False, None, "3", [3], {"a": 3}]
)
def test_what_is_not_a_finite_number_is_rejected(value):
    assert not finite(value)
    assert number(value) is None
    assert mm(value) == percent(value) == "–"


@pytest.mark.parametrize("text", ["NaN", "Infinity", "1e999", "true", '"7"', "null"])
def test_constants_that_json_readers_accept_are_not_finite_numbers(text):
    assert not finite(json.loads(text))


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "true", '"7"', "2026-01-01"])
def test_values_of_toml_that_are_not_finite_numbers(text):
    assert not finite(tomllib.loads(f"x = {text}")["x"])


def test_the_limit_belongs_to_the_allowed_numbers():
    assert finite(5, 5) and finite(-5.0, 5)
    assert not finite(5.001, 5) and not finite(10**400, 5)


@pytest.mark.parametrize(
    ("errors", "share"),
    [((2.0, 1.0, None), 0.5), ((2.0, 1.0, 0.5), 2 / 3), ((2.0, 0.1, 0.5), 1.0), ((0.4, 0.1, 0.5), None),
     ((1.0, 2.0, 0.0), -1.0), ((1.0, math.nan, 0.0), None)],
)  # fmt: skip
def test_the_share_of_the_removable_error_is_at_most_all_of_it(errors, share):
    assert fall(*errors) == (share if share is None else pytest.approx(share))
