"""Time nearest points, as-rigid-as-possible steps, registration, and peers (`make bench`).

Times are processor time of a separate process with one thread, because libraries choose their
threads on loading. The Makefile installs pykdtree (LGPL) and libigl (MPL 2.0, without its copyleft
parts) for benchmarks only; a row without its peer states so. The results of both sides are compared
before timing. Pinned by tests/benches/test_benches.py.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benches.row import ratio, side_by_side
from softmap_edge import _core
from softmap_edge.alignment.register import PAPER_ROUNDS, PAPER_STRENGTH, register
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.model.bundle import builtin_model
from softmap_edge.synthetic.depth_camera import HALF

THREADS = ("RAYON_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
CLOCK = time.process_time
SHAPES, FEW = 12, 3  # registered finite-element shapes, and those of a quick run
FRAMES, DIFFERENT = 1000, 50  # frames registered in parallel, and distinct clouds among them
STEPS = 100  # local and global steps in one call
HOLD = 1e7  # strength of fixed handles
SETTLED_MM = 1e-3  # as in rust/geometry/paper.rs


def rows(quick: bool = False) -> list[dict[str, object]]:
    """Return the rows; a `quick` run omits the thousand frames and uses fewer shapes."""
    found = json.loads(alone(1, "--shapes", str(FEW if quick else SHAPES)))
    return found if quick else [*found, frames()]


def alone(threads: int, *arguments: str) -> str:
    """Run this module with `arguments` in a process with some threads; return its output."""
    command = [sys.executable, "-m", "benches.geometry", *arguments]
    root, env = Path(__file__).parents[1], os.environ | dict.fromkeys(THREADS, str(threads))
    return subprocess.run(
        command, cwd=root, env=env, check=True, stdout=subprocess.PIPE, text=True
    ).stdout


def frames() -> dict[str, object]:
    """1000 frames of 10 000 points registered in one call, on two cores and on one."""
    one, two = (float(alone(threads, "--frames", str(FRAMES))) for threads in (1, 2))
    row = ratio(
        f"registration of {FRAMES} frames on two cores", two, one, "on one core", "goal ≥ 1.7"
    )
    return row | {"value": two, "peer": one, "unit": "s"}


def truths(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return commands (K, 2) and shapes (K, N, 3) of another finger than the model's.

    It has another mesh, modulus, load and lean.
    """
    finger = Finger.builtin()
    other = finger.replace(solid=finger.solid.along(0.75), young_mpa=0.9 * finger.young_mpa)
    lean = np.array([0.4, 0.0, np.sqrt(0.84)])
    commands = np.random.default_rng(3).uniform(-11.0, 11.0, (count, 2))
    simulator = Simulator(other, template=Simulator(finger).template)
    return commands, simulator.path(commands, gravity=tuple(lean), load=tuple(0.196 * lean))


def half_clouds(shapes: np.ndarray, triangles: np.ndarray) -> list[np.ndarray]:
    """Return one cloud (10 000, 3) of each shape: half of it, from a random direction."""
    rng = np.random.default_rng(1)
    return [
        replace(HALF, views=(rng.uniform(0, 360),)).look(shape, triangles, rng) for shape in shapes
    ]


def chamfer(template: np.ndarray, cloud: np.ndarray) -> list[dict[str, object]]:
    """Time the Chamfer distance both ways with the gradient, and its peers.

    Peers are two trees, without a gradient, and torch as in a training loop.
    """

    def ours():
        return _core.chamfer(template, cloud)

    name, found = f"Chamfer {len(template)} × {len(cloud)} both ways, with gradient", ours()
    try:
        from pykdtree.kdtree import KDTree
    except ImportError:
        trees = absent(name, ours, "pykdtree", "goal ≥ 4.5, aim 6")
    else:

        def peer():
            return KDTree(cloud).query(template)[0], KDTree(template).query(cloud)[0]

        for distance, side in zip(peer(), ("to_cloud", "to_template")):
            # up to single precision
            same(f"{name}, {side}", found[side][0], distance, 2e-4)
        trees = ratio(name, *side_by_side(ours, peer, CLOCK), "pykdtree", "goal ≥ 4.5, aim 6")
    try:
        import torch
    except ImportError:
        return [trees, absent(name, ours, "torch", "goal ≥ 50")]
    points = torch.tensor(template, dtype=torch.float32, requires_grad=True)
    seen = torch.tensor(cloud, dtype=torch.float32)

    def loop():
        points.grad = None
        distance = torch.cdist(points, seen)
        (distance.min(1).values.mean() + distance.min(0).values.mean()).backward()
        return points.grad.numpy()

    same(f"{name}, gradient", found["gradient"], loop(), 1e-4)
    return [
        trees,
        ratio(
            name, *side_by_side(ours, loop, CLOCK), "torch.cdist forward + backward", "goal ≥ 50"
        ),
    ]


