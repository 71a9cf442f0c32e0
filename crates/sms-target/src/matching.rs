//! Matches reconstructed bodies with true ones.

use glamx::DVec3;
use sms_core::Aabb;
use sms_scene::{Body, BodyKind, Scene};

/// Smallest intersection over union of two boxes that match.
const MIN_OVERLAP: f64 = 0.1;

/// Matches dynamic bodies by place and returns the pairs (planner's body, target's body) in the order of the planner's
/// bodies. Pairs are made greedily by the largest intersection over union of the boxes in the world, at least a tenth.
/// Each body is in at most one pair. Both scenes must be in the same world.
pub fn match_bodies(planned: &Scene, truth: &Scene) -> Vec<(String, String)> {
    let (own, other) = (boxes(planned), boxes(truth));
    let mut candidates: Vec<(f64, usize, usize)> = Vec::new();
    for (i, (_, a)) in own.iter().enumerate() {
        for (j, (_, b)) in other.iter().enumerate() {
            let overlap = intersection_over_union(a, b);
            if overlap >= MIN_OVERLAP {
                candidates.push((overlap, i, j));
            }
        }
    }
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut partner: Vec<Option<usize>> = vec![None; own.len()];
    for (_, i, j) in candidates {
        if partner[i].is_none() && !partner.contains(&Some(j)) {
            partner[i] = Some(j);
        }
    }
    let name = |(a, j): (&(&Body, Aabb), Option<usize>)| Some((a.0.name.clone(), other[j?].0.name.clone()));
    own.iter().zip(partner).filter_map(name).collect()
}

fn boxes(scene: &Scene) -> Vec<(&Body, Aabb)> {
    let dynamic = scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic);
    dynamic.filter_map(|b| Some((b, b.aabb_w()?))).collect()
}

fn intersection_over_union(a: &Aabb, b: &Aabb) -> f64 {
    let common = (a.max.min(b.max) - a.min.max(b.min)).max(DVec3::ZERO).element_product();
    let union = a.extents().element_product() + b.extents().element_product() - common;
    if union > 0.0 { common / union } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DPose3;
    use sms_core::sphere_mass_properties;
    use sms_scene::{BodyShape, SCENE_VERSION, example_material, floor_body};

    fn scene(balls: &[(&str, f64, f64)]) -> Scene {
        let ball = |&(name, x, radius): &(&str, f64, f64)| Body {
            name: name.into(),
            kind: BodyKind::Dynamic,
            x_wb: DPose3::from_translation(DVec3::new(x, 0.0, 0.03)),
            shape: BodyShape::Sphere { radius },
            mass: Some(sphere_mass_properties(DVec3::ZERO, radius, 1000.0).unwrap()),
            ..floor_body(0.0, example_material())
        };
        let floor = floor_body(0.0, example_material());
        Scene {
            version: SCENE_VERSION,
            name: "t".into(),
            gravity_w: DVec3::NEG_Z,
            size_sigma: 0.0,
            x_world_recording: DPose3::IDENTITY,
            bodies: [floor].into_iter().chain(balls.iter().map(ball)).collect(),
        }
    }

    #[test]
    fn bodies_in_the_same_place_are_matched_whatever_their_order_and_names() {
        let planned = scene(&[("ghost", 2.0, 0.03), ("a", 0.101, 0.029), ("b", 0.5, 0.03)]);
        let truth = scene(&[("target", 0.5, 0.03), ("cue", 0.1, 0.03), ("unseen", 0.9, 0.03)]);
        let pairs = match_bodies(&planned, &truth);
        assert_eq!(pairs, [("a".to_owned(), "cue".to_owned()), ("b".to_owned(), "target".to_owned())]);
    }

    #[test]
    fn the_better_of_two_candidates_wins() {
        let planned = scene(&[("far", 0.02, 0.03), ("near", 0.001, 0.03)]);
        let truth = scene(&[("ball", 0.0, 0.03)]);
        assert_eq!(match_bodies(&planned, &truth), [("near".to_owned(), "ball".to_owned())]);
    }
}
