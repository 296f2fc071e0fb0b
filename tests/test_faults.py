"""Every fault in every state: the table of docs/safety.md, each cell through the loop's process and a terminal."""

import re
import signal
import time
from pathlib import Path

import pytest
from loops import LEADS_ON, PATIENCE, STATES, Loop

PAGE = Path(__file__).parents[1] / "docs" / "safety.md"
LOOK = 0.12  # s for which nothing must happen where nothing should: two dozen periods
BUSY = 0.5  # s by which a busy machine may be late


def table():
    """Return the page's table: fault → (cause, state → cell, time)."""
    section = PAGE.read_text(encoding="utf-8").split("## Every fault in every state")[1].split("\n## ")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:1] == "|"]
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
    "a servo draws more than its cap": lambda loop: (loop.bus.burden(0, 14.0), loop.bus.damage(0, uncapped=True)),
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
def bench(request):
    """Give a state and a function to get its loop, in that state; one loop for all faults, anew where it ended."""
    loops = []

    def loop():
        if loops and loops[-1].ended:
            loops.pop().close()
        if loops and loops[-1].untouched and loops[-1].state == request.param != "safe_stop":
            return loops[-1]
        if not loops:
            # Slow homewards, so that there is time for something to happen on the way.
            loops.append(Loop(slew=1300.0 if request.param == "safe_stop" else 2000.0))
        else:
            loops[-1].restore()
        loops[-1].bring(request.param)
        return loops[-1]

    yield request.param, loop
    for left in loops:
        left.close()


def seconds(text, loop):
    """Return a time of the table: a sum of limits by name, and of seconds."""
    parts = [part.strip(" `") for part in text.split("+")]
    return sum(
        loop.path if part == "path" else float(part[:-2]) if part.endswith(" s") else loop.limits[part]
        for part in parts
    )


def goes_on(loop, state, begin):
    """Prove that nothing happens."""
    time.sleep(LOOK)
    away = [report["state"] for report in loop.changes(begin, state)]
    assert away in ([], ["ready"] if state == "safe_stop" else []), "it goes on"
    assert not loop.ended
    assert loop.reports[-1]["t"] > begin


def changes(loop, state, begin, cause, wanted, within):
    """Prove that the next changes are to the states `wanted`, because of `cause`, in its time."""
    overruns = loop.reports[-1]["overruns"]
    loop.wait(lambda: len(loop.changes(begin, state)) >= len(wanted) or loop.ended)
    found = loop.changes(begin, state)[: len(wanted)]
    causes = ["late" if one == "hold" else cause for one in wanted]
    assert [(one["state"], one["cause"]) for one in found] == list(zip(wanted, causes)), loop.reports[-1]
    late = (loop.reports[-1]["overruns"] - overruns) * loop.limits["period"]
    assert found[-1]["t"] - begin <= within + BUSY + late
    assert [one["torque"] for one in found] == [one in ("hold", "safe_stop") for one in wanted]


def without_torque(loop):
    """Wait until no servo that hears has torque."""
    until = time.monotonic() + PATIENCE
    while any(on for _, on, *_ in loop.bus.state()[1][:1]):
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.mark.parametrize("fault", TABLE)
def test_reaction(bench, fault):
    state, get = bench
    cause, cells, within = TABLE[fault]
    cell, loop = cells[state], get()
    begin = time.monotonic()
    loop.untouched = False
    BREAKS[fault](loop)
    if fault == "the computer freezes, and goes on":
        return frozen(loop, state, cell)
    if fault == "a servo is mute for a moment":
        return briefly(loop, state, cell, begin)
    if cell == "–":
        goes_on(loop, state, begin)
        loop.bus.faults()
        loop.untouched = fault in WIRE
        return None
    if cell == "denies":
        time.sleep(0.08 if cause == "silent" else seconds(within, loop) + 0.1)
        known = ("trouble(late)", "trouble(silent)") if cause == "silent" else (f"trouble({cause})", "outside")
        until = time.monotonic() + PATIENCE
        # On a busy machine an answer may be late besides.
        while (said := loop.ask(LEADS_ON[state])) not in known and time.monotonic() < until:
            assert said is not None, "it is allowed"
            time.sleep(0.01)
        assert said in known and loop.state == state
        return None
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


def briefly(loop, state, cell, begin):
    """A servo is silent for longer than `late` and less than `silent`; once more where this test was not that quick."""
    for _ in range(5):
        if cell == "–":
            time.sleep(1.2 * loop.limits["late"])
        else:
            assert loop.wait(lambda since=begin: loop.changes(since, state))
        loop.bus.damage(1, mute=False)
        silent = time.monotonic() - begin
        time.sleep(LOOK)
        if silent < 0.8 * loop.limits["silent"]:
            break
        loop.restore()
        loop.bring(state)
        begin = time.monotonic()
        loop.bus.damage(1, mute=True)
    found = [(report["state"], report["cause"]) for report in loop.changes(begin, state)]
    if cell == "–":
        return goes_on(loop, state, begin)
    assert cell == "HOLD → ENGAGED" and found == [("hold", "late"), ("engaged", "none")]
    return None


def frozen(loop, state, cell):
    """The loop's process stands still, and nobody is there to rescue; then it goes on."""
    if cell.startswith("stands"):
        until = time.monotonic() + PATIENCE
        while not all(tripped for _, _, tripped, _ in loop.bus.state()[1]):
            assert time.monotonic() < until, "the watchdogs do not trip"
            time.sleep(0.01)
        at = loop.angles()
        time.sleep(0.1)
        assert all(on for _, on, *_ in loop.bus.state()[1]), "they hold"
        assert loop.angles() == pytest.approx(at, abs=1.0), "they stand"
    else:
        time.sleep(0.4)
    begin = time.monotonic()
    loop.process.send_signal(signal.SIGCONT)
    if cell.startswith("stands"):
        assert loop.wait(lambda: loop.state == "fault")
        assert loop.reports[-1]["cause"] in ("tripped", "silent")
        return without_torque(loop)
    time.sleep(LOOK)
    allowed = [[]] + [[one.lower()] for one in re.findall("[A-Z]+", cell)]
    assert [report["state"] for report in loop.changes(begin, state)] in allowed
    assert not any(on for _, on, *_ in loop.bus.state()[1])
    return None


def test_every_fault_and_state_is_in_the_table():
    assert list(TABLE) == list(BREAKS)
    for cause, cells, within in TABLE.values():
        assert all(cells.values()) and bool(cause) == bool(within)
