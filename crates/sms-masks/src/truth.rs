//! The truth of a generated recording.

use crate::files::{ObjectsFile, mask_in, number_labels, read_maps};
use crate::names::{file_name, unique};
use crate::{MasksError, Segmenter};
use sms_core::{InputError, LabelInfo, Labels, MaskSource, StageContext, atomic};
use sms_frames::Sequence;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The masks rendered by the generator (`truth/masks/000000.png`, value = index + 1 in `truth/truth.json`'s
/// `objects`). For ablations only: the labels are marked as the truth ([`MaskSource::Truth`]).
#[derive(Debug, Clone, Default)]
pub struct TruthMasks;

impl Segmenter for TruthMasks {
    fn segment(&self, sequence: &Sequence, context: StageContext<'_>) -> Result<Labels, MasksError> {
        let StageContext { progress, cancel, warnings, .. } = context;
        let folder = sequence.source.join("truth");
        let path = folder.join("truth.json");
        if !path.is_file() {
            return Err(InputError::new(
                "this recording has no truth: only generated recordings do",
                &path,
                "use `--masks files` or `--masks geometry`",
            )
            .into());
        }
        let truth: ObjectsFile = atomic::read_json(&path)?;
        let mut taken = Vec::new();
        let mut named = BTreeMap::new();
        for (index, object) in truth.objects.iter().enumerate() {
            let name = unique(file_name(&object.name), &taken);
            taken.push(name.clone());
            let id = index as u16 + 1;
            named.insert(id, LabelInfo { id, name, description: String::new() });
        }
        let masks = folder.join("masks");
        let paths: Vec<PathBuf> = sequence.frames.iter().map(|frame| mask_in(&masks, frame)).collect();
        if let Some(missing) = paths.iter().find(|p| !p.is_file()) {
            return Err(
                InputError::new("a truth mask is missing", missing, "generate the recording again").into()
            );
        }
        let maps = read_maps(sequence, &paths, progress, cancel)?;
        Ok(number_labels(maps, &named, MaskSource::Truth, warnings))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture;
    use sms_core::{Cancel, Warnings};
    use sms_core::{Image, write_png_gray16};

    #[test]
    fn truth_is_read_in_the_objects_order_and_its_absence_is_explained() {
        let dir = tempfile::tempdir().unwrap();
        let mut sequence = fixture::blank_sequence(2, 4, 2);
        sequence.source = dir.path().to_owned();
        let warnings = Warnings::new();
        let run = |s: &Sequence| TruthMasks.segment(s, StageContext::quiet(&Cancel::new(), &warnings));
        let fails_at = |file: &str| match run(&sequence) {
            Err(MasksError::Input(e)) => assert!(e.path.ends_with(file), "{e}"),
            other => panic!("{other:?}"),
        };
        fails_at("truth.json");

        std::fs::create_dir(dir.path().join("truth")).unwrap();
        let truth = r#"{"objects": [{"name": "cue_ball", "mass": 1}, {"name": "mug"}], "seed": 3}"#;
        std::fs::write(dir.path().join("truth/truth.json"), truth).unwrap();
        fails_at("000000.png");

        for index in 0..2 {
            let mask = Image::from_vec(4, 2, vec![0, 0, 2, 2, 0, 1, 1, 0]);
            write_png_gray16(&dir.path().join(format!("truth/masks/{index:06}.png")), &mask).unwrap();
        }
        let labels = run(&sequence).unwrap();
        assert_eq!(labels.source, MaskSource::Truth);
        assert_eq!(labels.maps[1].data, [0, 0, 2, 2, 0, 1, 1, 0]);
        let names: Vec<_> = labels.objects.iter().map(|o| o.name.as_str()).collect();
        assert_eq!(names, ["cue_ball", "mug"]);
    }
}
