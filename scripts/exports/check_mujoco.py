#!/usr/bin/env python3
"""Loads an MJCF export into MuJoCo, simulates it for a second and compares it with its bodies.json.

usage: check_mujoco.py DIR [--drift-mm 1] [--turn-deg 0.5]

One JSON object on standard output: bodies, the worst drift and turn with their bodies, the largest relative error of
masses and principal inertias (infinite for a body that is missing or invisible), `passed`. Exit code 0 if it passed, 1 if
not, 3 if MuJoCo is missing.
"""

import sys

import common


def main():
    arguments = common.arguments(__doc__)
    common.need("mujoco")
    import mujoco

    scene, moving = common.bodies(arguments.dir)
    model = mujoco.MjModel.from_xml_path(str(arguments.dir / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    index = {b["name"]: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, b["name"]) for b in scene["bodies"]}

    errors = []
    for body in moving:
        i = index[body["name"]]
        errors += common.mass_errors(body, model.body_mass[i], model.body_inertia[i])
    if any(i < 0 for i in index.values()) or model.nbody != len(scene["bodies"]) + 1:
        errors.append(float("inf"))
    # The viewer shows the groups 0 to 2.
    seen = {int(model.geom_bodyid[g]) for g in range(model.ngeom) if model.geom_group[g] <= 2}
    if not set(index.values()) <= seen or model.nlight == 0:
        errors.append(float("inf"))

    def poses():
        # xipos is the mass centre, the origin of a moving body's frame.
        return {b["name"]: (data.xipos[index[b["name"]]].copy(), data.xquat[index[b["name"]]].copy()) for b in moving}

    began = poses()
    start = common.start_errors(moving, began)
    for _ in range(round(1.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    common.finish(arguments, "mujoco", mujoco.__version__, moving, began, poses(), errors, start)


if __name__ == "__main__":
    sys.exit(main())
