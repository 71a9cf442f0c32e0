//! Draws the planned shot from above, as SVG.

use crate::input::ReportInput;
use crate::top_view::{TopOutline, TopPath, TopShape, TopView};
use glamx::DVec2;
use sms_mesh::outline::convex_outline;
use sms_scene::{Body, BodyKind, BodyShape};
use sms_task::Trajectory;
use std::fmt::Write;

/// Length of the picture's longer side, pixels.
const SIZE: f64 = 760.0;
/// Smallest displacement that is drawn, metres.
const STILL_M: f64 = 0.003;

fn outline(body: &Body) -> TopOutline {
    let shape = match &body.shape {
        BodyShape::Sphere { radius } => {
            TopShape::Disc { center_w: body.x_wb.translation.truncate().to_array(), radius: *radius }
        }
        _ => {
            let corners = body.visual.vertices.iter().map(|&p| body.x_wb.transform_point(p).truncate());
            let hull = convex_outline(&corners.collect::<Vec<_>>());
            TopShape::Polygons { polygons_w: vec![hull.iter().map(DVec2::to_array).collect()] }
        }
    };
    TopOutline { name: body.name.clone(), color: body.color, shape }
}

fn path_of(trajectory: &Trajectory, name: &str) -> Vec<DVec2> {
    let Some(track) = trajectory.body(name) else { return Vec::new() };
    track.states.iter().map(|s| s.x_wb.translation.truncate()).collect()
}

/// Draws the picture; `None` without a scene.
pub(crate) fn shot_svg(input: &ReportInput<'_>) -> Option<String> {
    let scene = input.scene?;
    let dynamic: Vec<&Body> = scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic).collect();
    let predicted = input.plan.map(|p| &p.trajectory);
    let realised = input.execution.map(|e| &e.trajectory);
    let target_name = |planner: &str| -> String {
        let matched = input.execution.and_then(|e| e.matches.iter().find(|m| m.0 == planner));
        matched.map_or_else(|| planner.to_owned(), |m| m.1.clone())
    };
    let mut paths = Vec::new();
    for body in &dynamic {
        let color = path_color(input, &body.name);
        for (trajectory, name, dashed) in
            [(predicted, body.name.clone(), false), (realised, target_name(&body.name), true)]
        {
            let Some(points) = trajectory.map(|t| path_of(t, &name)).filter(|p| p.len() > 1) else {
                continue;
            };
            if points.iter().any(|&p| (p - points[0]).length() >= STILL_M) {
                paths.push(TopPath { dashed, ..TopPath::line(points, color) });
            }
        }
    }
    if let Some(points) = predicted.map(|t| path_of(t, "striker")).filter(|p| p.len() > 1) {
        paths.push(TopPath::sweep(&points));
    }
    let view = TopView {
        outlines: dynamic.iter().map(|b| outline(b)).collect(),
        paths,
        goal_w: input.goal_w,
        names: true,
        size_px: SIZE,
        ..TopView::default()
    };
    view.svg(legend)
}

fn path_color(input: &ReportInput<'_>, name: &str) -> &'static str {
    match input.roles.iter().find(|r| r.0 == name).map(|r| r.1.as_str()) {
        Some("target") => "#1f5fd0",
        Some("cue") => "#c77700",
        _ => "#777",
    }
}

fn legend(svg: &mut String, height: f64) {
    let y = height - 14.0;
    let _ = write!(
        svg,
        "<g font-size=\"14\" fill=\"#333\"><line x1=\"12\" x2=\"44\" y1=\"{y:.0}\" y2=\"{y:.0}\" stroke=\"#1f5fd0\" \
         stroke-width=\"3\"/><text x=\"50\" y=\"{t:.0}\">predicted</text><line x1=\"134\" x2=\"166\" y1=\"{y:.0}\" \
         y2=\"{y:.0}\" stroke=\"#1f5fd0\" stroke-width=\"3\" stroke-dasharray=\"7 5\"/><text x=\"172\" \
         y=\"{t:.0}\">realised</text><text x=\"250\" y=\"{t:.0}\">grid 10 cm</text></g>",
        t = y + 4.0
    );
}
