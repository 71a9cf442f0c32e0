//! The photograph, the same with the names of the objects, and a picture of each object.

use crate::contour::{outlines, path_data};
use crate::html::{PHOTO_ID, rgb};
use crate::input::ReportInput;
use crate::name_text::{half_width, inside, lowest};
use crate::photo::{RecordedView, photo_address};
use sms_core::{BACKGROUND, ColorImage, LabelMap, counted, escape_xml};
use sms_frames::resize_color;
use std::fmt::Write;

/// Longer side of the picture of an object, pixels.
const OBJECT_SIDE: usize = 200;
/// Margin around an object in its picture, as a share of its size.
const OBJECT_MARGIN: f64 = 0.2;
/// Height of the names as a share of the picture's width: about 14 pixels in a column of half a desktop page.
const TEXT_SHARE: f64 = 1.0 / 38.0;

/// An object with a name.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Named<'a> {
    pub label: u16,
    pub name: &'a str,
    /// "cue", "target", or "".
    pub role: &'a str,
}

impl Named<'_> {
    /// Returns the colour that stands for the object in pictures and tables.
    pub(crate) fn color(&self) -> String {
        rgb(sms_masks::label_color(self.label))
    }
}

/// Returns the labelled objects: the bodies of the scene, or those of the masks if there is no scene.
pub(crate) fn objects<'a>(input: &'a ReportInput<'_>) -> Vec<Named<'a>> {
    let role = |name: &str| input.roles.iter().find(|r| r.0 == name).map_or("", |r| r.1.as_str());
    match input.scene {
        Some(scene) => scene
            .bodies
            .iter()
            .filter(|b| b.label != BACKGROUND)
            .map(|b| Named { label: b.label, name: &b.name, role: role(&b.name) })
            .collect(),
        None => input.names.iter().map(|(label, name)| Named { label: *label, name, role: "" }).collect(),
    }
}

/// Returns the section with the photograph and the labelled objects; empty without recorded views.
pub(crate) fn photo_section(input: &ReportInput<'_>) -> String {
    let Some(first) = input.recorded.first() else { return String::new() };
    let objects = objects(input);
    let (w, h) = first.photo.size();
    let address = photo_address(&first.photo);
    let mut html = format!(
        "<section id=\"section-photo\"><div class=\"photos\"><figure><img id=\"{PHOTO_ID}\" src=\"{address}\" \
         width=\"{w}\" height=\"{h}\" alt=\"photograph of the scene, frame {}\"><figcaption>Recorded: frame \
         {}</figcaption></figure>",
        first.frame_index, first.frame_index
    );
    if !objects.is_empty() {
        // The same picture again, by reference: the page contains it once.
        let _ = write!(
            html,
            "<figure><div class=\"labelled\"><img style=\"aspect-ratio:{w}/{h}\" data-copy=\"{PHOTO_ID}\" src=\"{BLANK}\" width=\"{w}\" height=\"{h}\" \
             alt=\"\">{}</div><figcaption>Recognised: {}</figcaption></figure>",
            labels_svg(&first.labels, &objects),
            counted(objects.len(), "object", "objects")
        );
    }
    html.push_str("</div>");
    html.push_str(&object_cards(input, &objects));
    html.push_str("</section>");
    html
}

/// A transparent picture of one pixel.
const BLANK: &str = "data:image/gif;base64,R0lGODlhAQABAIAAAAAAAP///yH5BAEAAAAALAAAAAABAAEAAAIBRAA7";

/// Draws the outline and the name of each object that the view shows, at the size of the label map.
fn labels_svg(labels: &LabelMap, objects: &[Named<'_>]) -> String {
    let (w, h) = (labels.width as f64, labels.height as f64);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"the names of the objects in the photograph\" \
         font-family=\"system-ui,sans-serif\">"
    );
    for object in objects {
        let path = path_data(&outlines(labels, object.label));
        if !path.is_empty() {
            let name = escape_xml(object.name);
            let color = object.color();
            let _ = write!(
                svg,
                "<path class=\"region\" data-body=\"{name}\" d=\"{path}\" fill=\"{color}\" stroke=\"{color}\" \
                 fill-rule=\"evenodd\"><title>{name}</title></path>"
            );
        }
    }
    let size = w * TEXT_SHARE;
    for (object, (x, y)) in placed_names(labels, objects, size) {
        let name = escape_xml(object.name);
        let _ = write!(
            svg,
            "<text data-body=\"{name}\" x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size:.1}\" \
             stroke-width=\"{:.1}\">{name}</text>",
            0.3 * size
        );
    }
    svg + "</svg>"
}

