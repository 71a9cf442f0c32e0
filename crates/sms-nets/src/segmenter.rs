//! Masks of a sequence by the two networks: objects are detected in the first frame and tracked through the rest
//! (paper, "Object detection and segmentation").

use crate::carry::{Carried, carried_box};
use crate::objects::{NamedBox, foreign, household, label_infos};
use crate::owlv2::{ClipTokenizer, Detection, Owlv2, Owlv2Config, PixelBox, detections, suppressed};
use crate::sam2::{ObjectMask, Sam2, Sam2Config, Tracker};
use crate::{NetsError, TensorObserver, Weights, owlv2, sam2};
use candle_core::Device;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sms_core::{
    BACKGROUND, Cancel, ColorImage, CoreError, InputError, LabelMap, Labels, MaskSource, Progress,
    StageContext, Warnings, counted,
};
use sms_frames::{Frame, ReadOptions, Sequence, recorded_colors};
use sms_masks::{MasksError, Segmenter};
use std::path::{Path, PathBuf};

const STAGE: &str = "masks";
/// Longest side of the images that the networks use.
const LONG_SIDE_PX: usize = 1024;
/// Number of frames with recorded images in memory at once.
const FRAMES_AT_ONCE: usize = 16;

/// Method of tracking objects from frame to frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Track {
    /// SAM 2's memory, as in the paper.
    #[default]
    Memory,
    /// SAM 2 on each image separately, prompted with the box of the last mask, transferred by pose and depth; several
    /// times cheaper.
    Reprompt,
}

/// Settings of detection and tracking.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetsConfig {
    /// Queries, usually nouns in English.
    pub objects: Vec<String>,
    /// Smallest score of a detection. OWLv2's scores are low; its authors' examples use 0.1 to 0.3.
    pub threshold: f64,
    /// Overlap above which the lower-scoring of two detections is dropped.
    pub max_overlap: f64,
    /// Share of the image above which a detection is the scene instead of an object in it.
    pub max_area_share: f64,
    /// Greatest number of objects; the highest scores are kept.
    pub max_objects: usize,
    /// Method of tracking.
    pub track: Track,
}

impl Default for NetsConfig {
    fn default() -> Self {
        Self {
            objects: household(),
            threshold: 0.2,
            max_overlap: 0.5,
            max_area_share: 0.6,
            max_objects: 40,
            track: Track::Memory,
        }
    }
}

impl NetsConfig {
    /// Validates all settings.
    ///
    /// # Errors
    /// [`InputError`] with the first setting out of range.
    pub fn validate(&self) -> Result<(), InputError> {
        let shares = [
            ("threshold", self.threshold),
            ("max_overlap", self.max_overlap),
            ("max_area_share", self.max_area_share),
        ];
        for (name, value) in shares {
            if !(0.0..=1.0).contains(&value) {
                return Err(InputError::new(
                    format!("{name} is {value}"),
                    name,
                    "give a share between 0 and 1",
                ));
            }
        }
        Ok(())
    }
}

/// Folders with the files of the two models, with the layout of their repositories.
#[derive(Debug, Clone)]
pub struct ModelFolders {
    /// OWLv2: `config.json`, `model.safetensors`, `vocab.json`, `merges.txt`. Not needed if boxes are given.
    pub owlv2: Option<PathBuf>,
    /// SAM 2.1: `config.json`, `model.safetensors`.
    pub sam2: PathBuf,
}

/// Masks by OWLv2 and SAM 2.1.
#[derive(Debug, Clone)]
pub struct NetsMasks {
    /// Settings of detection and tracking.
    pub config: NetsConfig,
    /// Boxes in the first frame given by the user. They replace overlapping detections, and detections of the same name
    /// that contain a box or lie inside it. If `config.objects` is empty, nothing else is detected.
    pub boxes: Vec<NamedBox>,
    /// Folders of the models.
    pub models: ModelFolders,
    /// Device of the computation.
    pub device: Device,
    /// Options of reading the recording: the networks use its original images, not those resampled for the scan.
    pub read: ReadOptions,
}

/// Share of a box within another box above which it counts as inside.
const INSIDE: f64 = 0.8;

/// An object in the first frame.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectedObject {
    /// The query, or the name given by the user.
    pub name: String,
    /// Score of the detector; 1 for the user's boxes.
    pub score: f64,
    /// Its box.
    pub bbox: PixelBox,
}

impl DetectedObject {
    /// Returns whether this box, given by the user, replaces a detection: the boxes overlap, or they have the same name
    /// and one lies inside the other. Detections that users correct are often half or twice as large as the object.
    fn replaces(&self, detected: &Self, max_overlap: f64) -> bool {
        let holds = |a: &PixelBox, b: &PixelBox| a.holds(b, INSIDE);
        self.bbox.overlap(&detected.bbox) > max_overlap
            || (self.name == detected.name
                && (holds(&self.bbox, &detected.bbox) || holds(&detected.bbox, &self.bbox)))
    }
}

