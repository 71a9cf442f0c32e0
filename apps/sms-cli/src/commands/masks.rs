//! `sms masks`: what a run's masks show.

use super::shown;
use crate::cli::Masks;
use crate::context::Context;
use sms_core::metrics::Metrics;
use sms_core::{BACKGROUND, ColorImage, InputError, LabelMap, write_png_color};
use sms_frames::Sequence;
use sms_masks::{label_color, load_labels};

pub(crate) fn run(context: &Context, a: &Masks) -> anyhow::Result<()> {
    let (frames, masks) = (a.run.join("frames"), a.run.join("masks"));
    if !masks.join("labels.json").is_file() {
        let cure = "give the folder of a run: `sms scan RECORDING --out RUN` makes one";
        return Err(InputError::new("there are no masks here", &a.run, cure).into());
    }
    let labels = load_labels(&masks)?;
    let mut metrics = Metrics::new();
    metrics.set("masks.objects", labels.objects.len()).set("masks.frames", labels.maps.len());
    for object in &labels.objects {
        let frames = labels.maps.iter().filter(|m| m.data.contains(&object.id)).count();
        let pixels = labels.maps.first().map_or(0, |m| m.data.iter().filter(|l| **l == object.id).count());
        context.say(format!(
            "{:3} {:24} in {frames} of {} frames, {pixels} pixels in the first{}",
            object.id,
            object.name,
            labels.maps.len(),
            if object.description.is_empty() { String::new() } else { format!(" ({})", object.description) }
        ));
    }
    if a.preview {
        let sequence = Sequence::load(&frames)?;
        let (Some(frame), Some(map)) = (sequence.frames.first(), labels.maps.first()) else {
            return Err(InputError::new("this run has no frames", &frames, "scan a recording").into());
        };
        let path = masks.join("preview.png");
        write_png_color(&path, &annotated(&frame.color, map))?;
        context.say(format!("the first frame with its masks: {}", shown(&path)));
    }
    if context.json {
        context.print_json(&metrics)?;
    }
    Ok(())
}

/// The image with each label's pixels tinted in its colour, and its outline in full.
fn annotated(image: &ColorImage, map: &LabelMap) -> ColorImage {
    let mut out = image.clone();
    if map.size() != image.size() {
        return out;
    }
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