/// Returns the positions of names of `size` pixels: on their objects, inside the picture, and free of overlap where there is
/// room below.
fn placed_names<'a>(
    labels: &LabelMap,
    objects: &'a [Named<'a>],
    size: f64,
) -> Vec<(&'a Named<'a>, (f64, f64))> {
    let (w, h) = (labels.width as f64, labels.height as f64);
    let mut placed: Vec<(&Named<'_>, (f64, f64))> = Vec::new();
    let half = |o: &Named<'_>| half_width(o.name, size);
    for object in objects {
        let Some(center) = center_pixel(labels, object.label) else { continue };
        let (x, mut y) = inside(object.name, size, center, (w, h));
        let hits = |y: f64, placed: &[(&Named<'_>, (f64, f64))]| {
            let reach = half(object);
            placed.iter().any(|(o, (ox, oy))| (ox - x).abs() < half(o) + reach && (oy - y).abs() < size)
        };
        while hits(y, &placed) && y + size <= lowest(size, h) {
            y += 0.5 * size;
        }
        placed.push((object, (x, y)));
    }
    placed
}

/// Returns the centre of a label's pixel that is nearest to the mean of all; `None` without any.
fn center_pixel(labels: &LabelMap, label: u16) -> Option<(f64, f64)> {
    let pixels = || {
        let marked = labels.data.iter().enumerate().filter(move |(_, l)| **l == label);
        marked.map(|(i, _)| ((i % labels.width) as f64 + 0.5, (i / labels.width) as f64 + 0.5))
    };
    let count = pixels().count();
    let sum = pixels().fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1));
    let mean = (sum.0 / count.max(1) as f64, sum.1 / count.max(1) as f64);
    let distance = |p: &(f64, f64)| (p.0 - mean.0).powi(2) + (p.1 - mean.1).powi(2);
    pixels().min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

/// Returns the list of the objects, each with its picture from the view that shows most of it.
fn object_cards(input: &ReportInput<'_>, objects: &[Named<'_>]) -> String {
    if objects.is_empty() {
        return String::new();
    }
    let mut html = String::from("<ul class=\"objects\" aria-label=\"objects\">");
    for object in objects {
        let name = escape_xml(object.name);
        let role = if object.role.is_empty() {
            String::new()
        } else {
            format!(" <span class=\"tag\">{}</span>", escape_xml(object.role))
        };
        let picture = best_picture(&input.recorded, object.label).map_or_else(String::new, |p| {
            let (w, h) = p.size();
            let address = photo_address(&p);
            format!("<img src=\"{address}\" width=\"{w}\" height=\"{h}\" alt=\"{name}\">")
        });
        let _ = write!(
            html,
            "<li data-body=\"{name}\" tabindex=\"0\" style=\"--object:{}\"><div class=\"thumb\">{picture}</div>\
             <div>{name}{role}</div></li>",
            object.color()
        );
    }
    html + "</ul>"
}

/// The rectangle of a label's pixels, inclusive, and their number.
struct Extent {
    min: (usize, usize),
    max: (usize, usize),
    count: usize,
}

fn extent(labels: &LabelMap, label: u16) -> Option<Extent> {
    let mut found: Option<Extent> = None;
    for (i, _) in labels.data.iter().enumerate().filter(|(_, l)| **l == label) {
        let (x, y) = (i % labels.width, i / labels.width);
        let e = found.get_or_insert(Extent { min: (x, y), max: (x, y), count: 0 });
        e.min = (e.min.0.min(x), e.min.1.min(y));
        e.max = (e.max.0.max(x), e.max.1.max(y));
        e.count += 1;
    }
    found
}

