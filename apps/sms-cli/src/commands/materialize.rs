//! `sms materialize`: Gaussians → entities → materials → scene.

use crate::cli::MaterializeArguments;
use sms_cli::front::Console;
use sms_core::{Entity, EntityKind, EntityShape};
use sms_pipeline::{MaterializeRequest, Run};

pub(crate) fn run(console: &Console, a: &MaterializeArguments) -> anyhow::Result<()> {
    let run = Run::new(&a.run, &console.context);
    let request = MaterializeRequest { materials: a.materials.clone(), vlm: a.vlm.mode() };
    let outcome = run.materialize(&request)?;
    for e in &outcome.entities.entities {
        console.say(format!("{:>16}: {}, {:.0} % observed", e.name, shape(e), 100.0 * e.observed_share));
    }
    console.say(format!("  in {}", outcome.scene_dir.join("scene.json").display()));
    console.print_metrics(&run)
}

fn shape(e: &Entity) -> String {
    match (&e.kind, &e.shape) {
        (EntityKind::Static, _) => format!("static, {} triangles", e.mesh.triangles.len()),
        (_, EntityShape::Sphere { radius, .. }) => format!("sphere, radius {:.2} mm", radius * 1e3),
        (_, EntityShape::Box { half_extents, .. }) => {
            let [x, y, z] = (2e3 * *half_extents).to_array();
            format!("box, {x:.1} × {y:.1} × {z:.1} mm")
        }
        (_, EntityShape::Cylinder { radius, half_length, .. }) => {
            format!("cylinder, radius {:.2} mm, {:.1} mm long", radius * 1e3, half_length * 2e3)
        }
        _ => format!("{} convex parts, {:.0} cm³", e.parts.len(), e.mesh.volume() * 1e6),
    }
}
