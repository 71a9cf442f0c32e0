//! A loaded sequence on disk, so that later stages need not read the recording again.
//!
//! `sequence.json` holds the human-readable part: cameras, the world alignment, links to the recording's files.
//! `color/NNNNNN.png` is the resampled colour, and `geometry.bin` the depth and normals, bit for bit: a magic line,
//! then for each frame two deflated blocks, each after its length (u64, little endian).

use crate::normals::NORMAL_GRID;
use crate::rigid::pose_to_rows;
use crate::{DepthNoise, Frame, FramesError, Sequence, evenly_spread};
use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use glamx::DPose3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::{
    Camera, CoreError, DepthImage, Image, InputError, NormalImage, atomic, read_png_color, write_png_color,
};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const VERSION: u32 = 2;
const ATTACHED: &str = "attached.png";
const MAGIC: &[u8; 16] = b"sms geometry 1\r\n";

#[derive(Serialize, Deserialize)]
struct SequenceFile {
    version: u32,
    source: PathBuf,
    /// `X_world_recording`, 4 × 4 rows, for readers of the file.
    x_world_recording: [[f64; 4]; 4],
    /// The same pose, bit for bit.
    x_world_recording_pose: DPose3,
    settings: serde_json::Value,
    /// Image of the pixels that show something attached to the camera: white.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    attached: Option<String>,
    frames: Vec<FrameEntry>,
}

/// Read first: other versions have other fields.
#[derive(Deserialize)]
struct Version {
    version: u32,
}

#[derive(Serialize, Deserialize)]
struct FrameEntry {
    index: usize,
    time_s: Option<f64>,
    color: String,
    color_path: PathBuf,
    mask_path: Option<PathBuf>,
    camera: Camera,
    depth_noise: DepthNoise,
    /// Colour as recorded over the saved colour, per channel.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    gain: [f32; 3],
}

fn one() -> [f32; 3] {
    [1.0; 3]
}

fn is_one(gain: &[f32; 3]) -> bool {
    *gain == one()
}

