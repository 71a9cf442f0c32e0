//! Colour pictures in PNG and JPEG files.

use crate::{ColorImage, CoreError, Image, InputError, read_png_color};
use jpeg_encoder::{ColorType, Encoder};
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

const PNG_MAGIC: [u8; 8] = *b"\x89PNG\r\n\x1a\n";

/// The error of an image file of a recording that cannot be opened; `kind` is colour or depth.
pub fn missing_image(kind: &str, path: &Path, reason: impl std::fmt::Display) -> InputError {
    InputError::new(
        format!("the {kind} image cannot be opened"),
        path,
        "put the file back, or remove this frame from the recording",
    )
    .because(reason)
}

/// The error of an image file of a recording that cannot be decoded; `kind` is colour or depth.
pub fn damaged_image(kind: &str, path: &Path, reason: impl std::fmt::Display) -> InputError {
    InputError::new(
        format!("the {kind} image is damaged or of an unknown format"),
        path,
        "export or copy this frame again, or remove it from the recording",
    )
    .because(reason)
}

fn damaged(path: &Path, reason: impl std::fmt::Display) -> InputError {
    damaged_image("colour", path, reason)
}

/// Opens a file and tells whether its first bytes are those of a PNG.
fn open(path: &Path) -> Result<(BufReader<File>, bool), InputError> {
    let mut file = File::open(path).map_err(|e| missing_image("colour", path, e))?;
    let mut magic = [0; PNG_MAGIC.len()];
    let is_png = file.read_exact(&mut magic).is_ok() && magic == PNG_MAGIC;
    file.rewind().map_err(|e| missing_image("colour", path, e))?;
    Ok((BufReader::new(file), is_png))
}

fn jpeg_decoder(file: BufReader<File>) -> JpegDecoder<BufReader<File>> {
    // A JPEG's own limit is 65535 pixels a side. Grey and CMYK pictures are converted.
    let options = DecoderOptions::default()
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX))
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    JpegDecoder::new_with_options(file, options)
}

/// Reads the width and height of a PNG or JPEG from its header alone.
///
/// # Errors
/// [`CoreError::Input`] naming the file when it is missing, damaged or of another format.
pub fn read_color_size(path: &Path) -> Result<(usize, usize), CoreError> {
    let (file, is_png) = open(path)?;
    if is_png {
        let reader = png::Decoder::new(file).read_info().map_err(|e| damaged(path, e))?;
        return Ok((reader.info().width as usize, reader.info().height as usize));
    }
    let mut decoder = jpeg_decoder(file);
    decoder.decode_headers().map_err(|e| damaged(path, e))?;
    Ok(decoder.dimensions().ok_or_else(|| damaged(path, "its header has no size"))?)
}

/// Reads a colour picture, PNG or JPEG by its content.
///
/// # Errors
/// [`CoreError::Input`] naming the file when it is missing, damaged or of another format.
pub fn read_color(path: &Path) -> Result<ColorImage, CoreError> {
    let (file, is_png) = open(path)?;
    if is_png {
        return read_png_color(path);
    }
    let mut decoder = jpeg_decoder(file);
    let bytes = decoder.decode().map_err(|e| damaged(path, e))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| damaged(path, "its header has no size"))?;
    let pixels: Vec<[u8; 3]> = bytes.as_chunks().0.to_vec();
    if pixels.len() != width * height {
        return Err(damaged(path, "its pixels do not have three channels").into());
    }
    Ok(Image::from_vec(width, height, pixels))
}

/// Encodes a picture as JPEG of a quality from 1 to 100; the same picture gives the same bytes. Empty pictures and
/// those with a side above 65535 pixels, which the format cannot hold, give no bytes.
pub fn jpeg_bytes(picture: &ColorImage, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    if let (Ok(width), Ok(height)) = (u16::try_from(picture.width), u16::try_from(picture.height)) {
        let encoder = Encoder::new(&mut bytes, quality);
        if encoder.encode(picture.data.as_flattened(), width, height, ColorType::Rgb).is_err() {
            bytes.clear();
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth picture: JPEG keeps it within a few grey values.
    fn ramp(width: usize, height: usize) -> ColorImage {
        let pixel = |i: usize| {
            let (x, y) = (i % width, i / width);
            [(40 + 3 * x) as u8, (200 - 4 * y) as u8, (90 + x + y) as u8]
        };
        Image::from_vec(width, height, (0..width * height).map(pixel).collect())
    }

    fn largest_difference(a: &ColorImage, b: &ColorImage) -> u8 {
        assert_eq!(a.size(), b.size());
        let pairs = a.data.as_flattened().iter().zip(b.data.as_flattened());
        pairs.map(|(a, b)| a.abs_diff(*b)).max().unwrap()
    }

    #[test]
    fn jpegs_of_every_kind_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("picture.dat");
        let picture = ramp(45, 31);
        std::fs::write(&path, jpeg_bytes(&picture, 95)).unwrap();
        assert_eq!(read_color_size(&path).unwrap(), (45, 31));
        assert!(largest_difference(&read_color(&path).unwrap(), &picture) <= 6);

        let mut progressive = Vec::new();
        let mut encoder = Encoder::new(&mut progressive, 95);
        encoder.set_progressive(true);
        encoder.encode(picture.data.as_flattened(), 45, 31, ColorType::Rgb).unwrap();
        std::fs::write(&path, progressive).unwrap();
        assert!(largest_difference(&read_color(&path).unwrap(), &picture) <= 6);

        let grey: Vec<u8> = picture.data.iter().map(|p| p[0]).collect();
        let mut bytes = Vec::new();
        Encoder::new(&mut bytes, 95).encode(&grey, 45, 31, ColorType::Luma).unwrap();
        std::fs::write(&path, bytes).unwrap();
        assert!(largest_difference(&read_color(&path).unwrap(), &picture.map(|p| [p[0]; 3])) <= 6);
    }

    #[test]
    fn pngs_are_told_by_their_content() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("picture.jpg");
        crate::write_png_color(&path, &ramp(7, 5)).unwrap();
        assert_eq!(read_color_size(&path).unwrap(), (7, 5));
        assert_eq!(read_color(&path).unwrap(), ramp(7, 5));
    }

    #[test]
    fn files_that_are_no_picture_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("picture.jpg");
        let whole = jpeg_bytes(&ramp(40, 30), 90);
        let png = {
            crate::write_png_color(&path, &ramp(40, 30)).unwrap();
            std::fs::read(&path).unwrap()
        };
        for bytes in [&b""[..], b"no picture", &whole[..20], &png[..20]] {
            std::fs::write(&path, bytes).unwrap();
            assert!(matches!(read_color(&path), Err(CoreError::Input(_))), "{} bytes", bytes.len());
            assert!(matches!(read_color_size(&path), Err(CoreError::Input(_))), "{} bytes", bytes.len());
        }
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(read_color(&path), Err(CoreError::Input(_))));
    }

    #[test]
    fn jpegs_hold_no_empty_and_no_endless_pictures() {
        assert!(jpeg_bytes(&Image::from_vec(0, 0, Vec::new()), 80).is_empty());
        assert!(jpeg_bytes(&Image::filled(70_000, 1, [0; 3]), 80).is_empty());
        let bytes = jpeg_bytes(&ramp(8, 8), 80);
        assert_eq!((&bytes[..3], bytes == jpeg_bytes(&ramp(8, 8), 80)), (&[0xFF, 0xD8, 0xFF][..], true));
    }
}
