//! The landing section: the approach from above, and the predicted and realised outcomes.

use crate::html::{PREDICTED, REALISED, action_table};
use crate::top_view::{LegendLine, TopOutline, TopPath, TopShape, TopView, begin_legend};
use glamx::{DPose3, DVec2, DVec3};
use sms_core::{Mesh, escape_xml, length_text};
use sms_landing::{LandingOutcome, LandingPlan, LandingPrediction, QUADROTOR};
use sms_mesh::outline::{convex_outline, outline_of};
use sms_scene::{Body, BodyKind, Scene};
use sms_task::{STRIKER, Trajectory};
use sms_wash::{SPREADING_RATE, WashModel};
use std::borrow::Cow;
use std::fmt::Write;

/// Length of the picture's longer side, pixels.
const SIZE: f64 = 760.0;
/// Smallest displacement, metres, and rotation, radians, for which a body's final pose is drawn.
const STILL_M: f64 = 0.005;
const STILL_RAD: f64 = 0.02;
const WASH: &str = "#7fb7e6";
/// Number of segments of a propeller's disk.
const ROTOR_SEGMENTS: usize = 24;
const ROTOR_HALF_M: f64 = 0.002;

/// A landing for the report.
#[derive(Debug, Clone, Copy)]
pub struct LandingInput<'a> {
    /// The plan.
    pub plan: &'a LandingPlan,
    /// The executed landing, if any.
    pub realised: Option<LandingRealised<'a>>,
}

/// An executed landing.
#[derive(Debug, Clone, Copy)]
pub struct LandingRealised<'a> {
    /// Label of the target.
    pub engine: &'a str,
    /// Outcome in the target world.
    pub outcome: &'a LandingOutcome,
    /// Outcome with another wash model.
    pub second_opinion: Option<&'a LandingOutcome>,
    /// Planner's body name → target's body name.
    pub matches: &'a [(String, String)],
}

/// Returns the vehicle as a body at the start of its flight, for pictures.
fn vehicle_body(plan: &LandingPlan) -> Body {
    let vehicle = &plan.vehicle;
    let x_wv = DPose3::from_translation(plan.landing().start_w());
    let mut visual = Mesh::default();
    let rotor = |p: &DVec3| {
        Mesh::cylinder(vehicle.rotor_radius, ROTOR_HALF_M, ROTOR_SEGMENTS)
            .transformed(&DPose3::from_translation(*p))
    };
    let dark = vehicle.solids().into_iter().map(|m| (m, [52, 56, 64]));
    let light = vehicle.rotors.iter().map(|p| (rotor(p), [150, 170, 190]));
    for (mesh, color) in dark.chain(light) {
        let first = visual.vertices.len() as u32;
        visual.triangles.extend(mesh.triangles.iter().map(|t| t.map(|i| i + first)));
        visual.colors.extend(vec![color; mesh.vertices.len()]);
        visual.vertices.extend(mesh.vertices);
    }
    Body { visual, color: [52, 56, 64], ..vehicle.body(QUADROTOR, x_wv, None, sms_scene::example_material()) }
}

/// Returns the scene with the vehicle, if there is a landing.
pub(crate) fn with_vehicle<'a>(scene: &'a Scene, landing: Option<&LandingInput<'_>>) -> Cow<'a, Scene> {
    let Some(landing) = landing.filter(|_| scene.body(QUADROTOR).is_none()) else {
        return Cow::Borrowed(scene);
    };
    let mut scene = scene.clone();
    scene.bodies.push(vehicle_body(landing.plan));
    Cow::Owned(scene)
}

/// Returns the planner's name of a target's body.
pub(crate) fn planner_name(matches: &[(String, String)], name: &str) -> Option<String> {
    if name == QUADROTOR || name == STRIKER {
        return Some(name.to_owned());
    }
    matches.iter().find(|m| m.1 == name).map(|m| m.0.clone())
}

