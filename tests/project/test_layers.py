"""Allowed imports: each folder of the package imports only from the layers below it.

A line of `LAYERS` is a layer, highest first. Folders of one layer may import each other without a
circle. Imports in functions and those for types alone count as well.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "softmap_edge"
LAYERS = """
__main__
cli
commands
report experiment adaptation lab
diagnosis comparison calibration sweep synthetic
robot checks fem rod alignment
model logs noise
run
files geometry web
errors version
"""
LAYERS_OF_ROBOT = """
doctor emulated open
teleop drive commissioning
control
servo motion link
finding remedies
"""


def heights(layers):
    """Return the height of each folder, 0 for the lowest layer."""
    return {name: -k for k, line in enumerate(layers.strip().splitlines()) for name in line.split()}


def arrows(root, within):
    """Return who imports whom, folder by folder: `{(from, to): [modules]}`; `within` is the dotted
    name of the root.
    """
    found = {}
    for file in sorted(root.rglob("*.py")):
        source = file.relative_to(root).parts[0].removesuffix(".py")
        if source == "__init__":
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (f"{node.module}.").startswith(f"{within}."):
                inner = str(node.module)[len(within) + 1 :].split(".")[0]
                for target in {inner} if inner else {alias.name for alias in node.names}:
                    if target not in (source, "_core"):
                        found.setdefault((source, target), []).append(str(file.relative_to(root)))
    return found


@pytest.mark.parametrize(
    ("root", "within", "layers"),
    [(PACKAGE, "softmap_edge", LAYERS), (PACKAGE / "robot", "softmap_edge.robot", LAYERS_OF_ROBOT)],
)
def test_arrows_point_down_without_circles(root, within, layers):
    height, found = heights(layers), arrows(root, within)
    assert {name for pair in found for name in pair} <= set(height), "each folder has its layer"
    assert not {pair: files for pair, files in found.items() if height[pair[0]] < height[pair[1]]}
    level = {pair for pair in found if height[pair[0]] == height[pair[1]]}
    assert not circles(level), "a circle of folders within one layer"


def circles(pairs):
    """Return the pairs `(from, to)` that are left after all that lead to an end are taken away."""
    left = set(pairs)
    while ends := {b for _, b in left} - {a for a, _ in left}:
        left = {pair for pair in left if pair[1] not in ends}
    return left


def test_modules_of_commands_import_each_other_without_circles():
    """Imports in functions and those for types alone count as well."""
    assert not circles(arrows(PACKAGE / "commands", "softmap_edge.commands"))


WORKSHOP = (
    "fem rod sweep logs alignment calibration checks comparison diagnosis experiment synthetic "
    "adaptation report"
)


def test_driving_a_robot_loads_no_workshop():
    """A board imports nothing of simulation, learning, diagnosis and reports."""
    code = (
        "import pkgutil, importlib, sys, softmap_edge.robot as robot\n"
        "for module in pkgutil.walk_packages(robot.__path__, robot.__name__ + '.'):\n"
        "    importlib.import_module(module.name)\n"
        "print(*{name.split('.')[1] for name in sys.modules if name.startswith('softmap_edge.')})"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not set(loaded) & set(WORKSHOP.split())
    assert {"robot", "model", "run"} <= set(loaded)


def test_opening_a_robot_loads_few_modules():
    code = (
        "import sys; from softmap_edge import open_robot\n"
        "names = [n for n in sys.modules if n.startswith('softmap_edge.')]\n"
        "print(sum(not hasattr(sys.modules[n], '__path__') for n in names))"
    )
    count = int(
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
    )
    assert count <= 41, count
