"""The command `softmap` in a process of its own."""

import subprocess
import sys
from pathlib import Path

SOFTMAP = str(Path(sys.executable).with_name("softmap"))


def interruptible(*argv):
    """Start the command so that Ctrl-C reaches it, however the tests were started; it prints `up`
    once it begins.
    """
    # A shell starts what it puts in the background with SIGINT ignored, and children inherit that.
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from softmap_edge.cli import main; print('up', flush=True); sys.exit(main())"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code, *argv],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
