//! Label images supplied with the recording.

use crate::names::{file_name, unique};
use crate::{MasksError, STAGE, Segmenter};
use serde::Deserialize;
use sms_core::{
    BACKGROUND, Cancel, Image, InputError, LabelInfo, LabelMap, Labels, MaskSource, Progress, StageContext,
    Warnings, atomic, read_png_labels,
};
use sms_frames::{Frame, Sequence};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Images with more values than this are depth or colour images instead of label images.
const MOST_OBJECTS: usize = 500;

/// Label images: grey PNGs of up to 16 bits, or palette PNGs, with 0 for the background and one value per object.
///
/// The images may be larger than the frames (the recording's native size); they are resampled by nearest neighbour
/// with pixel centres at +0.5, as in the paper's appendix. Values are renumbered from 1 in increasing order. Names
/// come from `objects.json` in the recording's folder (`objects[].{name, mask_value}`), if it exists.
#[derive(Debug, Clone, Default)]
pub struct FileMasks {
    /// Folder with one PNG per frame, named like the colour image or by the frame's index (`000000.png`); `None`
    /// takes the masks listed in the recording.
    pub dir: Option<PathBuf>,
}

/// The fields used of `objects.json` and of `truth/truth.json`; both may contain others.
#[derive(Debug, Deserialize)]
pub(crate) struct ObjectsFile {
    pub(crate) objects: Vec<MaskObject>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct MaskObject {
    pub(crate) name: String,
    #[serde(default)]
    description: String,
    mask_value: Option<u16>,
}

impl FileMasks {
    fn path_of(&self, frame: &Frame) -> Result<PathBuf, InputError> {
        if let Some(dir) = &self.dir {
            let what = || format!("there are fewer masks than frames: frame {} has none", frame.index);
            let cure = "add one label PNG per frame, named like the colour image, or use `--masks geometry`";
            let path = Some(mask_in(dir, frame)).filter(|path| path.is_file());
            return path.ok_or_else(|| InputError::new(what(), dir, cure));
        }
        frame.mask_path.clone().ok_or_else(|| {
            let index = frame.index;
            let what =
                format!("there are fewer masks than frames: the recording names none for frame {index}");
            let cure = "add `mask_path` to every frame of transforms.json, or use `--masks geometry`";
            InputError::new(what, &frame.color_path, cure)
        })
    }
}

/// Returns the mask of a frame in a folder: named like the colour image if there is such a file (a sequence with omitted
/// frames keeps the recording's file names), else by the frame's index.
pub(crate) fn mask_in(dir: &Path, frame: &Frame) -> PathBuf {
    let stem = frame.color_path.file_stem().map(|s| dir.join(s).with_extension("png"));
    stem.filter(|p| p.is_file()).unwrap_or_else(|| dir.join(format!("{:06}.png", frame.index)))
}

impl Segmenter for FileMasks {
    fn segment(&self, sequence: &Sequence, context: StageContext<'_>) -> Result<Labels, MasksError> {
        let StageContext { progress, cancel, warnings, .. } = context;
        // All paths first, to report a missing mask before minutes of reading.
        let paths = sequence.frames.iter().map(|f| self.path_of(f)).collect::<Result<Vec<_>, _>>()?;
        let maps = read_maps(sequence, &paths, progress, cancel)?;
        let named = read_objects(&sequence.source, warnings)?;
        let labels = number_labels(maps, &named, MaskSource::Files, warnings);
        if labels.objects.is_empty() {
            warnings.add(STAGE, "no_objects", "the label images are all background", "check the masks");
        }
        Ok(labels)
    }
}

/// Reads one label image per frame, resampled to the frames' size.
pub(crate) fn read_maps(
    sequence: &Sequence,
    paths: &[PathBuf],
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Vec<LabelMap>, MasksError> {
    progress.begin("reading masks", paths.len() as u64);
    let mut native = None;
    let mut maps = Vec::with_capacity(paths.len());
    for (frame, path) in sequence.frames.iter().zip(paths) {
        cancel.check()?;
        let image = read_png_labels(path)?;
        let values = value_count([&image]);
        if values > MOST_OBJECTS {
            let what = format!("this mask has {values} different values, more than a label image of objects");
            let cure = "give label images, with one value for each object; this may be a depth image";
            return Err(InputError::new(what, path, cure).into());
        }
        let first = *native.get_or_insert(image.size());
        if image.size() != first {
            return Err(wrong_size(path, image.size(), first, "the first mask").into());
        }
        if !fits(image.size(), frame.depth.size()) {
            return Err(wrong_size(path, image.size(), frame.depth.size(), "the frames of this scan").into());
        }
        maps.push(resample_nearest(&image, frame.depth.size()));
        progress.update(maps.len() as u64, "");
    }
    let values = value_count(&maps);
    if let (true, Some(first)) = (values > MOST_OBJECTS, paths.first()) {
        let what =
            format!("the masks of this sequence have {values} different values, few of them in each frame");
        let cure = "give an object the same value in all frames: these seem to be renumbered in each frame";
        return Err(InputError::new(what, first.parent().unwrap_or(first), cure).into());
    }
    progress.end(&format!("{} masks", maps.len()));
    Ok(maps)
}

/// Marks the values that occur in images, except the background's.
fn values_in<'a>(images: impl IntoIterator<Item = &'a LabelMap>) -> Vec<bool> {
    let mut seen = vec![false; 1 << 16];
    images.into_iter().flat_map(|m| &m.data).for_each(|&v| seen[usize::from(v)] = true);
    seen[usize::from(BACKGROUND)] = false;
    seen
}

/// Returns the number of values in images, without the background's.
fn value_count<'a>(images: impl IntoIterator<Item = &'a LabelMap>) -> usize {
    values_in(images).into_iter().filter(|is_there| *is_there).count()
}

