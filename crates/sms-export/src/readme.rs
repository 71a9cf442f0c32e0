//! The README in each export.

use crate::{Format, bodies};
use sms_scene::Scene;

/// Returns the README: loading, mapping of values, and limits of the format.
pub(crate) fn text(scene: &Scene, format: Format, has_gaussians: bool) -> String {
    let gaussians = if has_gaussians {
        "\n\n## Gaussians\n`gaussians/<body>.ply` holds the Gaussian splats of a body in its frame (the layout of 3D Gaussian \
         Splatting): draw them with the body's pose and they move with it."
    } else {
        ""
    };
    let [title, load, mapping] = parts(format);
    format!(
        include_str!("../assets/readme/README.md"),
        name = scene.name,
        title = title,
        load = load,
        frames = frames(scene, format),
        table = bodies::table(scene),
        mapping = mapping,
        gaussians = gaussians,
    )
}

/// Returns the title of a format, the programs that load it, and the mapping of values.
fn parts(format: Format) -> [&'static str; 3] {
    let text = match format {
        Format::Mjcf => include_str!("../assets/readme/mjcf.md"),
        Format::Urdf => include_str!("../assets/readme/urdf.md"),
        Format::Sdf => include_str!("../assets/readme/sdf.md"),
        Format::Usd => include_str!("../assets/readme/usd.md"),
        Format::Glb => include_str!("../assets/readme/glb.md"),
        Format::Obj => include_str!("../assets/readme/obj.md"),
    };
    let mut parts = text.split("---\n").map(str::trim_end);
    std::array::from_fn(|_| parts.next().unwrap_or_default())
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
