//! The README in each export.

use crate::{Format, bodies};
use sms_scene::Scene;

/// Returns the README: loading, mapping of values, and limits of the format.
pub(crate) fn text(scene: &Scene, format: Format, has_gaussians: bool) -> String {
    let gaussians = if has_gaussians {
        "\n## Gaussians\n`gaussians/<body>.ply` holds the Gaussian splats of a body in its frame (the layout of 3D Gaussian \
         Splatting): draw them with the body's pose and they move with it.\n"
    } else {
        ""
    };
    format!(
        "# {name}\n\nA scene reconstructed from an RGB-D scan by sms, as {title}. Paths are relative: the folder can be moved.\n\
         \n## Load it\n{load}\n## Units and frames\n{frames}\n\n## Bodies\n{table}\n\
         Each property: best estimate [about 90 % interval] (source: `vlm` a vision-language model, `table` a handbook, `user`, \
         `prior` a stated assumption). Seen: share of the surface that cameras observed; the rest was closed. `bodies.json` \
         has the same for programs, with inertia, Young's modulus and Poisson's ratio.\n\
         \n## What maps to what\n{mapping}{gaussians}",
        name = scene.name,
        title = title(format),
        load = load(format),
        frames = frames(scene, format),
        table = bodies::table(scene),
        mapping = mapping(format),
    )
}

fn title(format: Format) -> &'static str {
    match format {
        Format::Mjcf => "MJCF for MuJoCo",
        Format::Urdf => "URDF, one file per body",
        Format::Sdf => "an SDFormat 1.9 world",
        Format::Usd => "OpenUSD with UsdPhysics schemas",
        Format::Glb => "glTF 2.0 binary",
        Format::Obj => "Wavefront OBJ",
    }
}

fn frames(scene: &Scene, format: Format) -> String {
    let [x, y, z] = scene.gravity_w.to_array();
    let up = match format {
        Format::Glb => "Below the root node, which turns the scene to glTF's y up, the world has z up",
        _ => "The world has z up",
    };
    format!(
        "Metres, kilograms, seconds, radians. {up}; gravity is ({x:.5}, {y:.5}, {z:.5}) m/s². The frame of a moving body has \
         its origin at the centre of mass; its axes are those of the world at the time of the scan, or of the box or cylinder. \
         Inertia is about the centre of mass."
    )
}

fn load(format: Format) -> &'static str {
    match format {
        Format::Mjcf => {
            "- MuJoCo: `python -m mujoco.viewer --mjcf=scene.xml`, or `mujoco.MjModel.from_xml_path(\"scene.xml\")`.\n\
             - MJX, MuJoCo Warp, dm_control: the same file.\n\
             - Genesis: `scene.add_entity(gs.morphs.MJCF(file=\"scene.xml\"))`.\n\
             - Drake: `Parser(plant).AddModels(\"scene.xml\")` reads bodies, primitives and hulls; it ignores `solref`.\n\
             - Isaac Sim: File > Import, or take the `usd` export.\n"
        }
        Format::Urdf => {
            "- PyBullet: `python load_pybullet.py` opens a window; `load_pybullet.load(pybullet)` loads into a client of yours. \
             It sets poses, gravity, time step, collision margins and contacts; loading a URDF by hand leaves those out.\n\
             - ROS 2 / RViz: put the folder into a package and publish `<body>.urdf` with `robot_state_publisher`; `poses.yaml` \
             has the pose of each body for `static_transform_publisher`. If your loader wants it, write `package://…` before \
             `meshes/`.\n\
             - Drake: `Parser(plant).AddModels(\"<body>.urdf\")`, then the pose from `poses.yaml`.\n\
             - Genesis: `gs.morphs.URDF(file=\"<body>.urdf\", pos=…, quat=…)` with the pose from `bodies.json`.\n\
             - Isaac Sim: File > Import, one file per body, or take the `usd` export.\n"
        }
        Format::Sdf => {
            "- Gazebo: `gz sim world.sdf` (Fortress or newer).\n\
             - Into a world of yours: add `models/` to `GZ_SIM_RESOURCE_PATH` and \
             `<include><uri>model://<body></uri><pose>…</pose></include>`; poses are in `world.sdf`.\n\
             - Drake: `Parser(plant).AddModels(\"world.sdf\")`.\n"
        }
        Format::Usd => {
            "- Isaac Sim, Omniverse: open `scene.usda`, or reference it below a prim of yours (the default prim is `/World`); \
             press Play.\n\
             - Blender: File > Import > Universal Scene Description (visual meshes; physics is not read).\n\
             - usdview, or `pxr.Usd.Stage.Open(\"scene.usda\")`; collision shapes have the purpose `guide`.\n"
        }
        Format::Glb => {
            "- Blender: File > Import > glTF 2.0; physical properties arrive as custom properties of the objects.\n\
             - three.js, model-viewer, Unity, Unreal, Godot, trimesh: `scene.glb`, or one object: `objects/<body>.glb`.\n"
        }
        Format::Obj => {
            "- Blender, MeshLab, trimesh, anything: `scene.obj` (world frame), or `meshes/<body>_visual.obj` and the convex parts \
             `meshes/<body>_hull_NN.obj` (body frame; poses in `bodies.json`).\n\
             - Blender asks for the axes: forward Y, up Z.\n"
        }
    }
}

