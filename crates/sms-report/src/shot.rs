//! The planned shot from above, as SVG.

use crate::page::ReportInput;
use glamx::DVec2;
use sms_core::Aabb;
use sms_scene::{Body, BodyKind, BodyShape};
use sms_task::Trajectory;
use std::fmt::Write;

/// Pixels of the picture's longer side.
const SIZE: f64 = 760.0;
const MARGIN_M: f64 = 0.15;

/// Convex hull of points in the plane, counter-clockwise (Andrew's monotone chain).
pub(crate) fn convex_hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let half = |points: &mut dyn Iterator<Item = DVec2>| {
        let mut hull: Vec<DVec2> = Vec::new();
        for p in points {
            while hull.len() >= 2 {
                let (a, b) = (hull[hull.len() - 2], hull[hull.len() - 1]);
                if (b - a).perp_dot(p - a) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(p);
        }
        hull.pop();
        hull
    };
    let mut hull = half(&mut points.iter().copied());
    hull.extend(half(&mut points.iter().rev().copied()));
    hull
}

fn footprint(body: &Body) -> Vec<DVec2> {
    match &body.shape {
        BodyShape::Sphere { .. } | BodyShape::HalfSpace => Vec::new(),
        _ => convex_hull(
            body.visual.vertices.iter().map(|&p| body.x_wb.transform_point(p).truncate()).collect(),
        ),
    }
}

fn path_of(trajectory: &Trajectory, name: &str) -> Vec<DVec2> {
    let Some(track) = trajectory.body(name) else { return Vec::new() };
    track.states.iter().map(|s| s.x_wb.translation.truncate()).collect()
}

fn rgb(c: [u8; 3]) -> String {
    format!("rgb({},{},{})", c[0], c[1], c[2])
}

/// The picture; `None` without a scene.
pub(crate) fn shot_svg(input: &ReportInput<'_>) -> Option<String> {
    let scene = input.scene?;
    let dynamic: Vec<&Body> = scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic).collect();
    let predicted = input.plan.map(|p| &p.trajectory);
    let realised = input.execution.map(|e| &e.trajectory);
    let target_name = |planner: &str| -> String {
        let matched = input.execution.and_then(|e| e.matches.iter().find(|m| m.0 == planner));
        matched.map_or_else(|| planner.to_owned(), |m| m.1.clone())
    };
    let mut extent: Vec<DVec2> = dynamic.iter().flat_map(|b| footprint(b)).collect();
    extent.extend(dynamic.iter().map(|b| b.x_wb.translation.truncate()));
    extent.extend(input.goal_w.map(|[x, y]| DVec2::new(x, y)));
    // Balls roll far beyond the scene once they have passed the goal: what happens among the objects is the shot.
    let bounds = Aabb::of_points(extent.iter().map(|p| p.extend(0.0)))?;
    let min = bounds.min.truncate() - DVec2::splat(MARGIN_M);
    let size = bounds.extents().truncate() + DVec2::splat(2.0 * MARGIN_M);
    let scale = SIZE / size.max_element();
    // x to the right, y up, as seen from above.
    let at = |p: DVec2| DVec2::new((p.x - min.x) * scale, (size.y - (p.y - min.y)) * scale);
    let polyline = |points: &[DVec2]| {
        points.iter().map(|&p| at(p)).map(|p| format!("{:.1},{:.1}", p.x, p.y)).collect::<Vec<_>>().join(" ")
    };
    let (w, h) = (size.x * scale, size.y * scale);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w:.0} {h:.0}\" role=\"img\" \
         aria-label=\"the shot from above\" font-family=\"system-ui,sans-serif\">\
         <rect width=\"100%\" height=\"100%\" fill=\"#f4f1ea\"/>"
    );
    grid(&mut svg, min, size, &at, scale);
    if let Some([x, y]) = input.goal_w {
        let c = at(DVec2::new(x, y));
        for (r, color) in [(0.045, "#d33"), (0.03, "#fff"), (0.015, "#d33")] {
            let _ = write!(
                svg,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.1}\" fill=\"{color}\" fill-opacity=\"0.85\"/>",
                c.x,
                c.y,
                r * scale
            );
        }
    }
    for body in &dynamic {
        draw_body(&mut svg, body, &at, scale, &polyline);
    }
    for body in &dynamic {
        let color = path_color(input, &body.name);
        for (trajectory, name, dash) in [
            (predicted, body.name.clone(), ""),
            (realised, target_name(&body.name), " stroke-dasharray=\"7 5\""),
        ] {
            let Some(points) = trajectory.map(|t| path_of(t, &name)).filter(|p| p.len() > 1) else {
                continue;
            };
            if points.iter().all(|&p| (p - points[0]).length() < 0.003) {
                continue;
            }
            let _ = write!(
                svg,
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"3\"{dash} \
                 stroke-linejoin=\"round\" stroke-linecap=\"round\"/>",
                polyline(&points)
            );
        }
    }
    if let Some(points) = predicted.map(|t| path_of(t, "striker")).filter(|p| p.len() > 1) {
        // The finger is taken away after its sweep; that jump is no path.
        let sweep = points.windows(2).take_while(|w| (w[1] - w[0]).length() < 0.05).map(|w| w[1]);
        let moving: Vec<DVec2> = points.first().copied().into_iter().chain(sweep).collect();
        let _ = write!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"#555\" stroke-width=\"6\" stroke-opacity=\"0.35\" \
             stroke-linecap=\"round\"/>",
            polyline(&moving)
        );
    }
    legend(&mut svg, h);
    svg.push_str("</svg>");
    Some(svg)
}