impl Sequence {
    /// Writes the sequence and the settings that it was loaded with; [`Sequence::load`] gives back the same bits.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn save_with_settings<T: Serialize>(&self, dir: &Path, settings: &T) -> Result<(), FramesError> {
        let name = |f: &Frame| format!("color/{:06}.png", f.index);
        let written: Vec<Result<(), FramesError>> =
            self.frames.par_iter().map(|f| write_png_color(&dir.join(name(f)), &f.color)).collect();
        written.into_iter().collect::<Result<(), _>>()?;
        let attached = self.frames.iter().find_map(|f| f.attached.as_ref());
        if let Some(pixels) = attached {
            write_png_color(&dir.join(ATTACHED), &pixels.map(|&is| if is { [255; 3] } else { [0; 3] }))?;
        }
        let geometry = geometry_file(dir);
        let blocks: Vec<std::io::Result<[Vec<u8>; 2]>> = self
            .frames
            .par_iter()
            .map(|f| Ok([deflate(&depth_bytes(&f.depth))?, deflate(&normal_bytes(&f.normal_c))?]))
            .collect();
        let blocks: Vec<[Vec<u8>; 2]> =
            blocks.into_iter().collect::<Result<_, _>>().map_err(CoreError::write(&geometry))?;
        atomic::write_with(&geometry, |w| {
            w.write_all(MAGIC)?;
            for block in blocks.iter().flatten() {
                w.write_all(&(block.len() as u64).to_le_bytes())?;
                w.write_all(block)?;
            }
            Ok(())
        })?;
        let file = SequenceFile {
            version: VERSION,
            source: self.source.clone(),
            x_world_recording: pose_to_rows(&self.x_world_recording),
            x_world_recording_pose: self.x_world_recording,
            // Plain settings always have a JSON form; no program reads the record.
            settings: serde_json::to_value(settings).unwrap_or_default(),
            attached: attached.map(|_| ATTACHED.into()),
            frames: self
                .frames
                .iter()
                .map(|f| FrameEntry {
                    index: f.index,
                    time_s: f.time_s,
                    color: name(f),
                    color_path: f.color_path.clone(),
                    mask_path: f.mask_path.clone(),
                    camera: f.camera,
                    depth_noise: f.depth_noise,
                    gain: f.gain,
                })
                .collect(),
        };
        // Written last, so that a sequence.json always has its images.
        atomic::write_json(&dir.join("sequence.json"), &file)
    }

    /// Reads a sequence that [`Sequence::save_with_settings`] wrote.
    ///
    /// # Errors
    /// [`InputError`] naming the file when it is missing, damaged or of another version.
    pub fn load(dir: &Path) -> Result<Self, FramesError> {
        let (file, geometry) = read_files(dir)?;
        let damaged = || damaged(dir);
        let blocks =
            split_blocks(&geometry).filter(|b| b.len() == 2 * file.frames.len()).ok_or_else(damaged)?;
        let attached = match &file.attached {
            Some(name) => Some(Arc::new(read_png_color(&dir.join(name))?.map(|c| c[0] > 127))),
            None => None,
        };
        let frames: Vec<Result<Frame, FramesError>> = file
            .frames
            .into_par_iter()
            .enumerate()
            .map(|(i, entry)| {
                let color_file = dir.join(&entry.color);
                let color = read_png_color(&color_file)?;
                let k = entry.camera.intrinsics;
                let other_size = |size: (usize, usize), path: &Path| {
                    let what = "the size of this cached image differs from the camera's";
                    (size != (k.width, k.height))
                        .then(|| InputError::new(what, path, "scan the recording again"))
                };
                let masked = attached.as_ref().and_then(|a| other_size(a.size(), &dir.join(ATTACHED)));
                if let Some(error) = other_size(color.size(), &color_file).or(masked) {
                    return Err(error.into());
                }
                let depth =
                    depth_from_bytes(inflate(blocks[2 * i]), k.width, k.height).ok_or_else(damaged)?;
                let normal_c =
                    normals_from_bytes(inflate(blocks[2 * i + 1]), k.width, k.height).ok_or_else(damaged)?;
                Ok(Frame {
                    index: entry.index,
                    time_s: entry.time_s,
                    gain: entry.gain,
                    depth_noise: entry.depth_noise,
                    attached: attached.clone(),
                    color_path: entry.color_path,
                    mask_path: entry.mask_path,
                    ..Frame::new(entry.camera, color, depth, normal_c)
                })
            })
            .collect();
        Ok(Self {
            frames: frames.into_iter().collect::<Result<_, _>>()?,
            x_world_recording: file.x_world_recording_pose,
            source: file.source,
        })
    }
}

/// Reads the cameras and depth images of up to `most` evenly spread frames of a saved sequence, in a fraction of the
/// time of [`Sequence::load`].
///
/// # Errors
/// As [`Sequence::load`].
pub fn load_depths(dir: &Path, most: usize) -> Result<Vec<(Camera, DepthImage)>, FramesError> {
    let (file, geometry) = read_files(dir)?;
    let damaged = || damaged(dir);
    let count = file.frames.len();
    let blocks = split_blocks(&geometry).filter(|b| b.len() == 2 * count).ok_or_else(damaged)?;
    let depths: Vec<Option<(Camera, DepthImage)>> = evenly_spread(count, most)
        .into_par_iter()
        .map(|i| {
            let camera = file.frames[i].camera;
            let size = camera.intrinsics;
            Some((camera, depth_from_bytes(inflate(blocks[2 * i]), size.width, size.height)?))
        })
        .collect();
    Ok(depths.into_iter().collect::<Option<_>>().ok_or_else(damaged)?)
}

