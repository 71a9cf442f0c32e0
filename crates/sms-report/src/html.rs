//! Helpers for HTML text.

use crate::photo::photo_address;
use base64::Engine;
use sms_core::{ColorImage, CoreError, escape_xml, write_png_color};
use sms_task::Parameter;
use std::fmt::Write;
use std::path::Path;

/// Colours of predicted and of realised motion and values, in all figures.
pub(crate) const PREDICTED: &str = "#2563c9";
pub(crate) const REALISED: &str = "#bf520a";
/// Id of the page's photograph, which the labelled picture and the 3-D view also show.
pub(crate) const PHOTO_ID: &str = "photo";

/// Formats an sRGB colour for CSS and SVG.
pub(crate) fn rgb([r, g, b]: [u8; 3]) -> String {
    format!("rgb({r},{g},{b})")
}

/// Encodes bytes for JSON and for `data:` addresses.
pub(crate) fn base64_of(bytes: &[u8]) -> String {
    base64::engine::general_purpose::STANDARD.encode(bytes)
}

/// Writes a picture as PNG; returns it as JPEG in the address of an image in a page without other files. The page stays
/// small and the file exact.
pub(crate) fn write_picture(path: &Path, picture: &ColorImage) -> Result<String, CoreError> {
    write_png_color(path, picture)?;
    Ok(photo_address(picture))
}

/// Returns the table of an action's values and the ranges that were searched.
pub(crate) fn action_table(parameters: &[Parameter], values: &[f64], decimals: usize) -> String {
    let mut html = String::from(
        "<div class=\"scroll\"><table><tr><th scope=\"col\">action</th><th scope=\"col\">value</th><th scope=\"col\">range searched</th></tr>",
    );
    for (p, value) in parameters.iter().zip(values) {
        let _ = write!(
            html,
            "<tr><td>{}</td><td>{value:.decimals$} {unit}</td><td>{:.3} to {:.3} {unit}</td></tr>",
            escape_xml(&p.name),
            p.low,
            p.high,
            unit = escape_xml(&p.unit)
        );
    }
    html + "</table></div>"
}
