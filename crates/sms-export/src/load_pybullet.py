#!/usr/bin/env python3
"""Loads this folder into PyBullet.

As a program it opens the scene in a window: python load_pybullet.py
From another one:

    import pybullet, load_pybullet
    pybullet.connect(pybullet.DIRECT)
    bodies = load_pybullet.load(pybullet)      # {name: body id}

PyBullet inflates the convex parts of a URDF by 1 mm and offers no way to change that, so this builds the bodies from their
meshes. getBasePositionAndOrientation gives the pose of the principal axes of inertia, as for every body in PyBullet; pose()
gives that of the body frame of bodies.json.
"""

import json
import os
import xml.etree.ElementTree

HERE = os.path.dirname(os.path.abspath(__file__))
# Margin that is added around convex parts, metres. Bullet's 1 mm would have bodies begin inside what they stand on.
MARGIN_M = 0.00002
TIME_STEP_S = 1.0 / 500.0


def load(p, client=0):
    """Puts every body into a connected PyBullet client and sets gravity, step and contacts; {name: body id}."""
    scene = description()
    p.setGravity(*scene["gravity_w"], physicsClientId=client)
    p.setPhysicsEngineParameter(
        fixedTimeStep=TIME_STEP_S,
        numSolverIterations=200,
        # Approach speeds below this do not bounce. It must be well above what gravity adds in a step (2 cm/s), or bodies
        # at rest hop, and creep.
        restitutionVelocityThreshold=0.05,
        # Overlap is pushed apart without giving speed, down to 10 µm.
        useSplitImpulse=1,
        contactSlop=0.00001,
        # Bullet sees contacts 2 cm ahead, and takes what is left of the gap from the bounce: balls did not bounce at all.
        contactBreakingThreshold=0.0005,
        physicsClientId=client,
    )
    return {body["name"]: load_body(p, body, client) for body in scene["bodies"]}


def description():
    """The content of bodies.json."""
    with open(os.path.join(HERE, "bodies.json")) as file:
        return json.load(file)


def load_body(p, body, client=0):
    """One body of bodies.json; its id."""
    moves = body["kind"] == "dynamic"
    pose = body["pose_world"]
    shape = collision_shape(p, body["shape"], client)
    # The margin of nested shapes can be set only while they are the shape of a body themselves.
    probe = p.createMultiBody(0, shape, physicsClientId=client)
    p.changeDynamics(probe, -1, collisionMargin=MARGIN_M, physicsClientId=client)
    p.removeBody(probe, physicsClientId=client)
    body_id = p.createMultiBody(
        baseMass=body["mass"]["mass_kg"] if moves else 0.0,
        baseCollisionShapeIndex=shape,
        baseVisualShapeIndex=visual_shape(p, body, client),
        basePosition=pose["position_m"],
        baseOrientation=xyzw(pose["quaternion_wxyz"]),
        baseInertialFrameOrientation=xyzw(body["principal"]["axes_wxyz"]) if moves else (0, 0, 0, 1),
        physicsClientId=client,
    )
    if moves:
        p.changeDynamics(body_id, -1, localInertiaDiagonal=body["principal"]["moments_kg_m2"], physicsClientId=client)
    p.changeDynamics(body_id, -1, linearDamping=0, angularDamping=0, physicsClientId=client, **contact(body["name"]))
    if body.get("picture"):
        picture = p.loadTexture(os.path.join(HERE, body["picture"]), physicsClientId=client)
        p.changeVisualShape(body_id, -1, textureUniqueId=picture, rgbaColor=(1, 1, 1, 1), physicsClientId=client)
    return body_id


def pose(p, body_id, body, client=0):
    """Position and quaternion (x y z w) of the body frame of bodies.json."""
    position, orientation = p.getBasePositionAndOrientation(body_id, physicsClientId=client)
    if body["kind"] == "dynamic":
        _, back = p.invertTransform((0, 0, 0), xyzw(body["principal"]["axes_wxyz"]))
        position, orientation = p.multiplyTransforms(position, orientation, (0, 0, 0), back)
    return position, orientation


def xyzw(wxyz):
    w, x, y, z = wxyz
    return x, y, z, w


def collision_shape(p, shape, client):
    path = lambda file: os.path.join(HERE, file)
    kind = shape["type"]
    if kind == "hulls":
        files = [path(file) for file in shape["files"]]
        return p.createCollisionShapeArray([p.GEOM_MESH] * len(files), fileNames=files, physicsClientId=client)
    arguments = {
        "sphere": lambda: {"shapeType": p.GEOM_SPHERE, "radius": shape["radius"]},
        "box": lambda: {"shapeType": p.GEOM_BOX, "halfExtents": shape["half_extents"]},
        "cylinder": lambda: {"shapeType": p.GEOM_CYLINDER, "radius": shape["radius"], "height": 2 * shape["half_length"]},
        "half_space": lambda: {"shapeType": p.GEOM_PLANE, "planeNormal": (0, 0, 1)},
        "tri_mesh": lambda: {"shapeType": p.GEOM_MESH, "fileName": path(shape["file"]), "flags": p.GEOM_FORCE_CONCAVE_TRIMESH},
    }[kind]()
    return p.createCollisionShape(physicsClientId=client, **arguments)


def visual_shape(p, body, client):
    if not body.get("visual"):
        return -1
    color = [c / 255.0 for c in body["color_srgb"]] + [1.0]
    return p.createVisualShape(p.GEOM_MESH, fileName=os.path.join(HERE, body["visual"]), rgbaColor=color,
                               physicsClientId=client)


def contact(name):
    """Friction, restitution and rolling resistance from <name>.urdf. Bullet multiplies those of a pair, so these are not
    the coefficients of bodies.json but factors whose product with the ground's is the mean of both."""
    tag = xml.etree.ElementTree.parse(os.path.join(HERE, name + ".urdf")).getroot().find("link/contact")
    value = lambda key: float(tag.find(key).get("value"))
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
