"""The gradient of the certificate of tubes made of pieces, against differences."""

from __future__ import annotations

import numpy as np
import pytest

import tubeopt
from tubeopt import ConcentricRobot, Piece, Tube
from tubeopt.physics.certificate import PARAMETERS
from tubeopt.robots.robot import resized
from tubeopt.stability.certificate import _problem, worst_case

MM = 1e-3


def turning() -> ConcentricRobot:
    """Two tubes whose planes turn against each other, so that they do better than pairs that oppose each other."""
    inner = Tube.of_pieces(
        1.2 * MM, 1.0 * MM, [Piece(25 * MM, 12.0), Piece(35 * MM, (0.0, 14.0, 20.0))], straight_length=40 * MM
    )
    return ConcentricRobot((inner, Tube(1.8 * MM, 1.5 * MM, 10 * MM, 50 * MM, 11.0)))


@pytest.mark.parametrize("name", ["example_pieces", "till_snapping_pair", "turning"])
def test_the_certificate_of_tubes_made_of_pieces_changes_as_its_gradient(name: str) -> None:
    robot = turning() if name == "turning" else tubeopt.load_robot(f"configs/robots/{name}.yaml")
    shift = robot.home_translations - 2e-3 * np.arange(1, robot.n_tubes + 1)
    result = tubeopt.certify(robot, shift)
    assert (name == "turning") == (result.margin > worst_case(_problem(robot, shift))[0] + 1e-3)
    for parameter in PARAMETERS:
        for i, tube in enumerate(robot.tubes):
            values = []
            size = 0.1 if parameter == "translation" else abs(float(getattr(tube, parameter)))
            for step in (1e-4 * size, -1e-4 * size):
                if parameter == "translation":
                    reached = robot, shift + step * np.eye(robot.n_tubes)[i]
                else:
                    reached = resized(robot, i, parameter, float(getattr(tube, parameter)) + step), shift
                values.append(tubeopt.snap_free_certificate(*reached))
            slope = (values[0] - values[1]) / (2e-4 * size)
            # The certificate also subtracts what the mesh leaves out, which its gradient does not see.
            assert result.gradient[parameter][i] == pytest.approx(slope, rel=1e-3, abs=1e-6 / size)
