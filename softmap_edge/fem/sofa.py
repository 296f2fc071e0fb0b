"""Write a finger as a SofaPython3 scene: the same cells, material, clamp, gravity and tendons in another simulator.

The scene is text made from numbers only; it is compiled for its syntax before it is written and is never run here.
SOFA computes in mm, N, MPa, s and tonnes. Differences to expect, stated in the file too: its hyperelastic tetrahedra
have four nodes and lock (a 10-node mesh goes out as its corners), its hexahedra are corotational and linear in strain;
its cables go through single points, which cut into a mesh, and have no stiffness of their own.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import FingerError
from softmap_edge.fem.finger import Finger
from softmap_edge.version import __version__

_TONNES = 1e-12  # of a kg/m³, in tonnes/mm³
_GUIDES = 24  # along a tendon that is given by a formula

_SCENE = '''"""SofaPython3 scene of the finger {name}, by softmap-edge {version}. It was not run where it was written.

Needs SOFA with SofaPython3 and the plugin SoftRobots: runSofa {file}. Units: mm, N, MPa, s, tonnes.
The command of tendon t is the key of TENDONS: {meaning}. Expect differences to softmap-edge:
{cells_note}
Cables go through single points and do not stretch; in softmap-edge they are spread and have {stiffness:g} N/mm.
"""

NODES = {nodes}
CELLS = {cells}
HELD = {held}
TENDONS = {tendons}


def createScene(root):
    root.gravity = {gravity}
    root.dt = 0.1
    for plugin in {plugins}:
        root.addObject("RequiredPlugin", name=plugin)
    root.addObject("FreeMotionAnimationLoop")
    root.addObject("GenericConstraintSolver", maxIterations=1000, tolerance=1e-6)
    finger = root.addChild("finger")
    finger.addObject("EulerImplicitSolver", rayleighStiffness=0.1, rayleighMass=0.1)
    finger.addObject("SparseLDLSolver", template="CompressedRowSparseMatrixMat3x3d")
    finger.addObject("{container}", position=NODES, {key}=CELLS)
    finger.addObject("MechanicalObject", template="Vec3d")
    finger.addObject("MeshMatrixMass", massDensity={density!r}, topology="@.")
    finger.addObject({forces})
    finger.addObject("FixedProjectiveConstraint", indices=HELD)
    finger.addObject("LinearSolverConstraintCorrection")
    for name, guides in TENDONS.items():
        cable = finger.addChild(name)
        cable.addObject("MechanicalObject", position=guides)
        cable.addObject(
            "CableConstraint",
            indices=list(range(len(guides))),
            pullPoint=guides[0],
            hasPullPoint=True,
            valueType="{value}",
            value=0.0,
            minForce=0.0,
        )
        cable.addObject("BarycentricMapping")
    return root
'''


def sofa_scene(finger: Finger, file: str = "finger.py") -> str:
    """Return the text of a SofaPython3 scene of `finger`. Raises FingerError for one with regions of other moduli."""
    if finger.regions:
        raise FingerError(
            f"{finger.name}: has {len(finger.regions)} regions of another modulus, which the scene's one material "
            "cannot hold; export it without them"
        )
    mesh = finger.solid.cells([z for tendon in finger.tendons for z in tendon.ends()])
    bricks = mesh.cells.shape[1] == 8
    cells = mesh.cells if bricks else mesh.cells[:, :4]
    corners, renumbered = np.unique(cells, return_inverse=True)
    young, poisson = finger.young_mpa, finger.poisson
    mu, kappa = young / (2 * (1 + poisson)), young / (3 * (1 - 2 * poisson))
    if bricks:
        forces = f'"HexahedronFEMForceField", youngModulus={young!r}, poissonRatio={poisson!r}, method="large"'
        note = "Its hexahedra are corotational and linear in strain; in softmap-edge they are neo-Hookean."
    else:
        parameters = f"{mu!r} {kappa!r}"
        forces = f'"TetrahedronHyperelasticityFEMForceField", materialName="NeoHookean", ParameterSet="{parameters}"'
        note = "Its tetrahedra have four nodes and lock (2 to 5 mm at the tip); in softmap-edge they have ten."
    tendons = {f"tendon_{t}": _rounded(tendon.guides(_GUIDES)) for t, tendon in enumerate(finger.tendons)}
    text = _SCENE.format(
        name=repr(finger.name)[1:-1].replace('"', "'"),
        version=__version__,
        file=repr(file)[1:-1].replace('"', "'"),
        meaning="its tension in N" if finger.command_unit == "N" else "its shortening in mm",
        cells_note=note,
        stiffness=finger.cable_stiffness_n_mm,
        nodes=_rounded(mesh.nodes[corners]),
        cells=renumbered.reshape(cells.shape).tolist(),
        held=np.flatnonzero(np.isin(corners, mesh.fixed)).tolist(),
        tendons=tendons,
        gravity=[1e3 * _core.STANDARD_GRAVITY * g for g in finger.gravity],
        plugins=["SofaPython3", "SoftRobots", "Sofa.Component"],
        container="HexahedronSetTopologyContainer" if bricks else "TetrahedronSetTopologyContainer",
        key="hexahedra" if bricks else "tetrahedra",
        density=finger.density_kg_m3 * _TONNES,
        forces=forces,
        value="force" if finger.command_unit == "N" else "displacement",
    )
    compile(text, file, "exec")
    return text


def write_sofa_scene(finger: Finger, path: str | Path) -> Path:
    """Write the scene of `finger` and return its path. Raises FingerError."""
    file = Path(path)
    text = sofa_scene(finger, file.name)
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FingerError(f"{file}: cannot be written ({error}); choose another place") from None
    return file


def _rounded(points: NDArray[np.float64] | Iterable[tuple[float, float, float]]) -> list[list[float]]:
    return [[round(float(v), 6) + 0.0 for v in point] for point in points]
