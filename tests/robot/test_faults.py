"""Every fault in every state: the table of docs/reference/safety.md, each cell through loop process
and terminal.
"""

import re
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from loops import LEADS_ON, PATIENCE, STATES, Loop

PAGE = Path(__file__).parents[2] / "docs/reference/safety.md"
# periods by which anything may be later than its time: two of them are the way to the servos and
# back
FEW = 8
WIRED = 3.0  # s of a poor wire at the limits of commands
TRIES = 4  # where the machine was seen to be too busy


def table():
    """Return the page's table: fault → (cause, state → cell, time)."""
    section = (
        PAGE.read_text(encoding="utf-8").split("## Every fault in every state")[1].split("\n## ")[0]
    )
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in section.splitlines()
        if line[:1] == "|"
    ]
    head, cells = [name.lower() for name in rows[0]], rows[2:]
    assert head == ["fault", "cause", *STATES, "within"]
    return {row[0]: (row[1], dict(zip(STATES, row[2:11])), row[11]) for row in cells}


TABLE = table()

BREAKS = {
    "one answer in five is lost": lambda loop: loop.bus.faults(drop=0.2),
    "one answer in twenty is damaged": lambda loop: loop.bus.faults(damage=0.05),
    "junk before one answer in five": lambda loop: loop.bus.faults(junk=0.2),
    "each answer 0.5 ms late": lambda loop: loop.bus.faults(slow=0.0005),
    "a servo is mute for a moment": lambda loop: loop.bus.damage(1, mute=True),
    "a servo is mute": lambda loop: loop.bus.damage(1, mute=True),
    "each answer 0.1 s late": lambda loop: loop.bus.faults(slow=0.1),
    "a servo resets": lambda loop: loop.bus.reset(1),
    "no power on the bus": lambda loop: loop.bus.faults(unpowered=True),
    "a servo shuts down: overload error": lambda loop: loop.bus.fail(1, 0x20),
    "a servo draws more than its cap": lambda loop: (
        loop.bus.burden(0, 14.0),
        loop.bus.damage(0, uncapped=True),
    ),
    "the finger is blocked": lambda loop: (loop.bus.damage(0, jammed=True), back(loop)),
    "supply too low": lambda loop: loop.bus.supply(0, 2.9),
    "too hot": lambda loop: loop.bus.heat(0, 69.0),
    "an encoder stands": lambda loop: (loop.bus.damage(0, stuck=True), back(loop)),
    "a turn is lost": lambda loop: loop.bus.lose_turn(0),
    "two ids are exchanged": lambda loop: loop.bus.swap(0, 1),
    "a tendon is torn": lambda loop: (loop.bus.damage(0, torn=True), back(loop)),
    "a tendon is wound the other way": lambda loop: (loop.bus.damage(0, reversed=True), back(loop)),
    "the computer freezes, and goes on": lambda loop: loop.process.send_signal(signal.SIGSTOP),
    "the port is unplugged": lambda loop: loop.bus.unplug(),
}


WIRE = list(BREAKS)[:4]  # they leave nothing behind


def back(loop):
    """Move to the other side, if the state follows commands."""
    loop.command = (-1.0, -1.0)


@pytest.fixture(scope="module", params=STATES)
def loop_in_state(request):
    """Give a state and a function to get its loop, in that state; two loops take turns, one is led
    there while the other is broken."""
    state, stop = request.param, request.param == "safe_stop"

    def led(loop):
        """Lead it there, again where it ended; one that releases tension is stopped on request."""
        for left in reversed(range(TRIES)):
            try:
                if loop is None or loop.ended:
                    if loop is not None:
                        loop.close()
                    # Slow homewards, so that there is time for something to happen on the way.
                    loop = Loop(slew=1300.0 if stop else 2000.0)
                else:
                    loop.restore()
                loop.bring("engaged" if stop else state)
                return loop
            except AssertionError:
                loop.close()
                loop = None
                if not left:
                    raise

    with ThreadPoolExecutor(1) as worker:
        now, next_one = None, worker.submit(led, None)

        def loop():
            nonlocal now, next_one
            if (
                now is not None
                and now.untouched
                and not now.ended
                and now.state == state
                and not stop
            ):
                return now
            before, now = now, next_one.result()
            next_one = worker.submit(led, before)
            if now.state != ("engaged" if stop else state):  # a busy machine ended it meanwhile
                now.restore()
                now.bring(state)
            elif stop:
                now.reach("stop", "safe_stop")
            return now

        yield state, loop
        for left in (now, next_one.result()):
            if left is not None:
                left.close()


