//! PNG files: 8-bit colour and 8- or 16-bit grey (depth, labels).

use crate::{ColorImage, CoreError, Image, InputError, atomic};
use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::Path;

fn decode(path: &Path, what: &str) -> Result<(png::OutputInfo, Vec<u8>), CoreError> {
    let file = File::open(path).map_err(|e| {
        InputError::new(
            format!("the {what} image cannot be opened"),
            path,
            "check that the file exists; a recording must have one for every frame",
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
    decoder.set_transformations(png::Transformations::EXPAND);
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
    let (info, bytes) = decode(path, "colour")?;
    let wide = usize::from(info.bit_depth == png::BitDepth::Sixteen) + 1;
    let samples = info.color_type.samples();
    let pixels = bytes
        .chunks_exact(samples * wide)
        .map(|p| if samples < 3 { [p[0]; 3] } else { [p[0], p[wide], p[2 * wide]] })
        .collect();
    Ok(Image::from_vec(info.width as usize, info.height as usize, pixels))
}

/// Reads a grey PNG of 8 or 16 bits as raw values; of a colour image, the first channel.
///
/// # Errors
/// [`CoreError::Input`] naming the file when it is missing, truncated or not a PNG.
pub fn read_png_gray16(path: &Path) -> Result<Image<u16>, CoreError> {
    let (info, bytes) = decode(path, "depth or label")?;
    let samples = info.color_type.samples();
    let pixels = match info.bit_depth {
        png::BitDepth::Sixteen => {
            bytes.chunks_exact(2 * samples).map(|p| u16::from_be_bytes([p[0], p[1]])).collect()
        }
        _ => bytes.chunks_exact(samples).map(|p| u16::from(p[0])).collect(),
    };
    Ok(Image::from_vec(info.width as usize, info.height as usize, pixels))
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
        let message = read_png_gray16(&path).unwrap_err().to_string();
        assert!(message.contains("d.png") && message.contains("cure"), "{message}");
    }
}
