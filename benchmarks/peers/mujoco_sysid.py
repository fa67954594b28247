"""Peer: mujoco.sysid finds two moments of inertia of a free body from its gyro.

A script for a virtual environment of its own with ``mujoco[sysid]``. It reads a JSON
object from its input: step, duration [s], fixed [kg m^2], spin [rad/s], and
records, each with a guess and what the gyro read. The last line of its output is a JSON
list, one row per record.
"""

import json
import sys
import time

import mujoco
import numpy as np
from mujoco import sysid

# what no body can have is levelled out: a search that tries it goes on
BODY = """<mujoco><compiler balanceinertia="true"/>
<option timestep="{step!r}" integrator="RK4" gravity="0 0 0"/>
<worldbody><body name="body"><freejoint/>
<inertial pos="0 0 0" mass="1" diaginertia="{x!r} {y!r} {z!r}"/>
<site name="imu"/></body></worldbody>
<sensor><gyro name="gyro" site="imu"/></sensor></mujoco>"""
NAMES = ("x", "y")


def parameter(k, guess):
    """A moment, within bounds that leave room for guesses 30 % off."""

    def changed(spec, given):
        moments = np.array(spec.body("body").inertia)
        moments[k] = given.value[0]
        spec.body("body").inertia = moments

    span = 0.6 * guess, 1.7 * guess
    return sysid.Parameter(NAMES[k], guess, *span, modifier=changed)


def found(problem, record, counted):
    """One record's estimates, with the time that they took."""
    x, y = record["guess"]
    xml = BODY.format(step=problem["step"], x=x, y=y, z=problem["fixed"])
    spec = mujoco.MjSpec.from_string(xml)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[3:] = problem["spin"]
    start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
    read = np.array(record["values"])
    # its runs give what sensors read at a step's begin under the time of its end: the
    # record gets these times, too, or estimates are off in proportion to the step
    times = np.linspace(0.0, problem["duration"], len(read)) + problem["step"]
    ends = np.array([0.0, times[-1]])
    control = sysid.TimeSeries(ends, np.zeros((2, 0)))
    measured = sysid.TimeSeries.from_names(times, read, model)
    sequences = sysid.ModelSequences("body", spec, "record", start, control, measured)
    parameters = sysid.ParameterDict()
    for k, guess in enumerate(record["guess"]):
        parameters.add(parameter(k, guess))
    residual = sysid.build_residual_fn(models_sequences=[sequences])

    def counting(x, *given, **options):
        counted["rollouts"] += x.shape[1] if x.ndim > 1 else 1
        return residual(x, *given, **options)

    began = time.perf_counter()
    quiet = {"verbose": False}
    best, _ = sysid.optimize(parameters, counting, **quiet)
    return [float(best[n].value[0]) for n in NAMES], time.perf_counter() - began


def main():
    """Read, fit, print."""
    problem, rows = json.load(sys.stdin), []
    for record in problem["records"]:
        counted = {"rollouts": 0}
        moments, seconds = found(problem, record, counted)
        rows.append({"moments": moments, "seconds": seconds} | counted)
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
