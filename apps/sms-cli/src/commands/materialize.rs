//! `sms materialize`: Gaussians → entities → materials → scene.

use crate::cli::MaterializeArguments;
use sms_cli::front::Console;
use sms_core::{Entity, EntityKind, EntityShape};
use sms_materials::{ClassChoice, ClassOrigin};
use sms_pipeline::{MaterializeRequest, Run};

pub(crate) fn run(console: &Console, a: &MaterializeArguments) -> anyhow::Result<()> {
    let run = Run::new(&a.run, &console.context);
    let request = MaterializeRequest { materials: a.materials.clone(), vlm: a.vlm.mode() };
    let outcome = run.materialize(&request)?;
    for e in &outcome.entities.entities {
        console.say(format!("{:>16}: {}, {:.0} % observed", e.name, shape(e), 100.0 * e.observed_share));
    }
    materials_text(&outcome.materials).iter().for_each(|line| console.say(line));
    console.say(format!("  in {}", outcome.scene_dir.join("scene.json").display()));
    console.conclude(&run)
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

/// Returns one line with the materials of the objects by the origin of their classes; `None` without objects.
fn materials_text(choices: &[ClassChoice]) -> Option<String> {
    let of = |origin: ClassOrigin| choices.iter().filter(move |c| c.origin == origin);
    let known = [
        (ClassOrigin::User, "from your values"),
        (ClassOrigin::Vlm, "from the vision-language model"),
        (ClassOrigin::Words, "from their names or descriptions"),
    ];
    let mut groups = Vec::new();
    for (origin, source) in known {
        let materials: Vec<String> = of(origin).map(|c| format!("{} {}", c.name, c.class)).collect();
        if !materials.is_empty() {
            groups.push(format!("{} ({source})", materials.join(", ")));
        }
    }
    let unknown: Vec<&str> = of(ClassOrigin::Unknown).map(|c| c.name.as_str()).collect();
    if !unknown.is_empty() {
        groups.push(format!("{} unknown", unknown.join(", ")));
    }
    (!groups.is_empty()).then(|| format!("materials: {}", groups.join("; ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn materials_are_grouped_by_the_origin_of_their_classes() {
        let choice =
            |name: &str, class: &str, origin| ClassChoice { name: name.into(), class: class.into(), origin };
        let all = [
            choice("mug", "ceramic", ClassOrigin::Words),
            choice("object_03", "unknown", ClassOrigin::Unknown),
            choice("bowl", "steel", ClassOrigin::User),
            choice("duck", "rubber", ClassOrigin::Words),
            choice("object_05", "unknown", ClassOrigin::Unknown),
        ];
        let text = materials_text(&all).unwrap();
        let groups: Vec<&str> = text.trim_start_matches("materials: ").split("; ").collect();
        let starts = ["bowl steel (", "mug ceramic, duck rubber (", "object_03, object_05 unknown"];
        assert_eq!(groups.len(), starts.len(), "{text}");
        assert!(groups.iter().zip(starts).all(|(group, start)| group.starts_with(start)), "{text}");
        assert_eq!(materials_text(&[]), None);
    }
}
