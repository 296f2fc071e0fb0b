"""Make the sample logs of docs/learn/own_csv.md.

A finger with a hidden effect, as a CSV that a lab might write.

`python examples/make_sample_log.py FOLDER` writes sample_log.csv and sample_other.csv there: time,
two commands and six markers at 5 Hz. The finger is a simulated one on another mesh, of another
batch of silicone, with play in its tendons. The same call gives the same bytes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.run.protocol import Protocol, other_protocol, standard_protocol
from softmap_edge.synthetic.finger import Camera, Truth, hide, template

RATE_HZ = 5.0
HEIGHTS_MM = (40.0, 80.0, 110.0)  # of the markers along the body, one on each of two sides
EFFECT, SEED = "backlash", 3
CAMERA = Camera(vertex_mm=0.15)


def markers() -> list[int]:
    """Return the six vertices that carry markers: at each height the nearest to +x and to +y."""
    places = template()
    chosen = []
    for height in HEIGHTS_MM:
        ring = np.flatnonzero(np.abs(places[:, 2] - height) < 3.0)
        chosen += [int(ring[np.argmax(places[ring, axis])]) for axis in (0, 1)]
    return chosen


def hanging(protocol: Protocol) -> Protocol:
    """Return the part of a protocol before the robot is turned, with frames at an even rate."""
    turned = np.any(protocol.gravity != protocol.gravity[0], axis=1)
    end = protocol.t[np.argmax(turned)] if turned.any() else protocol.t[-1]
    rows = protocol.t < end
    seen = np.arange(0.0, end - 1.0 / RATE_HZ, 1.0 / RATE_HZ)
    return replace(
        protocol,
        t=protocol.t[rows],
        command=protocol.command[rows],
        gravity=protocol.gravity[rows],
        t_seen=seen,
        block=np.full(len(seen), "log"),
    )


def write(path: Path, truth: Truth, protocol: Protocol, seed: int) -> None:
    """Write the log of one recording."""
    chosen = markers()
    run = truth.measure(protocol, seed=seed)
    seen: NDArray[np.float64] = np.asarray(run.vertices)[:, chosen]
    command = np.stack(
        [np.interp(run.t_seen, run.t, run.command[:, c]) for c in range(run.channels)], axis=1
    )
    names = ["time_s", *(f"command_{c}_mm" for c in range(run.channels))]
    names += [f"marker_{k}_{axis}_mm" for k in range(len(chosen)) for axis in "xyz"]
    columns = np.column_stack([run.t_seen, command, seen.reshape(len(seen), -1)])
    np.savetxt(path, columns, delimiter=",", header=",".join(names), comments="", fmt="%.2f")


def main(argv: list[str] | None = None) -> int:
    """Write both logs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parent)
    args = parser.parse_args(argv)
    truth = hide([EFFECT], SEED, CAMERA)
    write(args.folder / "sample_log.csv", truth, hanging(standard_protocol(2)), 0)
    write(args.folder / "sample_other.csv", truth, hanging(other_protocol(2)), 1)
    rest = ", ".join(f"[{x:.1f}, {y:.1f}, {z:.1f}]" for x, y, z in template()[markers()])
    print(f"markers at rest, mm: [{rest}]")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