fn way(trajectory: &Trajectory) -> Vec<DVec2> {
    let track = trajectory.body(QUADROTOR);
    track.map(|t| t.states.iter().map(|s| s.x_wb.translation.truncate()).collect()).unwrap_or_default()
}

/// Returns the outline of the vehicle's feet and propellers from above.
fn vehicle_outline(plan: &LandingPlan, at: DVec2) -> Vec<DVec2> {
    let around = |center: DVec2, radius: f64| {
        (0..16).map(move |k| center + radius * DVec2::from_angle(std::f64::consts::TAU * f64::from(k) / 16.0))
    };
    let rotors =
        plan.vehicle.rotors.iter().flat_map(|p| around(at + p.truncate(), plan.vehicle.rotor_radius));
    convex_outline(&rotors.collect::<Vec<_>>())
}

fn outline_at(body: &Body, x_wb: &DPose3) -> Vec<DVec2> {
    outline_of(body.visual.vertices.iter().map(|&p| x_wb.transform_point(p)))
}

/// Returns the final pose of a body: its motion in the trajectory, applied to its pose in the scene. `None` if it did
/// not move.
fn moved_to(trajectory: &Trajectory, name: &str, body: &Body) -> Option<DPose3> {
    let states = &trajectory.body(name)?.states;
    let (first, last) = (states.first()?.x_wb, states.last()?.x_wb);
    let turn = (first.rotation.inverse() * last.rotation).xyz().length();
    let moved = first.translation.distance(last.translation) > STILL_M || 2.0 * turn > STILL_RAD;
    moved.then(|| last * first.inverse() * body.x_wb)
}

/// Draws the landing from above: structure, wash region, planned and realised paths, and the final pose of each moved
/// body.
pub(crate) fn landing_svg(scene: &Scene, landing: &LandingInput<'_>) -> Option<String> {
    let plan = landing.plan;
    let resolved = plan.landing();
    let mut bodies: Vec<&Body> =
        scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic && b.name != QUADROTOR).collect();
    // Draws supporting bodies first.
    let top = |b: &Body| b.visual.aabb().map_or(0.0, |a| b.x_wb.translation.z + a.max.z);
    bodies.sort_by(|a, b| top(a).total_cmp(&top(b)));
    let outlines: Vec<TopOutline> = bodies
        .iter()
        .map(|b| {
            let hull = outline_at(b, &b.x_wb).iter().map(DVec2::to_array).collect();
            let shape = TopShape::Polygons { polygons_w: vec![hull] };
            TopOutline { name: b.name.clone(), color: b.color, shape }
        })
        .collect();
    let flight = resolved.flight(&plan.action, &sms_landing::CarriedOut::default()).ok()?;
    let curve: Vec<DVec2> = (0..=100)
        .map(|k| flight.path().point(flight.path().length() * f64::from(k) / 100.0).0.truncate())
        .collect();
    let place = plan.action.landing();
    let all =
        curve.iter().copied().chain(outlines.iter().filter_map(TopOutline::bounds).flat_map(|(l, h)| [l, h]));
    let (low, high) = all.fold((DVec2::MAX, DVec2::MIN), |(l, h), p| (l.min(p), h.max(p)));
    let (low, high) = (low - 0.25, high + 0.25);
    let scale = SIZE / (high - low).max_element();

    // The wash region: jets spread on their way down to the platform.
    let depth = plan.task.flight.height + resolved.vehicle().standing_height();
    let reach = plan.vehicle.rotors.iter().map(|p| p.truncate().length()).fold(0.0, f64::max);
    let blown = reach + plan.vehicle.rotor_radius + SPREADING_RATE * depth;
    let swath = TopPath { width: 2.0 * blown * scale, opacity: 0.28, ..TopPath::line(curve.clone(), WASH) };
    let mut paths = vec![swath, TopPath { width: 4.0, ..TopPath::line(curve, PREDICTED) }];
    let closed = |mut points: Vec<DVec2>, color: &str, dashed: bool| {
        points.extend(points.first().copied());
        TopPath { width: 2.0, dashed, ..TopPath::line(points, color) }
    };
    paths.push(closed(vehicle_outline(plan, place), PREDICTED, false));
    for body in &bodies {
        if let Some(x_wb) = moved_to(&plan.nominal.trajectory, &body.name, body) {
            paths.push(closed(outline_at(body, &x_wb), PREDICTED, false));
        }
    }
    if let Some(realised) = landing.realised {
        let trajectory = &realised.outcome.trajectory;
        let flown = way(trajectory);
        if let Some(end) = flown.last() {
            paths.push(closed(vehicle_outline(plan, *end), REALISED, true));
        }
        paths.push(TopPath { dashed: true, ..TopPath::line(flown, REALISED) });
        for body in &bodies {
            let Some((_, there)) = realised.matches.iter().find(|m| m.0 == body.name) else { continue };
            if let Some(x_wb) = moved_to(trajectory, there, body) {
                paths.push(closed(outline_at(body, &x_wb), REALISED, true));
            }
        }
    }
    let view = TopView {
        outlines,
        paths,
        goal_w: Some(place.to_array()),
        names: true,
        window_w: Some((low, high)),
        size_px: SIZE,
        ..TopView::default()
    };
    view.svg(legend)
}

