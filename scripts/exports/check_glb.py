#!/usr/bin/env python3
"""Checks the GLB files of an export by the rules of glTF 2.0 that writers often break (needs only Python), and loads them with
trimesh if it is installed.

usage: check_glb.py DIR

One JSON object on standard output. Exit code 0 if it passed, else 1.
"""

import json
import math
import struct
import sys

import common

SIZES = {5121: 1, 5123: 2, 5125: 4, 5126: 4}
CODES = {5121: "B", 5123: "H", 5125: "I", 5126: "f"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def chunks(data):
    magic, version, length = struct.unpack_from("<4sII", data)
    if (magic, version, length) != (b"glTF", 2, len(data)):
        raise ValueError("wrong header")
    at, found = 12, []
    while at < length:
        size, kind = struct.unpack_from("<I4s", data, at)
        if size % 4:
            raise ValueError("chunk length is no multiple of 4")
        found.append((kind, data[at + 8:at + 8 + size]))
        at += 8 + size
    if [kind for kind, _ in found] not in ([b"JSON"], [b"JSON", b"BIN\0"]):
        raise ValueError("wrong chunks")
    return json.loads(found[0][1]), found[1][1] if len(found) == 2 else b""


def read(file, binary, index):
    accessor = file["accessors"][index]
    view = file["bufferViews"][accessor["bufferView"]]
    width, size = WIDTHS[accessor["type"]], SIZES[accessor["componentType"]]
    if view["byteOffset"] % size or (view.get("target") == 34962 and width * size % 4):
        raise ValueError(f"accessor {index} is not aligned")
    if width * size * accessor["count"] > view["byteLength"]:
        raise ValueError(f"accessor {index} is longer than its view")
    numbers = struct.unpack_from(f"<{width * accessor['count']}{CODES[accessor['componentType']]}", binary, view["byteOffset"])
    return [numbers[i:i + width] for i in range(0, len(numbers), width)]


def problems_of(path):
    found = []
    file, binary = chunks(path.read_bytes())
    if file["asset"]["version"] != "2.0":
        found.append("version")
    for key, value in file.items():
        if value == []:
            found.append(f"{key} is an empty array")
    for view in file.get("bufferViews", []):
        if view["byteOffset"] + view["byteLength"] > file["buffers"][0]["byteLength"]:
            found.append("a view leaves its buffer")
    if binary and not 0 <= len(binary) - file["buffers"][0]["byteLength"] < 4:
        found.append("buffer length")
    for node in file["nodes"]:
        if abs(math.hypot(*node.get("rotation", [0, 0, 0, 1])) - 1) > 1e-5:
            found.append(f"{node.get('name')}: rotation is no unit quaternion")
    for mesh in file.get("meshes", []):
        for primitive in mesh["primitives"]:
            attributes = {k: read(file, binary, i) for k, i in primitive["attributes"].items()}
            positions = attributes["POSITION"]
            if len({len(a) for a in attributes.values()}) != 1:
                found.append(f"{mesh['name']}: attributes of different lengths")
            said = file["accessors"][primitive["attributes"]["POSITION"]]
            low = [min(p[k] for p in positions) for k in range(3)]
            high = [max(p[k] for p in positions) for k in range(3)]
            if [struct.unpack("<f", struct.pack("<f", v))[0] for v in said["min"] + said["max"]] != low + high:
                found.append(f"{mesh['name']}: min or max is wrong")
            if any(abs(math.hypot(*n) - 1) > 1e-4 for n in attributes["NORMAL"]):
                found.append(f"{mesh['name']}: a normal is no unit vector")
            indices = [i for (i,) in read(file, binary, primitive["indices"])]
            if len(indices) % 3 or max(indices) >= len(positions):
                found.append(f"{mesh['name']}: indices")
            if any(not 0 <= v <= 1 for uv in attributes.get("TEXCOORD_0", []) for v in uv):
                found.append(f"{mesh['name']}: texture coordinates outside of [0, 1]")
    for image in file.get("images", []):
        view = file["bufferViews"][image["bufferView"]]
        if "target" in view or binary[view["byteOffset"]:view["byteOffset"] + 8] != b"\x89PNG\r\n\x1a\n":
            found.append("an image is no PNG")
    return found, file


def main():
    arguments = common.arguments(__doc__, drift=False)
    scene, _ = common.bodies(arguments.dir)
    files = [arguments.dir / "scene.glb"] + [arguments.dir / "objects" / f"{b['name']}.glb" for b in scene["bodies"]]
    problems = []
    for path in files:
        found, file = problems_of(path)
        problems += [f"{path.name}: {what}" for what in found]
        if path.name == "scene.glb":
            nodes = {n["name"]: n for n in file["nodes"]}
            for body in scene["bodies"]:
                pose = body["pose_world"]
                x, y, z, w = nodes[body["name"]]["rotation"]
                mm, degrees = common.moved((pose["position_m"], pose["quaternion_wxyz"]),
                                           (nodes[body["name"]]["translation"], (w, x, y, z)))
                if mm > 1e-3 or degrees > 1e-3:
                    problems.append(f"{body['name']} is {mm} mm and {degrees} degrees from where it should be")
    try:
        import trimesh
    except ImportError:
        loaded = "trimesh is missing"
    else:
        loaded = len(trimesh.load(str(files[0])).geometry)
        if loaded != sum("mesh" in node for node in nodes.values()):
            problems.append(f"trimesh found {loaded} meshes")
    print(json.dumps({"files": len(files), "trimesh": loaded, "passed": not problems, "problems": problems[:20]}))
    sys.exit(1 if problems else 0)


if __name__ == "__main__":
    sys.exit(main())
