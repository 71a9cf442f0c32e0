//! The annotated first frame of a run: masks, detections, and their names.

#[cfg(feature = "nets")]
use crate::Context;
use crate::Error;
use crate::picture::{draw_text, enlarged};
use serde::{Deserialize, Serialize};
use sms_core::{BACKGROUND, ColorImage, InputError, LabelMap, Labels, atomic, write_png_color};
use sms_frames::{Frame, Sequence};
use sms_masks::label_color;
use std::path::{Path, PathBuf};

/// File of the detections in the first frame, beside their masks.
pub(crate) const FOUND: &str = "found.json";
/// The annotated first frame, in the run's folder.
const PREVIEW: &str = "preview.png";
/// Smallest width of the annotated frame, so that its letters are legible.
const WIDE_PX: usize = 800;

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

/// Draws the annotated frame: the image, enlarged if it is small, with tinted and outlined labels, and the boxes, names
/// and scores of detections on top.
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
    // Names are drawn after all boxes, so that no box hides a name.
    for f in found {
        let [x0, y0, ..] = f.box_px.map(at);
        // The user may have renamed the object.
        let name = labels.and_then(|l| l.object(f.id)).map_or(&f.name, |o| &o.name);
        let text = format!("{name} {:.2}", f.score);
        draw_text(&mut out, (x0, y0.saturating_sub(18)), &text, 2, label_color(f.id));
    }
    out
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
    use sms_core::{LabelInfo, MaskSource};

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
        // Without detections, only labels are drawn; without labels, detections have their own names.
        let alone = annotated(&image, Some(&labels), &[]);
        assert_eq!((alone[(259, 150)], alone[(160, 160)]), ([10; 3], tint));
        let before = annotated(&image, None, &found);
        assert_eq!((before[(259, 150)], before[(160, 160)]), (color, [10; 3]));
        assert_ne!(plate(&before), plate(&out), "cup, not mug");
    }
}
