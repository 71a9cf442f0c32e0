//! Depth images of recordings: 16-bit PNG.

use crate::FramesError;
use sms_core::{Image, InputError, damaged_image, missing_image};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Reads width and height from the header alone; the file must be a PNG of 16 bits.
pub(crate) fn depth_size(path: &Path) -> Result<(usize, usize), FramesError> {
    let file = File::open(path).map_err(|e| missing_image("depth", path, e))?;
    let reader =
        png::Decoder::new(BufReader::new(file)).read_info().map_err(|e| damaged_image("depth", path, e))?;
    let info = reader.info();
    if info.bit_depth != png::BitDepth::Sixteen {
        let what = format!("the depth image has {} bits per pixel instead of 16", info.bit_depth as u8);
        let cure = "export depth as 16-bit PNG (a preview or colourised depth image cannot be used)";
        return Err(InputError::new(what, path, cure).into());
    }
    Ok((info.width as usize, info.height as usize))
}

/// Reads a depth image as raw values.
pub(crate) fn read_depth(path: &Path) -> Result<Image<u16>, FramesError> {
    depth_size(path)?;
    sms_core::read_png_gray16(path)
}
