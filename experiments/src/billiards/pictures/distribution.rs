//! Predicted against realised, scene by scene, as in the paper's figure.

use super::Picture;
use crate::billiards::{BilliardsScene, Row};
use sms_core::{QuantileRule, quantile};
use std::fmt::Write as _;

const HEIGHT: f64 = 460.0;
const LEFT: f64 = 60.0;
const RIGHT: f64 = 170.0;
const TOP: f64 = 66.0;
const BOTTOM: f64 = 60.0;
/// Width of a scene's column, pixels.
const COLUMN: f64 = 58.0;
/// Upper limit of the axis, metres; values beyond it are drawn at its end.
const MOST_M: f64 = 0.8;

/// Colours of predicted and realised values.
const COLORS: [&str; 2] = ["#2a6fbb", "#d2691e"];
/// The paper's means over all starts (Table 1), metres: predicted and realised, and the baseline's realised.
const PAPER_M: [f64; 3] = [0.055, 0.205, 0.282];

/// A column for each scene with two boxes (quartiles, median) and all starts as dots: predicted on the left, realised on the
/// right; the robust plan as a diamond, the grid baseline as a cross; the paper's means as lines. `None` where no scene has
/// the row.
pub(super) fn distribution_svg(scenes: &[&BilliardsScene], row: Row, engine: &str) -> Option<Picture> {
    let there: Vec<(&BilliardsScene, Vec<f64>, Vec<f64>)> = scenes
        .iter()
        .filter_map(|s| Some((*s, s.predicted_m(row), s.realised_m(engine, row)?)))
        .filter(|(_, predicted, realised)| !predicted.is_empty() && !realised.is_empty())
        .collect();
    let single = |s: &BilliardsScene, row| s.realised_m(engine, row).and_then(|v| v.first().copied());
    let extremes = there.iter().flat_map(|(s, p, r)| {
        p.iter().chain(r).copied().chain(single(s, Row::Robust)).chain(single(s, Row::Grid))
    });
    let top_m = extremes.fold(PAPER_M[2], f64::max).min(MOST_M);
    let axis = Axis { top_m: (10.0 * top_m).ceil() / 10.0 };
    if there.is_empty() {
        return None;
    }
    let width = LEFT + COLUMN * there.len().max(6) as f64 + RIGHT;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{HEIGHT:.0}\" \
         viewBox=\"0 0 {width:.0} {HEIGHT:.0}\" role=\"img\" aria-label=\"predicted against realised\" \
         font-family=\"system-ui,sans-serif\"><rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>"
    );
    axis.draw(&mut svg, width);
    for (k, (s, predicted, realised)) in there.iter().enumerate() {
        let middle = LEFT + COLUMN * (k as f64 + 0.5);
        for (values, side) in [(predicted, 0), (realised, 1)] {
            let x = middle + if side == 0 { -12.0 } else { 12.0 };
            axis.strip(&mut svg, x, values, COLORS[side]);
        }
        if let Some(v) = single(s, Row::Robust) {
            let y = axis.y(v);
            let (l, r) = (middle + 7.0, middle + 17.0);
            let x = middle + 12.0;
            let _ = write!(
                svg,
                "<polygon points=\"{l:.1},{y:.1} {x:.1},{:.1} {r:.1},{y:.1} {x:.1},{:.1}\" fill=\"#111\"/>",
                y - 6.0,
                y + 6.0
            );
        }
        if let Some(v) = single(s, Row::Grid) {
            let (x, y) = (middle + 24.0, axis.y(v));
            let _ = write!(
                svg,
                "<path d=\"M{:.1} {:.1}l8 8m0 -8l-8 8\" stroke=\"#2e8b57\" stroke-width=\"2\"/>",
                x - 4.0,
                y - 4.0
            );
        }
        let _ = write!(
            svg,
            "<text x=\"{middle:.1}\" y=\"{:.0}\" font-size=\"13\" text-anchor=\"middle\">{}</text>\
             <text x=\"{middle:.1}\" y=\"{:.0}\" font-size=\"9\" text-anchor=\"middle\" fill=\"#666\">{}</text>",
            HEIGHT - BOTTOM + 18.0,
            s.number,
            HEIGHT - BOTTOM + 31.0,
            s.layout.as_str()
        );
    }
    legend(&mut svg, row, engine);
    svg.push_str("</svg>");
    Some(Picture { svg, height: HEIGHT })
}

struct Axis {
    top_m: f64,
}

impl Axis {
    fn y(&self, value_m: f64) -> f64 {
        let share = (value_m / self.top_m).clamp(0.0, 1.0);
        HEIGHT - BOTTOM - share * (HEIGHT - BOTTOM - TOP)
    }

