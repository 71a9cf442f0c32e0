//! A scene from above, as SVG: outlines, paths, a goal.

use crate::html::rgb;
use crate::name_text::inside;
use glamx::DVec2;
use serde::{Deserialize, Serialize};
use sms_core::escape_xml;
use std::fmt::Write;

const MARGIN_M: f64 = 0.15;
const BACKGROUND: &str = "#f4f1ea";
/// Height of names, pixels.
const NAME_PX: f64 = 15.0;

/// Outline of a body in the xy plane of the world, metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum TopShape {
    /// The disc of a ball.
    Disc {
        /// Centre.
        center_w: [f64; 2],
        /// Radius.
        radius: f64,
    },
    /// The union of convex polygons, counter-clockwise.
    Polygons {
        /// Corners of the polygons.
        polygons_w: Vec<Vec<[f64; 2]>>,
    },
}

/// A body from above.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TopOutline {
    /// Name, drawn if names are shown.
    pub name: String,
    /// Colour, sRGB.
    pub color: [u8; 3],
    /// Outline in the world.
    pub shape: TopShape,
}

impl TopOutline {
    /// Returns the smallest and largest coordinates, metres; `None` without points.
    pub fn bounds(&self) -> Option<(DVec2, DVec2)> {
        match &self.shape {
            TopShape::Disc { center_w, radius } => {
                let center = DVec2::from_array(*center_w);
                Some((center - *radius, center + *radius))
            }
            TopShape::Polygons { polygons_w } => bounds(polygons_w.iter().flatten().map(|&p| p.into())),
        }
    }
}

fn bounds(points: impl Iterator<Item = DVec2>) -> Option<(DVec2, DVec2)> {
    points.fold(None, |b, p| Some(b.map_or((p, p), |(low, high): (DVec2, DVec2)| (low.min(p), high.max(p)))))
}

/// The path of a moving body.
#[derive(Debug, Clone, PartialEq)]
pub struct TopPath {
    /// Points in the xy plane of the world, metres.
    pub points_w: Vec<DVec2>,
    /// Colour of the line, in SVG syntax.
    pub color: String,
    /// Width, pixels.
    pub width: f64,
    /// Opacity.
    pub opacity: f64,
    /// Whether the line is dashed, like realised motion beside planned motion.
    pub dashed: bool,
    /// Radius, metres, and sRGB colour of balls that are drawn along the path with increasing opacity.
    pub ghosts: Option<(f64, [u8; 3])>,
}

impl TopPath {
    /// Returns a solid line of three pixels.
    pub fn line(points_w: Vec<DVec2>, color: &str) -> Self {
        Self { points_w, color: color.to_owned(), width: 3.0, opacity: 1.0, dashed: false, ghosts: None }
    }

    /// Returns the sweep of a finger, without the jump by which it is removed afterwards.
    pub fn sweep(points_w: &[DVec2]) -> Self {
        let sweep = points_w.windows(2).take_while(|w| (w[1] - w[0]).length() < 0.05).map(|w| w[1]);
        let moving = points_w.first().copied().into_iter().chain(sweep).collect();
        Self { width: 6.0, opacity: 0.35, ..Self::line(moving, "#555") }
    }
}

/// A picture from above: x to the right, y up, with a grid of 10 cm. Paths are clipped at the border.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TopView {
    /// Outlines of the bodies.
    pub outlines: Vec<TopOutline>,
    /// Paths, drawn over the bodies.
    pub paths: Vec<TopPath>,
    /// Position of the goal, metres.
    pub goal_w: Option<[f64; 2]>,
    /// Whether the names of the bodies are shown.
    pub names: bool,
    /// Title in the upper left corner, as SVG text.
    pub title: String,
    /// The visible region, metres; by default all outlines and the goal, with a margin. Paths do not extend it, because
    /// balls may roll far beyond the goal.
    pub window_w: Option<(DVec2, DVec2)>,
    /// Length of the longer side, pixels.
    pub size_px: f64,
}

impl TopView {
    /// Returns the smallest and largest coordinates of the default visible region, metres.
    pub fn window(&self) -> Option<(DVec2, DVec2)> {
        let corners = self.outlines.iter().filter_map(TopOutline::bounds).flat_map(|(low, high)| [low, high]);
        let (low, high) = bounds(corners.chain(self.goal_w.map(DVec2::from_array)))?;
        Some((low - MARGIN_M, high + MARGIN_M))
    }