def arap_step(rest: np.ndarray, triangles: np.ndarray) -> dict[str, object]:
    """Time a local and a global step of a surface with moved ends.

    The ends are constraints; our time includes the factorisation.
    """
    name, height = f"ARAP local-global step, {len(rest)} vertices", rest[:, 2]
    ends = np.flatnonzero((height < height.min() + 1.0) | (height > height.max() - 1.0))
    goals = rest + [20.0, 0.0, -8.0] * (height > height.mean())[:, None]
    strength = np.zeros(len(rest))
    strength[ends] = HOLD
    surface = _core.Registration(rest, triangles.tolist(), [])

    def ours():
        return surface.deformed(goals, strength, STEPS)

    try:
        from benches.peer_igl import Handles
    except ImportError:
        row = absent(name, ours, "libigl", "goal ≥ 5")
        return row | {"value": row["value"] / STEPS}
    peer = Handles(rest, triangles.astype(np.int64), ends, STEPS)
    # Of 20 mm: a third of these cotangent weights is below 1e-3, where ours are clamped and
    # libigl's may be negative.
    same(name, ours(), peer.deformed(goals[ends]), 1.0)
    ours_s, peer_s = side_by_side(ours, lambda: peer.deformed(goals[ends]), CLOCK)
    return ratio(name, ours_s / STEPS, peer_s / STEPS, "libigl", "goal ≥ 5")


def halved(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split every triangle of a surface into four at the midpoints of its edges."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2)  # (T, 3, 2)
    edges, which = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    (a, b, c), (ab, bc, ca) = triangles.T, len(vertices) + which.reshape(-1, 3).T
    four = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.vstack([vertices, vertices[edges].mean(axis=1)]), np.vstack(
        [np.stack(each, axis=1) for each in four]
    )


def registration(model, shapes: np.ndarray, clouds: list[np.ndarray]) -> dict[str, object]:
    """Time one cloud at a time, medians over the shapes, with the vertex error.

    It is compared with the published objective by libigl.
    """

    def measured(lay) -> tuple[float, float]:
        lay(clouds[0])
        seconds, off = [], []
        for cloud, shape in zip(clouds, shapes):
            start = CLOCK()
            vertices = lay(cloud)
            seconds.append(CLOCK() - start)
            off.append(np.linalg.norm(vertices - shape, axis=1).mean())
        return float(np.median(seconds)), float(np.median(off))

    ours_s, ours_mm = measured(lambda cloud: register(model, [cloud]).vertices[0])
    name, wanted = (
        f"registration of half a cloud, {ours_mm:.2f} mm off",
        "goal ≤ 250 ms, ≤ 0.45 mm",
    )
    row = {"name": name, "value": ours_s * 1e3, "unit": "ms", "error_mm": ours_mm, "wanted": wanted}
    try:
        from benches.peer_igl import Published
    except ImportError:
        return row | {"wanted": f"{wanted}; libigl is absent"}
    peer = Published(
        model.rest,
        np.asarray(model.triangles, np.int64),
        PAPER_STRENGTH,
        PAPER_ROUNDS,
        settled_mm=SETTLED_MM,
    )
    peer_s, peer_mm = measured(peer.register)
    row |= ratio(name, ours_s, peer_s, f"libigl, eq. 1, {peer_mm:.1f} mm off", wanted)
    return row | {"peer_error_mm": peer_mm}


def absent(name: str, ours, peer: str, wanted: str) -> dict[str, object]:
    """Return a row without its peer."""
    value, _ = side_by_side(ours, ours, CLOCK)
    return {
        "name": name,
        "value": value * 1e3,
        "unit": "ms",
        "wanted": f"{wanted}; {peer} is absent",
    }


def same(what: str, ours: np.ndarray, theirs: np.ndarray, tolerance: float) -> None:
    """Raise unless both sides have the same result: otherwise a ratio has no meaning."""
    off = float(np.abs(ours - theirs).max())
    if not off <= tolerance:
        raise RuntimeError(
            f"{what}: ours and the peer's differ by {off:.3g}, allowed are {tolerance:g}"
        )


def main() -> None:
    """Print the rows as one document, or with `--frames` the time of a registration, s.

    `--frames` is the number of frames.
    """
    parser = argparse.ArgumentParser(prog="benches.geometry", description=__doc__)
    parser.add_argument("--shapes", type=int, default=SHAPES)
    parser.add_argument("--frames", type=int)
    args = parser.parse_args()
    model = builtin_model()
    rest, triangles = np.ascontiguousarray(model.rest), np.asarray(model.triangles)
    if args.frames:
        _, shapes = truths(SHAPES)
        clouds = half_clouds(
            np.resize(shapes, (min(DIFFERENT, args.frames), *shapes.shape[1:])), triangles
        )
        many = [clouds[k % len(clouds)] for k in range(args.frames)]
        start = time.perf_counter()
        register(model, many)
        print(time.perf_counter() - start)
        return
    commands, shapes = truths(args.shapes)
    clouds = half_clouds(shapes, triangles)
    template = model.prior.evaluate(commands[:1]).reshape(rest.shape)
    found = chamfer(template, clouds[0])
    found += [
        arap_step(rest, triangles),
        arap_step(*halved(rest, triangles)),
        registration(model, shapes, clouds),
    ]
    print(json.dumps(found))


if __name__ == "__main__":
    main()
