"""Requests of the page: what is read, and one clear error for everything else."""

import json
import struct

import numpy as np
import pytest

from softmap_edge.lab.messages import BadRequest, Request, binary, read_request, text

GOOD = {
    "id": 1,
    "do": "try",
    "run": 0,
    "frame": 3,
    "effects": ["backlash"],
    "params": {"backlash.gap": 0.4},
}


def test_a_request_is_read():
    assert read_request(json.dumps(GOOD)) == Request(
        1, "try", 0, 3, ("backlash",), {"backlash.gap": 0.4}
    )
    assert read_request('{"id": 0, "do": "state"}') == Request(0, "state")


@pytest.mark.parametrize(
    ("said", "why"),
    [(b"{}", "not binary"), ("", "not JSON"), ("[]", "JSON object"), ("[" * 5000, "not JSON"),
     ("{}", "'id'"), ('{"id": true, "do": "state"}', "'id'"), ('{"id": -1, "do": "state"}', "'id'")]
    + [(json.dumps(GOOD | change), why) for change, why in (
        ({"do": "fly"}, "no request 'fly'"), ({"do": []}, "no request"), ({"run": -1}, "'run'"),
        ({"run": "0"}, "'run'"), ({"run": "../../etc/passwd"}, "'run'"), ({"frame": 1.5}, "'frame'"),
        ({"frame": 1 << 40}, "'frame'"), ({"path": "/etc/passwd"}, "has the keys"),
        ({"effects": ["a", "a"]}, "different names"), ({"effects": [1]}, "different names"),
        ({"effects": ["x" * 300]}, "different names"), ({"effects": ["a"] * 1000}, "list"),
        ({"params": []}, "'params'"), ({"params": {"a": "1"}}, "not a number within"),
        ({"params": {"a": 1e300}}, "not a number within"), ({"params": {"a": 10**400}}, "not a number within"),
        ({"params": {"a": True}}, "not a number within"),
        ({"params": {"a": None}}, "not a number within"))],
)  # fmt: skip
def test_what_is_no_request_is_refused_with_its_reason(said, why):
    with pytest.raises(BadRequest, match=why) as refused:
        read_request(said)
    if isinstance(said, str) and said.startswith('{"id": 1'):
        assert refused.value.id == 1


def test_numbers_that_are_not_finite_are_null_and_arrays_follow_the_header():
    assert json.loads(text({"a": float("nan"), "b": [1.0, float("inf")]})) == {
        "a": None,
        "b": [1.0, None],
    }
    message = binary({"re": 4}, {"x": np.arange(6, dtype=np.float32).reshape(2, 3)})
    (length,) = struct.unpack("<I", message[:4])
    assert length % 4 == 0
    assert json.loads(message[4 : 4 + length]) == {"re": 4, "arrays": [["x", [2, 3]]]}
    np.testing.assert_array_equal(np.frombuffer(message[4 + length :], "<f4"), np.arange(6.0))
