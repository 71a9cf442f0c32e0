//! The robust plan of a scene from above: as planned, and below it as realised.

use super::{Picture, escaped};
use crate::billiards::{BilliardsScene, Row, Way};
use glamx::DVec2;
use sms_report::{TopOutline, TopPath, TopShape, TopView};

/// Colours of the ways of cue and target ball.
const COLORS: [&str; 2] = ["#c77700", "#1f5fd0"];

/// Both pictures, one above the other, `width` pixels wide. `None` where the scene has no outlines.
pub(super) fn motion_svg(s: &BilliardsScene, engine: &str, width: f64) -> Option<Picture> {
    let drawing = &s.drawing;
    let shot = s.plans.get(&Row::Robust)?.first()?;
    let cm = |v: f64| format!("{:.1} cm", 1e2 * v);
    let head = format!("{} {}", s.number, s.layout.as_str());
    let planned_title = match (&s.problem, &shot.action) {
        (Some(_), _) => format!("{head}: nothing planned"),
        (None, None) => format!("{head}: no strike found"),
        _ => format!("{head}: planned {:.1} ({})", 1e2 * shot.predicted_m, cm(shot.expected_m())),
    };
    let realised_title = match s.realised.get(engine)?.get(&Row::Robust)?.first()? {
        Some(v) => format!("realised {}", cm(*v)),
        None => "not finished by the engine".to_owned(),
    };
    let no_ways = Vec::new();
    let realised = drawing.realised.get(engine).unwrap_or(&no_ways);
    let no_balls = [String::new(), String::new()];
    let balls = drawing.balls.as_ref().unwrap_or(&no_balls);
    let mut views = [
        view(&drawing.planned, &drawing.predicted, balls, drawing.goal_w, planned_title, width),
        view(&drawing.truth, realised, &drawing.true_balls, drawing.goal_w, realised_title, width),
    ];
    // Both show the same part of the table, as high as wide.
    let windows: Vec<(DVec2, DVec2)> = views.iter().filter_map(TopView::window).collect();
    let (low, high) = windows.into_iter().reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low).max_element());
    let window = Some((middle - half, middle + half));
    views.iter_mut().for_each(|v| v.window_w = window);
    let mut inner = String::new();
    for (k, view) in views.iter().enumerate() {
        let svg = view.svg(|_, _| {})?;
        let place = format!(
            "<svg x=\"0\" y=\"{:.0}\" width=\"{width:.0}\" height=\"{width:.0}\" ",
            k as f64 * (width + 2.0)
        );
        inner.push_str(&svg.replacen("<svg ", &place, 1));
    }
    let height = 2.0 * width + 2.0;
    let svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {width:.0} {height:.0}\">{inner}</svg>"
    );
    Some(Picture { svg, height })
}

fn view(
    outlines: &[TopOutline],
    ways: &[Way],
    balls: &[String; 2],
    goal_w: Option<[f64; 2]>,
    title: String,
    size_px: f64,
) -> TopView {
    let path = |way: &Way| {
        let points: Vec<DVec2> = way.points_w.iter().map(|&p| p.into()).collect();
        if way.name == "striker" {
            return TopPath::sweep(&points);
        }
        let Some(ball) = balls.iter().position(|b| *b == way.name) else {
            return TopPath { width: 1.5, ..TopPath::line(points, "#777") };
        };
        let ghosts = outlines.iter().find(|o| o.name == way.name).and_then(|o| match o.shape {
            TopShape::Disc { radius, .. } => Some((radius, o.color)),
            TopShape::Polygons { .. } => None,
        });
        TopPath { width: 2.0, ghosts, ..TopPath::line(points, COLORS[ball]) }
    };
    TopView {
        outlines: outlines.to_vec(),
        paths: ways.iter().map(path).collect(),
        goal_w,
        names: false,
        title: escaped(&title),
        window_w: None,
        size_px,
    }
}
