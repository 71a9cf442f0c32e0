//! PNG files: 8-bit colour and 8- or 16-bit grey (depth, labels).

use crate::{ColorImage, CoreError, Image, InputError, atomic};
use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::Path;

fn decode(
    path: &Path,
    what: &str,
    transformations: png::Transformations,
) -> Result<(png::OutputInfo, Vec<u8>), CoreError> {
    let file = File::open(path).map_err(|e| {
        InputError::new(
            format!("the {what} image cannot be opened"),
            path,
            "check that the file exists: a recording needs one for every frame",
        )
        .because(e)
    })?;
    let damaged = |e: png::DecodingError| {
        InputError::new(
            format!("the {what} image is damaged or not a PNG"),
            path,
            "export or copy this frame again, or remove it from the recording",
        )
        .because(e)
    };
    let mut decoder = png::Decoder::new(BufReader::new(file));
    decoder.set_transformations(transformations);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let size = reader.output_buffer_size().ok_or_else(|| {
        InputError::new(format!("the {what} image is too large"), path, "use images of a usual size")
    })?;
    let mut buffer = vec![0; size];
    let info = reader.next_frame(&mut buffer).map_err(damaged)?;
    buffer.truncate(info.buffer_size());
    Ok((info, buffer))
}

/// Reads a colour PNG (grey and palette are expanded, alpha is dropped, 16 bits are reduced to 8).
///
/// # Errors
/// [`CoreError::Input`] naming the file when it is missing, truncated or not a PNG.
pub fn read_png_color(path: &Path) -> Result<ColorImage, CoreError> {
    let (info, bytes) = decode(path, "colour", png::Transformations::EXPAND)?;
    let wide = usize::from(info.bit_depth == png::BitDepth::Sixteen) + 1;
    let samples = info.color_type.samples();
    let pixels = bytes
        .chunks_exact(samples * wide)
        .map(|p| if samples < 3 { [p[0]; 3] } else { [p[0], p[wide], p[2 * wide]] })
        .collect();
    Ok(Image::from_vec(info.width as usize, info.height as usize, pixels))
}

/// Reads a grey PNG of 8 or 16 bits as raw values, or the first channel of a colour image. For labels see
/// [`read_png_labels`].
///
/// # Errors
/// [`CoreError::Input`] naming the file when it is missing, truncated or not a PNG.
pub fn read_png_gray16(path: &Path) -> Result<Image<u16>, CoreError> {
    let (info, bytes) = decode(path, "depth", png::Transformations::EXPAND)?;
    let samples = info.color_type.samples();
    let pixels = match info.bit_depth {
        png::BitDepth::Sixteen => {
            bytes.chunks_exact(2 * samples).map(|p| u16::from_be_bytes([p[0], p[1]])).collect()
        }
        _ => bytes.chunks_exact(samples).map(|p| u16::from(p[0])).collect(),
    };
    Ok(Image::from_vec(info.width as usize, info.height as usize, pixels))
}

/// Reads a label image: the stored values of a grey PNG of 1 to 16 bits, or the palette indices of a palette PNG (as in the
/// VOC and DAVIS data sets). A colour image counts as grey if all its channels agree.
///
/// # Errors
/// [`CoreError::Input`] naming the file when it is missing, truncated, not a PNG, or in colour.
pub fn read_png_labels(path: &Path) -> Result<Image<u16>, CoreError> {
    let (info, bytes) = decode(path, "label", png::Transformations::IDENTITY)?;
    let samples = info.color_type.samples();
    let (width, height) = (info.width as usize, info.height as usize);
    let mut pixels = Vec::with_capacity(width * height);
    // Rows of packed values begin at byte boundaries.
    for row in bytes.chunks_exact(info.line_size.max(1)) {
        let values: Vec<u16> = match info.bit_depth {
            png::BitDepth::Sixteen => row.chunks_exact(2).map(|p| u16::from_be_bytes([p[0], p[1]])).collect(),
            png::BitDepth::Eight => row.iter().map(|&v| u16::from(v)).collect(),
            // Grey or palette: one sample per pixel.
            depth => {
                let bits = depth as usize;
                let (each, mask) = (8 / bits, (1u16 << bits) - 1);
                let value = |x: usize| (u16::from(row[x / each]) >> (8 - bits * (x % each + 1))) & mask;
                (0..width).map(value).collect()
            }
        };
        pixels.extend(labels_of(&values, samples, path)?);
    }
    Ok(Image::from_vec(width, height, pixels))
}

/// Returns the labels of a row of pixels with `samples` samples each; alpha is dropped.
fn labels_of(values: &[u16], samples: usize, path: &Path) -> Result<Vec<u16>, InputError> {
    let label = |p: &[u16]| (samples < 3 || (p[0] == p[1] && p[0] == p[2])).then_some(p[0]);
    values.chunks_exact(samples).map(label).collect::<Option<_>>().ok_or_else(|| {
        InputError::new(
            "this label image is a colour image: the objects of its colours are unknown",
            path,
            "export labels as a grey or palette PNG with one value for each object and 0 for the background",
        )
    })
}