fn mapping(format: Format) -> &'static str {
    match format {
        Format::Mjcf => {
            "- Friction: a body on the ground gets the mean of both coefficients. Of two moving bodies MuJoCo takes the larger.\n\
             - Restitution: MuJoCo has none. The contact's damping ratio (`solref`) is the one at which a damped spring gives \
             back this share of the approach speed; measured bounces are within 0.05 of it on average from 0.5 to 2 m/s. Of two \
             moving bodies the more damped one counts.\n\
             - Rolling resistance: third friction coefficient of spheres and cylinders.\n\
             - A static mesh is one thin prism per triangle (MuJoCo would take its convex hull); the floor is a slab of 6 m.\n\
             - Vertex colours: MuJoCo has none; a body without a picture has its mean colour.\n\
             - Lost: elastic constants, intervals (see `bodies.json`).\n"
        }
        Format::Urdf => {
            "- Bullet multiplies the coefficients of a pair; we take the mean. `<contact>` holds factors whose product with the \
             ground's is that mean; pairs of moving bodies come near it. Measured in PyBullet: friction as it should be, balls \
             bounce 0.05 higher than they should, bodies that land flat a quarter lower.\n\
             - The floor is a half space in PyBullet and a slab of 20 m in the file.\n\
             - A static mesh is a concave triangle mesh.\n\
             - Lost: gravity and poses (in `poses.yaml`), friction outside of PyBullet, elastic constants, intervals.\n"
        }
        Format::Sdf => {
            "- Friction: Gazebo's engines take the smaller coefficient of a pair; a moving body has its mean with the ground and \
             static ones the largest of these. Of two moving bodies the smaller counts.\n\
             - Restitution is multiplied by DART: values are factors whose product with the ground's is the mean.\n\
             - Convex parts are meshes, each its own convex hull.\n\
             - Lost: rolling resistance, elastic constants, intervals.\n"
        }
        Format::Usd => {
            "- Friction and restitution as they are: PhysX takes the mean of a pair, as sms does.\n\
             - Convex parts: `physics:approximation = convexHull`; static meshes: `none` (the triangles).\n\
             - The floor is a `Plane` with `PhysicsCollisionAPI`, which is infinite.\n\
             - `displayColor` is linear, pictures are sRGB.\n\
             - Lost: rolling resistance, elastic constants, intervals. PhysX drops convex hulls to 64 vertices: ours have no more.\n"
        }
        Format::Glb => {
            "- Pictures or vertex colours (linear, `COLOR_0`), normals, one node per body with its pose.\n\
             - Physics is in `extras` of each node: [best, low, high].\n\
             - Lost: convex parts (take `obj`), the half space (a square of 3 m).\n"
        }
        Format::Obj => {
            "- Vertex colours as `v x y z r g b` (sRGB), pictures through the MTL.\n\
             - Lost: everything physical, but for `bodies.json`.\n"
        }
    }
}
