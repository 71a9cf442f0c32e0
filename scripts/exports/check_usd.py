#!/usr/bin/env python3
"""Opens a USD export, runs USD's own validators over it, parses it with UsdPhysics and compares the result with
bodies.json.

usage: check_usd.py DIR

One JSON object on standard output. Exit code 0 if it passed, 1 if not, 3 if usd-core is missing.
"""

import json
import sys

import common


def main():
    arguments = common.arguments(__doc__, drift=False)
    common.need("pxr.UsdPhysics")
    from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade

    scene, moving = common.bodies(arguments.dir)
    stage = Usd.Stage.Open(str(arguments.dir / "scene.usda"))
    problems = []

    def expect(holds, what):
        if not holds:
            problems.append(what)

    expect(stage.GetDefaultPrim().GetPath() == "/World", "default prim")
    expect(UsdGeom.GetStageMetersPerUnit(stage) == 1 and UsdGeom.GetStageUpAxis(stage) == "Z", "units or up axis")
    expect(UsdPhysics.GetStageKilogramsPerUnit(stage) == 1, "kilograms per unit")

    problems += validators(stage)

    found = UsdPhysics.LoadUsdPhysicsFromRange(stage, ["/"])
    counts = {}
    for kind, (paths, descriptions) in found.items():
        counts[str(kind).rsplit(".", 1)[-1]] = len(paths)
        for path, description in zip(paths, descriptions):
            expect(description.isValid, f"{path}: UsdPhysics finds it invalid")
    expect(counts.get("RigidBody", 0) == len(moving), f"{counts.get('RigidBody', 0)} rigid bodies of {len(moving)}")
    expect(counts.get("Scene", 0) == 1, "physics scene")
    names = {"sphere": "SphereShape", "box": "CubeShape", "cylinder": "CylinderShape", "half_space": "PlaneShape"}
    expected = {}
    for body in scene["bodies"]:
        shape = body["shape"]
        kind = names.get(shape["type"], "MeshShape")
        expected[kind] = expected.get(kind, 0) + shape.get("count", 1)
    shapes = {k: n for k, n in counts.items() if k.endswith("Shape")}
    expect(shapes == expected, f"shapes {shapes}, expected {expected}")

    gravity = next(p for p in stage.Traverse() if p.IsA(UsdPhysics.Scene))
    g = UsdPhysics.Scene(gravity)
    vector = [g.GetGravityMagnitudeAttr().Get() * v for v in g.GetGravityDirectionAttr().Get()]
    expect(max(abs(a - b) for a, b in zip(vector, scene["gravity_w"])) < 1e-5, "gravity")

    cache = UsdGeom.XformCache()
    by_name = {}
    for prim in stage.GetDefaultPrim().GetChildren():
        if prim.GetTypeName() == "Xform":
            by_name[len(by_name)] = prim
    mass_error = pose_error = 0.0
    for body, prim in zip(scene["bodies"], by_name.values()):
        matrix = cache.GetLocalToWorldTransform(prim)
        position = list(matrix.ExtractTranslation())
        q = matrix.ExtractRotationQuat()
        pose = body["pose_world"]
        mm, degrees = common.moved((pose["position_m"], pose["quaternion_wxyz"]),
                                   (position, [q.GetReal(), *q.GetImaginary()]))
        pose_error = max(pose_error, mm, degrees)
        physics = [UsdShade.MaterialBindingAPI(c).ComputeBoundMaterial("physics")[0]
                   for c in Usd.PrimRange(prim) if c.HasAPI(UsdPhysics.CollisionAPI)]
        expect(physics and all(physics), f"{body['name']}: colliders without physics material")
        for material in physics:
            api = UsdPhysics.MaterialAPI(material)
            said = [api.GetDynamicFrictionAttr().Get(), api.GetRestitutionAttr().Get()]
            true = [body["material"][k]["best"] for k in ("friction", "restitution")]
            expect(max(abs(a - b) for a, b in zip(said, true)) < 1e-6, f"{body['name']}: {said} is not {true}")
        if body["kind"] == "dynamic":
            expect(prim.HasAPI(UsdPhysics.RigidBodyAPI), f"{body['name']} is no rigid body")
            api = UsdPhysics.MassAPI(prim)
            mass_error = max([mass_error] + common.mass_errors(body, api.GetMassAttr().Get(),
                                                                api.GetDiagonalInertiaAttr().Get()))
            axes = Gf.Matrix3d(Gf.Rotation(Gf.Quatd(api.GetPrincipalAxesAttr().Get())))
            mass_error = max(mass_error, inertia_error(body, axes, api.GetDiagonalInertiaAttr().Get()))
        else:
            expect(not prim.HasAPI(UsdPhysics.RigidBodyAPI), f"{body['name']} must not move")
    expect(len(by_name) == len(scene["bodies"]), "number of bodies")
    expect(mass_error <= 1e-3, f"masses differ by {mass_error}")
    expect(pose_error <= 1e-3, f"poses differ by {pose_error} mm or degrees")
    version = ".".join(str(v) for v in Usd.GetVersion()[1:])
    print(json.dumps({"usd": version, "bodies": len(moving), "passed": not problems, "shapes": shapes,
                      "mass_error": float(f"{mass_error:.2e}"), "problems": problems[:20]}))
    sys.exit(1 if problems else 0)


def inertia_error(body, axes, diagonal):
    """Largest error of the whole inertia matrix R diag Rᵀ, relative to the largest moment. USD's matrices are transposed."""
    r = [[axes[j][i] for j in range(3)] for i in range(3)]
    true = body["mass"]["inertia_kg_m2"]
    found = [[sum(r[i][k] * diagonal[k] * r[j][k] for k in range(3)) for j in range(3)] for i in range(3)]
    return max(abs(found[i][j] - true[i][j]) for i in range(3) for j in range(3)) / max(diagonal)


def validators(stage):
    """Errors of USD's registered validators."""
    from pxr import UsdValidation

    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    found = []
    for error in context.Validate(stage):
        if error.GetType() in (UsdValidation.ValidationErrorType.Error, UsdValidation.ValidationErrorType.Warn):
            sites = [str(s.GetPrim().GetPath()) for s in error.GetSites() if s.IsPrim()]
            found.append(f"{error.GetName()} at {sites}: {error.GetMessage()}")
    return found


if __name__ == "__main__":
    sys.exit(main())
