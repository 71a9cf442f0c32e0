//! Draws the planned shot from above, as SVG.

use crate::html::{PREDICTED, REALISED};
use crate::input::ReportInput;
use crate::top_view::{LegendLine, TopOutline, TopPath, TopShape, TopView, begin_legend};
use glamx::DVec2;
use sms_mesh::outline::convex_outline;
use sms_scene::{Body, BodyKind, BodyShape};
use sms_task::{STRIKER, Trajectory};
use std::fmt::Write;

/// Length of the picture's longer side, pixels.
const SIZE: f64 = 760.0;
/// Smallest displacement that is drawn, metres.
const STILL_M: f64 = 0.003;
/// Empty space between a path and the border, metres.
const MARGIN_M: f64 = 0.05;
/// Largest growth of the picture for paths, as a share of its size on each side: a ball that rolls far away must not shrink
/// the objects below half of their size.
const LARGEST_GROWTH: f64 = 0.5;
/// Height of the legend, pixels.
const LEGEND_PX: f64 = 28.0;

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

/// Draws the picture; `None` without a plan or a scene.
pub(crate) fn shot_svg(input: &ReportInput<'_>) -> Option<String> {
    let (scene, plan) = (input.scene?, input.plan?);
    let dynamic: Vec<&Body> = scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic).collect();
    let realised = input.execution.map(|e| &e.trajectory);
    let target_name = |planner: &str| -> String {
        let matched = input.execution.and_then(|e| e.matches.iter().find(|m| m.0 == planner));
        matched.map_or_else(|| planner.to_owned(), |m| m.1.clone())
    };
    let mut paths = Vec::new();
    for body in &dynamic {
        let motions = [
            (Some(&plan.trajectory), body.name.clone(), PREDICTED, false),
            (realised, target_name(&body.name), REALISED, true),
        ];
        for (trajectory, name, color, dashed) in motions {
            let Some(points) = trajectory.map(|t| path_of(t, &name)).filter(|p| p.len() > 1) else {
                continue;
            };
            if points.iter().any(|&p| (p - points[0]).length() >= STILL_M) {
                paths.push(TopPath { dashed, ..TopPath::line(points, color) });
            }
        }
    }
    let mut view = TopView {
        outlines: dynamic.iter().map(|b| outline(b)).collect(),
        goal_w: input.goal_w,
        names: true,
        size_px: SIZE,
        ..TopView::default()
    };
    view.window_w = Some(window(view.window()?, &paths));
    let strike = path_of(&plan.trajectory, STRIKER);
    if strike.len() > 1 {
        paths.push(TopPath::sweep(&strike));
    }
    view.paths = paths;
    view.svg(|svg, height| legend(svg, height, realised.is_some()))
}

/// Enlarges the region of the bodies so that the paths are inside, within limits.
fn window((low, high): (DVec2, DVec2), paths: &[TopPath]) -> (DVec2, DVec2) {
    let room = LARGEST_GROWTH * (high - low);
    let points = || paths.iter().flat_map(|p| p.points_w.iter().copied());
    let least = points().fold(low, |a, p| a.min(p - MARGIN_M)).max(low - room);
    let most = points().fold(high, |a, p| a.max(p + MARGIN_M)).min(high + room);
    (least, most)
}

fn legend(svg: &mut String, height: f64, is_executed: bool) {
    let y = height - 0.5 * LEGEND_PX;
    let width = if is_executed { 340 } else { 232 };
    begin_legend(svg, height, width, LEGEND_PX);
    let mut x = 12.0;
    let line = |color, is_dashed, text| LegendLine { length: 32.0, color, is_dashed, text };
    let lines = [line(PREDICTED, false, "predicted"), line(REALISED, true, "realised")];
    for line in lines.iter().take(1 + usize::from(is_executed)) {
        line.write(svg, (x, y));
        x += 122.0;
    }
    let _ = write!(svg, "<text x=\"{x:.0}\" y=\"{:.0}\">grid 10 cm</text></g>", y + 4.0);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_inside_the_picture_unless_they_would_shrink_it_too_much() {
        let path = |x: f64| TopPath::line(vec![DVec2::ZERO, DVec2::new(x, 0.0)], PREDICTED);
        let bodies = (DVec2::ZERO, DVec2::ONE);
        assert_eq!(window(bodies, &[]), bodies);
        assert_eq!(window(bodies, &[path(1.2)]).1, DVec2::new(1.25, 1.0));
        assert_eq!(window(bodies, &[path(-0.2)]).0, DVec2::new(-0.25, -0.05));
        assert_eq!(window(bodies, &[path(9.0)]).1, DVec2::new(1.5, 1.0));
    }
}
