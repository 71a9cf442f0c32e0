//! Data of a scene's pictures, kept with its results.

use glamx::DVec2;
use serde::{Deserialize, Serialize};
use sms_report::{TopOutline, TopShape};
use sms_scene::{Body, BodyShape, Scene};
use sms_task::Trajectory;
use std::collections::BTreeMap;

/// Time between kept places, seconds.
const EVERY_S: f64 = 1.0 / 30.0;
/// Places are kept to this, metres.
const RESOLUTION_M: f64 = 1e-4;
/// Motion below this is rest in a picture, metres.
const STILL_M: f64 = 3e-3;

/// The path of one body, from above.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Way {
    /// The body; `striker` is the finger.
    pub name: String,
    /// Its centre at even times, metres in the planner's world.
    pub points_w: Vec<[f64; 2]>,
}

/// A scene from above as planned and as it is, with the robust plan's motion in both. All in the planner's world.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Drawing {
    /// Goal of the target ball, metres.
    pub goal_w: Option<[f64; 2]>,
    /// Names of cue and target ball in the planner's scene.
    pub balls: Option<[String; 2]>,
    /// Names of the true ones.
    pub true_balls: [String; 2],
    /// Outlines in the planner's scene.
    pub planned: Vec<TopOutline>,
    /// Outlines in the true scene.
    pub truth: Vec<TopOutline>,
    /// Motion as predicted.
    pub predicted: Vec<Way>,
    /// Motion as realised, by the engine's name in metrics.
    pub realised: BTreeMap<String, Vec<Way>>,
}

fn rounded(p: DVec2) -> [f64; 2] {
    [p.x, p.y].map(|v| (v / RESOLUTION_M).round() * RESOLUTION_M)
}

/// Outlines of the bodies of a scene, except floors and bodies wider than a table.
pub(super) fn outlines(scene: &Scene) -> Vec<TopOutline> {
    const WIDEST_M: f64 = 1.0;
    let outline = |body: &Body| {
        let shape = match &body.shape {
            BodyShape::HalfSpace => return None,
            BodyShape::Sphere { radius } => {
                TopShape::Disc { center_w: rounded(body.x_wb.translation.truncate()), radius: *radius }
            }
            shape => {
                let part = |mesh: &sms_core::Mesh| -> Vec<[f64; 2]> {
                    let corners = mesh.vertices.iter().map(|&p| body.x_wb.transform_point(p).truncate());
                    sms_mesh::outline::convex_outline(&corners.collect::<Vec<_>>())
                        .into_iter()
                        .map(rounded)
                        .collect()
                };
                TopShape::Polygons { polygons_w: shape.meshes().iter().map(part).collect() }
            }
        };
        let outline = TopOutline { name: body.name.clone(), color: body.color, shape };
        let wide = outline.bounds().is_none_or(|(min, max)| (max - min).max_element() > WIDEST_M);
        (!wide).then_some(outline)
    };
    scene.bodies.iter().filter_map(outline).collect()
}

/// The ways of the bodies that moved, at even times.
pub(super) fn ways(trajectory: &Trajectory) -> Vec<Way> {
    let Some(&last) = trajectory.times_s.last() else { return Vec::new() };
    let times = (0..).map(|k| f64::from(k) * EVERY_S).take_while(|t| *t <= last);
    let indices: Vec<usize> = times
        .map(|t| trajectory.times_s.partition_point(|&s| s < t).min(trajectory.times_s.len() - 1))
        .collect();
    let way = |track: &sms_task::BodyTrack| {
        let points: Vec<DVec2> =
            indices.iter().filter_map(|&i| Some(track.states.get(i)?.x_wb.translation.truncate())).collect();
        let moved = points.iter().any(|p| p.distance(points[0]) > STILL_M);
        moved.then(|| Way { name: track.name.clone(), points_w: points.into_iter().map(rounded).collect() })
    };
    trajectory.bodies.iter().filter_map(way).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DVec3};
    use sms_sim::BodyState;
    use sms_synth::FIXED_SCENES;
    use sms_target::scene_from_truth;
    use sms_task::BodyTrack;

    #[test]
    fn ways_are_thinned_evenly_and_what_rests_has_none() {
        let state = |x: f64| BodyState {
            x_wb: DPose3::from_translation(DVec3::new(x, 0.0, 0.03)),
            v_w: DVec3::ZERO,
            w_w: DVec3::ZERO,
        };
        let times_s: Vec<f64> = (0..=240).map(|i| f64::from(i) / 240.0).collect();
        let track = |name: &str, speed: f64| BodyTrack {
            name: name.into(),
            states: times_s.iter().map(|t| state(speed * t)).collect(),
        };
        let bodies = vec![track("ball", 1.0), track("box", 0.001)];
        let found = ways(&Trajectory { times_s: times_s.clone(), bodies });
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].name.as_str(), found[0].points_w.len()), ("ball", 31));
        for (k, p) in found[0].points_w.iter().enumerate() {
            assert!((p[0] - k as f64 / 30.0).abs() < 1.0 / 240.0 + RESOLUTION_M, "{k} {p:?}");
        }
    }

    #[test]
    fn outlines_enclose_the_bodies() {
        let truth = FIXED_SCENES[7].generate();
        let scene = scene_from_truth(&truth).unwrap();
        let found = outlines(&scene);
        assert_eq!(found.len(), truth.objects.len());
        for object in &truth.objects {
            let outline = found.iter().find(|o| o.name == object.name).unwrap();
            let (min, max) = outline.bounds().unwrap();
            let bounds = object.aabb_w();
            assert!(min.distance(bounds.min.truncate()) < 3e-3 && max.distance(bounds.max.truncate()) < 3e-3);
        }
    }
}