fn legend(svg: &mut String, height: f64) {
    let y = height - 14.0;
    begin_legend(svg, height, 480, 30.0);
    let line = |color, is_dashed, text| LegendLine { length: 28.0, color, is_dashed, text };
    line(PREDICTED, false, "planned").write(svg, (10.0, y));
    line(REALISED, true, "realised").write(svg, (110.0, y));
    let _ = write!(
        svg,
        "<rect x=\"212\" y=\"{:.0}\" width=\"28\" height=\"12\" fill=\"{WASH}\" fill-opacity=\"0.5\"/>\
         <text x=\"246\" y=\"{t:.0}\">wash region</text><text x=\"344\" y=\"{t:.0}\">grid 10 cm</text></g>",
        y - 6.0,
        t = y + 4.0
    );
}

/// Describes the outcome of a landing in one line.
pub(crate) fn verdict(outcome: &LandingOutcome) -> String {
    match &outcome.failure {
        None => "success".to_owned(),
        Some(failure) if outcome.is_toppled_by_wash() => format!("{failure}, by the wash alone"),
        Some(failure) => failure.to_string(),
    }
}

/// Returns the value and the note of the prediction card.
pub(crate) fn predicted_card(plan: &LandingPlan) -> (String, String) {
    match &plan.predicted {
        Some(p) => (
            format!("{:.0} % succeed", 100.0 * p.success_share),
            format!("of {} perturbed worlds; in the scanned world: {}", p.worlds, verdict(&plan.nominal)),
        ),
        None => (verdict(&plan.nominal), "in the scanned world; not tested in perturbed ones".to_owned()),
    }
}

/// Returns the tables of a landing.
pub(crate) fn landing_section(landing: &LandingInput<'_>) -> String {
    let plan = landing.plan;
    let mut html = action_table(&plan.parameters, &plan.action.values().0, 3);
    let e = plan.evaluations;
    let _ = write!(
        html,
        "<p>On {}, {} above the floor. {} simulated landings with jets, {} with particles, in {}.</p>",
        escape_xml(&plan.surface.body),
        length_text(plan.surface.top_w),
        e.jet,
        e.sph,
        escape_xml(&plan.engine)
    );
    html.push_str("<div class=\"scroll\"><table><tr><th></th><th>wash</th><th>verdict</th><th>objective</th><th>landing error</th><th>tilt</th></tr>");
    row(&mut html, "predicted, scanned world", &plan.nominal);
    if let Some(r) = landing.realised {
        row(&mut html, &format!("realised, {}", r.engine), r.outcome);
        if let Some(second) = r.second_opinion {
            row(&mut html, "… with the second wash model", second);
        }
    }
    html.push_str("</table></div>");
    bodies_table(&mut html, landing);
    if let Some(p) = &plan.predicted {
        html.push_str(&prediction_text(p));
    }
    html
}