    /// Draws the picture; `None` if it is empty. `extra` appends SVG in pixel coordinates on top; its second argument
    /// is the height.
    pub fn svg(&self, extra: impl FnOnce(&mut String, f64)) -> Option<String> {
        let (min, max) = self.window_w.or_else(|| self.window())?;
        let size = max - min;
        let scale = self.size_px / size.max_element();
        let canvas = SvgCanvas { min, size, scale };
        let (w, h) = (size.x * scale, size.y * scale);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w:.0} {h:.0}\" role=\"img\" \
             aria-label=\"the scene from above\" font-family=\"system-ui,sans-serif\">\
             <rect width=\"100%\" height=\"100%\" fill=\"{BACKGROUND}\"/>"
        );
        canvas.grid(&mut svg);
        if let Some(goal) = self.goal_w {
            canvas.goal(&mut svg, goal.into());
        }
        for outline in &self.outlines {
            canvas.outline(&mut svg, outline, self.names);
        }
        for path in &self.paths {
            canvas.path(&mut svg, path);
        }
        if !self.title.is_empty() {
            let size = (self.size_px / 22.0).clamp(9.0, 16.0);
            let _ = write!(
                svg,
                "<text x=\"8\" y=\"{:.0}\" font-size=\"{size:.0}\" fill=\"#222\">{}</text>",
                1.4 * size,
                self.title
            );
        }
        extra(&mut svg, h);
        svg.push_str("</svg>");
        Some(svg)
    }
}

struct SvgCanvas {
    min: DVec2,
    size: DVec2,
    scale: f64,
}

impl SvgCanvas {
    fn at(&self, p: DVec2) -> DVec2 {
        DVec2::new((p.x - self.min.x) * self.scale, (self.size.y - (p.y - self.min.y)) * self.scale)
    }

    fn points(&self, points: impl Iterator<Item = DVec2>) -> String {
        points.map(|p| self.at(p)).map(|p| format!("{:.1},{:.1}", p.x, p.y)).collect::<Vec<_>>().join(" ")
    }

    fn grid(&self, svg: &mut String) {
        let step = 0.1;
        let lines = |from: f64, length: f64| {
            let (first, last) = ((from / step).ceil() as i64, ((from + length) / step).floor() as i64);
            (first..=last).map(move |i| i as f64 * step)
        };
        let (min, size, scale) = (self.min, self.size, self.scale);
        for x in lines(min.x, size.x) {
            let (x, h) = (self.at(DVec2::new(x, min.y)).x, size.y * scale);
            let _ =
                write!(svg, "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"0\" y2=\"{h:.1}\" stroke=\"#ddd6c8\"/>");
        }
        for y in lines(min.y, size.y) {
            let (y, w) = (self.at(DVec2::new(min.x, y)).y, size.x * scale);
            let _ =
                write!(svg, "<line y1=\"{y:.1}\" y2=\"{y:.1}\" x1=\"0\" x2=\"{w:.1}\" stroke=\"#ddd6c8\"/>");
        }
    }

    fn goal(&self, svg: &mut String, goal_w: DVec2) {
        let c = self.at(goal_w);
        for (r, color) in [(0.045, "#d33"), (0.03, "#fff"), (0.015, "#d33")] {
            let _ = write!(
                svg,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.1}\" fill=\"{color}\" fill-opacity=\"0.85\"/>",
                c.x,
                c.y,
                r * self.scale
            );
        }
    }

    fn outline(&self, svg: &mut String, outline: &TopOutline, named: bool) {
        let fill = rgb(outline.color);
        let name = escape_xml(&outline.name);
        let _ = write!(svg, "<g class=\"body\" data-body=\"{name}\"><title>{name}</title>");
        match &outline.shape {
            TopShape::Disc { center_w, radius } => {
                let c = self.at((*center_w).into());
                let _ = write!(
                    svg,
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.1}\" fill=\"{fill}\" stroke=\"#333\"/>",
                    c.x,
                    c.y,
                    radius * self.scale
                );
            }
            TopShape::Polygons { polygons_w } => {
                // Draws all edges first and the areas over them, so that the parts share one outline.
                let each: Vec<String> =
                    polygons_w.iter().map(|p| self.points(p.iter().map(|&p| p.into()))).collect();
                for points in &each {
                    let _ = write!(
                        svg,
                        "<polygon points=\"{points}\" fill=\"none\" stroke=\"#333\" stroke-width=\"2\"/>"
                    );
                }
                for points in &each {
                    let _ = write!(svg, "<polygon points=\"{points}\" fill=\"{fill}\"/>");
                }
            }
        }
        if let Some((low, high)) = outline.bounds().filter(|_| named) {
            let c = self.at(0.5 * (low + high));
            let size = (self.size.x * self.scale, self.size.y * self.scale);
            let (x, y) = inside(&outline.name, NAME_PX, (c.x, c.y + 4.0), size);
            let _ = write!(
                svg,
                "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{NAME_PX}\" text-anchor=\"middle\" fill=\"#222\" \
                 stroke=\"{BACKGROUND}\" stroke-width=\"3\" paint-order=\"stroke\">{}</text></g>",
                escape_xml(&outline.name)
            );
        } else {
            svg.push_str("</g>");
        }
    }

    fn path(&self, svg: &mut String, path: &TopPath) {
        if let Some((radius, color)) = path.ghosts {
            // Two radii apart, so that they are distinguishable.
            let mut shown: Vec<DVec2> = Vec::new();
            for &p in &path.points_w {
                if shown.last().is_none_or(|q| q.distance(p) > 2.0 * radius) {
                    shown.push(p);
                }
            }
            let count = shown.len().max(2) as f64 - 1.0;
            for (k, &p) in shown.iter().enumerate() {
                let (c, opacity) = (self.at(p), 0.15 + 0.45 * k as f64 / count);
                let _ = write!(
                    svg,
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.1}\" fill=\"{}\" stroke=\"#333\" \
                     stroke-opacity=\"0.45\" fill-opacity=\"{opacity:.2}\"/>",
                    c.x,
                    c.y,
                    radius * self.scale,
                    rgb(color)
                );
            }
        }
        let dash = if path.dashed { " stroke-dasharray=\"7 5\"" } else { "" };
        let _ = write!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" stroke-opacity=\"{}\"{dash} \
             stroke-linejoin=\"round\" stroke-linecap=\"round\"/>",
            self.points(path.points_w.iter().copied()),
            path.color,
            path.width,
            path.opacity
        );
    }
}