/// Reads the record and the packed depth and normals.
fn read_files(dir: &Path) -> Result<(SequenceFile, Vec<u8>), FramesError> {
    let path = dir.join("sequence.json");
    if !path.is_file() {
        return Err(
            InputError::new("this folder holds no loaded sequence", &path, "run `sms scan` first").into()
        );
    }
    let Version { version } = atomic::read_json(&path)?;
    if version != VERSION {
        let what = format!("this sequence has version {version} and this program reads {VERSION}");
        return Err(InputError::new(what, &path, "scan the recording again").into());
    }
    let file: SequenceFile = atomic::read_json(&path)?;
    let path = geometry_file(dir);
    let geometry = std::fs::read(&path).map_err(CoreError::read(&path))?;
    Ok((file, geometry))
}

fn geometry_file(dir: &Path) -> PathBuf {
    dir.join("geometry.bin")
}

fn damaged(dir: &Path) -> InputError {
    InputError::new(
        "the cached depth of this sequence is damaged",
        geometry_file(dir),
        "scan the recording again",
    )
}

fn deflate(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes)?;
    encoder.finish()
}

fn inflate(block: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    ZlibDecoder::new(block).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

fn split_blocks(file: &[u8]) -> Option<Vec<&[u8]>> {
    let mut rest = file.strip_prefix(MAGIC)?;
    let mut blocks = Vec::new();
    while !rest.is_empty() {
        let (length, tail) = rest.split_first_chunk::<8>()?;
        let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
        if length > tail.len() {
            return None;
        }
        let (block, tail) = tail.split_at(length);
        blocks.push(block);
        rest = tail;
    }
    Some(blocks)
}

/// Groups bytes of equal significance, which deflates better than interleaved floats.
fn planar<const N: usize>(values: impl ExactSizeIterator<Item = [u8; N]>) -> Vec<u8> {
    let n = values.len();
    let mut bytes = vec![0; N * n];
    for (i, value) in values.enumerate() {
        for (b, byte) in value.into_iter().enumerate() {
            bytes[b * n + i] = byte;
        }
    }
    bytes
}

fn from_planar<const N: usize>(bytes: &[u8], n: usize) -> Option<Vec<[u8; N]>> {
    (bytes.len() == N * n).then(|| (0..n).map(|i| std::array::from_fn(|b| bytes[b * n + i])).collect())
}

fn depth_bytes(depth: &DepthImage) -> Vec<u8> {
    planar(depth.data.iter().map(|z| z.to_le_bytes()))
}

fn depth_from_bytes(bytes: Option<Vec<u8>>, width: usize, height: usize) -> Option<DepthImage> {
    let values = from_planar::<4>(&bytes?, width * height)?;
    Some(Image::from_vec(width, height, values.into_iter().map(f32::from_le_bytes).collect()))
}

/// Encodes one tag byte, then 16-bit values if every normal lies on the grid (ours do), else the floats.
fn normal_bytes(normals: &NormalImage) -> Vec<u8> {
    let flat = normals.data.as_flattened();
    let on_grid = |v: f32| (v * NORMAL_GRID).round() / NORMAL_GRID;
    let exact = flat.iter().all(|&v| v.abs() <= 1.0 && on_grid(v).to_bits() == v.to_bits());
    let mut bytes = vec![u8::from(!exact)];
    bytes.extend(if exact {
        planar(flat.iter().map(|v| ((v * NORMAL_GRID).round() as i16).to_le_bytes()))
    } else {
        planar(flat.iter().map(|v| v.to_le_bytes()))
    });
    bytes
}

fn normals_from_bytes(bytes: Option<Vec<u8>>, width: usize, height: usize) -> Option<NormalImage> {
    let bytes = bytes?;
    let (&tag, body) = bytes.split_first()?;
    let n = 3 * width * height;
    let flat: Vec<f32> = match tag {
        0 => from_planar::<2>(body, n)?
            .into_iter()
            .map(|b| f32::from(i16::from_le_bytes(b)) / NORMAL_GRID)
            .collect(),
        1 => from_planar::<4>(body, n)?.into_iter().map(f32::from_le_bytes).collect(),
        _ => return None,
    };
    Some(Image::from_vec(width, height, flat.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Intrinsics;

    fn sequence(off_grid: f32) -> Sequence {
        let k = Intrinsics { width: 6, height: 4, fx: 5.1, fy: 5.3, cx: 3.01, cy: 2.2 };
        let pose = DPose3::from_parts(
            glamx::DVec3::new(0.1, 1.0 / 3.0, -2.7),
            glamx::DQuat::from_euler(glamx::EulerRot::XYZ, 0.3, 0.2, 0.7),
        );
        let frame = |index: usize| Frame {
            depth_noise: DepthNoise { a_m: 1e-3, b_per_m: 2e-3 },
            index,
            time_s: (index > 0).then_some(index as f64 / 30.0),
            color_path: PathBuf::from("rec/color.png"),
            gain: [1.0, 1.0 - 0.1 * index as f32, 1.0],
            ..Frame::new(
                Camera::new(k, pose),
                Image::from_vec(6, 4, (0..24).map(|i| [i as u8 * 7, i as u8, index as u8]).collect()),
                Image::from_vec(
                    6,
                    4,
                    (0..24).map(|i| if i % 5 == 0 { 0.0 } else { 1.0 / (i as f32 + 0.3) }).collect(),
                ),
                Image::from_vec(
                    6,
                    4,
                    (0..24).map(|i| [(i as f32 * 1000.0).round() / NORMAL_GRID, off_grid, -1.0]).collect(),
                ),
            )
        };
        Sequence { frames: vec![frame(0), frame(1)], x_world_recording: pose, source: PathBuf::from("rec") }
    }

    #[test]
    fn everything_comes_back_bit_for_bit() {
        let attached = Arc::new(Image::from_vec(6, 4, (0..24).map(|i| i % 7 == 0).collect()));
        for (off_grid, attached) in [(0.0, None), (0.123_456_79, Some(attached))] {
            let dir = tempfile::tempdir().unwrap();
            let mut saved = sequence(off_grid);
            saved.frames.iter_mut().for_each(|f| f.attached = attached.clone());
            saved.save_with_settings(dir.path(), &()).unwrap();
            let read = Sequence::load(dir.path()).unwrap();
            assert_eq!(read.x_world_recording, saved.x_world_recording);
            assert_eq!(read.source, saved.source);
            for (a, b) in read.frames.iter().zip(&saved.frames) {
                assert_eq!(
                    (a.index, a.time_s, &a.color_path, &a.mask_path),
                    (b.index, b.time_s, &b.color_path, &b.mask_path)
                );
                assert!(
                    a.camera == b.camera
                        && a.color == b.color
                        && a.depth == b.depth
                        && a.attached == b.attached
                        && a.gain == b.gain
                        && a.normal_c == b.normal_c
                );
            }
            assert_eq!(read.len(), 2);
        }
    }

    #[test]
    fn a_damaged_cache_is_named() {
        let dir = tempfile::tempdir().unwrap();
        sequence(0.0).save_with_settings(dir.path(), &()).unwrap();
        let path = dir.path().join("geometry.bin");
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 3]).unwrap();
        let faulty = |dir: &Path| match Sequence::load(dir) {
            Err(FramesError::Input(e)) => e.path,
            other => panic!("{other:?}"),
        };
        assert_eq!(faulty(dir.path()), path.display().to_string());
        assert!(faulty(&dir.path().join("no")).ends_with("sequence.json"));
    }

    #[test]
    fn another_version_is_named_whatever_its_fields() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("sequence.json");
        std::fs::write(&path, r#"{"version": 1, "frames": [{"index": 0}]}"#).unwrap();
        let Err(FramesError::Input(e)) = Sequence::load(dir.path()) else { panic!("refused") };
        assert!(e.what.contains("version 1") && e.what.contains(&VERSION.to_string()), "{e}");
    }
}
