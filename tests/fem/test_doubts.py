"""Numbers a thousand times off are doubted, with the ratio and the unit; usual and hard bodies are
not.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from softmap_edge.cli import main
from softmap_edge.errors import FingerError
from softmap_edge.fem.bodies import Block, Tapered
from softmap_edge.fem.doubts import doubts, lost_in_tendons
from softmap_edge.fem.finger import Finger, Region
from softmap_edge.fem.simulator import Simulator
from softmap_edge.fem.tendons import Tendon

CASES = Path(__file__).parents[1] / "data/meshes"
KPA = (
    "look at: young_mpa = 250 is 420 times as much as soft silicones have (0.1 to 0.6 MPa): is it "
    "in kPa? "
)
KPA += "Then write 0.25"


@pytest.mark.long
def test_the_case_is_doubted_and_its_lost_command_is_computed(tmp_path, capsys):
    assert (
        main(["build", str(CASES / "kpa.toml"), "--out", str(tmp_path / "k"), "--steps", "5"]) == 0
    )
    said = capsys.readouterr().out
    assert KPA in said
    assert (
        "look at: most of the command is lost in the stretch of the tendons: 93 %, as at 3 mm"
        in said
    )
    assert (
        main(
            [
                "model",
                "sweep",
                str(CASES / "good.toml"),
                "--out",
                str(tmp_path / "g.npz"),
                "--steps",
                "5",
                "--json",
            ]
        )
        == 0
    )
    assert json.loads(capsys.readouterr().out)["notes"] == []
    assert (
        main(
            [
                "model",
                "sweep",
                str(CASES / "kpa.toml"),
                "--out",
                str(tmp_path / "s.npz"),
                "--steps",
                "5",
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert KPA in said and "93 %" in said


def test_what_is_lost_is_what_the_body_lacks():
    """A body so stiff that it stands still: all of the command goes into the tendons; the tip shows
    what is left.
    """
    finger = Finger.load(CASES / "good.toml")
    command = np.array([[3.0]])
    moved = {}
    for young in (0.25, 25.0, 2500.0):
        changed = finger.replace(young_mpa=young)
        vertices, pull = Simulator(changed).path_and_pull(command)
        line = lost_in_tendons(changed, command, pull)
        moved[young] = np.abs(vertices[0] - Simulator(changed).rest()).max()
        lost = float(line.split("tendons: ")[1].split(" %")[0]) if line else 0.0
        assert (
            line == ""
            if young < 1
            else lost == pytest.approx(100 * (1 - moved[young] / moved[0.25]), abs=8)
        )


def finger(**changes):
    return Finger.builtin().replace(**{"bounds": (), **changes})


@pytest.mark.parametrize(
    "made, says",
    [
        (
            lambda: finger(young_mpa=120.0),
            "young_mpa = 120 is 200 times as much .*kPa. Then write 0.12",
        ),
        (lambda: finger(young_mpa=60_000.0), "in Pa. Then write 0.06"),
        (lambda: finger(young_mpa=0.00025), "400 times less than .*in GPa. Then write 0.25"),
        (lambda: finger(young_mpa=5e4), "83000 times as much"),
        (
            lambda: finger(regions=(Region(0.0003, z=(10.0, 20.0)),)),
            r"region\[0\].young_mpa = 0.0003 is .*GPa",
        ),
        (
            lambda: finger(density_kg_m3=10_700.0),
            "density_kg_m3 = 10700 is 8.2 times as much .*check its unit",
        ),
        (lambda: finger(density_kg_m3=12.0), "density_kg_m3 = 12 is 79 times less"),
        (
            lambda: finger(cable_stiffness_n_mm=9000.0),
            "stiffness_n_mm = 9000 is 90 times .*in N/m. Then write 9",
        ),
        (lambda: finger(cable_stiffness_n_mm=0.02), "is 250 times less .*in kN/mm. Then write 20"),
        (
            lambda: finger(command_range=((-0.016, 0.016), (-0.016, 0.016))),
            "range_mm reaches 0.016 mm .*are they in m",
        ),
        (
            lambda: finger(
                solid=Block((0.2, 0.2, 0.12), (2, 2, 4)),
                tendons=(),
                pairs=(),
                command_range=(),
                regions=(),
            ),
            "height of the body = 0.12 is 250 times less .*in m. Then write 120",
        ),
        (
            lambda: finger(
                tendons=(Tendon(points=((0.006, 0, 0.001), (0.006, 0, 0.1))), *finger().tendons[1:])
            ),
            r"tendon\[0\] is 0.099 mm long: are its points in m",
        ),
    ],
)
def test_what_is_far_off_is_doubted(made, says):
    import re

    lines = doubts(made())
    assert any(re.search(says, line) for line in lines), lines
    assert not any("\n" in line for line in lines)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"young_mpa": 0.02},  # the softest silicone
        {"young_mpa": 12.0},  # thermoplastic polyurethane
        {"density_kg_m3": 0.0},  # without weight
        {"density_kg_m3": 250.0},  # a foam
        {"cable_stiffness_n_mm": 1.0},  # fishing line and a belt
        {"cable_stiffness_n_mm": 1000.0},  # steel wire, stiff drive
        {"regions": (Region(3000.0, z=(100.0, 110.0)),)},  # a tip of hard plastic
        {"command_range": ((-0.5, 0.5), (-0.5, 0.5))},
    ],
)
def test_what_is_met_is_not_doubted(changes):
    assert doubts(finger(**changes)) == []
    assert isinstance(finger().solid, Tapered)


def test_commands_in_newtons_lose_nothing_in_tendons():
    pulled = finger(command_unit="N", command_range=((0.0, 5.0), (0.0, 5.0)), young_mpa=12.0)
    command = np.array([[5.0, 0.0]])
    assert lost_in_tendons(pulled, command, Simulator(pulled).path_and_pull(command)[1]) == ""
    assert doubts(pulled) == []


@pytest.mark.parametrize(
    "value, unit", [(1.07, "g/cm3"), (1.07e-3, "g/mm3"), (1.07e-6, "kg/mm3"), (1.07e-9, "t/mm3")]
)
def test_a_density_in_another_unit_names_it(value, unit):
    with pytest.raises(FingerError, match=f"looks like {unit}; multiply by 1"):
        finger(density_kg_m3=value)
