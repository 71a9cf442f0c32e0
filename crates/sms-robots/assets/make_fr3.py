"""Writes fr3.urdf: the Franka Research 3 with the Franka Hand, from a table of facts.

    python make_fr3.py franka_fr3.yaml fr3_capsules.json > fr3.urdf

The numbers are those of frankaemika/franka_description @ b299b39d9692bfae795184df32a98ce7778d56af (Apache-2.0:
kinematics, the narrower joint limits, inertials, hand and fingers) and of google-deepmind/mujoco_menagerie (Apache-2.0:
damping, friction, armature). The capsules of the links are our own fits (fit_capsules.py) of that description's
collision meshes. Needs PyYAML.
"""
import json
import math
import sys

import yaml

facts = yaml.safe_load(open(sys.argv[1]))
capsules = json.load(open(sys.argv[2]))
out = []


def num(x):
    return repr(float(x) + 0.0)


def vec(v):
    return " ".join(num(x) for x in v)


def rpy_of_z(direction):
    """Roll 0, pitch, yaw that turn z to `direction`."""
    x, y, z = direction
    return [0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x) if math.hypot(x, y) > 1e-9 else 0.0]


def collision(xyz, rpy, geometry):
    out.append(f'    <collision><origin xyz="{vec(xyz)}" rpy="{vec(rpy)}"/><geometry>{geometry}</geometry></collision>')


def capsule(a, b, radius):
    """A cylinder and two spheres, which every reader of URDF knows; ours makes one capsule of them."""
    d = [q - p for p, q in zip(a, b)]
    length = math.sqrt(sum(x * x for x in d))
    mid = [(p + q) / 2 for p, q in zip(a, b)]
    rpy = rpy_of_z(d)
    collision(mid, rpy, f'<cylinder radius="{num(radius)}" length="{num(length)}"/>')
    for end in (a, b):
        collision(end, [0, 0, 0], f'<sphere radius="{num(radius)}"/>')


def inertial(part):
    i = part["inertia"]
    out.append("    <inertial>")
    out.append(f'      <origin xyz="{vec(part["com"])}" rpy="0 0 0"/>')
    out.append(f'      <mass value="{num(part["mass"])}"/>')
    out.append("      <inertia " + " ".join(f'i{k}="{num(i[k])}"' for k in ("xx", "xy", "xz", "yy", "yz", "zz")) + "/>")
    out.append("    </inertial>")


def fixed(name, parent, child, xyz, rpy):
    out.append(f'  <joint name="{name}" type="fixed">')
    out.append(f'    <parent link="{parent}"/><child link="{child}"/><origin xyz="{vec(xyz)}" rpy="{vec(rpy)}"/>')
    out.append("  </joint>")


out.append('<?xml version="1.0"?>')
out.append("<!-- Written by make_fr3.py, which names the sources (Apache-2.0). SI units.")
out.append("     `armature` (kg m^2) of `dynamics` is ours: other readers ignore it. -->")
out.append('<robot name="fr3">')
links = facts["links"]
limits = facts["joint_limits"]["franka_description"]
dyn = facts["joint_dynamics"]["mujoco_menagerie"]
for k in range(8):
    out.append(f'  <link name="fr3_link{k}">')
    inertial(links[f"link{k}"])
    for c in capsules[f"link{k}"]:
        capsule(c["a"], c["b"], c["radius"])
    out.append("  </link>")
for k, row in enumerate(facts["kinematics"]["joint_origins"][:7]):
    out.append(f'  <joint name="fr3_joint{k + 1}" type="revolute">')
    out.append(f'    <parent link="fr3_link{k}"/><child link="fr3_link{k + 1}"/>')
    out.append(f'    <origin xyz="{vec(row["xyz"])}" rpy="{num(row["roll"])} 0.0 0.0"/><axis xyz="0 0 1"/>')
    out.append(
        f'    <limit lower="{num(limits["lower"][k])}" upper="{num(limits["upper"][k])}"'
        f' velocity="{num(limits["velocity"][k])}" effort="{num(limits["effort"][k])}"/>'
    )
    out.append(
        f'    <dynamics damping="{num(dyn["damping"][k])}" friction="{num(dyn["friction_loss"][k])}"'
        f' armature="{num(dyn["armature"][k])}"/>'
    )
    out.append("  </joint>")
flange = facts["kinematics"]["joint_origins"][7]
out.append('  <link name="fr3_link8"/>')
fixed("fr3_joint8", "fr3_link7", "fr3_link8", flange["xyz"], [0, 0, 0])
hand = facts["hand"]
out.append('  <link name="fr3_hand">')
inertial(hand)
# The second capsule of the source stands for the fingers at any opening; ours have boxes of their own.
for c in hand["self_collision_capsules"][:1]:
    half = [0, c["length"] / 2, 0]
    capsule([p - h for p, h in zip(c["centre"], half)], [p + h for p, h in zip(c["centre"], half)], c["radius"])
out.append("  </link>")
fixed("fr3_hand_joint", "fr3_link8", "fr3_hand", [0, 0, 0], [0, 0, hand["mount_rotation_about_z"]])
out.append('  <link name="fr3_hand_tcp"/>')
fixed("fr3_hand_tcp_joint", "fr3_hand", "fr3_hand_tcp", hand["tool_centre_point_in_hand"], [0, 0, 0])
fingers = hand["fingers"]
tip = fingers["collision_boxes_left"][-1]
for side, turn in (("left", 0.0), ("right", fingers["right_finger_rotation_about_z"])):
    name = f"fr3_{side}finger"
    out.append(f'  <link name="{name}">')
    inertial({"mass": fingers["mass_each"], "com": fingers["com"], "inertia": fingers["inertia"]})
    for box in fingers["collision_boxes_left"]:
        collision(box["centre"], [box["roll"], 0, 0], f'<box size="{vec(box["size"])}"/>')
    out.append("  </link>")
    out.append(f'  <joint name="fr3_finger_joint{1 if side == "left" else 2}" type="prismatic">')
    out.append(f'    <parent link="fr3_hand"/><child link="{name}"/>')
    out.append(f'    <origin xyz="{vec(fingers["joint_origin_in_hand"])}" rpy="0.0 0.0 {num(turn)}"/><axis xyz="0 1 0"/>')
    lower, upper = fingers["stroke_each"]
    out.append(
        f'    <limit lower="{num(lower)}" upper="{num(upper)}" velocity="{num(fingers["velocity"])}"'
        f' effort="{num(fingers["force"])}"/>'
    )
    out.append(f'    <dynamics damping="{num(fingers["damping"])}"/>')
    if side == "right":
        out.append('    <mimic joint="fr3_finger_joint1"/>')
    out.append("  </joint>")
# The fist: centre of the two closed rubber tips. x along the sweep, y along the fingers' stroke, z away from the floor
# when the hand points down.
centre = fingers["joint_origin_in_hand"][2] + tip["centre"][2]
out.append('  <link name="fr3_fist"/>')
fixed("fr3_fist_joint", "fr3_hand", "fr3_fist", [0, 0, centre], [math.pi, 0, 0])
out.append("</robot>")
print("\n".join(out))