def seconds(text, loop):
    """Return a time of the table: a sum of limits by name, and of seconds."""
    parts = [part.strip(" `") for part in text.split("+")]
    return sum(
        loop.path
        if part == "path"
        else float(part[:-2])
        if part.endswith(" s")
        else loop.limits[part]
        for part in parts
    )


def look(loop, state):
    """Return for how long (s) nothing must happen where nothing should: as long as the slowest
    reaction there takes.
    """
    slowest = max(
        seconds(within, loop)
        for _, cells, within in TABLE.values()
        if within and cells[state] != "–"
    )
    return slowest + FEW * loop.limits["period"]


def goes_on(loop, state, begin):
    """Prove that nothing happens, by the loop's own clock."""
    until = begin + look(loop, state)
    assert loop.wait(lambda: loop.ended or loop.reports[-1]["t"] >= until)
    away = [report["state"] for report in loop.changes(begin, state)]
    assert away in ([], ["ready"] if state == "safe_stop" else []), "it does not go on"
    assert not loop.ended, "it does not go on"


def changes(loop, state, begin, cause, wanted, within):
    """Prove that the next changes are to the states `wanted`, because of `cause`, in its time since
    the fault.

    By the loop's clock: a report names its period. Periods that it could not have are
    reported too.
    """
    struck, overruns = time.monotonic(), loop.reports[-1]["overruns"]
    loop.wait(lambda: len(loop.changes(begin, state)) >= len(wanted) or loop.ended)
    found = loop.changes(begin, state)[: len(wanted)]
    causes = ["late" if one == "hold" else cause for one in wanted]
    assert [(one["state"], one["cause"]) for one in found] == list(zip(wanted, causes)), (
        loop.reports[-1]
    )
    late = FEW + loop.reports[-1]["overruns"] - overruns
    assert found[-1]["t"] - struck <= within + late * loop.limits["period"], "too late"
    assert [one["torque"] for one in found] == [one in ("hold", "safe_stop") for one in wanted]


def without_torque(loop):
    """Wait until no servo that hears has torque."""
    until = time.monotonic() + PATIENCE
    while any(on for _, on, *_ in loop.bus.state()[1][:1]):
        assert time.monotonic() < until
        time.sleep(0.01)


def reported(get, check):
    """Check, and once more where it fails on a machine that was too busy meanwhile to be sure
    (`Loop.busy`).
    """
    for left in reversed(range(TRIES)):
        loop = get()
        begin = time.monotonic()
        loop.untouched = False
        try:
            return check(loop, begin)
        except AssertionError:
            if not left or not loop.busy(begin):
                raise
    return None


@pytest.mark.parametrize("fault", TABLE)
def test_reaction(loop_in_state, fault):
    state, get = loop_in_state
    reported(get, lambda loop, begin: reacts(loop, state, begin, fault, fault))


# What reacts, in place of what does not: the cells of the second must not hold for the first.
EXCHANGED = [
    (state, broken, quiet)
    for broken, quiet in (
        ("the finger is blocked", "a tendon is torn"),
        ("a servo draws more than its cap", "one answer in five is lost"),
    )
    for state in STATES
    if TABLE[broken][1][state] != "–"
] + [
    ("ready", "a servo is mute", "each answer 0.5 ms late"),
    ("hold", "a servo is mute", "a tendon is torn"),
]


@pytest.mark.parametrize("loop_in_state, broken, quiet", EXCHANGED, indirect=["loop_in_state"])
def test_a_cell_of_nothing_does_not_hold_where_something_happens(loop_in_state, broken, quiet):
    state, get = loop_in_state

    def caught(loop, begin):
        with pytest.raises(AssertionError, match="it does not go on"):
            reacts(loop, state, begin, quiet, broken)

    reported(get, caught)


def reacts(loop, state, begin, fault, broken):
    """Prove the cell of `fault` where `broken` is what happens."""
    cause, cells, within = TABLE[fault]
    cell = cells[state]
    BREAKS[broken](loop)
    if fault == "the computer freezes, and goes on":
        return frozen(loop, state, cell, cause, seconds(within, loop))
    if fault == "a servo is mute for a moment":
        return briefly(loop, state, cell, begin)
    if cell == "–":
        goes_on(loop, state, begin)
        loop.bus.faults()
        loop.untouched = fault in WIRE
        return None
    if cell == "denies":
        return denies(
            loop, state, cause, loop.limits["late"] if cause == "silent" else seconds(within, loop)
        )
    *parts, last = cell.split(" → ")
    wanted = [part.lower() for part in [*parts, last] if part != "ends"]
    if wanted:
        changes(loop, state, begin, cause, wanted, seconds(within, loop))
    if last == "ends":
        assert loop.wait(lambda: loop.ended), "it does not end"
        assert loop.ended["ended"] == "port"
        return None
    if last == "SAFE_STOP":
        assert loop.wait(lambda: loop.state == "fault"), "slack at last"
    return without_torque(loop)


