#!/usr/bin/env python3
"""Checks an SDFormat export: well-formed XML, required elements in their places, existing resources, and poses, masses and inertias
equal to bodies.json. Needs only Python.

usage: check_sdf.py DIR

One JSON object on standard output. Exit code 0 if it passed, else 1.
"""

import json
import math
import sys
import xml.etree.ElementTree as xml

import common

# Children that SDFormat 1.9 knows, of the elements that exports have.
KNOWN = {
    "sdf": {"world", "model"}, "world": {"gravity", "physics", "light", "model"},
    "physics": {"max_step_size", "real_time_factor", "real_time_update_rate"}, "light": {"pose", "diffuse", "direction", "cast_shadows"},
    "model": {"pose", "static", "link"}, "link": {"inertial", "visual", "collision"},
    "inertial": {"pose", "mass", "inertia"}, "inertia": {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"},
    "visual": {"geometry", "material"}, "collision": {"geometry", "surface"},
    "geometry": {"sphere", "box", "cylinder", "plane", "mesh"}, "mesh": {"uri"}, "sphere": {"radius"}, "box": {"size"},
    "cylinder": {"radius", "length"}, "plane": {"normal", "size"}, "material": {"ambient", "diffuse"},
    "surface": {"friction", "bounce"}, "friction": {"ode"}, "ode": {"mu", "mu2"},
    "bounce": {"restitution_coefficient", "threshold"},
}


def unknown(element):
    for child in element:
        if child.tag not in KNOWN.get(element.tag, set()):
            yield f"<{child.tag}> in <{element.tag}>"
        yield from unknown(child)


def quaternion(roll, pitch, yaw):
    (cr, sr), (cp, sp), (cy, sy) = [(math.cos(a / 2), math.sin(a / 2)) for a in (roll, pitch, yaw)]
    return (cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy)


def pose(element):
    numbers = [float(v) for v in element.findtext("pose", "0 0 0 0 0 0").split()]
    return numbers[:3], quaternion(*numbers[3:])


def model_problems(model, body, folder, posed):
    name = body["name"]
    link = model.find("link")
    if posed:
        said = body["pose_world"]
        mm, degrees = common.moved((said["position_m"], said["quaternion_wxyz"]), pose(model))
        if mm > 1e-3 or degrees > 1e-3:
            yield f"{name}: pose is off by {mm} mm, {degrees} degrees"
    if (model.findtext("static") == "true") != (body["kind"] == "static"):
        yield f"{name}: static"
    for kind in ("visual", "collision"):
        names = [e.get("name") for e in link.findall(kind)]
        if not names or len(set(names)) != len(names):
            yield f"{name}: no {kind}, or two of one name"
        if any(len(e.find("geometry")) != 1 for e in link.findall(kind)):
            yield f"{name}: a {kind} without one geometry"
    for uri in link.iter("uri"):
        if not (folder / uri.text).is_file():
            yield f"{name}: {uri.text} is missing"
    if body["kind"] == "dynamic":
        inertial = link.find("inertial")
        moments = [float(inertial.findtext(f"inertia/{k}")) for k in ("ixx", "iyy", "izz")]
        if max(common.mass_errors(body, float(inertial.findtext("mass")), moments)) > 1e-3:
            yield f"{name}: mass or inertia"
        _, turn = pose(inertial)
        if common.turn_deg(turn, body["principal"]["axes_wxyz"]) > 1e-3:
            yield f"{name}: principal axes"


def main():
    arguments = common.arguments(__doc__, drift=False)
    scene, _ = common.bodies(arguments.dir)
    root = xml.parse(arguments.dir / "world.sdf").getroot()
    problems = list(unknown(root))
    if root.tag != "sdf" or root.get("version") != "1.9":
        problems.append("no <sdf version='1.9'>")
    models = {m.get("name"): m for m in root.findall("world/model")}
    if sorted(models) != sorted(b["name"] for b in scene["bodies"]):
        problems.append(f"models {sorted(models)}")
    for body in scene["bodies"]:
        problems += model_problems(models[body["name"]], body, arguments.dir, True)
        folder = arguments.dir / "models" / body["name"]
        config = xml.parse(folder / "model.config").getroot()
        alone = xml.parse(folder / config.findtext("sdf")).getroot()
        problems += list(unknown(alone))
        problems += model_problems(alone.find("model"), body, folder, False)
    print(json.dumps({"models": len(models), "passed": not problems, "problems": problems[:20]}))
    sys.exit(1 if problems else 0)


if __name__ == "__main__":
    sys.exit(main())
