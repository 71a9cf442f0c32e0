"""Writes the tables that tests/oracle.rs compares with: Pinocchio on random states of two robots.

    python -m venv venv && venv/bin/pip install pin && venv/bin/python make_tables.py

Of each state only the outputs are stored, as little-endian f64: tau of RNEA (with rotors' inertia), C q' + g, the upper
triangle of CRBA by rows, the tool's Jacobian by rows (LOCAL_WORLD_ALIGNED), its J' q', its rotation by rows and position.
The states come from splitmix64, one stream for each robot: q, q', q'' for joint 0, 1, ... of state 0, 1, ...; a draw x in
[0, 1) gives q = lower + x (upper - lower) (-3 to 3 where there are no limits) and 2 x - 1 times 3 for speeds, 20 for
accelerations.
"""
import re
from pathlib import Path

import numpy as np
import pinocchio as pin

HERE = Path(__file__).parent
MASK = (1 << 64) - 1


def stream(seed):
    state = seed
    while True:
        state = (state + 0x9E3779B97F4A7C15) & MASK
        z = state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        z ^= z >> 31
        yield (z >> 11) * 2.0**-53


def armatures(urdf):
    """`armature` of <dynamics>, by joint: Pinocchio does not read it from a URDF."""
    found = {}
    for name, body in re.findall(r'<joint name="([^"]+)"(.*?)</joint>', urdf.read_text(), re.S):
        value = re.search(r'armature="([^"]+)"', body)
        found[name] = float(value.group(1)) if value else 0.0
    return found


def tables(urdf, tool, states, seed, held, out):
    model = pin.buildModelFromUrdf(str(urdf))
    if held:
        ids = [model.getJointId(n) for n in held]
        model = pin.buildReducedModel(model, ids, pin.neutral(model))
    rotor = armatures(urdf)
    n = model.nv
    for j in range(1, model.njoints):
        model.armature[model.joints[j].idx_v] = rotor[model.names[j]]
    data = model.createData()
    frame = model.getFrameId(tool)
    draw = stream(seed)
    rows = []
    for _ in range(states):
        q, v, a = np.zeros(model.nq), np.zeros(n), np.zeros(n)
        for j in range(1, model.njoints):
            joint = model.joints[j]
            x = next(draw)
            if joint.nq == 2:
                angle = -3 + 6 * x
                q[joint.idx_q], q[joint.idx_q + 1] = np.cos(angle), np.sin(angle)
            else:
                lower, upper = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
                q[joint.idx_q] = lower + x * (upper - lower)
            v[joint.idx_v] = 3 * (2 * next(draw) - 1)
            a[joint.idx_v] = 20 * (2 * next(draw) - 1)
        tau = pin.rnea(model, data, q, v, a).copy()
        nle = pin.nonLinearEffects(model, data, q, v).copy()
        mass = pin.crba(model, data, q).copy()
        jac = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED).copy()
        pin.forwardKinematics(model, data, q, v, np.zeros(n))
        pin.updateFramePlacement(model, data, frame)
        drift = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        place = data.oMf[frame]
        rows.append(
            np.concatenate([tau, nle, mass[np.triu_indices(n)], jac.ravel(), drift, place.rotation.ravel(), place.translation])
        )
    (HERE / out).write_bytes(np.array(rows, dtype="<f8").tobytes())
    print(out, list(model.names)[1:], len(rows[0]), "numbers a state, Pinocchio", pin.__version__)


tables(HERE / "../../assets/fr3.urdf", "fr3_fist", 1000, 1, ["fr3_finger_joint1", "fr3_finger_joint2"], "fr3.bin")
tables(HERE / "branch.urdf", "tip", 500, 2, [], "branch.bin")
