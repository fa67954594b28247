"""Peer: Exudyn's ideal rolling-disc joint on the disc of P2, implicit trapezoidal rule.

A script for a virtual environment of its own with numpy and exudyn. The last line of
its output is a JSON list, one row per problem and setting.

P2 only: Exudyn has no ideal rolling of a ball on a moving plane (P1) nor of an
ellipsoid (P3). The constraints are solved at velocity level (index 2), as suits rolling
without slip; of the rotation parameters Exudyn's default, Euler parameters, is used.
Its tolerances are the defaults: tighter ones changed the error by under 2 %.
"""

import json
import statistics
import sys
import time
from pathlib import Path

import exudyn as exu
import numpy as np
from exudyn.utilities import EulerParameters2RotationMatrix, RigidBodyInertia

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from peers.problems import GRAVITY, INITIAL, PROBLEMS, arm, end_error

STEPS = (("1e-3", 10_000), ("2e-4", 50_000))  # step [s] and how many
REPEATS, LONG = 3, 3.0  # timed runs; a run over LONG seconds is not repeated


def assembled(problem):
    """Return the system, the disc's node and its container, to be kept alive."""
    y = np.array(INITIAL[problem["name"]])
    rotation, omega = EulerParameters2RotationMatrix(y[:4]), y[4:7]
    container = exu.SystemContainer()
    system = container.AddSystem()
    disc = system.CreateRigidBody(
        inertia=RigidBodyInertia(problem["mass"], np.array(problem["inertia"])),
        referencePosition=list(problem["position"]),
        referenceRotationMatrix=rotation,
        # without slip the centre turns about the contact point
        initialVelocity=rotation @ np.cross(omega, arm(problem, y)),
        initialAngularVelocity=rotation @ omega,
        gravity=[0.0, 0.0, -GRAVITY],
        returnDict=True,
    )
    system.CreateRollingDisc(
        bodyNumbers=[system.CreateGround(), disc["bodyNumber"]],
        axisPosition=[0.0, 0.0, 0.0],
        axisVector=[0.0, 0.0, 1.0],
        discRadius=problem["surface"]["radius"],
    )
    system.Assemble()
    return system, disc["nodeNumber"], container


def settings(problem, steps):
    """Return the settings of the solver: equal steps, no output."""
    chosen = exu.SimulationSettings()
    chosen.timeIntegration.numberOfSteps = steps
    chosen.timeIntegration.endTime = problem["t_end"]
    # the default, kept explicit: zero accelerations make the error of first order
    chosen.timeIntegration.generalizedAlpha.computeInitialAccelerations = True
    chosen.timeIntegration.verboseMode = 0
    chosen.solution.file.write = False
    return chosen


def end_state(system, node):
    """Return the disc's state as the peers have it."""
    kinds = exu.OutputVariableType
    place = system.GetNodeOutput(node, kinds.Position)
    quaternion = system.GetNodeOutput(node, kinds.CoordinatesTotal)[3:]
    omega = system.GetNodeOutput(node, kinds.AngularVelocityLocal)
    return [float(v) for v in (*quaternion, *omega, *place[:2])]


def run(problem, steps):
    """Run a problem once; return the larger error [m or rad] and the wall time [s]."""
    system, node, _container = assembled(problem)
    chosen = settings(problem, steps)
    solver = exu.DynamicSolverType.TrapezoidalIndex2
    begin = time.perf_counter()
    system.SolveDynamic(chosen, solverType=solver)
    seconds = time.perf_counter() - begin
    error = end_error(problem, end_state(system, node))
    return max(error.position, error.rotation), seconds


def row(problem, step, steps):
    """Return one row of the table, its time the median of the runs."""
    error, first = run(problem, steps)
    times = [first]
    if first < LONG:
        times += [run(problem, steps)[1] for _ in range(REPEATS - 1)]
    return {
        "problem": problem["name"],
        "peer": "Exudyn trapezoidal index 2",
        "setting": f"dt {step}",
        "error": error,
        "seconds": statistics.median(times),
        "steps": steps,
    }


def main():
    """Run all settings and print the rows."""
    print(json.dumps([row(PROBLEMS["P2"], *step) for step in STEPS]))


if __name__ == "__main__":
    main()