fn row(html: &mut String, name: &str, outcome: &LandingOutcome) {
    let _ = write!(
        html,
        "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{:.1}°</td></tr>",
        escape_xml(name),
        escape_xml(&outcome.wash),
        escape_xml(&verdict(outcome)),
        outcome.objective.map_or_else(|| "–".to_owned(), |o| format!("{o:.3}")),
        length_text(outcome.landing_error_m),
        outcome.tilt_rad.to_degrees()
    );
}

fn bodies_table(html: &mut String, landing: &LandingInput<'_>) {
    html.push_str(
        "<div class=\"scroll\"><table><tr><th>structure</th><th>predicted: moved, turned</th><th>largest wash force</th>\
         <th>realised: moved, turned</th></tr>",
    );
    for change in &landing.plan.nominal.bodies {
        let there = landing.realised.and_then(|r| {
            let name = &r.matches.iter().find(|m| m.0 == change.body)?.1;
            r.outcome.bodies.iter().find(|b| b.body == *name)
        });
        let text = |b: &sms_landing::BodyChange| {
            format!("{}, {:.1}°", length_text(b.moved_m), b.turned_rad.to_degrees())
        };
        let _ = write!(
            html,
            "<tr data-body=\"{name}\"><td>{name}</td><td>{}</td><td>{:.1} N</td><td>{}</td></tr>",
            text(change),
            change.wash_peak_n,
            there.map_or_else(|| "–".to_owned(), text),
            name = escape_xml(&change.body),
        );
    }
    html.push_str("</table></div>");
}

fn model(wash: WashModel) -> &'static str {
    match wash {
        WashModel::None => "none",
        WashModel::Disk => "disks",
        WashModel::Jet => "jets",
        WashModel::Sph => "particles",
    }
}