/// Reads a model's `config.json` and checks its kind.
fn config<T: DeserializeOwned>(folder: &Path, kinds: &[&str]) -> Result<T, NetsError> {
    let path = folder.join("config.json");
    if !path.is_file() {
        let cure = format!(
            "give a folder with config.json and model.safetensors of a model of the kind {}",
            kinds[0]
        );
        return Err(InputError::new("this folder contains no model", folder, cure).into());
    }
    let unread = |e: serde_json::Error| {
        InputError::new("this config.json cannot be read", &path, "fetch the model again").because(e)
    };
    // Parsed again from the text, so that errors have a line number.
    let text = std::fs::read_to_string(&path).map_err(CoreError::read(&path))?;
    let value: serde_json::Value = serde_json::from_str(&text).map_err(unread)?;
    let kind = value["model_type"].as_str().unwrap_or("none");
    if !kinds.contains(&kind) {
        let cure = format!("give a model of the kind {}", kinds[0]);
        return Err(InputError::new(format!("this is a model of the kind `{kind}`"), &path, cure).into());
    }
    Ok(serde_json::from_str(&text).map_err(unread)?)
}

/// Returns an error for a model with a fault in its `config.json`.
fn refuse(folder: &Path, fault: Option<String>) -> Result<(), InputError> {
    let cure = "fetch the model again, or give the folder of another one";
    fault.map_or(Ok(()), |fault| {
        let what = format!("this model cannot be built: {fault}");
        Err(InputError::new(what, folder.join("config.json"), cure))
    })
}

impl NetsMasks {
    /// Finds objects in the first frame, `image` in any resolution: the user's boxes first, then detections
    /// elsewhere by decreasing score. Boxes are in pixels of the frame, which has `size` (width, height).
    ///
    /// # Errors
    /// [`NetsError`] for unusable models and boxes outside the frame.
    pub fn find(
        &self,
        image: &ColorImage,
        size: (usize, usize),
        cancel: &Cancel,
        warnings: &Warnings,
    ) -> Result<Vec<DetectedObject>, NetsError> {
        self.config.validate()?;
        let (width, height) = size;
        let mut found = Vec::new();
        for named in &self.boxes {
            let bbox = named.bbox.clipped(width, height);
            if bbox.area() < 1.0 {
                let what = format!("the box of `{}` lies outside the first frame", named.name);
                let cure = format!("the frame has {width} × {height} pixels");
                return Err(InputError::new(what, "--box", cure).into());
            }
            found.push(DetectedObject { name: named.name.clone(), score: 1.0, bbox });
        }
        if self.config.objects.is_empty() {
            return Ok(found);
        }
        let strange = foreign(&self.config.objects);
        if !strange.is_empty() {
            warnings.add(
                STAGE,
                "foreign_query",
                format!("the detector was trained on English and will hardly find {strange:?}"),
                "name the objects in English",
            );
        }
        cancel.check()?;
        let area = width as f64 * height as f64;
        let by_hand = found.len();
        let all = suppressed(self.detect(image, size, warnings)?, self.config.max_overlap);
        for Detection { query, score, bbox } in all {
            let bbox = bbox.clipped(width, height);
            let detected = DetectedObject { name: self.config.objects[query].clone(), score, bbox };
            let is_taken = found[..by_hand].iter().any(|f| f.replaces(&detected, self.config.max_overlap));
            if !is_taken && bbox.area() >= 1.0 && bbox.area() <= self.config.max_area_share * area {
                found.push(detected);
            }
        }
        if found.len() > self.config.max_objects {
            warnings.add(
                STAGE,
                "too_many_objects",
                format!(
                    "{} objects were found; those with the {} highest scores are kept",
                    found.len(),
                    self.config.max_objects
                ),
                "raise `threshold`, or name fewer objects",
            );
            found.truncate(self.config.max_objects);
        }
        self.warn_of_missing(&found, warnings);
        if found.is_empty() {
            warnings.add(
                STAGE,
                "no_objects",
                format!("the detector found nothing above {} in the first frame", self.config.threshold),
                "lower `threshold`, use other names with --objects, or give --box",
            );
        }
        Ok(found)
    }

    /// Warns about objects in the user's list that are not among `found`. There is no warning for the default
    /// vocabulary, because most of its objects are absent.
    fn warn_of_missing(&self, found: &[DetectedObject], warnings: &Warnings) {
        let objects = &self.config.objects;
        if found.is_empty() || *objects == household() {
            return;
        }
        for name in objects.iter().filter(|o| found.iter().all(|f| f.name != **o)) {
            warnings.add(
                STAGE,
                "object_not_found",
                format!("no `{name}` was found above {} in the first frame", self.config.threshold),
                "lower `threshold`, use another name with --objects, or give its --box",
            );
        }
    }

