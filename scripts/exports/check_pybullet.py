#!/usr/bin/env python3
"""Loads a URDF export into PyBullet with its own loader, simulates it for a second and compares it with bodies.json.

usage: check_pybullet.py DIR [--drift-mm 1] [--turn-deg 0.5]

One JSON object on standard output: bodies, the worst drift and turn with their bodies, the largest relative error of
masses and principal inertias, `passed`. Exit code 0 if it passed, 1 if not, 3 if PyBullet is missing.
"""

import sys

import common


def main():
    arguments = common.arguments(__doc__)
    common.need("pybullet")
    import importlib.metadata

    import pybullet as p

    scene, moving = common.bodies(arguments.dir)
    client = p.connect(p.DIRECT)
    sys.path.insert(0, str(arguments.dir))
    import load_pybullet

    ids = load_pybullet.load(p, client)
    errors = [] if sorted(ids) == sorted(b["name"] for b in scene["bodies"]) else [float("inf")]
    for body in moving:
        dynamics = p.getDynamicsInfo(ids[body["name"]], -1)
        errors += common.mass_errors(body, dynamics[0], dynamics[2])

    def poses():
        found = {}
        for body in moving:
            position, (x, y, z, w) = load_pybullet.pose(p, ids[body["name"]], body, client)
            found[body["name"]] = (position, (w, x, y, z))
        return found

    began = poses()
    start = common.start_errors(moving, began)
    steps = round(1.0 / p.getPhysicsEngineParameters()["fixedTimeStep"])
    for _ in range(steps):
        p.stepSimulation()
    common.finish(arguments, "pybullet", importlib.metadata.version("pybullet"), moving, began, poses(), errors, start)


if __name__ == "__main__":
    sys.exit(main())
