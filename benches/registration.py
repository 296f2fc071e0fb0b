"""Print the table of docs/do/registration.md.

It has the errors of fitted vertices, with the default and the published objective.

Twelve finite-element shapes of another finger than the model's (`benches.geometry.truths`) are
measured as four kinds of clouds each. The columns are median and worst of the mean distances to the
true vertices, mm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benches.geometry import SHAPES, truths
from softmap_edge.alignment.register import register
from softmap_edge.fem.build import handles_of
from softmap_edge.fem.finger import Finger
from softmap_edge.model.bundle import builtin_model
from softmap_edge.synthetic.depth_camera import FULL, HALF, HARD, TWO

HANDLES = 137
CAMERAS = {"full": FULL, "two": TWO, "half": HALF, "hard": HARD}


def main() -> None:
    """Print one row for each kind of cloud."""
    model, (_, shapes) = builtin_model(), truths(SHAPES)
    few = replace(model, handles=handles_of(Finger.builtin().replace(handles=HANDLES), model.rest))
    for kind, cameras in CAMERAS.items():
        rng = np.random.default_rng(1)
        turned = (
            replace(cameras, views=tuple(v + rng.uniform(0, 360) for v in cameras.views))
            for _ in shapes
        )
        clouds = [each.look(shape, model.triangles, rng) for each, shape in zip(turned, shapes)]
        cells = []
        for one, mode in ((model, "robust"), (model, "paper"), (few, "paper")):
            off = np.linalg.norm(register(one, clouds, mode).vertices - shapes, axis=2).mean(axis=1)
            cells.append(f"{np.median(off):6.2f} {off.max():6.2f}")
        print(f"{kind:<6}" + "   ".join(cells), flush=True)


if __name__ == "__main__":
    main()
