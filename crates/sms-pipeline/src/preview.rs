//! The annotated first frame of a run: masks, detections, and their names.

#[cfg(feature = "nets")]
use crate::Context;
use crate::Error;
use crate::picture::{draw_text, enlarged, plate_size};
use serde::{Deserialize, Serialize};
use sms_core::{BACKGROUND, ColorImage, InputError, LabelInfo, LabelMap, Labels, atomic, write_png_color};
use sms_frames::{Frame, Sequence};
use sms_masks::label_color;
use std::path::{Path, PathBuf};

/// File of the detections in the first frame, beside their masks.
pub(crate) const FOUND: &str = "found.json";
/// The annotated first frame, in the run's folder.
const PREVIEW: &str = "preview.png";
/// Smallest width of the annotated frame, so that its letters are legible.
const WIDE_PX: usize = 800;
/// Width of the dots of letters, pixels of the annotated frame.
const DOT_PX: usize = 2;

/// A detection: its label, name and score, and its box in pixels of the first frame (left, top, right, bottom).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct FoundBox {
    pub(crate) id: u16,
    pub(crate) name: String,
    pub(crate) score: f64,
    pub(crate) box_px: [f64; 4],
}

/// Writes the first frame with masks and, if there are any, detections; returns the picture's path.
pub(crate) fn write_masks_preview(run: &Path, labels: &Labels) -> Result<PathBuf, Error> {
    let sequence = Sequence::load(&run.join("frames"))?;
    let path = run.join("masks").join(FOUND);
    let found = if path.is_file() { atomic::read_json(&path)? } else { Vec::new() };
    write_preview(run, first(&sequence)?, Some(labels), &found)
}

/// Reports and draws the detections in the first frame, in the format of `--box`.
#[cfg(feature = "nets")]
pub(crate) fn show_found(
    context: &Context,
    run: &Path,
    sequence: &Sequence,
    found: &[FoundBox],
) -> Result<(), Error> {
    for f in found {
        let [x0, y0, x1, y1] = f.box_px;
        context.message(format!(
            "{:.2} {:24} --box \"{}={x0:.0},{y0:.0},{x1:.0},{y1:.0}\"",
            f.score, f.name, f.name
        ));
    }
    let path = write_preview(run, first(sequence)?, None, found)?;
    context.message(format!("{} found in the first frame: {}", found.len(), path.display()));
    Ok(())
}

fn first(sequence: &Sequence) -> Result<&Frame, InputError> {
    let none = || InputError::new("this run has no frames", &sequence.source, "scan a recording");
    sequence.frames.first().ok_or_else(none)
}

/// Writes the annotated frame into the run's folder and returns its path.
fn write_preview(
    run: &Path,
    frame: &Frame,
    labels: Option<&Labels>,
    found: &[FoundBox],
) -> Result<PathBuf, Error> {
    let path = run.join(PREVIEW);
    write_png_color(&path, &annotated(&frame.color, labels, found))?;
    Ok(path)
}

/// Draws the annotated frame: the image, enlarged if it is small, with tinted and outlined labels, and on top the names of
/// the objects, and the boxes and scores of detections.
fn annotated(image: &ColorImage, labels: Option<&Labels>, found: &[FoundBox]) -> ColorImage {
    let map = labels.and_then(|l| l.maps.first()).filter(|m| m.size() == image.size());
    let tinted = map.map(|map| tinted(image, map));
    let factor = WIDE_PX.div_ceil(image.width.max(1)).clamp(1, 8);
    let mut out = enlarged(tinted.as_ref().unwrap_or(image), factor);
    let at = |v: f64| (v.max(0.0) * factor as f64).round() as usize;
    for f in found {
        let [x0, y0, x1, y1] = f.box_px.map(at);
        out.draw_box((x0, y0), (x1, y1), 2, label_color(f.id));
    }
    // Names are drawn after all regions and boxes, so that none of these hides a name.
    for object in labels.iter().flat_map(|l| &l.objects) {
        // The plate of a detection has the name already.
        let is_found = found.iter().any(|f| f.id == object.id);
        let Some((x, y)) = map.and_then(|map| top_center(map, object.id)).filter(|_| !is_found) else {
            continue;
        };
        draw_name(&mut out, object, (x * factor as f64, y * factor as f64));
    }
    for f in found {
        let [x0, y0, ..] = f.box_px.map(at);
        // The user may have renamed the object.
        let name = labels.and_then(|l| l.object(f.id)).map_or(&f.name, |o| &o.name);
        let text = format!("{name} {:.2}", f.score);
        let above = y0.saturating_sub(plate_size(&text, DOT_PX).1);
        draw_text(&mut out, (x0, above), &text, DOT_PX, label_color(f.id));
    }
    out
}

/// Draws the name of an object above a point of the annotated frame; where there is no room, inside the frame.
fn draw_name(out: &mut ColorImage, object: &LabelInfo, (x, y): (f64, f64)) {
    let (width, height) = plate_size(&object.name, DOT_PX);
    let corner = ((x - 0.5 * width as f64).max(0.0) as usize, (y - height as f64).max(0.0) as usize);
    draw_text(out, corner, &object.name, DOT_PX, label_color(object.id));
}

