"""The command `softmap` at a terminal of its own, and somebody who types there."""

import contextlib
import os
import pty
import subprocess
import termios
import threading
import time

from command import SOFTMAP

PATIENCE = 60.0  # s, on a busy machine


class Typist:
    """A program at a terminal of its own, and its output so far."""

    def __init__(self, folder, *words):
        self.ours, self.theirs = pty.openpty()
        self.before = termios.tcgetattr(self.theirs)
        self.process = subprocess.Popen(
            [SOFTMAP, *words],
            cwd=folder,
            stdin=self.theirs,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self._said = b""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        while more := self.process.stderr.read1(400):
            self._said += more

    @property
    def said(self):
        """Its output on standard error."""
        return self._said.decode()

    def types(self, text):
        """Type a text."""
        os.write(self.ours, text.encode())

    def holds(self, key, *whats, late):
        """Hold a key as a keyboard does, a press, 0.6 s nothing, then a repetition every 33 ms,
        until one of `whats` after the other was so, and `late` s longer.
        """
        self.types(key)
        time.sleep(0.6)
        until, left = time.monotonic() + PATIENCE, list(whats)
        while time.monotonic() < until:
            if left and left[0]():
                left.pop(0)
                until = until if left else time.monotonic() + late
            self.types(key)
            time.sleep(0.033)
        assert not left, self.said

    def until(self, what):
        """Wait until `what()`."""
        end = time.monotonic() + PATIENCE
        while not what():
            assert time.monotonic() < end and self.process.poll() is None, self.said
            time.sleep(0.01)

    def ends(self):
        """Wait for its end; its exit code."""
        code = self.process.wait(PATIENCE)
        self._reader.join(PATIENCE)
        return code


@contextlib.contextmanager
def typist(folder, *words):
    one = Typist(folder, *words)
    try:
        yield one
    finally:
        one.process.kill()
        one.process.wait()
        one.process.stdout.close()
        one._reader.join()
        one.process.stderr.close()
        os.close(one.ours)
        os.close(one.theirs)