    /// Returns all detections above the threshold.
    fn detect(
        &self,
        image: &ColorImage,
        size: (usize, usize),
        warnings: &Warnings,
    ) -> Result<Vec<Detection>, NetsError> {
        let Some(folder) = &self.models.owlv2 else {
            let cure = "give the folder of an OWLv2 model, or boxes with --box and no --objects";
            return Err(InputError::new("there is no detector", "--weights", cure).into());
        };
        let config: Owlv2Config = config(folder, &["owlv2"])?;
        refuse(folder, config.fault())?;
        let tokenizer = ClipTokenizer::open(folder, config.text_config.max_position_embeddings)?;
        let model = Owlv2::new(&config, &Weights::open(&folder.join("model.safetensors"), &self.device)?)?;
        let mut tokens = Vec::new();
        for query in &self.config.objects {
            let encoded = tokenizer.encode(query)?;
            if encoded.is_cut {
                let message = format!("`{query}` is too long for the detector and was cut");
                warnings.add(STAGE, "long_query", message, "use fewer words");
            }
            tokens.push(encoded);
        }
        let observer = &mut TensorObserver::none();
        let pixels = owlv2::pixel_values(image, config.vision_config.image_size, &self.device)?;
        let features = model.image(&pixels, observer)?;
        let heads = model.heads(&features, &model.text(&tokens, observer)?)?;
        Ok(detections(&heads.logits, &heads.boxes, size, self.config.threshold)?)
    }

    /// Returns the original images of some frames at the size that the networks need; `None` if the recording is gone.
    fn recorded(
        &self,
        sequence: &Sequence,
        frames: &[Frame],
        cancel: &Cancel,
    ) -> Result<Vec<Option<ColorImage>>, NetsError> {
        let part = Sequence {
            frames: frames.to_vec(),
            x_world_recording: sequence.x_world_recording,
            source: sequence.source.clone(),
        };
        Ok(recorded_colors(&part, &self.read, LONG_SIDE_PX, cancel)?)
    }

    fn track(
        &self,
        sequence: &Sequence,
        found: &[DetectedObject],
        progress: &dyn Progress,
        cancel: &Cancel,
        warnings: &Warnings,
    ) -> Result<Vec<LabelMap>, NetsError> {
        let folder = &self.models.sam2;
        let config: Sam2Config = config(folder, &["sam2_video", "sam2"])?;
        refuse(folder, config.fault())?;
        let model = Sam2::new(&config, &Weights::open(&folder.join("model.safetensors"), &self.device)?)?;
        let size = sequence.frames[0].color.size();
        let mut boxes: Vec<Option<PixelBox>> = found.iter().map(|f| Some(f.bbox)).collect();
        let prompts: Vec<PixelBox> = found.iter().map(|f| f.bbox).collect();
        let mut tracker = Tracker::new(&model, &prompts, size, sequence.len());
        let mut maps: Vec<LabelMap> = Vec::with_capacity(sequence.len());
        let mut last_seen: Vec<Option<usize>> = vec![None; found.len()];
        let mut recorded = Vec::new();
        progress.begin("masks by SAM 2", sequence.len() as u64);
        for (index, frame) in sequence.frames.iter().enumerate() {
            cancel.check()?;
            if index % FRAMES_AT_ONCE == 0 {
                let next = sequence.len().min(index + FRAMES_AT_ONCE);
                recorded = self.recorded(sequence, &sequence.frames[index..next], cancel)?;
            }
            let color = recorded[index % FRAMES_AT_ONCE].as_ref().unwrap_or(&frame.color);
            let pixels = sam2::pixel_values(color, config.image_size, &self.device)?;
            let features = model.encode(&pixels, &mut TensorObserver::none())?;
            let masks: Vec<Option<ObjectMask>> = match self.config.track {
                Track::Memory => {
                    tracker.next(&features, &mut TensorObserver::none())?.into_iter().map(Some).collect()
                }
                Track::Reprompt => {
                    for (i, bbox) in boxes.iter_mut().enumerate() {
                        // From the frame in which the object was last visible: it may return.
                        let Some(last) = last_seen[i] else { continue };
                        match carried_box(&sequence.frames[last], &maps[last], i as u16 + 1, frame) {
                            Carried::At(carried) => *bbox = Some(carried),
                            Carried::OutOfView => *bbox = None,
                            Carried::Unknown => {}
                        }
                    }
                    let segment = |b: &Option<PixelBox>| {
                        b.map(|b| model.segment(&features, &b, frame.color.size())).transpose()
                    };
                    boxes.iter().map(segment).collect::<candle_core::Result<_>>()?
                }
            };
            let map = labelled(&masks, frame.color.size());
            for (i, seen) in last_seen.iter_mut().enumerate() {
                if map.data.contains(&(i as u16 + 1)) {
                    *seen = Some(index);
                }
            }
            maps.push(map);
            progress.update(index as u64 + 1, &format!("frame {index}"));
        }
        progress.end(&counted(found.len(), "object", "objects"));
        for (found, seen) in found.iter().zip(last_seen) {
            let (code, message) = match seen {
                Some(last) if last + 1 == sequence.len() => continue,
                Some(last) => ("object_lost", format!("`{}` is not seen after frame {last}", found.name)),
                None => ("object_unseen", format!("of `{}` no frame shows a mask", found.name)),
            };
            warnings.add(STAGE, code, message, "check masks/, and correct its box with --box if it is wrong");
        }
        Ok(maps)
    }

