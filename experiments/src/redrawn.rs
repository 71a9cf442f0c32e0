//! Another world that correct material classes do not distinguish from the true one.

use sms_core::{Interval, MassProperties, Material, Property, PropertySource, Seed};
use sms_synth::{Hollow, TruthScene, draw_material_named};

/// Draws the materials and masses of all objects and the floor again from the ranges of their classes: another world that
/// correct classes do not distinguish from this one. Objects without a class of the table keep their material.
pub(crate) fn redraw_materials(truth: &TruthScene, seed: Seed) -> TruthScene {
    let seed = seed.derive("redrawn materials");
    let draw = |class: &str, of: &str| draw_material_named(class, &mut seed.derive(of).rng());
    let mut redrawn = truth.clone();
    for object in &mut redrawn.objects {
        let Some(material) = draw(&object.material.class, &object.name) else { continue };
        let effective = object.material.density.value.best;
        let substance = match object.hollow {
            Hollow::Shell { wall_density, .. } => wall_density,
            Hollow::Solid | Hollow::Vessel { .. } => effective,
        };
        let ratio = material.density.value.best / substance;
        let (mass, com, inertia) = (object.mass.mass(), object.mass.com(), object.mass.inertia());
        // A positive multiple of a possible inertia is possible.
        let Ok(mass) = MassProperties::new(mass * ratio, com, inertia * ratio) else { continue };
        if let Hollow::Shell { wall_density, .. } = &mut object.hollow {
            *wall_density *= ratio;
        }
        object.mass = mass;
        let density = Property::new(Interval::exact(effective * ratio), PropertySource::Truth);
        object.material = Material { density, ..material };
    }
    if let Some(material) = draw(&redrawn.floor.material.class, "(floor)") {
        redrawn.floor.material = material;
    }
    redrawn
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DVec2;
    use sms_synth::{BilliardsSettings, LandingStructure, generate_billiards};

    #[test]
    fn redrawn_materials_stay_in_their_class_and_masses_go_with_them() {
        let scene = generate_billiards(Seed(3), &BilliardsSettings::default());
        let other = redraw_materials(&scene, Seed(1));
        assert_eq!(other, redraw_materials(&scene, Seed(1)));
        assert_ne!(scene.floor.material, other.floor.material);
        for (a, b) in scene.objects.iter().zip(&other.objects) {
            assert_eq!(a.material.class, b.material.class);
            assert_ne!(a.material.friction, b.material.friction);
            let (mass, density) = (
                b.mass.mass() / a.mass.mass(),
                b.material.density.value.best / a.material.density.value.best,
            );
            assert!((mass / density - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn redrawn_masses_change_the_loads() {
        let scene = LandingStructure::ALL[0].fixed();
        let other = redraw_materials(&scene, Seed(5));
        let end = DVec2::from(scene.landing.as_ref().unwrap().end_w);
        assert_ne!(scene.tipping_load_n(end), other.tipping_load_n(end));
        let supports = |scene: &TruthScene| scene.landing.as_ref().unwrap().supports.clone();
        assert_eq!(supports(&scene), supports(&other));
    }
}
