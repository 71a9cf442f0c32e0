//! Image files of recordings: PNG and JPEG colour, 16-bit PNG depth.

use crate::FramesError;
use image::ImageReader;
use sms_core::{ColorImage, Image, InputError};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

fn is_png(path: &Path) -> bool {
    let mut magic = [0u8; 8];
    File::open(path).and_then(|mut f| f.read_exact(&mut magic)).is_ok() && magic == *b"\x89PNG\r\n\x1a\n"
}

fn missing(kind: &str, path: &Path, reason: impl std::fmt::Display) -> InputError {
    InputError::new(
        format!("the {kind} image cannot be opened"),
        path,
        "put the file back, or remove this frame from the recording",
    )
    .because(reason)
}

fn damaged(kind: &str, path: &Path, reason: impl std::fmt::Display) -> InputError {
    InputError::new(
        format!("the {kind} image is damaged or of an unknown format"),
        path,
        "export or copy this frame again, or remove it from the recording",
    )
    .because(reason)
}

fn open_color(path: &Path) -> Result<ImageReader<BufReader<File>>, FramesError> {
    let reader = ImageReader::open(path).map_err(|e| missing("colour", path, e))?;
    Ok(reader.with_guessed_format().map_err(|e| damaged("colour", path, e))?)
}

/// Reads width and height from the header alone.
pub(crate) fn color_size(path: &Path) -> Result<(usize, usize), FramesError> {
    let (w, h) = open_color(path)?.into_dimensions().map_err(|e| damaged("colour", path, e))?;
    Ok((w as usize, h as usize))
}

/// Reads width and height from the header alone; the file must be a PNG of 16 bits.
pub(crate) fn depth_size(path: &Path) -> Result<(usize, usize), FramesError> {
    let file = File::open(path).map_err(|e| missing("depth", path, e))?;
    let reader =
        png::Decoder::new(BufReader::new(file)).read_info().map_err(|e| damaged("depth", path, e))?;
    let info = reader.info();
    if info.bit_depth != png::BitDepth::Sixteen {
        let what = format!("the depth image has {} bits per pixel instead of 16", info.bit_depth as u8);
        let cure = "export depth as 16-bit PNG (a preview or colourised depth image cannot be used)";
        return Err(InputError::new(what, path, cure).into());
    }
    Ok((info.width as usize, info.height as usize))
}

/// Reads a colour image, PNG or JPEG.
pub(crate) fn read_color(path: &Path) -> Result<ColorImage, FramesError> {
    if is_png(path) {
        return sms_core::read_png_color(path);
    }
    let rgb = open_color(path)?.decode().map_err(|e| damaged("colour", path, e))?.to_rgb8();
    let (w, h) = (rgb.width() as usize, rgb.height() as usize);
    Ok(Image::from_vec(w, h, rgb.pixels().map(|p| p.0).collect()))
}

/// Reads a depth image as raw values.
pub(crate) fn read_depth(path: &Path) -> Result<Image<u16>, FramesError> {
    depth_size(path)?;
    sms_core::read_png_gray16(path)
}
