#!/usr/bin/env python3
"""Loads a USD or MJCF export into Newton, simulates it for a second and compares it with its bodies.json.

usage: check_newton.py DIR [--drift-mm 1] [--turn-deg 0.5]

The solver is SolverMuJoCo, Newton's main one for rigid bodies, with MuJoCo's own C code: it needs no GPU and compiles no
solver kernels. Wants `pip install "newton[sim,importers]"`.

One JSON object on standard output: bodies, the worst drift and turn with their bodies, the largest relative error of
masses and principal inertias (infinite for a body or a collider that is missing, and for a wrong friction or restitution
of a USD material), `passed`. Exit code 0 if it passed, 1 if not, 3 if Newton or a package that it needs is missing.
"""

import contextlib
import sys

import common

TIME_STEP = 0.001


def main():
    arguments = common.arguments(__doc__)
    usd = (arguments.dir / "scene.usda").exists()
    for module in ["newton", "mujoco_warp"] + (["pxr.UsdPhysics", "newton_usd_schemas"] if usd else []):
        with contextlib.redirect_stdout(sys.stderr):
            common.need(module)
    # Warp and Newton write their progress to the standard output.
    with contextlib.redirect_stdout(sys.stderr):
        result = simulate(arguments.dir, usd)
    common.finish(arguments, *result)


def simulate(folder, usd):
    import newton
    import warp

    warp.set_device("cpu")
    scene, moving = common.bodies(folder)
    # add_mjcf does not read the gravity of the file, add_usd does.
    builder = newton.ModelBuilder(gravity=scene["gravity_w"])
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    if usd:
        builder.add_usd(str(folder / "scene.usda"))
    else:
        builder.add_mjcf(str(folder / "scene.xml"))
    model = builder.finalize()
    names = prims(folder, scene) if usd else {b["name"]: f"{scene['scene']}/worldbody/{b['name']}" for b in scene["bodies"]}
    index = {b["name"]: model.body_label.index(names[b["name"]]) for b in moving if names[b["name"]] in model.body_label}

    errors = []
    masses, inertias = model.body_mass.numpy(), model.body_inertia.numpy()
    centres = model.body_com.numpy()
    for body in moving:
        i = index.get(body["name"])
        if i is None:
            errors.append(float("inf"))
            continue
        # Newton stores single precision.
        matrix = [[float(inertias[i][j][k] + inertias[i][k][j]) / 2 for k in range(3)] for j in range(3)]
        errors += common.mass_errors(body, float(masses[i]), common.moments(matrix))
        if abs(centres[i]).max() > 1e-6:
            errors.append(float("inf"))
    errors += collider_errors(scene, model, names, usd)
    if abs(model.gravity.numpy()[0] - scene["gravity_w"]).max() > 1e-5:
        errors.append(float("inf"))
    moving = [b for b in moving if b["name"] in index]

    # A box or a hull has one contact with another one unless multiccd is on, and rocks on it.
    solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True, enable_multiccd=True)
    state, after, control = model.state(), model.state(), model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)

    def poses():
        rows = state.body_q.numpy().tolist()  # position, quaternion x y z w
        return {n: (rows[i][:3], [rows[i][6], *rows[i][3:6]]) for n, i in index.items()}

    began = poses()
    start = common.start_errors(moving, began)
    for _ in range(round(1.0 / TIME_STEP)):
        state.clear_forces()
        solver.step(state, after, control, None, TIME_STEP)
        state, after = after, state
    return "newton SolverMuJoCo", newton.__version__, moving, began, poses(), errors, start


def prims(folder, scene):
    """Path of each body's prim. Names may differ from those of the bodies, the order does not."""
    from pxr import Usd

    stage = Usd.Stage.Open(str(folder / "scene.usda"))
    paths = [str(p.GetPath()) for p in stage.GetDefaultPrim().GetChildren() if p.GetTypeName() == "Xform"]
    return {b["name"]: path for b, path in zip(scene["bodies"], paths)}


def collider_errors(scene, model, names, usd):
    """Infinite for each body with too few colliders, or with a friction or restitution that is not its own."""
    import newton

    flags = model.shape_flags.numpy()
    friction, restitution = model.shape_material_mu.numpy(), model.shape_material_restitution.numpy()
    errors = []
    for body in scene["bodies"]:
        mine = [s for s, label in enumerate(model.shape_label) if label.startswith(names[body["name"]] + "/")
                and flags[s] & newton.ShapeFlags.COLLIDE_SHAPES]
        count = body["shape"].get("count", 1)
        if len(mine) != count if body["kind"] == "dynamic" else not mine:
            errors.append(float("inf"))
        # The friction in an MJCF is that of a body on its ground, and its restitution is in solref.
        for shape in mine if usd else []:
            said = (friction[shape], restitution[shape])
            true = [body["material"][k]["best"] for k in ("friction", "restitution")]
            if max(abs(a - b) for a, b in zip(said, true)) > 1e-6:
                errors.append(float("inf"))
    return errors


if __name__ == "__main__":
    sys.exit(main())
