"""Recordings of ROS: stamps that were never set, and messages of topics that are not listed."""

import sqlite3

import numpy as np
import pytest
from containers import messages, write_db3
from recordings import write_mcap

from softmap_edge.logs.readers.cdr import Message
from softmap_edge.logs.readers.mcap_file import open_mcap
from softmap_edge.logs.readers.messages import MessageRows
from softmap_edge.logs.readers.rosbag_sqlite import open_db3


def with_stamps(change):
    """Return messages whose stamps are 0 where `change` is true of their number."""
    recorded = []
    for k, (topic, definition, message, seconds) in enumerate(messages()):
        stamp = {"sec": 0, "nanosec": 0} if change(k) else message["header"]["stamp"]
        message = message | {"header": message["header"] | {"stamp": stamp}}
        recorded.append((topic, definition, message, seconds + 0.25))
    return recorded


@pytest.mark.parametrize("change", [lambda k: k % 7 == 0, lambda k: k > 80, lambda k: True])
@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_stamps_of_zero_leave_one_clock(tmp_path, kind, change):
    path, recorded = tmp_path / f"log.{kind}", with_stamps(change)
    (write_db3 if kind == "db3" else write_mcap)(path, recorded)
    columns = (open_db3 if kind == "db3" else open_mcap)(path, "/goal")
    time, logged = (columns.numbers[:, columns.names.index(n)] for n in ("time", "log_time"))
    assert np.array_equal(time, logged)
    assert any("have no stamp (header.stamp is 0); time is the log" in n for n in columns.notes)


@pytest.mark.parametrize("first", [0.0, 0.5])
def test_the_clock_of_a_simulation_may_start_at_zero(tmp_path, first):
    rows = MessageRows(tmp_path, "/goal")
    for k in range(9):
        rows.add(Message({"header.stamp": first + 0.1 * k}), 1.9e9 + k)
    columns = rows.columns()
    assert np.allclose(columns.numbers[:, 0], first + 0.1 * np.arange(9))
    assert columns.notes == ()


@pytest.mark.parametrize("lost", [["/poses"], ["/poses", "/goal"]])
def test_messages_of_topics_that_are_not_listed_are_counted(tmp_path, lost):
    path = write_db3(tmp_path / "log.db3", messages())
    with sqlite3.connect(path) as database:
        for topic in lost[:1]:
            database.execute("DELETE FROM topics WHERE name = ?", (topic,))
        if len(lost) > 1:
            database.execute("UPDATE messages SET topic_id = 77 WHERE id % 10 = 3")
        count = database.execute(
            "SELECT count(*) FROM messages WHERE topic_id NOT IN (SELECT id FROM topics)"
        ).fetchone()[0]
    notes = open_db3(path, "/goal").notes
    assert any(n.startswith(f"{count} messages of topic_id ") for n in notes) and count
    assert ("77" in "".join(notes)) == (len(lost) > 1)
