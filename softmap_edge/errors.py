"""The errors of this package; each message states the fault, what is allowed, and the remedy."""

import re
from collections.abc import Iterable, Mapping
from unicodedata import category

_LEAST, _MOST = 6, 17  # printed digits of a time
_NEAR = 0.05  # of the smallest difference: rounding error of a printed time
LONGEST_WORD, LONGEST_LINE = 300, 1500  # characters of a message
_LONG_WORD = re.compile(rf"\S{{{LONGEST_WORD + 1},}}")


def printable(text: str) -> str:
    """Return `text` with non-printing characters escaped, except spaces, tabs and line ends."""
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c in "\n\t" or category(c) == "Zs" else _escape(c) for c in text
    )


def one_line(text: str) -> str:
    """Return `text` as one printable line: line ends and tabs are escaped too."""
    return printable(text.replace("\n", "\\n").replace("\r", "\\r").replace("\t", "\\t"))


def plain_line(text: str) -> str:
    """Return a sentence as one printable line, with overlong words shortened in the middle.

    It is for errors and remarks, which quote names of files, columns and topics. A path may have
    `LONGEST_WORD` characters.
    """
    return shortened(_LONG_WORD.sub(_short_word, one_line(text)), LONGEST_LINE)


def shortened(text: str, longest: int) -> str:
    """Return `text` with at most `longest` characters: an ellipsis stands for its middle."""
    if len(text) <= longest:
        return text
    tail = longest // 3
    return f"{text[: longest - tail - 1]}…{text[-tail:]}"


def _short_word(found: re.Match[str]) -> str:
    return shortened(found[0], LONGEST_WORD)


def _escape(character: str) -> str:
    units = character.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[k]:02x}{units[k + 1]:02x}" for k in range(0, len(units), 2))


class SoftmapError(Exception):
    """Base of every error a user can cause; its message is one complete, printable line."""

    def __init__(self, *args: object) -> None:
        super().__init__(*(plain_line(one) if isinstance(one, str) else one for one in args))


class RunError(SoftmapError):
    """A run file or one of its fields is not usable."""


class RecordingWarning(SoftmapError, UserWarning):
    """A recording is damaged or truncated; its intact part is read.

    `warnings.simplefilter("error", RecordingWarning)` rejects such recordings instead.
    """


class BundleError(SoftmapError):
    """A bundle folder is damaged, too new or not a bundle."""


class SweepError(SoftmapError):
    """A sweep of another simulator is not usable."""


class EffectError(SoftmapError):
    """A user-defined effect cannot be loaded, or fails."""


class ComparisonError(SoftmapError):
    """A model and a run cannot be compared."""


class AlignError(SoftmapError):
    """The frame of a run cannot be determined from its data."""


class CalibrationError(SoftmapError):
    """Servo ticks cannot be converted to commands, or a calibration is damaged."""


class RegistrationError(SoftmapError):
    """A cloud cannot be read, or does not show the finger it is registered to."""


class ReportError(SoftmapError):
    """A report cannot be written or read."""


class FingerError(SoftmapError):
    """A finger description cannot be built."""


class RobotError(SoftmapError):
    """The description of a tendon robot cannot be read, or a run belongs to another robot."""


class SimulationError(SoftmapError):
    """The requested simulation is impossible."""


class NoEquilibriumError(SimulationError):
    """The simulator found no equilibrium; the message states where, the residual, and a remedy."""


class ServoError(SoftmapError):
    """A servo or its port does not carry out a request."""


class RecordingBroken(ServoError):
    """A recording ended before the robot stopped, for example on a full disk; its start is kept."""


class SessionWarning(UserWarning):
    """The last session of a rig ended without shutdown: it was killed, or the computer stopped."""


class NoAnswer(ServoError):
    """A servo does not answer: it may be absent, or a packet was lost.

    `why` is the diagnosis, if one was made; it takes seconds and is made once.
    """

    why: str = ""


class GuardStopped(ServoError):
    """The guard ended a drive; `cause` is the guard's name for the reason."""

    cause: str = ""

    @classmethod
    def by(cls, message: str, cause: object) -> "GuardStopped":
        """Return the error with its cause."""
        fault = cls(message)
        fault.cause = str(cause)
        return fault


class PortLost(ServoError):
    """An open port is gone, closed or failed, so no servo behind it can be reached."""


class NoSuchRate(ServoError):
    """A port does not support a baud rate."""


class LimitError(ServoError):
    """A limit that the guard rejects.

    `.name` is its name in the table of limits; `.servo` is the index of the servo (from 0), None
    for a limit of the robot.
    """

    def __init__(self, text: str, name: str, servo: int | None) -> None:
        super().__init__(text)
        self.name, self.servo = name, servo


class TeleopError(SoftmapError):
    """Camera, hand or landmarks are unavailable, or a package of teleoperation is absent."""


class LabError(SoftmapError):
    """A session of the lab cannot be opened, or a request of its page is not valid."""


class LinkError(SoftmapError):
    """A key, an address or a datagram between two programs is not usable."""


class CoreError(SoftmapError, ValueError):
    """The request to the compiled core is impossible."""


def no_name(
    what: str,
    name: str,
    known: Iterable[str],
    most: int | None = None,
    also: Mapping[str, str] | None = None,
) -> str:
    """Return the error message for an unknown name, with the nearest known one.

    Args:
        what: kind of the name, such as "effect".
        name: the given name.
        known: the names that exist.
        most: how many of them are listed; None for all.
        also: further names that are not listed, each with what is suggested for it.
    """
    names = list(known)
    full = dict(also or {}) | {one: one for one in names}
    near = next((full[one] for one in nearest(name, full)), None)
    listed = ", ".join(names[:most]) + (
        f", … ({len(names)} in all)" if most is not None and len(names) > most else ""
    )
    hint = f"; did you mean '{near}'?" if near else ""
    return f"no {what} '{name:.60}'; there are {listed or 'none'}{hint}"


def nearest(name: str, known: Iterable[str], most: int = 1) -> list[str]:
    """Return the known names of most similar spelling, best first; empty if none is similar."""
    from difflib import get_close_matches

    names = {one.lower(): one for one in known}
    return [names[one] for one in get_close_matches(name.lower()[:60], names, most)]


def no_effect(name: str, known: Iterable[str]) -> str:
    """Return the error message for an unknown effect, with the nearest known one."""
    line = no_name("effect", name, known)
    return f"{line}; a file is given by an --effects of its own" if ".py" in name else line


def brief(fault: BaseException) -> str:
    """Return the message of another library's exception in one line of at most 160 characters."""
    return " ".join(str(fault).split())[:160]


def differing_times(*times: float) -> list[str]:
    """Return times (s) as texts without exponents, with enough digits to show differences."""
    ordered = sorted(set(times))
    gaps = [after - before for before, after in zip(ordered, ordered[1:])]
    if not gaps and len(times) > 1:  # show all digits that a clock may have
        return [_plain(time, _MOST - 1) for time in times]
    for digits in range(_LEAST, _MOST):
        texts = [_plain(time, digits) for time in times]
        if not gaps or all(
            abs(float(text) - time) <= _NEAR * min(gaps) for text, time in zip(texts, times)
        ):
            return texts
    return [_plain(time, _MOST) for time in times]


def _plain(time: float, digits: int) -> str:
    """Return a time with at most `digits` digits; digits before the point are never dropped."""
    if not 1e-6 < abs(time) < 1e15:
        return f"{time:.{digits}g}"
    text = f"{time:.{max(0, digits - len(str(int(abs(time)))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
