//! `sms masks`: lists the masks of a run, and detections in its first frame.

use crate::cli::MasksArguments;
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_pipeline::Run;

pub(crate) fn run(console: &Console, a: &MasksArguments) -> anyhow::Result<()> {
    let run = Run::new(&a.run, &console.context);
    let request = a.nets.request();
    if request.is_question() {
        return Ok(run.preview_detections(&request)?);
    }
    let labels = run.masks()?;
    let count = labels.maps.len();
    for object in &labels.objects {
        let frames = labels.maps.iter().filter(|m| m.data.contains(&object.id)).count();
        let pixels = labels.maps.first().map_or(0, |m| m.data.iter().filter(|l| **l == object.id).count());
        console.say(format!(
            "{:3} {:24} in {frames} of {count} frames, {pixels} pixels in the first{}",
            object.id,
            object.name,
            if object.description.is_empty() { String::new() } else { format!(" ({})", object.description) }
        ));
    }
    if a.preview {
        let picture = run.preview_masks(&labels)?;
        console.say(format!("the first frame with its masks: {}", picture.display()));
    }
    if console.json {
        let mut metrics = Metrics::new();
        metrics.set("masks.objects", labels.objects.len()).set("masks.frames", count);
        console.print_json(&metrics)?;
    }
    Ok(())
}