fn prediction_text(p: &LandingPrediction) -> String {
    let failures: Vec<String> = p.failures.iter().map(|(kind, n)| format!("{kind}: {n}")).collect();
    let why = if failures.is_empty() {
        String::new()
    } else {
        format!(" Failures by kind: {}.", failures.join(", "))
    };
    let invalid = if p.invalid > 0 { format!(" {} invalid rollouts.", p.invalid) } else { String::new() };
    format!(
        "<p>In {} other worlds (wash by {}): {:.0} % succeed; objective {:.3} on average, {:.3} to {:.3} in 80 %.{}{}</p>",
        p.worlds,
        model(p.wash),
        100.0 * p.success_share,
        p.mean,
        p.q10,
        p.q90,
        escape_xml(&why),
        invalid
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::box_mass_properties;
    use sms_landing::{BodyChange, LandingEvaluations, LandingFailure, LandingTask};
    use sms_scene::BodyShape;
    use sms_sim::BodyState;
    use sms_task::BodyTrack;

    fn scene() -> Scene {
        let half = DVec3::new(0.4, 0.3, 0.3);
        let table = Body {
            name: "table".into(),
            kind: BodyKind::Dynamic,
            x_wb: DPose3::from_translation(DVec3::Z * 0.3),
            shape: BodyShape::Box { half_extents: half },
            visual: Mesh::cuboid(half),
            mass: Some(box_mass_properties(half, 300.0).unwrap()),
            ..sms_scene::floor_body(0.0, sms_scene::example_material())
        };
        Scene {
            version: sms_scene::SCENE_VERSION,
            name: "table".into(),
            gravity_w: DVec3::NEG_Z * 9.81,
            size_sigma: 0.0,
            x_world_recording: DPose3::IDENTITY,
            bodies: vec![sms_scene::floor_body(0.0, sms_scene::example_material()), table],
        }
    }

    fn outcome(body: &str, moved_m: f64, failure: Option<LandingFailure>) -> LandingOutcome {
        let state = |p_w: DVec3| BodyState {
            x_wb: DPose3::from_translation(p_w),
            v_w: DVec3::ZERO,
            w_w: DVec3::ZERO,
        };
        let track = |name: &str, from: DVec3, to: DVec3| BodyTrack {
            name: name.into(),
            states: vec![state(from), state(to)],
        };
        let change = BodyChange {
            body: body.into(),
            moved_m,
            turned_rad: 0.0,
            wash_impulse_w: DVec3::ZERO,
            wash_peak_n: 7.25,
        };
        LandingOutcome {
            engine: "e".into(),
            wash: "sph".into(),
            objective: Some(moved_m),
            failure,
            bodies: vec![change],
            landing_error_m: 0.012,
            tilt_rad: 0.0,
            speed: 0.0,
            cut_s: Some(2.0),
            touched_early: false,
            toppled_s: None,
            end_s: 3.0,
            trajectory: Trajectory {
                times_s: vec![0.0, 3.0],
                bodies: vec![
                    track(body, DVec3::Z * 0.3, DVec3::new(moved_m, 0.0, 0.3)),
                    track(QUADROTOR, DVec3::new(2.0, 0.0, 1.0), DVec3::new(0.1, 0.0, 0.65)),
                ],
            },
            particles: Vec::new(),
        }
    }

    #[test]
    fn the_picture_and_the_tables_tell_planned_from_realised() {
        let scene = scene();
        let landing = LandingTask::new([2.0, 0.0]).resolve(&scene).unwrap();
        let plan = LandingPlan {
            task: landing.task().clone(),
            engine: "rapier".into(),
            vehicle: landing.vehicle().clone(),
            surface: landing.surface().clone(),
            structure: landing.structure().to_vec(),
            parameters: landing.parameters(),
            action: landing.straight(DVec2::new(0.1, 0.0)),
            bodies: Vec::new(),
            nominal: outcome("table", 0.0, None),
            wash: sms_wash::WashSettings::default(),
            predicted: None,
            alternatives: Vec::new(),
            evaluations: LandingEvaluations::default(),
        };
        let there = outcome(
            "true_table",
            0.2,
            Some(LandingFailure::Moved { body: "true_table".into(), moved_m: 0.2 }),
        );
        let matches = [("table".to_owned(), "true_table".to_owned())];
        let realised =
            LandingRealised { engine: "physx", outcome: &there, second_opinion: None, matches: &matches };
        let planned_alone = LandingInput { plan: &plan, realised: None };
        let input = LandingInput { realised: Some(realised), ..planned_alone };

        let both = landing_svg(&scene, &input).unwrap();
        let alone = landing_svg(&scene, &planned_alone).unwrap();
        assert!(both.contains("planned") && both.contains("wash region") && both.contains(">table<"));
        // The vehicle, its path, and the final outline of the table.
        assert_eq!(both.matches("polyline").count(), alone.matches("polyline").count() + 3);
        let html = landing_section(&input);
        assert!(
            html.contains("7.2 N") && html.contains("20.00 cm, 0.0°") && html.contains("moved by 20 cm"),
            "{html}"
        );
        assert_eq!(predicted_card(&plan).0, "success");

        let shown = with_vehicle(&scene, Some(&input));
        let vehicle = shown.body(QUADROTOR).unwrap();
        assert!(
            vehicle.x_wb.translation.distance(DVec3::new(2.0, 0.0, 1.0)) < 1e-9,
            "{}",
            vehicle.x_wb.translation
        );
        assert_eq!(with_vehicle(&scene, None).bodies.len(), 2);
        assert_eq!(planner_name(&matches, "true_table").as_deref(), Some("table"));
        assert_eq!(planner_name(&matches, QUADROTOR).as_deref(), Some(QUADROTOR));
    }
}
