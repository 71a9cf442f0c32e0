"""Replays a joint program's torques in MuJoCo, without feedback, from the start of the sweep to the contact.

    python replay_mujoco.py PROGRAM.json

Prints how far the tool ends from the program's, its speed and the angle to the program's velocity. For the built-in robot,
standing at the world's origin. Needs MuJoCo and NumPy.
"""
import json
import re
import sys
from pathlib import Path

import mujoco
import numpy as np

FRICTION_SPEED = 0.01  # as in the crate
SUB_STEPS = 5

program = json.load(open(sys.argv[1]))
urdf = (Path(__file__).parent / "../../assets/fr3.urdf").read_text()
dynamics = re.findall(r'damping="([^"]+)" friction="([^"]+)" armature="([^"]+)"', urdf)
damping, friction, armature = np.array(dynamics, dtype=float).T
options = f'<mujoco><compiler fusestatic="false"/><option timestep="{1e-3 / SUB_STEPS}" integrator="implicitfast"/></mujoco>'
text = urdf.replace('<robot name="fr3">', '<robot name="fr3">' + options)
text = re.sub(r"<collision>.*?</collision>", "", text).replace('type="prismatic"', 'type="fixed"')
model = mujoco.MjModel.from_xml_string(text)
data = mujoco.MjData(model)
# Friction is applied below, in the crate's form.
model.dof_armature[:], model.dof_damping[:], model.dof_frictionloss[:] = armature, 0, 0

points = program["points"]
first = next(i for i, p in enumerate(points) if p["phase"] == "sweep")
last = int(program["contact_s"] / program["period_s"])
data.qpos[:], data.qvel[:] = points[first]["q"], points[first]["qd"]
for k in range(first, last):
    for s in range(SUB_STEPS):
        w = (s + 0.5) / SUB_STEPS
        tau = (1 - w) * np.array(points[k]["tau"]) + w * np.array(points[k + 1]["tau"])
        data.qfrc_applied[:] = tau - damping * data.qvel - friction * np.tanh(data.qvel / FRICTION_SPEED)
        mujoco.mj_step(model, data)
mujoco.mj_forward(model, data)
body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, program["tool"])
jacobian = np.zeros((3, model.nv))
mujoco.mj_jac(model, data, jacobian, None, data.xpos[body], body)
velocity = jacobian @ data.qvel
ours = np.array(points[last + 1]["tool_position_w"]) - np.array(points[last - 1]["tool_position_w"])
angle = np.arccos(np.clip(velocity @ ours / np.linalg.norm(velocity) / np.linalg.norm(ours), -1, 1))
off = np.linalg.norm(data.xpos[body] - points[last]["tool_position_w"])
print(f"{1e3 * off:.3f} mm off, {np.linalg.norm(velocity):.4f} m/s of {program['contact_speed']}, {np.degrees(angle):.3f} degrees")