    fn draw(&self, svg: &mut String, width: f64) {
        let right = width - RIGHT;
        for k in 0..=(10.0 * self.top_m).round() as u32 {
            let y = self.y(0.1 * f64::from(k));
            let _ = write!(
                svg,
                "<line x1=\"{LEFT}\" x2=\"{right:.0}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"#e4e4e4\"/>\
                 <text x=\"{:.0}\" y=\"{:.1}\" font-size=\"12\" text-anchor=\"end\">{}</text>",
                LEFT - 8.0,
                y + 4.0,
                10 * k
            );
        }
        let names = ["predicted", "realised", "baseline"];
        let colors = [COLORS[0], COLORS[1], "#2e8b57"];
        for ((value, name), color) in PAPER_M.into_iter().zip(names).zip(colors) {
            let y = self.y(value);
            let _ = write!(
                svg,
                "<line x1=\"{LEFT}\" x2=\"{right:.0}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"{color}\" \
                 stroke-dasharray=\"6 4\"/><text x=\"{:.0}\" y=\"{:.1}\" font-size=\"11\" fill=\"{color}\">\
                 paper, {name}: {:.1}</text>",
                right + 6.0,
                y + 4.0,
                1e2 * value
            );
        }
        let _ = write!(
            svg,
            "<text transform=\"translate(16 {:.0}) rotate(-90)\" font-size=\"12\" text-anchor=\"middle\">least distance to \
             the goal, cm</text>",
            0.5 * (TOP + HEIGHT - BOTTOM)
        );
    }

    /// A box from quartile to quartile with the median, and every value as a dot.
    fn strip(&self, svg: &mut String, x: f64, values: &[f64], color: &str) {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at = |q: f64| quantile(&mut sorted.clone(), q, QuantileRule::Linear).unwrap_or(f64::NAN);
        let [low, middle, high] = [0.25, 0.5, 0.75].map(|q| self.y(at(q)));
        let _ = write!(
            svg,
            "<rect x=\"{:.1}\" y=\"{high:.1}\" width=\"18\" height=\"{:.1}\" fill=\"{color}\" fill-opacity=\"0.25\" \
             stroke=\"{color}\"/><line x1=\"{:.1}\" x2=\"{:.1}\" y1=\"{middle:.1}\" y2=\"{middle:.1}\" stroke=\"{color}\" \
             stroke-width=\"2.5\"/>",
            x - 9.0,
            (low - high).max(0.5),
            x - 9.0,
            x + 9.0
        );
        for (k, &v) in values.iter().enumerate() {
            // Offsets by the golden ratio keep equal values apart.
            let offset = 14.0 * ((k as f64 * 0.618_034).fract() - 0.5);
            let _ = write!(
                svg,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2\" fill=\"{color}\" fill-opacity=\"0.7\"/>",
                x + offset,
                self.y(v)
            );
        }
    }
}

/// Writes the legend in a line above the columns.
fn legend(svg: &mut String, row: Row, engine: &str) {
    let _ = write!(
        svg,
        "<text x=\"{LEFT}\" y=\"22\" font-size=\"15\">row {}, realised in {engine}</text><g font-size=\"12\">",
        row.as_str()
    );
    let mut x = LEFT;
    for (side, name) in ["predicted", "realised"].into_iter().enumerate() {
        let _ = write!(
            svg,
            "<rect x=\"{x:.0}\" y=\"34\" width=\"12\" height=\"12\" fill=\"{c}\" fill-opacity=\"0.25\" stroke=\"{c}\"/>\
             <text x=\"{:.0}\" y=\"45\">{name}</text>",
            x + 18.0,
            c = COLORS[side]
        );
        x += 95.0;
    }
    let _ = write!(
        svg,
        "<polygon points=\"{x:.0},40 {:.0},34 {:.0},40 {:.0},46\" fill=\"#111\"/><text x=\"{:.0}\" y=\"45\">one robust \
         plan</text>",
        x + 5.0,
        x + 10.0,
        x + 5.0,
        x + 18.0
    );
    x += 130.0;
    let _ = write!(
        svg,
        "<path d=\"M{x:.0} 36l8 8m0 -8l-8 8\" stroke=\"#2e8b57\" stroke-width=\"2\"/><text x=\"{:.0}\" y=\"45\">grid \
         baseline</text></g>",
        x + 16.0
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axis_goes_up() {
        let axis = Axis { top_m: 0.4 };
        assert_eq!((axis.y(0.0), axis.y(0.4), axis.y(0.9)), (HEIGHT - BOTTOM, TOP, TOP));
        assert!(axis.y(0.1) > axis.y(0.2));
    }
}