fn encode(
    path: &Path,
    size: (usize, usize),
    color: png::ColorType,
    depth: png::BitDepth,
    bytes: &[u8],
) -> Result<(), CoreError> {
    let mut out = Cursor::new(Vec::new());
    let encoded = (|| {
        let mut encoder = png::Encoder::new(&mut out, size.0 as u32, size.1 as u32);
        encoder.set_color(color);
        encoder.set_depth(depth);
        encoder.set_compression(png::Compression::Fast);
        encoder.write_header()?.write_image_data(bytes)
    })();
    encoded.map_err(|e| CoreError::Write { path: path.to_owned(), source: std::io::Error::other(e) })?;
    atomic::write_bytes(path, out.get_ref())
}

/// Writes an 8-bit colour PNG atomically.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_png_color(path: &Path, image: &ColorImage) -> Result<(), CoreError> {
    encode(path, image.size(), png::ColorType::Rgb, png::BitDepth::Eight, image.data.as_flattened())
}

/// Writes a 16-bit grey PNG atomically.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_png_gray16(path: &Path, image: &Image<u16>) -> Result<(), CoreError> {
    let bytes: Vec<u8> = image.data.iter().flat_map(|v| v.to_be_bytes()).collect();
    encode(path, image.size(), png::ColorType::Grayscale, png::BitDepth::Sixteen, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(path: &Path, color: png::ColorType, depth: png::BitDepth, width: u32, bytes: &[u8]) {
        let mut encoder = png::Encoder::new(File::create(path).unwrap(), width, 2);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == png::ColorType::Indexed {
            // The first colours of the VOC palette: black, dark red, dark green, olive.
            encoder.set_palette(vec![0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0]);
        }
        encoder.write_header().unwrap().write_image_data(bytes).unwrap();
    }

    #[test]
    fn labels_are_the_stored_values_of_any_grey_or_palette() {
        use png::{BitDepth, ColorType};
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.png");
        let expected = Image::from_vec(3, 2, vec![0, 1, 2, 3, 2, 1]);
        let packed = [0b0001_1000, 0b1110_0100];
        for (color, depth, bytes) in [
            (ColorType::Indexed, BitDepth::Eight, vec![0, 1, 2, 3, 2, 1]),
            (ColorType::Indexed, BitDepth::Two, packed.to_vec()),
            (ColorType::Grayscale, BitDepth::Two, packed.to_vec()),
            (ColorType::Grayscale, BitDepth::Four, vec![0x01, 0x20, 0x32, 0x10]),
            (ColorType::Grayscale, BitDepth::Eight, vec![0, 1, 2, 3, 2, 1]),
            (ColorType::Grayscale, BitDepth::Sixteen, vec![0, 0, 0, 1, 0, 2, 0, 3, 0, 2, 0, 1]),
            (ColorType::GrayscaleAlpha, BitDepth::Eight, vec![0, 9, 1, 9, 2, 9, 3, 9, 2, 9, 1, 9]),
            (ColorType::Rgb, BitDepth::Eight, vec![0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 2, 2, 2, 1, 1, 1]),
        ] {
            write(&path, color, depth, 3, &bytes);
            assert_eq!(read_png_labels(&path).unwrap(), expected, "{color:?} {depth:?}");
        }
        write(&path, ColorType::Grayscale, BitDepth::One, 3, &[0b1010_0000, 0b0100_0000]);
        assert_eq!(read_png_labels(&path).unwrap().data, [1, 0, 1, 0, 1, 0]);
        write(&path, ColorType::Rgb, BitDepth::Eight, 1, &[0, 128, 0, 0, 0, 0]);
        assert!(matches!(read_png_labels(&path), Err(CoreError::Input(e)) if e.path.ends_with("m.png")));
    }

    #[test]
    fn images_round_trip_and_truncation_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.png");
        let depth = Image::from_vec(5, 3, (0..15).map(|i| i * 4321).collect());
        write_png_gray16(&path, &depth).unwrap();
        assert_eq!(read_png_gray16(&path).unwrap(), depth);
        let color = Image::from_vec(3, 2, (0..6).map(|i| [i, 2 * i, 255 - i]).collect());
        let color_path = dir.path().join("c.png");
        write_png_color(&color_path, &color).unwrap();
        assert_eq!(read_png_color(&color_path).unwrap(), color);
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 20]).unwrap();
        assert!(matches!(read_png_gray16(&path), Err(CoreError::Input(e)) if e.path.ends_with("d.png")));
    }
}