    /// Applies [`NetsMasks::find`] to the first frame of `sequence`, in its original image if it still exists. This
    /// takes seconds, but tracking takes minutes, so callers can show the detections first.
    ///
    /// # Errors
    /// As [`NetsMasks::find`].
    pub fn find_first(
        &self,
        sequence: &Sequence,
        cancel: &Cancel,
        warnings: &Warnings,
    ) -> Result<Vec<DetectedObject>, MasksError> {
        let Some(first) = sequence.frames.first() else { return Ok(Vec::new()) };
        let recorded = self.recorded(sequence, &sequence.frames[..1], cancel)?;
        let image = recorded[0].as_ref().unwrap_or(&first.color);
        Ok(self.find(image, first.color.size(), cancel, warnings)?)
    }

    /// Returns labels of all frames for the objects found in the first one. The id of an object is its index in `found`
    /// plus 1. Objects without pixels keep their id and cause a warning.
    ///
    /// # Errors
    /// [`NetsError`] for an unusable model, and interruption.
    pub fn follow(
        &self,
        sequence: &Sequence,
        found: &[DetectedObject],
        progress: &dyn Progress,
        cancel: &Cancel,
        warnings: &Warnings,
    ) -> Result<Labels, MasksError> {
        let names: Vec<String> = found.iter().map(|f| f.name.clone()).collect();
        let maps = if found.is_empty() {
            let empty = |f: &Frame| LabelMap::filled(f.color.width, f.color.height, BACKGROUND);
            sequence.frames.iter().map(empty).collect()
        } else if sequence.is_empty() {
            Vec::new()
        } else {
            self.track(sequence, found, progress, cancel, warnings)?
        };
        cancel.check()?;
        Ok(Labels { maps, objects: label_infos(&names), source: MaskSource::Foundation })
    }
}

/// Gives each pixel the object with the largest logit, if above 0 (the first of equals).
fn labelled(masks: &[Option<ObjectMask>], (width, height): (usize, usize)) -> LabelMap {
    let mut map = LabelMap::filled(width, height, BACKGROUND);
    let mut best = vec![0f32; width * height];
    for (i, mask) in masks.iter().enumerate() {
        let Some(mask) = mask.as_ref().filter(|m| m.is_present()) else { continue };
        let logits = mask.resized(width, height);
        for ((label, best), logit) in map.data.iter_mut().zip(&mut best).zip(logits) {
            if logit > *best {
                (*label, *best) = (i as u16 + 1, logit);
            }
        }
    }
    map
}

impl Segmenter for NetsMasks {
    /// Mask borders of the networks are inexact by some pixels. [`sms_masks::complete`] corrects them, as for other
    /// sources.
    fn segment(&self, sequence: &Sequence, context: StageContext<'_>) -> Result<Labels, MasksError> {
        let StageContext { progress, cancel, warnings, .. } = context;
        let found = self.find_first(sequence, cancel, warnings)?;
        self.follow(sequence, &found, progress, cancel, warnings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_by_hand_replaces_the_detection_that_it_corrects_and_no_other() {
        let found = |name: &str, x0: f64, x1: f64| {
            let bbox = PixelBox { x0, y0: 0.0, x1, y1: 10.0 };
            DetectedObject { name: name.into(), score: 1.0, bbox }
        };
        let by_hand = found("mug", 10.0, 20.0);
        for (detected, expected) in [
            // Almost the same box, with another name.
            (found("bowl", 11.0, 20.0), true),
            // Four times as wide, and a fifth as wide.
            (found("mug", 0.0, 40.0), true),
            (found("mug", 12.0, 14.0), true),
            // A spoon in the mug, the table below it, and another mug beside it.
            (found("spoon", 12.0, 14.0), false),
            (found("table", 0.0, 40.0), false),
            (found("mug", 17.0, 27.0), false),
        ] {
            assert_eq!(by_hand.replaces(&detected, 0.5), expected, "{detected:?}");
        }
    }
}