fn wrong_size(path: &Path, (w, h): (usize, usize), want: (usize, usize), reference: &str) -> InputError {
    let what = format!("this mask is {w}×{h} pixels, which does not fit {reference} ({}×{})", want.0, want.1);
    InputError::new(what, path, "export the masks at the size of the recording's colour images, uncropped")
}

/// Returns whether an image can show the same view at another size: its aspect ratio is equal within the rounding to
/// whole pixels.
fn fits(have: (usize, usize), want: (usize, usize)) -> bool {
    let (sx, sy) = (have.0 as f64 / want.0 as f64, have.1 as f64 / want.1 as f64);
    let rounding = 0.5 / want.0 as f64 + 0.5 / want.1 as f64;
    have.0 > 0 && have.1 > 0 && (sx / sy - 1.0).abs() <= rounding
}

/// Resamples by nearest neighbour with pixel centres at +0.5: target pixel x gets the source pixel at (x + 0.5)·scale.
pub(crate) fn resample_nearest(image: &LabelMap, (width, height): (usize, usize)) -> LabelMap {
    if image.size() == (width, height) {
        return image.clone();
    }
    // Integer arithmetic: (2x + 1)·W / 2w never reaches W.
    let columns: Vec<usize> = (0..width).map(|x| (2 * x + 1) * image.width / (2 * width)).collect();
    let mut data = Vec::with_capacity(width * height);
    for y in 0..height {
        let row = (2 * y + 1) * image.height / (2 * height) * image.width;
        data.extend(columns.iter().map(|x| image.data[row + x]));
    }
    Image::from_vec(width, height, data)
}

/// Reads the objects of `objects.json` by mask value; returns none without the file.
fn read_objects(source: &Path, warnings: &Warnings) -> Result<BTreeMap<u16, LabelInfo>, MasksError> {
    let path = source.join("objects.json");
    if !path.is_file() {
        return Ok(BTreeMap::new());
    }
    let file: ObjectsFile = atomic::read_json(&path)?;
    let mut taken = Vec::new();
    let mut named = BTreeMap::new();
    for object in file.objects {
        let Some(value) = object.mask_value else { continue };
        if value == BACKGROUND || named.contains_key(&value) {
            let name = object.name;
            let what = format!("the mask value {value} of `{name}` is 0 (the background) or used twice");
            return Err(
                InputError::new(what, &path, "give every object its own mask value, at least 1").into()
            );
        }
        let name = unique(file_name(&object.name), &taken);
        if name != object.name {
            let message = format!("the object `{}` was renamed to `{name}`", object.name);
            warnings.add(STAGE, "renamed", message, "names must be unique and usable as file names");
        }
        taken.push(name.clone());
        let description =
            if object.description.is_empty() { object.name.replace('_', " ") } else { object.description };
        named.insert(value, LabelInfo { id: value, name, description });
    }
    Ok(named)
}

