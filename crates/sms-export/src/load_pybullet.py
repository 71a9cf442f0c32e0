#!/usr/bin/env python3
"""Loads this folder into PyBullet.

As a program it opens the scene in a window: python load_pybullet.py
From another one:

    import pybullet, load_pybullet
    pybullet.connect(pybullet.DIRECT)
    bodies = load_pybullet.load(pybullet)      # {name: body id}
"""

import json
import os

HERE = os.path.dirname(os.path.abspath(__file__))
# Bullet inflates convex shapes by a margin of 1 mm; objects would begin inside what they stand on.
MARGIN_M = 0.00002
TIME_STEP_S = 1.0 / 500.0


def load(p, client=0):
    """Puts every body into a connected PyBullet client and sets gravity, step and contacts; {name: body id}."""
    with open(os.path.join(HERE, "bodies.json")) as file:
        scene = json.load(file)
    p.setGravity(*scene["gravity_w"], physicsClientId=client)
    p.setPhysicsEngineParameter(
        fixedTimeStep=TIME_STEP_S,
        numSolverIterations=200,
        # Approach speeds below this do not bounce: a body at rest stays at rest.
        restitutionVelocityThreshold=0.02,
        # Contacts are pushed apart without gaining speed, and kept closed down to a few micrometres.
        useSplitImpulse=1,
        contactSlop=0.00001,
        physicsClientId=client,
    )
    return {body["name"]: load_body(p, body, client) for body in scene["bodies"]}


def load_body(p, body, client=0):
    """One body of bodies.json; its id."""
    position = body["pose_world"]["position_m"]
    w, x, y, z = body["pose_world"]["quaternion_wxyz"]
    contact = contact_of(os.path.join(HERE, body["name"] + ".urdf"))
    if body["shape"]["type"] == "half_space":
        # URDF has no half space, and the slab that stands for it is far larger than what lies on it.
        plane = p.createCollisionShape(p.GEOM_PLANE, planeNormal=[0, 0, 1], physicsClientId=client)
        body_id = p.createMultiBody(0, plane, -1, position, [x, y, z, w], physicsClientId=client)
    else:
        body_id = p.loadURDF(
            os.path.join(HERE, body["name"] + ".urdf"),
            basePosition=position,
            baseOrientation=[x, y, z, w],
            useFixedBase=body["kind"] == "static",
            flags=p.URDF_USE_INERTIA_FROM_FILE | p.URDF_USE_MATERIAL_COLORS_FROM_MTL,
            physicsClientId=client,
        )
    p.changeDynamics(body_id, -1, linearDamping=0, angularDamping=0, collisionMargin=MARGIN_M,
                     physicsClientId=client, **contact)
    return body_id


def contact_of(path):
    """Friction, restitution and rolling resistance of a URDF file. Bullet multiplies those of a pair, so these are not
    the coefficients of bodies.json but factors whose product with the ground's is the pair's mean."""
    import xml.etree.ElementTree

    contact = xml.etree.ElementTree.parse(path).getroot().find("link/contact")
    value = lambda name: float(contact.find(name).get("value"))
    return {
        "lateralFriction": value("lateral_friction"),
        "restitution": value("restitution"),
        "rollingFriction": value("rolling_friction"),
        "spinningFriction": value("spinning_friction"),
    }


def main():
    import time

    import pybullet as p

    p.connect(p.GUI)
    bodies = load(p)
    position = p.getBasePositionAndOrientation(list(bodies.values())[-1])[0]
    p.resetDebugVisualizerCamera(0.8, 45, -35, position)
    while p.isConnected():
        p.stepSimulation()
        time.sleep(TIME_STEP_S)


if __name__ == "__main__":
    main()