/// Writes the start of a legend along the lower border: a group of text with its background.
pub(crate) fn begin_legend(svg: &mut String, picture_height: f64, width: u32, height: f64) {
    let _ = write!(
        svg,
        "<g font-size=\"14\" fill=\"#333\"><rect x=\"0\" y=\"{:.0}\" width=\"{width}\" height=\"{height}\" \
         fill=\"#f4f1ea\" fill-opacity=\"0.85\"/>",
        picture_height - height
    );
}

/// A line of a legend with its text.
pub(crate) struct LegendLine {
    pub(crate) length: f64,
    pub(crate) color: &'static str,
    pub(crate) is_dashed: bool,
    pub(crate) text: &'static str,
}

impl LegendLine {
    /// Writes the line from `(x, y)` on, with its text on the right.
    pub(crate) fn write(&self, svg: &mut String, (x, y): (f64, f64)) {
        let Self { length, color, is_dashed, text } = self;
        let dash = if *is_dashed { " stroke-dasharray=\"7 5\"" } else { "" };
        let _ = write!(
            svg,
            "<line x1=\"{x:.0}\" x2=\"{:.0}\" y1=\"{y:.0}\" y2=\"{y:.0}\" stroke=\"{color}\" stroke-width=\"3\"{dash}/>\
             <text x=\"{:.0}\" y=\"{:.0}\">{text}</text>",
            x + length,
            x + length + 6.0,
            y + 4.0
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_shows_what_there_is_with_y_up() {
        let disc = |x: f64, y: f64| TopOutline {
            name: "ball".into(),
            color: [1, 2, 3],
            shape: TopShape::Disc { center_w: [x, y], radius: 0.05 },
        };
        let mut view =
            TopView { size_px: 500.0, outlines: vec![disc(0.0, 0.0), disc(0.0, 0.6)], ..TopView::default() };
        let (low, high) = view.window().unwrap();
        assert!(low.distance(DVec2::new(-0.2, -0.2)) < 1e-12 && high.distance(DVec2::new(0.2, 0.8)) < 1e-12);
        let svg = view.svg(|_, _| {}).unwrap();
        assert!(svg.contains("cx=\"100.0\" cy=\"400.0\" r=\"25.0\" fill=\"rgb(1,2,3)\""), "{svg}");
        assert!(svg.contains("cx=\"100.0\" cy=\"100.0\""), "{svg}");
        let way = (0..=6).map(|k| DVec2::new(0.0, 0.1 * f64::from(k))).collect();
        view.paths = vec![TopPath { ghosts: Some((0.05, [9, 9, 9])), ..TopPath::line(way, "#123") }];
        let svg = view.svg(|_, _| {}).unwrap();
        assert!(svg.matches("rgb(9,9,9)").count() >= 3 && svg.contains("#123"), "{svg}");
        assert!(TopView::default().svg(|_, _| {}).is_none());
    }

    #[test]
    fn a_sweep_ends_where_the_finger_is_taken_away() {
        let points: Vec<DVec2> = [0.0, 0.01, 0.02, 0.4].map(|x| DVec2::new(x, 0.0)).to_vec();
        assert_eq!(TopPath::sweep(&points).points_w.len(), 3);
    }
}