/// Renumbers the occurring values to 1, 2, … in increasing order and names them.
pub(crate) fn number_labels(
    mut maps: Vec<LabelMap>,
    named: &BTreeMap<u16, LabelInfo>,
    source: MaskSource,
    warnings: &Warnings,
) -> Labels {
    let seen = values_in(&maps);
    let mut new_id = vec![BACKGROUND; 1 << 16];
    let mut objects: Vec<LabelInfo> = Vec::new();
    let mut taken: Vec<String> = named.values().map(|o| o.name.clone()).collect();
    for value in (1..=u16::MAX).filter(|&v| seen[usize::from(v)]) {
        let id = objects.len() as u16 + 1;
        new_id[usize::from(value)] = id;
        let info = named.get(&value).cloned().unwrap_or_else(|| {
            let name = unique(format!("object_{id:02}"), &taken);
            taken.push(name.clone());
            LabelInfo { id, name, description: String::new() }
        });
        objects.push(LabelInfo { id, ..info });
    }
    for object in named.values().filter(|o| !seen[usize::from(o.id)]) {
        let message = format!("the object `{}` occurs in no mask", object.name);
        warnings.add(STAGE, "unseen_object", message, "check its `mask_value` in objects.json");
    }
    for value in maps.iter_mut().flat_map(|m| &mut m.data) {
        *value = new_id[usize::from(*value)];
    }
    Labels { maps, objects, source }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture;
    use sms_core::StageContext;
    use sms_core::write_png_gray16;

    /// A sequence of `n` frames of 8×6 with a recording in `dir` (masks of 16×12).
    fn recording(dir: &Path, n: usize) -> Sequence {
        let mut sequence = fixture::blank_sequence(n, 8, 6);
        sequence.source = dir.to_owned();
        for frame in &mut sequence.frames {
            let path = dir.join(format!("masks/{:06}.png", frame.index));
            let mut mask = Image::filled(16, 12, 0);
            mask[(3, 5)] = 132;
            mask[(9, 7)] = 48;
            mask[(0, 0)] = 7;
            write_png_gray16(&path, &mask).unwrap();
            frame.mask_path = Some(path);
            frame.color_path = dir.join(format!("color/{:06}.png", frame.index));
        }
        sequence
    }

    fn run(masks: &FileMasks, sequence: &Sequence, warnings: &Warnings) -> Result<Labels, MasksError> {
        masks.segment(sequence, StageContext::quiet(&Cancel::new(), warnings))
    }

    #[test]
    fn values_are_renumbered_named_and_resampled_by_pixel_centres() {
        let dir = tempfile::tempdir().unwrap();
        let sequence = recording(dir.path(), 2);
        std::fs::write(
            dir.path().join("objects.json"),
            r#"{"objects": [{"name": "glue_bottle", "mask_value": 48, "extents_m": [1, 2, 3]},
                            {"name": "Tea cup", "mask_value": 132}, {"name": "ghost", "mask_value": 9}]}"#,
        )
        .unwrap();
        let warnings = Warnings::new();
        let labels = run(&FileMasks::default(), &sequence, &warnings).unwrap();
        // (3, 5) and (9, 7) contain the centres of pixels (1, 2) and (4, 3) at half size; (0, 0) contains none.
        assert_eq!(labels.maps[1].size(), (8, 6));
        assert_eq!((labels.maps[1][(1, 2)], labels.maps[1][(4, 3)], labels.maps[1][(0, 0)]), (2, 1, 0));
        let names: Vec<_> =
            labels.objects.iter().map(|o| (o.id, o.name.as_str(), o.description.as_str())).collect();
        assert_eq!(names, [(1, "glue_bottle", "glue bottle"), (2, "tea_cup", "Tea cup")]);
        let codes: Vec<_> = warnings.snapshot().into_iter().map(|w| w.code).collect();
        assert_eq!(codes, ["renamed", "unseen_object"]);
        let from_dir = FileMasks { dir: Some(dir.path().join("masks")) };
        assert_eq!(run(&from_dir, &sequence, &warnings).unwrap(), labels);
    }

    #[test]
    fn resampling_keeps_every_other_size_in_range() {
        let image = Image::from_vec(7, 5, (0..35).collect());
        for (w, h) in [(7, 5), (3, 2), (14, 10), (1, 1), (5, 4)] {
            let out = resample_nearest(&image, (w, h));
            assert_eq!(out.size(), (w, h));
            let (x, y) = (w - 1, h - 1);
            let expect =
                (((x as f64 + 0.5) * 7.0 / w as f64) as usize, ((y as f64 + 0.5) * 5.0 / h as f64) as usize);
            assert_eq!(out[(x, y)], image[expect]);
        }
    }

    #[test]
    fn faults_are_input_errors_with_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let mut sequence = recording(dir.path(), 3);
        let warnings = Warnings::new();
        let fault = |masks: &FileMasks, sequence: &Sequence| match run(masks, sequence, &warnings) {
            Err(MasksError::Input(e)) => (e.path, e.what),
            other => panic!("{other:?}"),
        };
        let bytes = std::fs::read(dir.path().join("masks/000001.png")).unwrap();
        std::fs::write(dir.path().join("masks/000001.png"), &bytes[..bytes.len() / 2]).unwrap();
        let (path, _) = fault(&FileMasks::default(), &sequence);
        assert!(path.ends_with("000001.png"), "{path}");

        write_png_gray16(&dir.path().join("masks/000001.png"), &Image::filled(12, 12, 0)).unwrap();
        let other_size = fault(&FileMasks::default(), &sequence);
        let shows = |size: (usize, usize), text: &str| text.contains(&format!("{}×{}", size.0, size.1));
        assert!(other_size.0.ends_with("000001.png") && shows((12, 12), &other_size.1), "{other_size:?}");

        write_png_gray16(&dir.path().join("masks/000000.png"), &Image::filled(12, 12, 0)).unwrap();
        let other_aspect = fault(&FileMasks::default(), &sequence);
        assert!(other_aspect.0.ends_with("000000.png") && shows((8, 6), &other_aspect.1), "{other_aspect:?}");

        let depth = Image::from_vec(40, 30, (0..1200).collect());
        write_png_gray16(&dir.path().join("masks/000000.png"), &depth).unwrap();
        let no_labels = fault(&FileMasks::default(), &sequence);
        let counts = |n: usize, text: &str| text.contains(&n.to_string());
        assert!(no_labels.0.ends_with("000000.png") && counts(1199, &no_labels.1), "{no_labels:?}");

        // 192 values in each frame, all different between frames; 48 per frame survive resampling.
        for (frames, is_fine) in [(10, true), (11, false)] {
            let numbered = recording(&dir.path().join("numbered"), frames);
            for (i, frame) in numbered.frames.iter().enumerate() {
                let values = (0..192).map(|p| (1 + 200 * i + p) as u16).collect();
                write_png_gray16(frame.mask_path.as_ref().unwrap(), &Image::from_vec(16, 12, values))
                    .unwrap();
            }
            if is_fine {
                assert_eq!(run(&FileMasks::default(), &numbered, &warnings).unwrap().objects.len(), 480);
            } else {
                let renumbered = fault(&FileMasks::default(), &numbered);
                assert!(renumbered.0.ends_with("masks") && counts(528, &renumbered.1), "{renumbered:?}");
            }
        }

        std::fs::remove_file(dir.path().join("masks/000002.png")).unwrap();
        let from_dir = FileMasks { dir: Some(dir.path().join("masks")) };
        let fewer = fault(&from_dir, &sequence);
        assert!(fewer.0.ends_with("masks") && counts(2, &fewer.1), "{fewer:?}");

        sequence.frames[0].mask_path = None;
        let none = fault(&FileMasks::default(), &sequence);
        assert!(none.0.ends_with("000000.png") && counts(0, &none.1), "{none:?}");

        let good = recording(dir.path(), 1);
        let twice = r#"{"objects": [{"name": "a", "mask_value": 48}, {"name": "b", "mask_value": 48}]}"#;
        std::fs::write(dir.path().join("objects.json"), twice).unwrap();
        let (path, what) = fault(&FileMasks::default(), &good);
        assert!(path.ends_with("objects.json") && counts(48, &what), "{what}");
        std::fs::write(dir.path().join("objects.json"), "{").unwrap();
        assert!(fault(&FileMasks::default(), &good).0.ends_with("objects.json"));
    }

    #[test]
    fn a_request_to_stop_is_honoured() {
        let dir = tempfile::tempdir().unwrap();
        let sequence = recording(dir.path(), 1);
        let cancel = Cancel::new();
        cancel.cancel();
        let stopped = FileMasks::default().segment(&sequence, StageContext::quiet(&cancel, &Warnings::new()));
        assert!(matches!(stopped, Err(MasksError::Interrupted)));
    }
}