fn path_color(input: &ReportInput<'_>, name: &str) -> &'static str {
    match input.roles.iter().find(|r| r.0 == name).map(|r| r.1.as_str()) {
        Some("target") => "#1f5fd0",
        Some("cue") => "#c77700",
        _ => "#777",
    }
}

fn grid(svg: &mut String, min: DVec2, size: DVec2, at: &impl Fn(DVec2) -> DVec2, scale: f64) {
    let step = 0.1;
    let lines = |from: f64, length: f64| {
        let first = (from / step).ceil() as i64;
        let last = ((from + length) / step).floor() as i64;
        (first..=last).map(move |i| i as f64 * step)
    };
    for x in lines(min.x, size.x) {
        let p = at(DVec2::new(x, min.y));
        let _ = write!(
            svg,
            "<line x1=\"{0:.1}\" x2=\"{0:.1}\" y1=\"0\" y2=\"{1:.1}\" stroke=\"#ddd6c8\"/>",
            p.x,
            size.y * scale
        );
    }
    for y in lines(min.y, size.y) {
        let p = at(DVec2::new(min.x, y));
        let _ = write!(
            svg,
            "<line y1=\"{0:.1}\" y2=\"{0:.1}\" x1=\"0\" x2=\"{1:.1}\" stroke=\"#ddd6c8\"/>",
            p.y,
            size.x * scale
        );
    }
}

fn draw_body(
    svg: &mut String,
    body: &Body,
    at: &impl Fn(DVec2) -> DVec2,
    scale: f64,
    polyline: &impl Fn(&[DVec2]) -> String,
) {
    let fill = rgb(body.color);
    let c = at(body.x_wb.translation.truncate());
    if let BodyShape::Sphere { radius } = body.shape {
        let _ = write!(
            svg,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.1}\" fill=\"{fill}\" stroke=\"#333\"/>",
            c.x,
            c.y,
            radius * scale
        );
    } else {
        let _ = write!(
            svg,
            "<polygon points=\"{}\" fill=\"{fill}\" fill-opacity=\"0.8\" stroke=\"#333\"/>",
            polyline(&footprint(body))
        );
    }
    let _ = write!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"15\" text-anchor=\"middle\" fill=\"#222\" \
         stroke=\"#f4f1ea\" stroke-width=\"3\" paint-order=\"stroke\">{}</text>",
        c.x,
        c.y + 4.0,
        body.name
    );
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hull_of_a_square_with_inner_points_is_the_square() {
        let mut points: Vec<DVec2> =
            (0..5).flat_map(|i| (0..5).map(move |j| DVec2::new(f64::from(i), f64::from(j)))).collect();
        points.push(DVec2::new(2.0, 2.0));
        let hull = convex_hull(points);
        assert_eq!(hull.len(), 4);
        let area: f64 = (0..4).map(|i| hull[i].perp_dot(hull[(i + 1) % 4])).sum::<f64>() / 2.0;
        assert_eq!(area, 16.0, "counter-clockwise");
    }
}
