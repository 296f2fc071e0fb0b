"""Keys and values of a mapping that do not exist: one error that lists the right ones and names the
nearest.
"""

from pathlib import Path

import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.logs.mapping import CONSTANTS, KEYS, LOG, parse_mapping
from softmap_edge.logs.time_keys import KEYS as TIME_KEYS
from softmap_edge.run.run import Run

MAP = """schema = "softmap.mapping/1"
[[log]]
time = { column = "t" }
command = { columns = ["a"] }
markers = { columns = [["x", "y", "z"]] }
"""
MOVED = np.array([0.0, 10.0, 20.0])[:, None, None]  # mm, by frame


def refused(text):
    with pytest.raises(RunError) as found:
        parse_mapping(text, Path("map.toml"))
    return str(found.value)


@pytest.mark.parametrize(
    ("old", "new", "near", "listed"),
    [
        ("column =", "colum =", "column", TIME_KEYS),
        ('"t" }', '"t", jump = "mend" }', "jumps", TIME_KEYS),
        ('"t" }', '"t", repeat = "drop" }', "repeated", TIME_KEYS),
        ('"t" }', '"t", offset = 1.0 }', "offset_s", TIME_KEYS),
        ('{ column = "t" }', "{ rate = 100 }", "rate_hz", TIME_KEYS),
        ("time =", "tme =", "time", LOG),
        ("time =", "skip_row = 1\ntime =", "skip_rows", LOG),
        (
            "markers = { columns",
            "markers = { colums",
            "columns",
            ("columns", "swaps", "labels", "not_seen"),
        ),
        (
            "command = { columns",
            "command = { unwarp = 4096, columns",
            "unwrap",
            ("columns", "unwrap"),
        ),
        ('"z"]] }', '"z"]], swap = "mend" }', "swaps", ("swaps",)),
        ('"z"]] }\n', '"z"]] }\n[sean]\nrate_hz = 10\n', "seen", KEYS),
        ('"z"]] }\n', '"z"]] }\n[seen]\nfast_pm = 10\n', "fast_ppm", ("clock_step",)),
        ('"z"]] }\n', '"z"]] }\n[constant]\nsigma = 0.1\n', "sigma_mm", CONSTANTS),
    ],
)
def test_a_misspelt_key_is_named_with_the_nearest_and_all_others(old, new, near, listed):
    assert old in MAP
    text = refused(MAP.replace(old, new, 1))
    assert text.endswith(f"did you mean '{near}'?") and "no key" in text
    assert all(key in text.split("there are")[1] for key in listed)


@pytest.mark.parametrize(
    ("old", "new", "near"),
    [
        ('"t" }', '"t", unit = "msec" }', "ms"),
        ('"t" }', '"t", jumps = "mnd" }', "mend"),
        ('"t" }', '"t", repeated = "drpo" }', "drop"),
        ('"z"]] }', '"z"]], swaps = "mended" }', "mend"),
    ],
)
def test_a_misspelt_value_is_named_with_the_nearest(old, new, near):
    assert refused(MAP.replace(old, new, 1)).endswith(f"did you mean '{near}'?")


@pytest.mark.parametrize("key", ["labels = ['a']", 'swaps = "mend"', 'not_seen = "keep"'])
def test_a_key_of_markers_is_refused_for_commands(key):
    assert "no key" in refused(MAP.replace("command = {", f"command = {{ {key},"))


@pytest.mark.parametrize("time", ['"None"', '"off"', '"t"', '""'])
def test_a_time_that_is_a_text_says_what_is_expected(time):
    text = refused(MAP.replace('{ column = "t" }', time))
    assert '{ column = "t" }' in text and 'time = "none"' in text


def test_kinds_are_named_in_words():
    assert "rate_hz is text '100', expected a whole number or a number" in refused(
        MAP.replace('"t" }', '"t", rate_hz = "100" }')
    )
    assert "expected a table" in refused(MAP.replace('{ column = "t" }', "5"))


@pytest.mark.parametrize("key", ["robot", "command_unit"])
@pytest.mark.parametrize(
    "text", ["a\\u001b[31m", "a\\nb", "tab\\t", "\\u202egnp", "line\\u2028line", "x" * 101]
)
def test_a_name_that_the_run_refuses_is_refused_in_the_mapping(key, text):
    fault = refused(f'{key} = "{text}"\n{MAP}')
    assert fault.startswith(f"map.toml: {key}: ") and fault.isprintable()
    assert "plain name" in fault or "101 characters, at most 100" in fault


@pytest.mark.parametrize("text", ["trunk", "Rüssel 3", "机器人", "x" * 100])
def test_a_plain_name_of_a_robot_is_kept(text):
    assert parse_mapping(f'robot = "{text}"\n{MAP}', Path("map.toml")).robot == text
    run = Run(
        t=np.arange(3.0),
        command=np.ones((3, 1)),
        markers=np.ones((3, 1, 3)) * MOVED,
        t_seen=np.arange(3.0),
        robot=text,
    )
    assert run.robot == text


@pytest.mark.parametrize("text", ["a\x1b[31m", "a\nb", "tab\t", "\u202egnp", "x" * 101])
def test_a_run_in_memory_has_the_rule_of_a_run_that_is_read(text):
    with pytest.raises(RunError, match="robot: "):
        Run(
            t=np.arange(3.0),
            command=np.ones((3, 1)),
            markers=np.ones((3, 1, 3)) * MOVED,
            t_seen=np.arange(3.0),
            robot=text,
        )


@pytest.mark.parametrize("keys", ["count = 5\nseconds = 2.0", "seconds = 1\ncount = 1"])
def test_blocks_are_cut_by_count_or_by_seconds(keys):
    text = refused(f"{MAP}[blocks]\n{keys}\n")
    assert "blocks: count = " in text and "keep one of them" in text


@pytest.mark.parametrize(
    ("gravity", "said"),
    [
        ("[0.0, 0.0, 0.0]", "has no direction"),
        ("[0.0, 0.0, 9.81]", "length 9.81"),
        ("[0.5, 0.0, 0.5]", "gravity = [0.7071, 0, 0.7071] has this direction"),
        ("[nan, 0.0, 1.0]", "expected a direction of length 1"),
        ("[inf, 0.0, 0.0]", "expected a direction of length 1"),
        ("[0.0, 1.0]", "expected a direction of length 1"),
        ("9.81", "expected a direction of length 1"),
        ('["down"]', "expected a direction of length 1"),
        ("[[0.0, 0.0, 1.0]]", "expected a direction of length 1"),
        ("[true, false, false]", "expected a direction of length 1"),
    ],
)
def test_gravity_is_a_direction(gravity, said):
    text = refused(f"{MAP}[constant]\ngravity = {gravity}\n")
    assert "constant: gravity = " in text and said in text


@pytest.mark.parametrize("gravity", ["[0, 0, 1]", "[0.7071, 0.0, -0.7071]", "[0.0, -1.0, 0.0]"])
def test_a_unit_vector_is_gravity(gravity):
    mapping = parse_mapping(f"{MAP}[constant]\ngravity = {gravity}\n", Path("map.toml"))
    assert np.linalg.norm(mapping.constants["gravity"]) == pytest.approx(1.0, abs=1e-3)