fn best_picture(views: &[RecordedView], label: u16) -> Option<ColorImage> {
    let whole = |e: &Extent, l: &LabelMap| {
        e.min.0 > 0 && e.min.1 > 0 && e.max.0 + 1 < l.width && e.max.1 + 1 < l.height
    };
    let candidates = views.iter().filter_map(|v| Some((v, extent(&v.labels, label)?)));
    // A view that shows the whole object is better than one that cuts it at the border.
    let (view, e) = candidates.max_by_key(|(v, e)| (whole(e, &v.labels), e.count))?;
    let scale = view.photo.width as f64 / view.labels.width as f64;
    let (w, h) = ((e.max.0 + 1 - e.min.0) as f64, (e.max.1 + 1 - e.min.1) as f64);
    // A square around the object.
    let half = (0.5 + OBJECT_MARGIN) * w.max(h) * scale;
    let (x, y) = ((e.min.0 as f64 + 0.5 * w) * scale, (e.min.1 as f64 + 0.5 * h) * scale);
    let low = |c: f64| (c - half).max(0.0) as usize;
    let part = view.photo.cropped((low(x), low(y)), ((x + half) as usize, (y + half) as usize));
    let longest = part.width.max(part.height);
    let side = |n: usize| (n * OBJECT_SIDE / longest).max(1);
    let (w, h) = (side(part.width), side(part.height));
    Some(if longest > OBJECT_SIDE { resize_color(&part, w, h) } else { part })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DPose3;
    use sms_core::{Camera, Image, Intrinsics};

    fn view(labels: LabelMap, frame_index: usize) -> RecordedView {
        let (w, h) = labels.size();
        RecordedView {
            frame_index,
            held_out: false,
            camera: Camera::new(Intrinsics::from_fov(w, h, 1.0), DPose3::identity()),
            photo: Image::filled(2 * w, 2 * h, [9, 99, 9]),
            depth: Image::filled(w, h, 1.0),
            labels,
        }
    }

    fn block(label: u16, (x0, y0): (usize, usize), (x1, y1): (usize, usize)) -> LabelMap {
        let mut map = Image::filled(100, 60, 0);
        for y in y0..y1 {
            map.data[y * 100 + x0..y * 100 + x1].fill(label);
        }
        map
    }

    #[test]
    fn every_object_has_an_outline_a_name_and_a_picture() {
        let input = ReportInput {
            names: vec![(1, "duck <b>".into()), (2, "out of sight".into())],
            recorded: vec![view(block(1, (90, 10), (100, 20)), 4), view(block(1, (40, 10), (46, 16)), 9)],
            ..ReportInput::default()
        };
        let html = photo_section(&input);
        assert!(html.contains("Recorded: frame 4") && html.contains("Recognised: 2 objects"));
        assert_eq!(html.matches("class=\"region\"").count(), 1, "only what the first view shows");
        assert_eq!(html.matches("<li data-body=").count(), 2);
        assert!(html.contains("data-body=\"duck &lt;b&gt;\"") && !html.contains("duck <b>"));
        // The second view shows the whole object: pixels 80 to 92 of the photograph, and a margin of a fifth of that.
        let picture = best_picture(&input.recorded, 1).unwrap();
        assert_eq!(picture.size(), (94 - 77, 34 - 17));
        assert_eq!(photo_section(&ReportInput::default()), "");
    }

    #[test]
    fn names_stay_inside_the_picture_and_apart() {
        let mut labels = block(1, (95, 55), (100, 60));
        for (label, x) in [(2u16, 0usize), (3, 4)] {
            for y in 0..4 {
                labels.data[y * 100 + x..y * 100 + x + 4].fill(label);
            }
        }
        let named = |label, name| Named { label, name, role: "" };
        let objects =
            [named(1, "object_01"), named(2, "object_02"), named(3, "object_03"), named(4, "absent")];
        let placed = placed_names(&labels, &objects, 5.0);
        assert_eq!(placed.len(), 3);
        for (object, (x, y)) in &placed {
            let half = half_width(object.name, 5.0);
            assert!(x - half >= 0.0 && x + half <= 100.0 && *y >= 5.0 && *y <= 60.0, "{object:?} {x} {y}");
        }
        assert!((placed[1].1.1 - placed[2].1.1).abs() >= 5.0, "names of neighbours do not overlap");
    }
}