def denies(loop, state, cause, within):
    """Prove that what leads on is denied from that time on, because of `cause`."""
    begin = time.monotonic() + within + FEW * loop.limits["period"]
    assert loop.wait(lambda: loop.reports[-1]["t"] >= begin)
    known = (
        ("trouble(late)", "trouble(silent)")
        if cause == "silent"
        else (f"trouble({cause})", "outside")
    )
    until = time.monotonic() + PATIENCE
    # On a busy machine an answer may be late besides.
    while (said := loop.ask(LEADS_ON[state])) not in known and time.monotonic() < until:
        assert said is not None, "it is allowed"
        time.sleep(0.01)
    assert said in known and loop.state == state


def briefly(loop, state, cell, begin):
    """A servo is silent for longer than `late` and less than `silent`."""
    late = loop.limits["late"]
    if cell == "–":
        time.sleep(1.2 * late)
    else:
        assert loop.wait(lambda: loop.changes(begin, state))
    loop.bus.damage(1, mute=False)
    assert time.monotonic() - begin < 0.8 * loop.limits["silent"], "this test was not quick enough"
    if cell == "–":
        return goes_on(loop, state, begin)
    assert cell == "HOLD → ENGAGED" and loop.wait(lambda: len(loop.changes(begin, state)) > 1)
    found = loop.changes(begin, state)
    assert [(report["state"], report["cause"]) for report in found] == [
        ("hold", "late"),
        ("engaged", "none"),
    ]
    assert found[0]["t"] - begin <= late + FEW * loop.limits["period"]
    return None


def frozen(loop, state, cell, cause, within):
    """The loop's process stands still, and no supervisor rescues it; then it goes on."""
    begin = time.monotonic()
    try:
        if cell.startswith("stands"):
            while not all(tripped for _, _, tripped, _ in loop.bus.state()[1]):
                assert time.monotonic() - begin < PATIENCE, "the watchdogs do not trip"
                time.sleep(0.002)
            took, at = time.monotonic() - begin, loop.angles()
            assert took <= within + FEW * loop.limits["period"], "they trip too late"
            time.sleep(0.03)  # with that it has stood for less than `silent`
            assert all(on for _, on, *_ in loop.bus.state()[1]), "they hold"
            assert loop.angles() == pytest.approx(at, abs=1.0), "they stand"
        else:
            time.sleep(0.4)
    finally:
        begin = time.monotonic()
        loop.process.send_signal(signal.SIGCONT)
    if cell.startswith("stands"):
        assert loop.wait(lambda: loop.state == "fault")
        assert [one["cause"] for one in loop.changes(begin, state)] == [cause]
        return without_torque(loop)
    until = begin + look(loop, state)
    assert loop.wait(lambda: loop.ended or loop.reports[-1]["t"] >= until)
    allowed = [[]] + [[one.lower()] for one in re.findall("[A-Z]+", cell)]
    assert [report["state"] for report in loop.changes(begin, state)] in allowed
    assert not any(on for _, on, *_ in loop.bus.state()[1])
    return None


@pytest.fixture(scope="module")
def usual():
    """Give a function to get a loop at the rate and the limits that commands have, engaged."""
    loop = Loop(usual=True)

    def engaged():
        if loop.state != "engaged":
            loop.restore()
            loop.bring("engaged")
        return loop

    yield engaged
    loop.close()


@pytest.mark.parametrize("fault", WIRE)
def test_a_poor_wire_at_the_limits_of_commands_ends_nothing(usual, fault):
    """At 100 Hz five answers in a row are late, and of one in five that happens: a hold that goes
    on by itself.
    """

    def goes_on_by_itself(loop, begin):
        BREAKS[fault](loop)
        assert loop.wait(lambda: loop.ended or loop.reports[-1]["t"] >= begin + WIRED)
        loop.bus.faults()
        loop.wait(lambda: loop.state != "hold")
        found = [(report["state"], report["cause"]) for report in loop.changes(begin, "engaged")]
        assert found == len(found) // 2 * [("hold", "late"), ("engaged", "none")] and not loop.ended
        assert len(found) // 2 <= 4, "0.2 are expected"

    reported(usual, goes_on_by_itself)


def test_every_fault_and_state_is_in_the_table():
    assert list(TABLE) == list(BREAKS)
    for cause, cells, within in TABLE.values():
        assert all(cells.values()) and bool(cause) == bool(within)