/// Returns the middle of the upper edge of the rectangle around a label's pixels; `None` without any.
fn top_center(map: &LabelMap, label: u16) -> Option<(f64, f64)> {
    let marked = map.data.iter().enumerate().filter(|(_, l)| **l == label);
    let places = marked.map(|(i, _)| (i % map.width, i / map.width));
    let extent = places.fold(None, |extent, (x, y)| {
        let (left, right, top) = extent.unwrap_or((x, x, y));
        Some((x.min(left), x.max(right), y.min(top)))
    });
    extent.map(|(left, right, top): (usize, usize, usize)| (0.5 * (left + right + 1) as f64, top as f64))
}

/// Tints each label's pixels in its colour and draws its outline opaquely.
fn tinted(image: &ColorImage, map: &LabelMap) -> ColorImage {
    let mut out = image.clone();
    for y in 0..map.height {
        for x in 0..map.width {
            let label = map[(x, y)];
            if label == BACKGROUND {
                continue;
            }
            let (x_px, y_px) = (x as i64, y as i64);
            let beside = [(-1, 0), (1, 0), (0, -1), (0, 1)];
            let is_edge = beside.iter().any(|(dx, dy)| map.get(x_px + dx, y_px + dy) != Some(&label));
            let color = label_color(label);
            let pixel = &mut out[(x, y)];
            for (value, tint) in pixel.iter_mut().zip(color) {
                *value = if is_edge { tint } else { ((u16::from(*value) + u16::from(tint)) / 2) as u8 };
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::MaskSource;

    #[test]
    fn boxes_stand_where_they_were_found_and_labels_are_tinted() {
        let image = ColorImage::filled(400, 250, [10; 3]);
        let mut map = LabelMap::filled(400, 250, BACKGROUND);
        for y in 60..100 {
            (60..120).for_each(|x| map[(x, y)] = 1);
        }
        let objects = vec![LabelInfo { id: 1, name: "mug".into(), description: String::new() }];
        let labels = Labels { maps: vec![map], objects, source: MaskSource::Foundation };
        let found = [FoundBox { id: 1, name: "cup".into(), score: 0.83, box_px: [50.0, 55.0, 130.0, 110.0] }];
        let color = label_color(1);
        let out = annotated(&image, Some(&labels), &found);
        assert_eq!(out.size(), (800, 500));
        // Pixels on the box, on the outline of the mask, in the mask, and outside of both.
        assert_eq!((out[(259, 150)], out[(120, 150)]), (color, color));
        let tint = color.map(|c| ((10 + u16::from(c)) / 2) as u8);
        assert_eq!((out[(160, 160)], out[(110, 150)], out[(300, 150)]), (tint, [10; 3], [10; 3]));
        // The plate with the name and the score is above the box.
        let plate = |out: &ColorImage| -> Vec<[u8; 3]> {
            (92..110).flat_map(|y| (100..196).map(move |x| (x, y))).map(|at| out[at]).collect()
        };
        assert!(plate(&out).iter().all(|c| *c == color || *c == [0; 3] || *c == [255; 3]));
        // The object has no second name, which would begin at (161, 102).
        assert_eq!(out[(161, 115)], [10; 3]);
        // Without detections, labels have their names above them: 38 × 18 pixels, centred.
        let alone = annotated(&image, Some(&labels), &[]);
        assert_eq!((alone[(259, 150)], alone[(160, 160)]), ([10; 3], tint));
        let name: Vec<[u8; 3]> =
            (102..120).flat_map(|y| (161..199).map(move |x| (x, y))).map(|at| alone[at]).collect();
        let ink = if color.iter().map(|&c| u32::from(c)).sum::<u32>() > 330 { [0; 3] } else { [255; 3] };
        assert!(name.iter().all(|c| *c == color || *c == ink) && name.contains(&ink));
        let around = [(160, 110), (199, 110), (180, 101)].map(|at| alone[at]);
        assert_eq!(around, [[10; 3]; 3]);
        // Without labels, detections have their own names.
        let before = annotated(&image, None, &found);
        assert_eq!((before[(259, 150)], before[(160, 160)]), (color, [10; 3]));
        assert_ne!(plate(&before), plate(&out), "cup, not mug");
    }

    #[test]
    fn every_visible_object_is_named_within_the_frame() {
        let image = ColorImage::filled(400, 250, [10; 3]);
        let mut map = LabelMap::filled(400, 250, BACKGROUND);
        (0..3).for_each(|y| map[(0, y)] = 1);
        (247..250).for_each(|y| map[(399, y)] = 2);
        let object = |id, name: &str| LabelInfo { id, name: name.into(), description: String::new() };
        let objects = vec![object(1, "mug"), object(2, "glue_bottle"), object(3, "hidden")];
        let labels = Labels { maps: vec![map], objects, source: MaskSource::Geometry };
        let out = annotated(&image, Some(&labels), &[]);
        // The plates lie in the upper left corner, and above the object at the right border.
        assert_eq!((out[(0, 17)], out[(37, 0)], out[(38, 10)]), (label_color(1), label_color(1), [10; 3]));
        let width = plate_size("glue_bottle", DOT_PX).0;
        assert_eq!((out[(800 - width, 480)], out[(799 - width, 480)]), (label_color(2), [10; 3]));
        assert_eq!(top_center(&labels.maps[0], 2), Some((399.5, 247.0)));
        assert_eq!(top_center(&labels.maps[0], 3), None);
        // Nothing else is drawn but the second object, of 2 × 6 pixels; the plate of the first one covers it.
        let drawn = out.data.iter().filter(|c| **c != [10; 3]).count();
        assert_eq!(drawn, 18 * (38 + width) + 2 * 6);
    }
}
